"""What the behavior model is told of a particle, and which particles are told the same."""

import jax
import jax.numpy as jnp
import numpy as np
import readings as by_hand

from jaxlangnav.messages import BEHIND, LEFT, NEAR, NONE, ROBOT
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.semantic_map.summary import behavior_world, distinct_topologies

HYDRANT, CONE = by_hand.HYDRANT, by_hand.CONE
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
    rows: list[tuple] = []
    for index in range(P):
        row = tuple(
            np.concatenate(
                [
                    particles.object_type[:, index],
                    particles.referent[:, index],
                    particles.is_mentioned[:, index],
                    particles.reading[index][None],
                ]
            ).tolist()
        )
        if row not in rows:
            rows.append(row)
            assert int(first[len(rows) - 1]) == index
        assert int(topology[index]) == rows.index(row)
    assert int(count) == len(rows)
    assert 3 < len(rows) < P
    assert (np.asarray(first)[len(rows) :] == P).all()


def test_world_of_a_particle_by_hand() -> None:
    """Slot 1 is the cone meant, the hydrant is only hypothesised; the robot comes last."""
    belief = by_hand.with_objects(
        by_hand.begin(config=CONFIG), [(HYDRANT, 1.0, 1.0), (CONE, 2.0, 0.0)]
    )
    one = jax.tree.map(lambda leaf: leaf[..., 0], belief.particles)
    one = replace(
        one,
        referent=jnp.array([NONE, 1, NONE]),
        is_mentioned=jnp.array([True, True, False]),
    )
    sentence = by_hand.readings(
        [[HYDRANT, CONE, ROBOT]], [[(0, BEHIND, 1, False), (1, LEFT, 2, True)]]
    )
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
