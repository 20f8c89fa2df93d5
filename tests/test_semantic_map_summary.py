"""What the behavior model is told of a map, what it leaves out, and what nobody has spoken of."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

import jaxlangnav
from jaxlangnav import navigator
from jaxlangnav.grounding import Context
from jaxlangnav.grounding.behavior import MAX_SLOTS, most_relevant_slots
from jaxlangnav.inputs.object_types import type_code
from jaxlangnav.messages import BEHIND, LEFT, NEAR, NONE, ROBOT, BehaviorWorld
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import unreferenced_objects as objects
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.semantic_map.summary import behavior_world, distinct_topologies

HYDRANT, CONE, CAR = by_hand.HYDRANT, by_hand.CONE, by_hand.CAR
P, SLOTS = 40, 4
CONFIG = MapConfig(num_particles=P, num_objects=SLOTS, num_cells=24)


def test_distinct_topologies_equal_a_plain_comparison() -> None:
    random = np.random.default_rng(0)
    particles = by_hand.begin(config=CONFIG).particles
    particles = replace(
        particles,
        object_type=jnp.asarray(random.choice([NONE, 0, 7], (SLOTS, P), p=[0.8, 0.1, 0.1])),
        referent=jnp.asarray(random.choice([NONE, 3], (by_hand.M, P), p=[0.8, 0.2])),
        reading=jnp.asarray(random.integers(0, 2, P)),
        is_mentioned=jnp.asarray(random.uniform(size=(by_hand.M, P)) < 0.9),
    )
    topology, first, count = jax.jit(distinct_topologies)(particles)
    names = ("object_type", "referent", "is_mentioned", "reading")
    told = [np.atleast_2d(getattr(particles, name)) for name in names]
    rows: list[list] = []
    for index, row in enumerate(np.concatenate(told).T.tolist()):
        if row not in rows:
            rows.append(row)
            assert int(first[len(rows) - 1]) == index
        assert int(topology[index]) == rows.index(row)
    assert int(count) == len(rows)
    assert 3 < len(rows) < P
    assert (np.asarray(first)[len(rows) :] == P).all()


def test_world_of_a_particle_by_hand() -> None:
    """Slot 1 is the cone meant, the hydrant is only hypothesised; the robot comes last."""
    objects = [(HYDRANT, 1.0, 1.0), (CONE, 2.0, 0.0)]
    belief = by_hand.with_objects(by_hand.begin(config=CONFIG), objects)
    one = jax.tree.map(lambda leaf: leaf[..., 0], belief.particles)
    referent, is_mentioned = jnp.array([NONE, 1, NONE]), jnp.array([True, True, False])
    one = replace(one, referent=referent, is_mentioned=is_mentioned)
    edges = [(0, BEHIND, 1, False), (1, LEFT, 2, True)]
    sentence = by_hand.readings([[HYDRANT, CONE, ROBOT]], [edges])
    world = jax.jit(behavior_world)(one, sentence, jnp.int32(0))
    robot, hypothesis = SLOTS + by_hand.M, SLOTS
    assert world.object_type.tolist() == [HYDRANT, CONE, NONE, NONE, HYDRANT, NONE, NONE, ROBOT]
    assert np.flatnonzero(world.is_object).tolist() == [0, 1, hypothesis, robot]
    edges = {tuple(edge) for edge in np.argwhere(np.asarray(world.is_related)).tolist()}
    assert edges == {(BEHIND, hypothesis, 1), (LEFT, 1, robot)}
    extremes = np.argwhere(np.asarray(world.is_superlative)).tolist()
    assert extremes == [[LEFT, 1, robot]]
    assert np.flatnonzero(world.is_previous).tolist() == [0]
    assert not np.asarray(world.is_related)[NEAR].any()


REMEMBER, PROMOTE = jax.jit(objects.add_bystanders), jax.jit(objects.exchange)
HERE = (jnp.float32(0.0), jnp.float32(0.0), jnp.float32(1e-4))


def spoken(*kinds: int) -> jax.Array:
    return jnp.isin(jnp.arange(16), jnp.array(kinds))


def see(known, *things):
    look = by_hand.observation(np.zeros(3), list(things))
    return REMEMBER(known, jax.tree.map(jnp.asarray, look), HERE)


def test_one_thing_seen_often_is_one_thing_placed_better() -> None:
    known, lost = see(objects.no_bystanders(4), (CAR, 1.0, 0.0), (CAR, 2.5, 0.0), (CONE, 1.0, 0.1))
    first = known.variance[0]
    for _ in range(3):
        known, lost = see(known, (CAR, 1.2, 0.0))
    assert int(lost) == 0
    np.testing.assert_array_equal(known.object_type, [CAR, CAR, CONE, NONE])
    assert 1.1 < known.x[0] < 1.2
    np.testing.assert_allclose(known.variance[0], first / 4, rtol=1e-5)
    # What the particles knew to be red is seen without its colour.
    red = type_code(CAR, 1)
    known, _ = see(replace(known, object_type=known.object_type.at[0].set(red)), (CAR, 1.2, 0.0))
    np.testing.assert_array_equal(known.object_type, [red, CAR, CONE, NONE])


def test_what_finds_no_room_is_counted() -> None:
    things = [(CAR, 1.0, 0.0), (CAR, -1.0, 0.0), (CAR, 0.0, 2.0)]
    known, lost = see(objects.no_bystanders(2), *things)
    assert int(lost) == 1
    np.testing.assert_array_equal(known.object_type, [CAR, CAR])


def test_observation_is_parted_by_what_the_task_speaks_of() -> None:
    look = by_hand.observation(np.zeros(3), [(CAR, 1.0, 0.0), (CONE, 1.0, 1.0)])
    ours, others = objects.split_by_type(jax.tree.map(jnp.asarray, look), spoken(CONE))
    np.testing.assert_array_equal(ours.is_detection[:2], [False, True])
    np.testing.assert_array_equal(others.is_detection[:2], [True, False])


def test_another_sentence_exchanges_what_is_spoken_of() -> None:
    belief = by_hand.with_objects(by_hand.begin(), [(HYDRANT, 3.0, 1.0), (CONE, 2.0, 0.0)])
    known, _ = see(objects.no_bystanders(4), (CAR, 1.0, 1.0), (CAR, -1.0, 0.0))
    told = spoken(CAR, CONE)
    after, listed = PROMOTE(belief.particles, known, told, belief.log_weight, True)
    np.testing.assert_array_equal(after.object_type[:3, 0], [CAR, CONE, CAR])
    np.testing.assert_allclose(after.mean_x[:3, 5], [1.0, 2.0, -1.0], atol=1e-5)
    assert after.covariance[0, 0, 0] > 1e-3
    assert float(jnp.abs(after.covariance[0, 1:]).max()) == 0.0
    assert sorted(np.asarray(listed.object_type).tolist()) == [NONE, NONE, NONE, HYDRANT]
    back, listed = PROMOTE(after, listed, spoken(HYDRANT), belief.log_weight, True)
    np.testing.assert_array_equal(back.object_type[:3, 0], [HYDRANT, NONE, NONE])
    np.testing.assert_allclose(back.mean_x[0], 3.0)
    assert int(jnp.sum(listed.is_filled)) == 3


def test_nothing_is_exchanged_until_something_is_said() -> None:
    belief = by_hand.with_objects(by_hand.begin(), [(HYDRANT, 3.0, 1.0)])
    known, _ = see(objects.no_bystanders(4), (CAR, 1.0, 1.0))
    after, listed = PROMOTE(belief.particles, known, spoken(CAR), belief.log_weight, False)
    jax.tree.map(np.testing.assert_array_equal, (after, listed), (belief.particles, known))


TREE = 2


def test_slots_are_kept_by_what_the_words_say_of_them() -> None:
    size = 50
    kind = np.full(size, TREE, np.int32)
    kind[40], kind[44], kind[47], kind[-1] = HYDRANT, CONE, NONE, ROBOT
    related = np.zeros((6, size, size), bool)
    related[1, 46, 44] = True  # of a tree, the last but a few
    world = BehaviorWorld(
        object_type=jnp.asarray(kind),
        is_object=jnp.asarray(kind != NONE),
        is_related=jnp.asarray(related),
        is_superlative=jnp.zeros((6, size, size), bool),
        is_ordinal=jnp.zeros((6, size, size), bool),
        is_previous=jnp.arange(size) == 45,
    )
    kept, slots = most_relevant_slots(world, jnp.arange(16) <= CONE)
    assert slots.shape == (MAX_SLOTS,)
    assert {40, 44, 45, 46, size - 1} <= set(np.asarray(slots).tolist())
    assert 47 not in slots
    assert kept.object_type[-1] == ROBOT
    np.testing.assert_array_equal(kept.object_type, kind[slots])
    figure, landmark = (int(np.flatnonzero(slots == slot)[0]) for slot in (46, 44))
    assert bool(kept.is_related[1, figure, landmark])
    assert int(kept.is_related.sum()) == 1


def test_forty_slots_fit_into_a_cycle() -> None:
    robot = jaxlangnav.Navigator.pretrained()
    config = NavigatorConfig(
        map=MapConfig(num_objects=40, num_bystanders=64, has_doubts=True),
        planner=PlannerConfig(policy="informed"),
    )
    # Without a conversation: one tells apart 31 slots at most.
    with pytest.raises(ValueError, match="at most 31"):
        dataclasses.replace(robot, config=config)
    told = robot.grounder.ground("go to the hydrant behind the cone", Context(is_under_way=False))
    area = jnp.array([-8.0, 8.0, -8.0, 8.0])
    state = navigator.start(told.instruction, jnp.zeros(3), area, config=config)
    seen = by_hand.observation(np.zeros(3), [], size=4)
    after, _, info = jax.eval_shape(
        lambda key, now: navigator.step(key, now, seen, params=robot.params, config=config),
        jax.random.key(0),
        state,
    )
    assert after.belief.particles.object_type.shape == (40, 64)
    assert info.behavior.goal.shape == (7, 40 + 6 + 1)
