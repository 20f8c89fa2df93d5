"""Places with things to avoid, in plain NumPy, that drive ``Navigator`` through its public doors.

From the origin of 14 × 18 m to a hydrant, and round a cone, or a cone and a barrel:

    python tests/avoiding.py --places 500
"""

import argparse
import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import outside
from oracles.detours import shortest_way
from stepping import Robots, together

import jaxlangnav
from jaxlangnav import messages

AREA = (0.0, 14.0, -9.0, 9.0)
BERTH, REACH, KEPT = 2.0, 1.2, 1.8
"""Metres: from what is avoided, at which the goal is reached, and that are asked for."""
STEPS = 120
MISSES = 0.05
KINDS = ("hydrant", "cone", "barrel")
SENTENCES = (
    "go to the hydrant", "go to the hydrant but avoid the cone",
    "go to the hydrant but avoid the cone and avoid the barrel",
)  # fmt: skip
"""By how many things are to be avoided."""


class Ride(outside.Ride):
    """One episode."""

    def arrives(self, goal: np.ndarray) -> bool:
        """Tell whether it says that it has arrived, and has."""
        is_there = np.hypot(*(self.position - goal)) <= REACH + 0.3
        return bool(self.status == messages.Status.ARRIVED and is_there)

    def nearest(self, things: np.ndarray) -> float:
        """Compute the least distance to things [n, 2], of steps as well as of waypoints."""
        share = np.linspace(0.0, 1.0, 20)[:, None, None]
        path = np.array(self.path)
        line = (1.0 - share) * path[None, :-1] + share * path[None, 1:]
        line = np.concatenate([line.reshape(-1, 2), path])
        return float(np.hypot(*(line[:, None] - things[None]).T).min())


def drive(
    places: list[np.ndarray],
    text: str,
    seeds: list[int],
    *,
    sight: float,
    misses: float = MISSES,
    stepping: Callable[[jaxlangnav.Navigator], Robots] = together,
) -> list[Ride]:
    """Drive one episode a place, [2..3, 2] metres each: the hydrant, then what else there is."""
    robot = outside.robot_of(0.0, 0.0)
    scenario = outside.Scenario(
        sentence=text, area=AREA, reach=sight, misses=misses, slip=0.0, steps=STEPS
    )
    types = np.array([robot.type_names.index(name) for name in KINDS])
    rides = [
        Ride(scenario, seed, robot.type_names, outside.Place(types[: len(place)], place))
        for place, seed in zip(places, seeds, strict=True)
    ]
    sensor = outside.sensor_of(dataclasses.replace(scenario, misses=MISSES))
    outside.ride(robot, rides, sensor, stepping)
    return rides


def draw_places(number: int, num_avoided: int, seed: int = 0) -> list[np.ndarray]:
    """Draw hydrants and what is to be avoided, [1 + num_avoided, 2] metres, half in the way."""
    random, places = np.random.default_rng([seed, num_avoided]), []
    while len(places) < number:
        goal = random.uniform([3.0, -8.0], [13.0, 8.0])
        across = np.array([-goal[1], goal[0]]) / np.hypot(*goal)
        in_way = (
            random.uniform(0.2, 0.9, (num_avoided, 1)) * goal
            + random.normal(0.0, 0.8, (num_avoided, 1)) * across
        )
        anywhere = random.uniform([0.5, -8.5], [13.5, 8.5], (num_avoided, 2))
        things = np.where(random.uniform(size=(num_avoided, 1)) < 0.5, in_way, anywhere)
        place = np.concatenate([goal[None], things])
        gap = np.hypot(*(place[:, None] - place[None]).T) + 9.0 * np.eye(len(place))
        if np.hypot(*things.T).min() >= BERTH + 0.1 and gap.min() >= 1.0:
            places.append(place)
    return places


class Score(NamedTuple):
    """What came of places with things to avoid."""

    nearest: np.ndarray  # metres
    is_kept: np.ndarray
    is_possible: np.ndarray  # there is a way to the goal's reach that keeps the berth
    arrives: np.ndarray
    arrives_freely: np.ndarray  # without the constraint
    ratio: np.ndarray  # way to the shortest one that keeps the berth; NaN where it does not arrive
    to_free: np.ndarray  # way to that without the constraint and as much longer as the shortest is

    def line(self) -> str:
        """Report on one line."""
        some = self.is_possible
        return (
            f"kept {self.is_kept[some].sum()}/{some.sum()} possible, {self.is_kept.mean():.3f} of "
            f"all, least {self.nearest.min():.2f}, 1 % {np.quantile(self.nearest, 0.01):.2f}; "
            f"arrives {self.arrives.mean():.3f} (freely {self.arrives_freely.mean():.3f}); way "
            f"{np.nanmean(self.ratio):.3f} of the shortest that keeps it (95 % "
            f"{np.nanquantile(self.ratio, 0.95):.2f}), {np.nanmean(self.to_free):.3f} of the free "
            f"way and the detour that this one takes; {self.steps.mean():.1f} steps"
        )

    steps: np.ndarray


def measure(number: int, num_avoided: int, *, sight: float) -> Score:
    """Drive random places with and without the constraint, by the same keys and detections."""
    places, seeds = draw_places(number, num_avoided), list(range(number))
    rides, free = (drive(places, SENTENCES[told], seeds, sight=sight) for told in (num_avoided, 0))
    arrives, freely = (
        np.array([one.arrives(place[0]) for place, one in zip(places, some, strict=True)])
        for some in (rides, free)
    )
    metres, own = (np.array([one.metres for one in some]) for some in (rides, free))
    nearest = np.array([one.nearest(place[1:]) for place, one in zip(places, rides, strict=True)])
    length, straight = (
        np.array([shortest_way(np.zeros(2), place[0], place[first:], AREA) for place in places])
        for first in (1, len(SENTENCES))
    )
    return Score(
        nearest=nearest,
        is_kept=nearest >= KEPT,
        is_possible=np.isfinite(length),
        arrives=arrives,
        arrives_freely=freely,
        ratio=np.where(arrives & np.isfinite(length), metres / length, np.nan),
        to_free=np.where(arrives & freely, metres / (own + length - straight), np.nan),
        steps=np.array([len(one.path) - 1 for one in rides]),
    )


def main() -> None:
    """Print one line for each number of things avoided and each range of sight."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--places", type=int, default=100)
    parser.add_argument("--sights", type=float, nargs="*", default=[4.0, 20.0])
    given = parser.parse_args()
    for sight in given.sights:
        for num_avoided in (1, 2):
            found = measure(given.places, num_avoided, sight=sight)
            print(f"{num_avoided} avoided, sight {sight} m: {found.line()}", flush=True)


if __name__ == "__main__":
    main()
