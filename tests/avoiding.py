"""Places with things to avoid, in plain NumPy, that drive ``Navigator`` through its public doors.

The robot starts at the origin of 14 × 18 m and is to go to a hydrant; a cone, or a cone and a
barrel, are to be avoided. No code is shared with ``jaxlangnav.world``. As a program it prints one
line for each number of things avoided and each range of sight:

    python tests/avoiding.py --places 500
"""

import argparse
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from oracles.detours import shortest_way

import jaxlangnav
from jaxlangnav import messages, navigator

AREA = (0.0, 14.0, -9.0, 9.0)
BERTH, REACH, KEPT = 2.0, 1.2, 1.8
"""Metres: from what is avoided, at which the goal is reached, and that are asked for."""
LANES, STEPS, DETECTIONS = 20, 120, 4
MISSES, NOISE = 0.05, 0.1
KINDS = ("hydrant", "cone", "barrel")
SENTENCES = (
    "go to the hydrant", "go to the hydrant but avoid the cone",
    "go to the hydrant but avoid the cone and avoid the barrel",
)  # fmt: skip
"""By how many things are to be avoided."""
_OFTEN = {"xla_backend_optimization_level": 3, "xla_llvm_disable_expensive_passes": False}


class Ride(NamedTuple):
    """One episode."""

    path: np.ndarray  # [T, 2] metres, true positions
    status: messages.Status

    @property
    def metres(self) -> float:
        """Length of the way."""
        return float(np.hypot(*np.diff(self.path, axis=0).T).sum())

    def arrives(self, goal: np.ndarray) -> bool:
        """Tell whether it says that it has arrived, and has."""
        is_there = np.hypot(*(self.path[-1] - goal)) <= REACH + 0.3
        return bool(self.status == messages.Status.ARRIVED and is_there)

    def nearest(self, things: np.ndarray) -> float:
        """Compute the least distance to things [n, 2], of steps as well as of waypoints."""
        share = np.linspace(0.0, 1.0, 20)[:, None, None]
        line = (1.0 - share) * self.path[None, :-1] + share * self.path[None, 1:]
        line = np.concatenate([line.reshape(-1, 2), self.path])
        return float(np.hypot(*(line[:, None] - things[None]).T).min())


@functools.lru_cache
def robot_of(policy: str = "informed") -> jaxlangnav.Navigator:
    """Build the robot as it ships."""
    return jaxlangnav.Navigator.pretrained(policy)


def together(robot: jaxlangnav.Navigator) -> Callable[..., Any]:
    """Step LANES robots in one program of their own."""
    return functools.partial(_stepper(robot.config), robot.params)


@functools.lru_cache
def _stepper(config: Any) -> Any:
    def one(params: Any, key: Any, state: Any, seen: Any) -> Any:
        state, action, _ = navigator.step(key, state, seen, params=params, config=config)
        return state, (action.step, action.status)

    return jax.jit(jax.vmap(one, in_axes=(None, 0, 0, 0)), compiler_options=_OFTEN)


def one_by_one(robot: jaxlangnav.Navigator) -> Callable[..., Any]:
    """Step one robot after the other through ``Navigator.step``, whose program others share."""

    def step(keys: Any, states: Any, looks: Any) -> Any:
        told = []
        for lane in range(len(keys)):
            state, look = jax.tree.map(lambda leaf, n=lane: leaf[n], (states, looks))
            state, action, _ = robot.step(keys[lane], state, look)
            told.append((state, (action.step, action.status)))
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *told)

    return step


def _look(
    random: np.random.Generator,
    place: np.ndarray,
    position: np.ndarray,
    sight: float,
    misses: float,
) -> list[tuple[int, float, float]]:
    """Detect kind, range and bearing of what is in sight."""
    found = []
    for kind, at in enumerate(place):
        span = at - position
        if np.hypot(*span) <= sight and random.uniform() >= misses:
            x, y = span + random.normal(0.0, NOISE, 2)
            found.append((kind, float(np.hypot(x, y)), float(np.arctan2(y, x))))
    return found


def _observe(positions: np.ndarray, found: list[Any], sight: float) -> messages.Observation:
    names = robot_of().type_names
    number = len(found)
    kind = np.full((number, DETECTIONS), messages.NONE, np.int32)
    metres, bearing = np.zeros((2, number, DETECTIONS), np.float32)
    for lane, detections in enumerate(found):
        for slot, (index, far, turn) in enumerate(detections):
            kind[lane, slot] = names.index(KINDS[index])
            metres[lane, slot], bearing[lane, slot] = far, turn
    sensor = messages.SensorParams(
        range_max=sight, field_of_view=2 * np.pi, detection_probability=1.0 - MISSES,
        noise=NOISE, false_detections=0.0, mislabelled=0.0,
    )  # fmt: skip
    return messages.Observation(
        pose=jnp.asarray(np.pad(positions, ((0, 0), (0, 1))), jnp.float32),
        detection_type=jnp.asarray(kind),
        detection_range=jnp.asarray(metres),
        detection_bearing=jnp.asarray(bearing),
        is_detection=jnp.asarray(kind != messages.NONE),
        sensor=jax.tree.map(lambda leaf: jnp.full((number,), leaf, jnp.float32), sensor),
    )


def drive(
    places: list[np.ndarray],
    text: str,
    seeds: list[int],
    *,
    sight: float,
    misses: float = MISSES,
    policy: str = "informed",
    stepping: Callable[..., Callable[..., Any]] = together,
) -> list[Ride]:
    """Drive one episode a place, LANES at a time.

    Args:
        places: [2..3, 2] metres each: the hydrant, then what else there is.
        text: what the robot is told.
        seeds: of each episode.
        sight: metres, all round.
        misses: probability that a look does not show what is in sight.
        policy: of the robot.
        stepping: whether they decide together or one by one.

    Returns:
        The episodes.
    """
    robot, rides = robot_of(policy), []
    first, step = robot.start(text, area=AREA), stepping(robot)
    lanes = LANES if stepping is together else len(places)
    for begin in range(0, len(places), lanes):
        some = [(begin + lane) % len(places) for lane in range(lanes)]
        randoms = [np.random.default_rng([seeds[n], 7]) for n in some]
        root = jax.vmap(jax.random.key)(jnp.asarray([seeds[n] for n in some]))
        state = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (lanes, *leaf.shape)), first)
        position, ended = np.zeros((lanes, 2)), np.zeros(lanes, int)
        paths = [[np.zeros(2)] for _ in some]
        for number in range(STEPS):
            found = [
                _look(randoms[k], places[n], position[k], sight, misses) for k, n in enumerate(some)
            ]
            keys = jax.vmap(jax.random.fold_in, in_axes=(0, None))(root, number)
            state, told = step(keys, state, _observe(position, found, sight))
            move, status = (np.asarray(leaf) for leaf in told)
            is_over = (ended > messages.Status.APPROACHING) | (status > messages.Status.APPROACHING)
            ended = np.where(ended > messages.Status.APPROACHING, ended, status)
            if is_over.all():
                break
            position = position + np.where(is_over[:, None], 0.0, move)
            for lane in np.nonzero(~is_over)[0]:
                paths[lane].append(position[lane].copy())
        rides += [
            Ride(np.array(path), messages.Status(int(how)))
            for path, how in zip(paths, ended, strict=True)
        ]
    return rides[: len(places)]


def draw_places(number: int, num_avoided: int, seed: int = 0) -> list[np.ndarray]:
    """Draw places in which the start allows to keep the berth; half of the things are in the way.

    Args:
        number: of places.
        num_avoided: 1 or 2.
        seed: of the places.

    Returns:
        The hydrant and what is to be avoided, [1 + num_avoided, 2] metres each.
    """
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
    to_free: np.ndarray  # way to that without the constraint
    endings: list[str]

    def line(self) -> str:
        """Report on one line."""
        some = self.is_possible
        return (
            f"kept {self.is_kept[some].sum()}/{some.sum()} possible, {self.is_kept.mean():.3f} of "
            f"all, least {self.nearest.min():.2f}, 1 % {np.quantile(self.nearest, 0.01):.2f}; "
            f"arrives {self.arrives.mean():.3f} (freely {self.arrives_freely.mean():.3f}); way "
            f"{np.nanmean(self.ratio):.3f} of the shortest that keeps it (95 % "
            f"{np.nanquantile(self.ratio, 0.95):.2f}), {np.nanmean(self.to_free):.3f} of that "
            f"without; {self.endings}"
        )


def score(places: list[np.ndarray], rides: list[Ride], free: list[Ride], seeds: list[int]) -> Score:
    """Hold episodes against plain geometry."""
    shortest = [shortest_way(np.zeros(2), place[0], place[1:], AREA) for place in places]
    arrives = np.array([ride.arrives(place[0]) for place, ride in zip(places, rides, strict=True)])
    freely = np.array([ride.arrives(place[0]) for place, ride in zip(places, free, strict=True)])
    nearest = np.array([ride.nearest(place[1:]) for place, ride in zip(places, rides, strict=True)])
    metres = np.array([ride.metres for ride in rides])
    length = np.array(shortest)
    ratio = np.where(arrives & np.isfinite(length), metres / length, np.nan)
    own = np.array([ride.metres for ride in free])
    return Score(
        nearest=nearest,
        is_kept=nearest >= KEPT,
        is_possible=np.isfinite(length),
        arrives=arrives,
        arrives_freely=freely,
        ratio=ratio,
        to_free=np.where(arrives & freely, metres / own, np.nan),
        endings=[
            f"{n}:{ride.status.name} {nearest[n]:.2f} way {metres[n]:.1f}"
            for n, ride in enumerate(rides)
            if not arrives[n] or (nearest[n] < KEPT and np.isfinite(length[n]))
        ][:40],
    )


def measure(number: int, num_avoided: int, *, sight: float, policy: str = "informed") -> Score:
    """Drive random places with and without the constraint, by the same keys and detections."""
    places, seeds = draw_places(number, num_avoided), list(range(number))
    rides = drive(places, SENTENCES[num_avoided], seeds, sight=sight, policy=policy)
    free = drive(places, SENTENCES[0], seeds, sight=sight, policy=policy)
    return score(places, rides, free, seeds)


def main() -> None:
    """Print one line for each number of things avoided and each range of sight."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--places", type=int, default=100)
    parser.add_argument("--policy", default="informed")
    parser.add_argument("--sights", type=float, nargs="*", default=[4.0, 20.0])
    given = parser.parse_args()
    for sight in given.sights:
        for num_avoided in (1, 2):
            found = measure(given.places, num_avoided, sight=sight, policy=given.policy)
            print(f"{num_avoided} avoided, sight {sight} m: {found.line()}", flush=True)


if __name__ == "__main__":
    main()
