"""What lies between two others is found in random worlds, where others of its noun stand about."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from placed import placed

from jaxlangnav.episode import Task, lanes
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import Status, default_motion, default_sensor
from jaxlangnav.navigator import default_params
from jaxlangnav.relations.between import lies_between
from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.state import NUM_SLOTS, Scenario

# Command → its goal, its landmarks, and what else stands about: two more of the goal's noun each.
COMMANDS = {
    "go to the hydrant between the cone and the car": ("hydrant", ("cone", "car"), 2),
    "go to the bench between the two trees": ("bench", ("tree", "tree"), 2),
    "go to the cone that is between the cone and the tree": ("cone", ("cone", "tree"), 1),
}
WORLDS_EACH = 14
HALF = 11.0
"""Metres, half a side of the area; the robot starts in its middle."""
RANGE, MAX_STEPS = 5.0, 120


def places_of(random: np.random.Generator, goal: str, landmarks: tuple, num_others: int):
    """Draw places [n, 2] of goal, landmarks and others, until only the goal lies between."""
    kinds = [goal, *landmarks, *[goal] * num_others]
    while True:
        places = random.uniform(-HALF + 1.0, HALF - 1.0, (len(kinds), 2))
        way = places[2] - places[1]
        length, share = np.linalg.norm(way), random.uniform(0.35, 0.65)
        aside = random.uniform(-0.1, 0.1) * np.array([-way[1], way[0]])
        places[0] = places[1] + share * way + aside
        gaps = np.linalg.norm(places[:, None] - places[None], axis=-1) + 99.0 * np.eye(len(kinds))
        is_apart = gaps.min() > 1.4 and gaps[0, 3:].min() > 3.0
        if not (4.0 <= length <= 9.0 and is_apart and np.linalg.norm(places, axis=1).min() > 1.5):
            continue
        between = [
            (figure, one, other)
            for figure in range(len(kinds))
            for one in range(len(kinds))
            for other in range(len(kinds))
            if kinds[figure] == goal and (kinds[one], kinds[other]) == landmarks
            if len({figure, one, other}) == 3
            if lies_between(*places[[figure, one, other]])
        ]
        if {figure for figure, _, _ in between} == {0}:
            return kinds, places


def scenario_of(kinds: list[str], places: np.ndarray, names: tuple[str, ...]) -> Scenario:
    rows = [(names.index(kind), *at) for kind, at in zip(kinds, places, strict=True)]
    return placed(rows, slots=NUM_SLOTS, area=(-HALF, HALF, -HALF, HALF), goal=0)


@pytest.mark.slow
def test_what_lies_between_is_found_among_others() -> None:
    """Nothing is known at the start; of three of the noun one lies between."""
    model, random = load_shipped(), np.random.default_rng(17)
    tasks = []
    for index, command in enumerate(COMMANDS):
        for number in range(WORLDS_EACH):
            world = scenario_of(*places_of(random, *COMMANDS[command]), model.type_names)
            tasks.append(
                Task(
                    key=jax.random.key(100 * index + number),
                    scenario=jax.tree.map(jnp.asarray, world),
                    instruction_index=jnp.int32(index),
                    sensor=default_sensor(RANGE),
                    motion=default_motion(),
                )
            )
    instructions = [understand(command, model).instruction for command in COMMANDS]
    result = lanes.run_batch(
        jax.tree.map(lambda *leaves: jnp.stack(leaves), *tasks),
        jax.tree.map(lambda *leaves: jnp.stack(leaves), *instructions),
        params=default_params(),
        config=navigator_config("informed"),
        num_lanes=len(tasks),
        max_steps=MAX_STEPS,
    )
    has_arrived = np.asarray(result.ending) == Status.ARRIVED
    is_there = np.asarray(result.goal_distance) <= SUCCESS_RADIUS
    is_right = has_arrived & is_there
    assert is_right.mean() >= 0.95, np.flatnonzero(~is_right)
    is_wrong = has_arrived & ~is_there
    assert not is_wrong.any(), np.flatnonzero(is_wrong)
