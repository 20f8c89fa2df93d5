"""A world of its own, in plain NumPy, that drives ``Navigator`` through public functions only.

No code is shared with ``jaxlangnav.world``: an error that world and belief have in common shows.
Places are 14 × 18 m, with goals anywhere ahead of the robot. One line a scenario:

    python tests/outside.py --episodes 100 pairs_3 ghosts_10
"""

import argparse
import dataclasses
import functools
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from stepping import DETECTIONS, LANES, Robots, keys_of, observation, together

import jaxlangnav
from jaxlangnav import messages

AREA = (-2.0, 12.0, -9.0, 9.0)
REACH = 1.5  # metres from the goal at which a stop is right
SENTENCE = "go to the hydrant behind the cone"


@dataclasses.dataclass(frozen=True)
class Scenario:
    """One kind of place, and what the robot's detector is like there."""

    extra_pairs: int = 0
    bystanders: int = 0
    ghosts: float = 0.0  # probability of a false detection in one look
    misses: float = 0.05
    wrong_labels: float = 0.0
    reach: float = 3.0  # metres of the detector
    says_false: bool = False  # the hydrant stands in front of the cone, not behind it
    is_empty: bool = False  # nothing of what is spoken of is there: to say so is right
    sentence: str = SENTENCE
    steady_drift: float = 0.0  # radians a metre, of either sign: what the heading drifts by
    drift: float = 0.0  # radians per root of a metre, standard deviation
    area: tuple[float, float, float, float] = AREA
    steps: int = 110
    slip: float = 0.02  # metres per metre of way, standard deviation of either axis
    wall: float = 0.0  # metres of a low wall across the way, which halts and is never told

    def furnish(self, random: np.random.Generator, types: tuple[str, ...]) -> "Place":
        """Draw a place."""
        return furnish(random, self, types)


SCENARIOS = {
    "plain": Scenario(),
    "pairs_3": Scenario(extra_pairs=2),
    "pairs_5": Scenario(extra_pairs=2, reach=5.0),
    "false": Scenario(says_false=True),
    "bystanders": Scenario(bystanders=14),
    "ghosts_2": Scenario(ghosts=0.02),
    "ghosts_10": Scenario(ghosts=0.1),
    "misses": Scenario(misses=0.6),
    "labels": Scenario(bystanders=6, wrong_labels=0.1),
    "bad_detector": Scenario(ghosts=0.1, misses=0.4),
    "crowd": Scenario(bystanders=56, extra_pairs=1),
    "nowhere": Scenario(is_empty=True, bystanders=4),
    "drift": Scenario(drift=np.radians(3.0)),
    "steady_drift": Scenario(steady_drift=np.radians(3.0)),
    "wall": Scenario(wall=4.0),
}


@dataclasses.dataclass
class Place:
    """What stands where; the goal first."""

    kind: np.ndarray  # [n] type index
    at: np.ndarray  # [n, 2] metres


def is_behind(figure: np.ndarray, landmark: np.ndarray) -> bool:
    """Tell whether a thing may pass for being behind another one, seen from the origin."""
    span = figure - landmark
    turn = np.arctan2(span[1], span[0]) - np.arctan2(landmark[1], landmark[0])
    return bool(np.hypot(*span) < 5.0 and np.cos(turn) > 0.3)


def furnish(random: np.random.Generator, scenario: Scenario, types: tuple[str, ...]) -> Place:
    """Draw a place in which exactly one hydrant stands behind a cone (or, said falsely, none)."""
    hydrant, cone = types.index("hydrant"), types.index("cone")
    others = [kind for kind in range(len(types)) if kind not in (hydrant, cone)]
    low, high = [AREA[0] + 0.5, AREA[2] + 0.5], [AREA[1] - 0.5, AREA[3] - 0.5]
    while True:
        landmark = random.uniform([1.5, -6.5], [9.0, 6.5])
        side = -1.0 if scenario.says_false else 1.0
        turn = np.arctan2(landmark[1], landmark[0]) + random.normal(0.0, 0.25)
        figure = landmark + side * random.uniform(1.2, 2.8) * np.array([np.cos(turn), np.sin(turn)])
        kind = [hydrant, cone] + [hydrant, cone] * scenario.extra_pairs
        kind += list(random.choice(others, scenario.bystanders))
        at = np.stack([figure, landmark] + [random.uniform(low, high) for _ in kind[2:]])
        gap = np.hypot(*(at[:, None] - at[None]).transpose(2, 0, 1))
        near = np.where(np.eye(len(at), dtype=bool), np.inf, gap)
        crowded = 0.5 if len(at) > 30 else 0.9
        is_in = (figure[0] < AREA[1] - 0.3) & (abs(figure[1]) < AREA[3] - 0.3) & (figure[0] > 0.5)
        hydrants = [n for n, one in enumerate(kind) if one == hydrant]
        cones = [n for n, one in enumerate(kind) if one == cone]
        fits = {(h, c) for h in hydrants for c in cones if is_behind(at[h], at[c])}
        if (
            is_in
            and near[:2].min() > 0.9
            and near.min() > (crowded if len(at) < 30 else 0.0)
            and fits == (set() if scenario.says_false else {(0, 1)})
        ):
            first = 2 if scenario.is_empty else 0
            return Place(np.array(kind)[first:], at[first:])


def look(
    random: np.random.Generator,
    scenario: Scenario,
    place: Place,
    position: np.ndarray,
    types: tuple[str, ...],
) -> list[tuple[int, float, float]]:
    """Detect: type, range, bearing of what is in range, of the nearest first."""
    hydrant, cone = types.index("hydrant"), types.index("cone")
    found = []
    for kind, at in zip(place.kind, place.at, strict=True):
        span = at - position
        if np.hypot(*span) > scenario.reach or random.uniform() < scenario.misses:
            continue
        if random.uniform() < scenario.wrong_labels:
            kind = random.choice([one for one in range(len(types)) if one != kind])
        span = span + random.normal(0.0, 0.1, 2)
        found.append((int(kind), float(np.hypot(*span)), float(np.arctan2(span[1], span[0]))))
    if random.uniform() < scenario.ghosts:
        # Of what the sentence speaks of: the worst that a detector can invent.
        metres = scenario.reach * np.sqrt(random.uniform())
        found.append((int(random.choice([hydrant, cone])), metres, random.uniform(-np.pi, np.pi)))
    return sorted(found, key=lambda one: one[1])[:DETECTIONS]


class Outcome(NamedTuple):
    """How episodes of one scenario ended, one entry each."""

    is_right: np.ndarray
    is_stopped: np.ndarray
    metres: np.ndarray
    overflow: np.ndarray

    def line(self, name: str) -> str:
        """Report on one line; the mean way with its standard error."""
        right, number = int(self.is_right.sum()), len(self.is_right)
        return (
            f"{name:14s} {right}/{number} = {right / number:.3f}  "
            f"path {self.metres.mean():5.1f} ± {self.metres.std() / np.sqrt(number):.1f} m  "
            f"stopped elsewhere {int((self.is_stopped & ~self.is_right).sum())}  "
            f"never {int((~self.is_stopped).sum())}  overflow {int((self.overflow > 0).sum())}"
        )


def sensor_of(scenario: Scenario) -> Any:
    """Tell the robot what its detector is like."""
    return messages.SensorParams(
        range_max=jnp.float32(scenario.reach),
        field_of_view=jnp.float32(2 * np.pi),
        detection_probability=jnp.float32(1.0 - scenario.misses),
        noise=jnp.float32(0.1),
        false_detections=jnp.float32(scenario.ghosts / 2.0),
        mislabelled=jnp.float32(scenario.wrong_labels),
    )


@functools.lru_cache
def robot_of(steady_drift: float, drift: float, **numbers: float) -> jaxlangnav.Navigator:
    """Build a robot that has been told how its heading drifts, and single numbers."""
    known = {"heading_bias": steady_drift, "heading_noise": drift}
    return jaxlangnav.Navigator.pretrained("informed", None, **(known | numbers))


def build_wall(random: np.random.Generator, length: float, goal: np.ndarray) -> np.ndarray:
    """Build a wall across the straight way to a goal: its two ends."""
    turn = np.arctan2(goal[1], goal[0]) + np.pi / 2 + random.uniform(-0.5, 0.5)
    middle, half = goal * random.uniform(0.3, 0.7), 0.5 * length
    return middle + half * np.array([[-1.0], [1.0]]) * [np.cos(turn), np.sin(turn)]


def halted_by(wall: np.ndarray, position: np.ndarray, step: np.ndarray) -> np.ndarray:
    """Cut a step short where the robot's body, 0.25 m in radius, meets a wall."""
    along = wall[1] - wall[0]
    at = position + np.linspace(0.0, 1.0, 41)[:, None] * step
    share = np.clip((at - wall[0]) @ along / (along @ along), 0.0, 1.0)
    gap = np.hypot(*(at - wall[0] - share[:, None] * along).T)
    is_into = (gap[1:] < 0.25) & (gap[1:] < gap[:-1])
    return step * (is_into.argmax() / 40.0 if is_into.any() else 1.0)


class Ride:
    """One robot in its place; both hang on its seed alone."""

    def __init__(
        self, scenario: Scenario, seed: int, types: tuple[str, ...], place: Place | None = None
    ) -> None:
        """Furnish the place, unless it is given, and stand at the origin."""
        self.scenario, self.seed, self.types = scenario, seed, types
        self.random = np.random.default_rng([seed, 29])
        self.drifting = np.random.default_rng([seed, 78])
        self.place = place or scenario.furnish(self.random, types)
        self.position, self.odometry = np.zeros((2, 2))
        wall = scenario.wall
        self.wall = build_wall(self.drifting, wall, self.place.at[0]) if wall else None
        # By how much the true heading exceeds that of odometry, which is all that the robot knows.
        self.turned, self.steady = 0.0, scenario.steady_drift * self.drifting.choice([-1.0, 1.0])
        self.path, self.metres, self.overflow = [self.position], 0.0, 0
        self.is_stopped, self.status = False, messages.Status.SEARCHING

    def detect(self) -> list[tuple[int, float, float]]:
        """Look round; bearings are taken against a heading that is out by what it has drifted."""
        found = look(self.random, self.scenario, self.place, self.position, self.types)
        return [
            (kind, metres, float(np.remainder(bearing - self.turned + np.pi, 2 * np.pi) - np.pi))
            for kind, metres, bearing in found
        ]

    def move(self, step: np.ndarray) -> None:
        """Go where odometry has it, but for drift, slip and walls."""
        if self.wall is not None:
            step = halted_by(self.wall, self.position, step)
        length = float(np.hypot(*step))
        self.metres += length
        self.odometry = self.odometry + step
        after = self.turned + self.steady * length
        after += self.scenario.drift * np.sqrt(length) * self.drifting.normal()
        cosine, sine = np.cos(0.5 * (self.turned + after)), np.sin(0.5 * (self.turned + after))
        step = np.array([[cosine, -sine], [sine, cosine]]) @ step
        self.position = (
            self.position + step + self.random.normal(0.0, self.scenario.slip, 2) * length
        )
        self.path.append(self.position)
        self.turned = after

    @property
    def is_right(self) -> bool:
        """Whether it was right to end here, and so."""
        if self.scenario.is_empty or not self.is_stopped:
            return self.is_stopped and self.status == messages.Status.NOT_FOUND
        return bool(np.hypot(*(self.position - self.place.at[0])) <= REACH)


def drive(
    robot: jaxlangnav.Navigator,
    scenario: Scenario,
    episodes: int,
    *,
    seed: int = 0,
    robots: Callable[[jaxlangnav.Navigator], Robots] = together,
) -> Outcome:
    """Drive episodes of a scenario, the first one's seed given: how they ended, in their order."""
    rides = [Ride(scenario, seed + index, robot.type_names) for index in range(episodes)]
    ride(robot, rides, sensor_of(scenario), robots)
    told = [(one.is_right, one.is_stopped, one.metres, one.overflow) for one in rides]
    return Outcome(*(np.array(leaves) for leaves in zip(*told, strict=True)))


def ride(
    robot: jaxlangnav.Navigator,
    rides: Sequence[Ride],
    sensor: Any,
    robots: Callable[[jaxlangnav.Navigator], Robots] = together,
) -> None:
    """Ride to the end in places of one scenario; a lane that has ended takes the next one."""
    many, waiting, scenario = robots(robot), iter(rides), rides[0].scenario
    first = robot.start(scenario.sentence, area=scenario.area)
    lanes: list[Ride] = [rides[0]] * (LANES if robots is together else len(rides))
    states = many.begin(first, len(lanes))
    is_new, is_idle = np.ones(len(lanes), bool), np.zeros(len(lanes), bool)
    while True:
        for lane in np.flatnonzero(is_new):
            following = next(waiting, None)
            is_idle[lane], lanes[lane] = following is None, following or lanes[lane]
        if is_idle.all():
            return
        states = many.renew(states, first, is_new)
        found = [[] if idle else one.detect() for one, idle in zip(lanes, is_idle, strict=True)]
        seen = observation([one.odometry for one in lanes], found, sensor)
        keys = keys_of(*np.array([(one.seed, len(one.path)) for one in lanes]).T)
        states, told = many.step(keys, states, seen, robot.params)
        move, is_stop, status, lost = (np.asarray(leaf) for leaf in told)
        for lane, one in enumerate(lanes):
            if is_idle[lane]:
                continue
            one.is_stopped, one.status = bool(is_stop[lane]), messages.Status(int(status[lane]))
            is_new[lane] = one.is_stopped or len(one.path) >= scenario.steps
            if not is_new[lane]:
                one.overflow += int(lost[lane])
                one.move(move[lane])
        is_new &= ~is_idle


def main(
    scenarios: Mapping[str, Scenario] = SCENARIOS,
    note: Callable[[Any, Outcome, int], str] = lambda *_: "",
) -> None:
    """Print one line a scenario, and a note on it."""
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*", default=list(scenarios))
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the first episode")
    parser.add_argument("--as-by-compass", action="store_true", help="tell it of no drift")
    parser.add_argument("--set", nargs="*", default=[], metavar="NUMBER=VALUE")
    given = parser.parse_args()
    numbers = tuple(one.split("=") for one in given.set)
    for name in given.names:
        begun, scenario = time.perf_counter(), scenarios[name]
        told = (0.0, 0.0) if given.as_by_compass else (scenario.steady_drift, scenario.drift)
        robot = robot_of(*told, **{name: float(value) for name, value in numbers})
        outcome = drive(robot, scenario, given.episodes, seed=given.seed)
        told = note(scenario, outcome, given.seed)
        print(outcome.line(name) + told, f" {time.perf_counter() - begun:.0f} s", flush=True)


if __name__ == "__main__":
    main()
