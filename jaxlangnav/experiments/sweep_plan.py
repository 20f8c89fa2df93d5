"""The plan of a sweep: which episodes there are, and which of them make up a file.

The grid falls into *arms* (policy, particles, Params of map, planner and motion: what one call
of the compiled program shares) and *settings* (world, command, range, detector, seed). An arm's
episodes are cut into chunks of the size the compiled program takes; a chunk is a file. The plan
depends on the configuration alone, so files are the same however the work is split.

Nothing of it is laid out before it is asked for: arm, setting and chunk are worked out from
their number, so that a part of a billion episodes costs what that part costs.
"""

import dataclasses
import functools
import itertools
import math
import re
from collections.abc import Sequence
from typing import Any, Literal

import jax.numpy as jnp

from jaxlangnav.experiments.devices import CHUNK
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.sizes import check_engine, counted
from jaxlangnav.experiments.sweep_config import SweepConfig, Values
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.navigator import NavigatorParams, check, default_params
from jaxlangnav.planner.config import POLICIES
from jaxlangnav.pytree import replace

MOST_FILES = 1_000_000
"""Files of a folder: file systems grow slow with more, and their names have six digits."""
Chosen = dict[str, float]
"""One value for each key of a table of Params."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arm:
    """What is compared: a policy with its numbers."""

    policy: str
    particles: int | None
    """None for a baseline, which has none."""
    motion: Chosen
    map: Chosen | None
    planner: Chosen | None

    def motion_params(self) -> MotionParams:
        """Build the odometry of the arm's worlds."""
        return replace(default_motion(), **_as_arrays(self.motion))

    def params(self) -> NavigatorParams:
        """Build the navigator's numbers; the belief knows the odometry's specification."""
        params = default_params()
        motion = self.motion_params()
        return replace(
            params,
            map=replace(params.map, motion=motion, **_as_arrays(self.map or {})),
            planner=replace(params.planner, **_as_arrays(self.planner or {})),
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setting:
    """Where it is compared: the same for all arms."""

    world: str
    command: int
    range: float
    sensor: Chosen
    seed: int

    def sensor_params(self) -> SensorParams:
        """Build the detector."""
        return replace(default_sensor(self.range), **_as_arrays(self.sensor))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Chunk:
    """The episodes of one file."""

    index: int
    arm: Arm
    first: int
    """Place of its first episode among the arm's."""
    size: int


@dataclasses.dataclass(frozen=True, kw_only=True)
class Plan:
    """All files of a sweep, by their number."""

    config: SweepConfig

    @functools.cached_property
    def num_settings(self) -> int:
        """Count the settings."""
        return math.prod(_setting_sizes(self.config))

    @functools.cached_property
    def num_arms(self) -> int:
        """Count the arms."""
        return sum(_arms_of(self.config, policy) for policy in self.config.policies)

    @property
    def files_of_arm(self) -> int:
        """Count the files of an arm."""
        return -(-self.num_settings * self.config.episodes // CHUNK)

    @property
    def num_files(self) -> int:
        """Count the files."""
        return self.num_arms * self.files_of_arm

    def episodes(self) -> int:
        """Count the rows of all files."""
        return self.num_arms * self.num_settings * self.config.episodes

    def size(self, index: int) -> int:
        """Count the episodes of a file."""
        first = index % self.files_of_arm * CHUNK
        return min(CHUNK, self.num_settings * self.config.episodes - first)

    def chunk(self, index: int) -> Chunk:
        """Work out the episodes of a file."""
        arm, place = divmod(index, self.files_of_arm)
        return Chunk(index=index, arm=self.arm(arm), first=place * CHUNK, size=self.size(index))

    def kind(self, index: int) -> tuple[str, int | None]:
        """Work out which program runs a file: policy, and particles if it has any."""
        arm = self.arm(index // self.files_of_arm)
        return arm.policy, arm.particles

    def arm(self, place: int) -> Arm:
        """Work out an arm; a baseline has few, as the navigator's numbers are none of its own."""
        return _arm(self.config, place)

    def setting(self, place: int) -> Setting:
        """Work out a setting."""
        config, sensor = self.config, self.config.params["sensor"]
        world, command, reach, *chosen, seed = _digits(place, _setting_sizes(config))
        return Setting(
            world=config.worlds[world],
            command=command,
            range=config.ranges[reach],
            sensor=_picked(sensor, chosen),
            seed=config.seeds[seed],
        )


def make_plan(config: SweepConfig) -> Plan:
    """Lay out a sweep.

    Args:
        config: the grid.

    Returns:
        The plan.

    Raises:
        ValueError: Params with which the robot could never stop, more particles than memory
            holds, or more files than a folder does.
    """
    plan = Plan(config=config)
    _check_files(plan)
    for policy in config.policies:
        if policy in POLICIES:
            check_engine(navigator_config(policy, max(config.particles)))
            # A limit of ``check`` is passed upwards or downwards: the ends stand for all arms.
            check(_end(config, policy, -1).params())
            check(_end(config, policy, 0).params())
    return plan


def _check_files(plan: Plan) -> None:
    """Refuse a sweep that no folder could hold, and say what one would."""
    if plan.num_files <= MOST_FILES:
        return
    fit = MOST_FILES // plan.num_arms * CHUNK // plan.num_settings
    cells = plan.num_arms * plan.num_settings
    remedy = f"at most {fit:,} episodes a cell fit" if fit else "not even one a cell fits"
    raise ValueError(
        f"the sweep has {counted(cells)} cells times {counted(plan.config.episodes)} episodes, "
        f"which make {counted(plan.num_files)} files, but a folder holds {MOST_FILES:,}: {remedy}; "
        "or divide the lists (seeds, worlds, ...) among several sweeps"
    )


def _setting_sizes(config: SweepConfig) -> list[int]:
    """Count the values of everything that makes up a setting, the slowest first."""
    sensor = [len(values) for values in config.params["sensor"].values()]
    return [
        len(config.worlds),
        len(config.commands),
        len(config.ranges),
        *sensor,
        len(config.seeds),
    ]


def _arms_of(config: SweepConfig, policy: str) -> int:
    """Count the arms of a policy."""
    return math.prod(_arm_sizes(config, policy))


def _arm_sizes(config: SweepConfig, policy: str) -> list[int]:
    """Count the values of everything that makes up a policy's arms, the slowest first."""
    motion, *navigator = (
        [len(values) for values in config.params[table].values()]
        for table in ("motion", "map", "planner")
    )
    if policy not in POLICIES:
        return motion
    return [*motion, len(config.particles), *itertools.chain(*navigator)]


def _arm(config: SweepConfig, place: int) -> Arm:
    """Work out an arm by its number."""
    for policy in config.policies:
        number = _arms_of(config, policy)
        if place < number:
            return _built(config, policy, _digits(place, _arm_sizes(config, policy)))
        place -= number
    raise IndexError("no such arm")


def _end(config: SweepConfig, policy: str, which: Literal[0, -1]) -> Arm:
    """Build a policy's arm with the least (0) or the largest (-1) of all numbers."""
    ordered = {
        table: {key: (sorted(values)[which],) for key, values in keys.items()}
        for table, keys in config.params.items()
    }
    single = dataclasses.replace(config, params=ordered, particles=config.particles[:1])
    return _built(single, policy, [0] * len(_arm_sizes(single, policy)))


def _built(config: SweepConfig, policy: str, digits: Sequence[int]) -> Arm:
    """Build an arm from the places of its values."""
    params = config.params
    first = len(params["motion"])
    motion = _picked(params["motion"], digits[:first])
    if policy not in POLICIES:
        return Arm(policy=policy, particles=None, motion=motion, map=None, planner=None)
    middle = first + 1 + len(params["map"])
    return Arm(
        policy=policy,
        particles=config.particles[digits[first]],
        motion=motion,
        map=_picked(params["map"], digits[first + 1 : middle]),
        planner=_picked(params["planner"], digits[middle:]),
    )


def _digits(place: int, sizes: Sequence[int]) -> list[int]:
    """Write a number in digits of the given bases, the fastest last."""
    digits = []
    for size in reversed(sizes):
        place, digit = divmod(place, size)
        digits.append(digit)
    return digits[::-1]


def _picked(values: Values, digits: Sequence[int]) -> Chosen:
    """Pick one value for each key of a table."""
    return {key: of[digit] for (key, of), digit in zip(values.items(), digits, strict=True)}


def _as_arrays(chosen: Chosen) -> dict[str, Any]:
    """Turn numbers into the traced scalars of Params."""
    return {key: jnp.float32(value) for key, value in chosen.items()}


def parse_shard(text: str) -> tuple[int, int]:
    """Read which part of a sweep to do.

    Args:
        text: "i/n", 1 ≤ i ≤ n: the chunks i, i + n, i + 2n, …

    Returns:
        i and n.

    Raises:
        ValueError: not of this form or out of limits.
    """
    match = re.fullmatch(r"\s*(\d+)\s*/\s*(\d+)\s*", text)
    if match is None:
        raise ValueError(f'shard is "{text}", but must be i/n, such as 1/4')
    part, parts = int(match[1]), int(match[2])
    if not 1 <= part <= parts:
        raise ValueError(
            f'shard is "{text}", but i must be from 1 to n: 1/{parts} to {parts}/{parts}'
        )
    return part, parts


def shard_files(plan: Plan, shard: str) -> range:
    """Pick the files of a shard.

    Args:
        plan: of the sweep.
        shard: "i/n".

    Returns:
        Their numbers.

    Raises:
        ValueError: the shard is not of this form.
    """
    part, parts = parse_shard(shard)
    return range(part - 1, plan.num_files, parts)


def shard_episodes(plan: Plan, shard: str) -> int:
    """Count the episodes of a shard.

    Args:
        plan: of the sweep.
        shard: "i/n".

    Returns:
        Rows of its files.

    Raises:
        ValueError: the shard is not of this form.
    """
    files, each = shard_files(plan, shard), plan.files_of_arm
    # All files are full but the last one of each arm.
    lasts = sum(last in files for last in range(each - 1, plan.num_files, each))
    return len(files) * CHUNK - lasts * (CHUNK - plan.size(each - 1))
