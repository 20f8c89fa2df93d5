"""More slots than a mask of bits holds: the words' own things come first, and nothing breaks."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxlangnav
from jaxlangnav import messages, navigator
from jaxlangnav.grounding import Context
from jaxlangnav.grounding.behavior import MAX_SLOTS
from jaxlangnav.messages import NONE, ROBOT, BehaviorWorld
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.semantic_map.behaviors import likeliest_slots
from jaxlangnav.semantic_map.params import MapConfig

HYDRANT, CONE, TREE = 0, 1, 2


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
        is_later=jnp.zeros((6, size, size), bool),
        is_previous=jnp.arange(size) == 45,
    )
    kept, slots = likeliest_slots(world, jnp.arange(16) <= CONE)
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
    seen = messages.Observation(
        pose=jnp.zeros(3),
        detection_type=jnp.full(4, NONE, jnp.int32),
        detection_range=jnp.zeros(4),
        detection_bearing=jnp.zeros(4),
        is_detection=jnp.zeros(4, bool),
        sensor=messages.default_sensor(),
    )
    after, _, info = jax.eval_shape(
        lambda key, now: navigator.step(key, now, seen, params=robot.params, config=config),
        jax.random.key(0),
        state,
    )
    assert after.belief.particles.object_type.shape == (40, 64)
    assert info.behavior.goal.shape == (7, 40 + 6 + 1)
