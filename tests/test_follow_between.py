"""What lies between two others is found in random worlds, where others of its noun stand about."""

import numpy as np
import pytest
from hand_geometry import Place
from test_spoken_driven import EXTENT, follow

from jaxlangnav.messages import Status
from jaxlangnav.relations.between import lies_between
from jaxlangnav.world.simulator import SUCCESS_RADIUS

# Command → its goal, its landmarks, and what else stands about: two more of the goal's noun each.
COMMANDS = {
    "go to the hydrant between the cone and the car": ("hydrant", ("cone", "car"), 2),
    "go to the bench between the two trees": ("bench", ("tree", "tree"), 2),
    "go to the cone that is between the cone and the tree": ("cone", ("cone", "tree"), 1),
}
WORLDS_EACH = 14


def draw_world(random: np.random.Generator, goal: str, landmarks: tuple, num_others: int) -> Place:
    """Draw a goal, landmarks and others, until only the goal lies between."""
    kinds = [goal, *landmarks, *[goal] * num_others]
    while True:
        places = random.uniform(1.0 - EXTENT, EXTENT - 1.0, (len(kinds), 2))
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
            return Place(tuple(kinds), places)


@pytest.mark.slow
def test_what_lies_between_is_found_among_others() -> None:
    """Nothing is known at the start; of three of the noun one lies between."""
    random = np.random.default_rng(17)
    cases = [
        (command, draw_world(random, *about))
        for command, about in COMMANDS.items()
        for _ in range(WORLDS_EACH)
    ]
    found = follow(cases)
    has_arrived = np.array([ended == Status.ARRIVED for _, ended, _ in found])
    ends = np.array(
        [path[-1] - world.at[0] for (path, *_), (_, world) in zip(found, cases, strict=True)]
    )
    is_there = np.hypot(*ends.T) <= SUCCESS_RADIUS
    is_right = has_arrived & is_there
    assert is_right.mean() >= 0.95, np.flatnonzero(~is_right)
    assert not (has_arrived & ~is_there).any(), np.flatnonzero(has_arrived & ~is_there)
