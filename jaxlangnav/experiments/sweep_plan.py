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
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.experiments.grid import Arm, Grid, policy_arm
from jaxlangnav.experiments.monte_carlo import CHUNK
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.sizes import check_engine, readable_count
from jaxlangnav.experiments.sweep_config import Choices, SweepConfig
from jaxlangnav.experiments.tasks import Cell
from jaxlangnav.messages import default_motion, default_sensor
from jaxlangnav.navigator import NavigatorParams, check, default_params
from jaxlangnav.planner.config import POLICIES, SHIPPED
from jaxlangnav.pytree import replace

MOST_FILES = 1_000_000
"""Files of a folder: file systems grow slow with more, and their names have six digits."""
_T = TypeVar("_T")


class Lazy(Sequence[_T]):
    """As many things as one likes, each made from its number when it is asked for."""

    def __init__(self, size: int, make: Callable[[int], _T]) -> None:
        """Keep how to make them; of those that are made the last few are kept."""
        self._size, self._make = size, functools.lru_cache(maxsize=256)(make)

    def __len__(self) -> int:
        """Count them."""
        return self._size

    def __getitem__(self, place: Any) -> Any:
        """Make one."""
        return self._make(place)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Chunk:
    """The episodes of one file."""

    index: int
    arm: Arm
    first: int
    """Place of its first episode among the arm's."""
    size: int

    @property
    def places(self) -> np.ndarray:
        """Places of its episodes among the arm's."""
        return self.first + np.arange(self.size)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepPlan:
    """All files of a sweep, by their number."""

    config: SweepConfig

    @functools.cached_property
    def grid(self) -> Grid:
        """The grid of the sweep; settings and arms are worked out when they are asked for."""
        config = self.config
        arms = [(policy, _arm_sizes(config, policy)) for policy in config.policies]
        sizes, tables = _setting_sizes(config), ("sensor", "motion", "map", "planner")
        params = [f"{table}.{key}" for table in tables for key in config.params[table]]

        def arm(place: int) -> Arm:
            for policy, own in arms:
                if place < math.prod(own):
                    return _arm(config, policy, _digits(place, own))
                place -= math.prod(own)
            raise IndexError("no such arm")

        return Grid(
            settings=Lazy(self.num_settings, lambda at: _setting(config, _digits(at, sizes))),
            arms=Lazy(self.num_arms, arm),
            episodes=config.episodes,
            names=("world", "command", "relation", "range", "policy", "particles", *params),
        )

    @functools.cached_property
    def num_settings(self) -> int:
        """Count the settings."""
        return math.prod(_setting_sizes(self.config))

    @functools.cached_property
    def num_arms(self) -> int:
        """Count the arms."""
        return sum(math.prod(_arm_sizes(self.config, one)) for one in self.config.policies)

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

    def files(self, shard: str) -> range:
        """List the files of a shard "i/n" by their numbers."""
        part, parts = parse_shard(shard)
        return range(part - 1, self.num_files, parts)

    def episodes_of(self, shard: str) -> int:
        """Count the rows of a shard's files: all are full but the last one of each arm."""
        files, each = self.files(shard), self.files_of_arm
        lasts = sum(last in files for last in range(each - 1, self.num_files, each))
        return len(files) * CHUNK - lasts * (CHUNK - self.size(each - 1))

    def size(self, index: int) -> int:
        """Count the episodes of a file."""
        first = index % self.files_of_arm * CHUNK
        return min(CHUNK, self.num_settings * self.config.episodes - first)

    def chunk(self, index: int) -> Chunk:
        """Work out the episodes of a file."""
        arm, place = divmod(index, self.files_of_arm)
        own = self.grid.arms[arm]
        return Chunk(index=index, arm=own, first=place * CHUNK, size=self.size(index))

    def kind(self, index: int) -> tuple[str, int | None]:
        """Work out which program runs a file: policy, and particles if it has any."""
        arm = self.grid.arms[index // self.files_of_arm]
        return arm.policy, arm.told["particles"]


def make_plan(config: SweepConfig) -> SweepPlan:
    """Lay out a sweep.

    Raises:
        ValueError: Params with which the robot could never stop, more particles than memory
            holds, or more files than a folder does.
    """
    plan = SweepPlan(config=config)
    if plan.num_files > MOST_FILES:
        fit = MOST_FILES // plan.num_arms * CHUNK // plan.num_settings
        remedy = f"at most {fit:,} episodes a cell fit" if fit else "not even one a cell fits"
        raise ValueError(
            f"the sweep has {readable_count(plan.num_arms * plan.num_settings)} cells times "
            f"{readable_count(config.episodes)} episodes, "
            f"which make {readable_count(plan.num_files)} files, but a folder holds "
            f"{MOST_FILES:,}: {remedy}; or divide the lists (seeds, worlds, ...) among several "
            "sweeps"
        )
    for policy in config.policies:
        if policy in POLICIES:
            check_engine(navigator_config(policy, max(config.particles)))
            # A limit of ``check`` is passed upwards or downwards: the ends stand for all arms.
            most, least = _end(config, policy, -1), _end(config, policy, 0)
            check(least, policy=SHIPPED[policy])
            unclumped = replace(most.map, clumping=least.map.clumping)
            check(replace(most, map=unclumped), policy=SHIPPED[policy])
    return plan


def _setting_sizes(config: SweepConfig) -> list[int]:
    """Count the values of everything that makes up a setting, the slowest first."""
    sensor = config.params["sensor"].values()
    lists = (config.worlds, config.commands, config.ranges, *sensor, config.seeds)
    return [len(values) for values in lists]


def _arm_sizes(config: SweepConfig, policy: str) -> list[int]:
    """Count the values of everything that makes up a policy's arms, the slowest first."""
    motion, *navigator = (config.params[table].values() for table in ("motion", "map", "planner"))
    own = (config.particles, *itertools.chain(*navigator)) if policy in POLICIES else ()
    return [len(values) for values in (*motion, *own)]


def _setting(config: SweepConfig, digits: Sequence[int]) -> Cell:
    """Build a setting from the places of its values."""
    place, number, reach, *chosen, seed = digits
    world, command = config.worlds[place], config.commands[number]
    sensing_range = config.ranges[reach]
    sensor, own = _picked(config.params["sensor"], chosen), config.own_worlds.get(world)
    labels: dict[str, Any] = {f"sensor.{key}": value for key, value in sensor.items()}
    labels |= {"world": world, "command": command.text, "relation": command.relation}
    return Cell(
        world=world,
        relation=command.relation,
        instruction_index=number,
        sensor=replace(default_sensor(sensing_range), **_as_arrays(sensor)),
        seed=config.seeds[seed],
        environments=config.environments,
        scenario=None if own is None else jax.tree.map(np.asarray, own.scenario),
        labels=labels | {"range": sensing_range},
    )


def _arm(config: SweepConfig, policy: str, digits: Sequence[int]) -> Arm:
    """Build an arm; a baseline has few, as the navigator's numbers are none of its own."""
    tables, rest = config.params, list(digits)
    motion = _picked(tables["motion"], [rest.pop(0) for _ in tables["motion"]])
    names = [f"{table}.{key}" for table in ("map", "planner") for key in tables[table]]
    told: dict[str, Any] = {"policy": policy, "particles": None} | dict.fromkeys(names)
    told |= {f"motion.{key}": value for key, value in motion.items()}
    odometry = replace(default_motion(), **_as_arrays(motion))
    if policy not in POLICIES:
        return Arm(policy=policy, told=told, motion=odometry)
    told["particles"] = particles = config.particles[rest.pop(0)]
    own = {
        table: _picked(tables[table], [rest.pop(0) for _ in tables[table]])
        for table in ("map", "planner")
    }
    told |= {f"{table}.{key}": value for table, of in own.items() for key, value in of.items()}
    params = default_params()
    params = replace(
        params,
        map=replace(params.map, **_as_arrays(own["map"])),
        planner=replace(params.planner, **_as_arrays(own["planner"])),
    )
    return policy_arm(policy, num_particles=particles, params=params, motion=odometry, told=told)


def _end(config: SweepConfig, policy: str, which: Literal[0, -1]) -> NavigatorParams:
    """Take a policy's numbers where each is the least (0) or the largest (-1) of all."""
    ordered = {
        table: {key: (sorted(values)[which],) for key, values in keys.items()}
        for table, keys in config.params.items()
    }
    single = dataclasses.replace(config, params=ordered, particles=config.particles[:1])
    params = _arm(single, policy, [0] * len(_arm_sizes(single, policy))).params
    return default_params() if params is None else params


def _digits(place: int, sizes: Sequence[int]) -> list[int]:
    """Write a number in digits of the given bases, the fastest last."""
    return [int(digit) for digit in np.unravel_index(place, tuple(sizes))]


def _picked(values: Choices, digits: Sequence[int]) -> dict[str, float]:
    """Pick one value for each key of a table."""
    return {key: of[digit] for (key, of), digit in zip(values.items(), digits, strict=True)}


def _as_arrays(chosen: Mapping[str, float]) -> dict[str, Any]:
    """Turn numbers into the traced scalars of Params."""
    return {key: jnp.float32(value) for key, value in chosen.items()}


def parse_shard(text: str) -> tuple[int, int]:
    """Read which part of a sweep to do, "i/n": chunks i, i + n, i + 2n, …; refuses all else."""
    match = re.fullmatch(r"\s*(\d+)\s*/\s*(\d+)\s*", text)
    if match is None:
        raise ValueError(f'shard is "{text}", but must be i/n, such as 1/4')
    part, parts = int(match[1]), int(match[2])
    if not 1 <= part <= parts:
        raise ValueError(
            f'shard is "{text}", but i must be from 1 to n: 1/{parts} to {parts}/{parts}'
        )
    return part, parts
