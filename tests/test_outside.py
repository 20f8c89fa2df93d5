"""Another pair of eyes: a world that shares no code with ours drives ``Navigator``."""

import avoiding
import numpy as np
import outside
import pytest
import searching
import stepping
from stepping import one_by_one

RIGHT = {
    "plain": 0.99,
    "false": 0.99,
    "pairs_3": 0.98,
    "pairs_5": 0.98,
    "crowd": 0.97,
    "misses": 0.98,
    "bystanders": 0.995,
    "ghosts_2": 0.99,
    "ghosts_10": 0.97,
    "labels": 0.96,
    "bad_detector": 0.95,
    "drift": 0.95,
    "steady_drift": 0.95,
    "nowhere": 0.99,
    "wall": 0.98,
}
"""Share of episodes that must end at the goal."""
MAX_METRES = {"false": 45.0, "nowhere": 65.0}
"""Metres walked on average that a scenario may cost."""
WAYS = {
    "behind": 16.5, "none": 24.0, "pairs": 20.0, "front": 38.0, "false": 48.0, "empty": 82.0,
    "no_landmark": 82.0, "large_behind": 80.0, "large_none": 88.0,
}  # fmt: skip
"""The same of a row of ``searching``."""
EPISODES = 200


def test_places_hold_what_is_asked_for() -> None:
    random, types = np.random.default_rng(0), ("car", "cone", "hydrant", "tree")
    place = outside.furnish(random, outside.Scenario(extra_pairs=2, bystanders=3), types)
    assert [types[kind] for kind in place.kind].count("hydrant") == 3
    assert len(place.kind) == len(place.at) == 9
    assert outside.is_behind(place.at[0], place.at[1])
    false = outside.furnish(random, outside.Scenario(says_false=True), types)
    assert not outside.is_behind(false.at[0], false.at[1])
    empty = outside.furnish(random, outside.Scenario(is_empty=True, bystanders=3), types)
    assert {types[kind] for kind in empty.kind} <= {"car", "tree"}


@pytest.mark.parametrize("name", ["plain", "wall"])
def test_goal_is_found_in_plain_places_and_past_a_wall(name: str) -> None:
    robot, scenario = outside.robot_of(0.0, 0.0), outside.SCENARIOS[name]
    outcome = outside.drive(robot, scenario, stepping.LANES, robots=one_by_one)
    assert outcome.is_right.all(), outcome.line(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGHT)
def test_goal_is_found_in_places_as_they_are(name: str) -> None:
    scenario = outside.SCENARIOS[name]
    robot = outside.robot_of(scenario.steady_drift, scenario.drift)
    outcome = outside.drive(robot, scenario, EPISODES)
    assert outcome.is_right.mean() >= RIGHT[name], outcome.line(name)
    assert outcome.metres.mean() <= MAX_METRES.get(name, np.inf), outcome.line(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", WAYS)
def test_search_is_short(name: str) -> None:
    outcome = outside.drive(outside.robot_of(0.0, 0.0), searching.ROWS[name], EPISODES)
    assert outcome.is_right.mean() >= 0.98, outcome.line(name)
    assert outcome.metres.mean() <= WAYS[name], outcome.line(name)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["behind", "none"])
def test_doubt_that_it_is_there_lengthens_the_way_by_little(name: str) -> None:
    sure, doubting = (
        outside.drive(outside.robot_of(0.0, 0.0, absent=absent), searching.ROWS[name], 500)
        for absent in (0.0, 0.05)
    )
    assert doubting.metres.mean() <= 1.03 * sure.metres.mean(), (sure, doubting)


ROUND, AFTER = avoiding.SENTENCES[1], "stay away from the cone and go to the hydrant"


@pytest.mark.parametrize(
    ("text", "hydrant", "cone"),
    [
        (ROUND, (7.56, -3.61), (2.29, -0.63)),
        (ROUND, (5.35, 0.08), (2.65, 0.06)),
        (AFTER, (6.26, -1.22), (4.02, -0.36)),
    ],
)
def test_named_places(text: str, hydrant: tuple[float, float], cone: tuple[float, float]) -> None:
    """All is seen at once: what is not cannot be gone round, or has to be found first."""
    place = np.array([hydrant, cone])
    shortest = avoiding.shortest_way(np.zeros(2), place[0], place[1:], avoiding.AREA)
    for ride in avoiding.drive(
        [place] * 6, text, list(range(6)), sight=9.0, misses=0.0, stepping=one_by_one
    ):
        assert ride.arrives(place[0]), ride.status
        assert ride.nearest(place[1:]) >= avoiding.KEPT
        assert ride.metres <= 1.25 * shortest + 1.0


@pytest.mark.slow
@pytest.mark.parametrize("num_avoided", [1, 2])
@pytest.mark.parametrize("sight", [4.0, 20.0])
def test_random_places(num_avoided: int, sight: float) -> None:
    found = avoiding.measure(100, num_avoided, sight=sight)
    assert found.is_kept[found.is_possible].mean() >= 0.98, found.line()
    assert found.arrives.mean() >= min(0.98, found.arrives_freely.mean()), found.line()
    # With the goal in sight from the start the way can be held against the shortest one.
    if sight > 15.0:
        assert np.nanmean(found.ratio) <= 1.25, found.line()
    else:
        assert np.nanmean(found.to_free) <= 1.25, found.line()
