"""A world of its own, in plain NumPy, that drives ``Navigator`` through public functions only.

No code is shared with ``jaxlangnav.world`` or with the paper's scenarios: what is placed where,
what a detector reports and how a robot moves are written down here once more. So an error that
world and belief have in common shows. Places are 14 × 18 m, with goals anywhere ahead of the robot.

Run as a program it prints one line a scenario:

    python tests/outside.py --episodes 100 pairs_3 ghosts_10
"""

import argparse
import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import jaxlangnav
from jaxlangnav import messages, navigator

AREA = (-2.0, 12.0, -9.0, 9.0)
_OFTEN = {"xla_backend_optimization_level": 3, "xla_llvm_disable_expensive_passes": False}
"""As users compile, also where tests are compiled briefly: it runs long."""
LANES, STEPS, DETECTIONS = 20, 110, 16
FEW = 8
"""Detections that the program holds which ``Navigator.step`` compiles first."""
REACH = 1.5
"""Metres from the goal at which a stop is right."""
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


def _anywhere(random: np.random.Generator) -> np.ndarray:
    return random.uniform([AREA[0] + 0.5, AREA[2] + 0.5], [AREA[1] - 0.5, AREA[3] - 0.5])


def furnish(random: np.random.Generator, scenario: Scenario, types: tuple[str, ...]) -> Place:
    """Draw a place in which exactly one hydrant stands behind a cone (or, said falsely, none)."""
    hydrant, cone = types.index("hydrant"), types.index("cone")
    others = [kind for kind in range(len(types)) if kind not in (hydrant, cone)]
    while True:
        landmark = random.uniform([1.5, -6.5], [9.0, 6.5])
        side = -1.0 if scenario.says_false else 1.0
        turn = np.arctan2(landmark[1], landmark[0]) + random.normal(0.0, 0.25)
        figure = landmark + side * random.uniform(1.2, 2.8) * np.array([np.cos(turn), np.sin(turn)])
        kind = [hydrant, cone] + [hydrant, cone] * scenario.extra_pairs
        kind += list(random.choice(others, scenario.bystanders))
        at = np.stack([figure, landmark] + [_anywhere(random) for _ in kind[2:]])
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


@functools.lru_cache
def stepper(config: Any) -> Any:
    """Compile one cycle of LANES robots."""

    def one(key: Any, state: Any, seen: Any, params: Any) -> Any:
        state, action, info = navigator.step(key, state, seen, params=params, config=config)
        return state, (action.step, action.is_stop, action.status, info.filter.overflow)

    many = jax.vmap(one, in_axes=(0, 0, 0, None))
    return jax.jit(many, compiler_options=_OFTEN)


class Robots(NamedTuple):
    """LANES robots that are told the same."""

    begin: Callable[[Any], Any]  # the state of one → those of all
    step: Callable[..., Any]  # as ``stepper`` gives


def together(robot: jaxlangnav.Navigator) -> Robots:
    """Step all robots in one program of their own."""

    def begin(first: Any) -> Any:
        return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (LANES, *leaf.shape)), first)

    return Robots(begin, stepper(robot.config))


def one_by_one(robot: jaxlangnav.Navigator) -> Robots:
    """Step one robot after the other through ``Navigator.step``, whose program others share.

    In a look there must not be more than FEW detections.
    """

    def step(keys: Any, states: list[Any], seen: Any, _: Any) -> Any:
        after, told = [], []
        looks, own = jax.device_get(seen), list(keys)
        for lane, state in enumerate(states):
            look = jax.tree.map(
                lambda leaf, n=lane: leaf[n][:FEW] if leaf.ndim > 1 else leaf[n], looks
            )
            state, action, info = robot.step(own[lane], state, look)
            after.append(state)
            told.append((action.step, action.is_stop, action.status, info.filter.overflow))
        return after, [np.stack(leaves) for leaves in zip(*jax.device_get(told), strict=True)]

    return Robots(lambda first: [first] * LANES, step)


def observation(poses: np.ndarray, found: list[Any], sensor: Any) -> messages.Observation:
    """Lay out what LANES robots see as one batch."""
    kind = np.full((LANES, DETECTIONS), messages.NONE, np.int32)
    metres, bearing = np.zeros((2, LANES, DETECTIONS), np.float32)
    for lane, detections in enumerate(found):
        for slot, (name, far, turn) in enumerate(detections):
            kind[lane, slot], metres[lane, slot], bearing[lane, slot] = name, far, turn
    return messages.Observation(
        pose=jnp.asarray(poses, jnp.float32),
        detection_type=jnp.asarray(kind),
        detection_range=jnp.asarray(metres),
        detection_bearing=jnp.asarray(bearing),
        is_detection=jnp.asarray(kind != messages.NONE),
        sensor=jax.tree.map(lambda leaf: jnp.full((LANES,), leaf, jnp.float32), sensor),
    )


@dataclasses.dataclass
class Outcome:
    """How episodes of one scenario ended, one entry each."""

    is_right: np.ndarray
    is_stopped: np.ndarray
    metres: np.ndarray
    overflow: np.ndarray

    def line(self, name: str) -> str:
        """Report on one line."""
        right, number = int(self.is_right.sum()), len(self.is_right)
        return (
            f"{name:14s} {right}/{number} = {right / number:.3f}  "
            f"path {self.metres.mean():5.1f} m  "
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
def robot_of(steady_drift: float, drift: float) -> jaxlangnav.Navigator:
    """Build a robot that has been told how its heading drifts."""
    return jaxlangnav.Navigator.pretrained(heading_bias=steady_drift, heading_noise=drift)


def drive(
    robot: jaxlangnav.Navigator,
    scenario: Scenario,
    episodes: int,
    *,
    seed: int = 0,
    robots: Callable[[jaxlangnav.Navigator], Robots] = together,
) -> Outcome:
    """Drive episodes of a scenario, LANES at a time.

    Args:
        robot: what is tried.
        scenario: the kind of place.
        episodes: how many; a multiple of LANES.
        seed: of the worlds and of the robot.
        robots: whether they decide together or one by one.

    Returns:
        How they ended.
    """
    many, rounds = robots(robot), range(episodes // LANES)
    parts = [_drive_lanes(robot, many, scenario, seed + index) for index in rounds]
    return Outcome(*(np.concatenate(leaves) for leaves in zip(*parts, strict=True)))


def _turned_back(
    found: list[tuple[int, float, float]], turned: float
) -> list[tuple[int, float, float]]:
    """Take bearings against a heading that is out by so much."""
    return [
        (kind, metres, float(np.remainder(bearing - turned + np.pi, 2 * np.pi) - np.pi))
        for kind, metres, bearing in found
    ]


def _drive_lanes(
    robot: jaxlangnav.Navigator, robots: Robots, scenario: Scenario, seed: int
) -> tuple[np.ndarray, ...]:
    random = np.random.default_rng([seed, 77])
    types = robot.type_names
    places = [furnish(random, scenario, types) for _ in range(LANES)]
    state = robots.begin(robot.start(scenario.sentence, area=AREA))
    position, odometry = np.zeros((2, LANES, 2))
    # By how much the true heading exceeds that of odometry, which is all that the robot knows.
    turned, drifting = np.zeros(LANES), np.random.default_rng([seed, 78])
    steady = scenario.steady_drift * drifting.choice([-1.0, 1.0], LANES)
    metres, is_done, overflow = np.zeros(LANES), np.zeros(LANES, bool), np.zeros(LANES, int)
    sensor = sensor_of(scenario)
    for number in range(STEPS):
        found = [
            _turned_back(look(random, scenario, place, position[lane], types), turned[lane])
            for lane, place in enumerate(places)
        ]
        poses = np.concatenate([odometry, np.zeros((LANES, 1))], axis=1)
        keys = jax.random.split(jax.random.key(1000 * seed + number), LANES)
        state, told = robots.step(keys, state, observation(poses, found, sensor), robot.params)
        move, is_stop, status, lost = (np.asarray(leaf) for leaf in told)
        is_done |= is_stop
        overflow += np.where(is_done, 0, lost)
        if is_done.all():
            break
        move = np.where(is_done[:, None], 0.0, move)
        length = np.hypot(*move.T)
        metres += length
        odometry = odometry + move
        after = turned + steady * length
        after = after + scenario.drift * np.sqrt(length) * drifting.normal(0.0, 1.0, LANES)
        cosine, sine = np.cos(0.5 * (turned + after)), np.sin(0.5 * (turned + after))
        move = np.stack([[cosine, -sine], [sine, cosine]]).transpose(2, 0, 1) @ move[:, :, None]
        position = position + move[:, :, 0]
        position = position + random.normal(0.0, 0.02, (LANES, 2)) * length[:, None]
        turned = after
    goal = np.stack([place.at[0] for place in places])
    is_right = is_done & (np.hypot(*(position - goal).T) <= REACH)
    if scenario.is_empty:
        is_right = is_done & (status == messages.Status.NOT_FOUND)
    return is_right, is_done, metres, overflow


def main() -> None:
    """Print one line a scenario."""
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*", default=list(SCENARIOS))
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--as-by-compass", action="store_true", help="tell it of no drift")
    given = parser.parse_args()
    for name in given.names:
        begun, scenario = time.perf_counter(), SCENARIOS[name]
        told = (0.0, 0.0) if given.as_by_compass else (scenario.steady_drift, scenario.drift)
        robot = robot_of(*told)
        outcome = drive(robot, scenario, given.episodes, seed=given.seed)
        print(outcome.line(name), f" {time.perf_counter() - begun:.0f} s", flush=True)


if __name__ == "__main__":
    main()
