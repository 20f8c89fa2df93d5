"""Plan of a sweep: its grid of arms and settings, divided into chunks of episodes, one per file.

The grid consists of *arms* (policy, particles, Params of map, planner and motion: what one call of
the compiled program shares) and *settings* (world, command, range, detector, seed). An arm's
episodes are divided into chunks of the compiled program's batch size; a chunk is a file. The plan
depends on the configuration alone. Arm, setting and chunk are computed from their index on demand,
so a shard of a billion episodes costs only what that shard costs.
"""

import bisect
import dataclasses
import functools
import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxlangnav.experiments.experiment import Grid
from jaxlangnav.experiments.monte_carlo import CHUNK_SIZE
from jaxlangnav.experiments.policies import DEFAULT_PARTICLES, Arm, navigator_config, policy_arm
from jaxlangnav.experiments.sizes import check_engine, readable_count
from jaxlangnav.experiments.sweep_config import SweepConfig
from jaxlangnav.experiments.tasks import Cell
from jaxlangnav.messages import default_sensor
from jaxlangnav.navigator import NavigatorParams, check, default_params
from jaxlangnav.navigator.deployment import set_params
from jaxlangnav.planner.config import POLICIES, SHIPPED
from jaxlangnav.pytree import replace

MAX_FILES = 1_000_000
"""Limit of files in a folder: file systems get slow, and file names have six digits."""
Axes = dict[str, Sequence[Any]]
"""Axes of a grid, the slowest first: the values of a column, by its name."""


class LazySequence(Sequence[Any]):
    """Sequence whose items are computed from their index on access, with a small cache."""

    def __init__(self, size: int, make: Callable[[int], Any]) -> None:
        """Store the length and the function from index to item, cached."""
        self._size, self._make = size, functools.lru_cache(maxsize=256)(make)

    def __len__(self) -> int:
        """Return the length."""
        return self._size

    def __getitem__(self, index: Any) -> Any:
        """Compute an item, or take it from the cache."""
        return self._make(index)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepPlan:
    """All files of a sweep, by index."""

    config: SweepConfig

    @functools.cached_property
    def grid(self) -> Grid:
        """Grid of the sweep; settings and arms are computed on access."""
        config = self.config
        counts = [_grid_size(_arm_axes(config, policy)) for policy in config.policies]
        starts = [0, *itertools.accumulate(counts)]
        defaults = dict.fromkeys(("particles", *_params_axes(config, "map", "planner")))

        def arm(index: int) -> Arm:
            p = bisect.bisect(starts, index) - 1
            policy = config.policies[p]
            point = _grid_point(_arm_axes(config, policy), index - starts[p])
            params = _params(point)
            return policy_arm(
                policy,
                num_particles=point.get("particles", DEFAULT_PARTICLES),
                params=params,
                motion=params.map.motion,
                labels={"policy": policy, **defaults, **point},
            )

        params = _params_axes(config, "sensor", "motion", "map", "planner")
        return Grid(
            settings=LazySequence(_grid_size(_setting_axes(config)), lambda i: _setting(config, i)),
            arms=LazySequence(starts[-1], arm),
            episodes=config.episodes,
            names=("world", "command", "relation", "range", "policy", "particles", *params),
        )

    @property
    def episodes_of_arm(self) -> int:
        """Count the rows of an arm."""
        return len(self.grid.settings) * self.config.episodes

    @property
    def files_of_arm(self) -> int:
        """Count the files of an arm."""
        return -(-self.episodes_of_arm // CHUNK_SIZE)

    @property
    def num_files(self) -> int:
        """Count the files."""
        return len(self.grid.arms) * self.files_of_arm

    def files(self, shard: str) -> range:
        """List the indices of the files of a shard "i/n"."""
        part, parts = parse_shard(shard)
        return range(part - 1, self.num_files, parts)

    def episodes_of(self, shard: str) -> int:
        """Count the rows of a shard's files."""
        return sum(map(self.size, self.files(shard)))

    def size(self, index: int) -> int:
        """Count the episodes of a file; only the last file of an arm may be partial."""
        return min(CHUNK_SIZE, self.episodes_of_arm - index % self.files_of_arm * CHUNK_SIZE)

    def arm(self, index: int) -> Arm:
        """Find the arm of a file."""
        return self.grid.arms[index // self.files_of_arm]

    def episode_indices(self, index: int) -> np.ndarray:
        """List the indices of a file's episodes within its arm."""
        return index % self.files_of_arm * CHUNK_SIZE + np.arange(self.size(index))


def make_plan(config: SweepConfig) -> SweepPlan:
    """Build and validate the plan of a sweep.

    ``ValueError``: Params with which the robot could never stop, more particles than memory holds,
    or more files than a folder holds.
    """
    plan = SweepPlan(config=config)
    arms, settings = len(plan.grid.arms), len(plan.grid.settings)
    if plan.num_files > MAX_FILES:
        max_n = MAX_FILES // arms * CHUNK_SIZE // settings
        remedy = f"at most {max_n:,} episodes a cell fit" if max_n else "not even one a cell fits"
        raise ValueError(
            f"the sweep has {readable_count(arms * settings)} cells times "
            f"{readable_count(config.episodes)} episodes, "
            f"which make {readable_count(plan.num_files)} files, but a folder holds "
            f"{MAX_FILES:,}: {remedy}; or divide the lists (seeds, worlds, ...) among several "
            "sweeps"
        )
    for policy in config.policies:
        if policy in POLICIES:
            check_engine(navigator_config(policy, max(config.particles)))
            # Limits of ``check`` are monotone: the extreme values stand for all arms.
            axes = _params_axes(config, "motion", "map", "planner").items()
            lower, upper = (
                _params({name: sorted(values)[end] for name, values in axes}) for end in (0, -1)
            )
            check(lower, policy=SHIPPED[policy])
            map_params = replace(upper.map, clumping=lower.map.clumping)
            check(replace(upper, map=map_params), policy=SHIPPED[policy])
    return plan


def _params_axes(config: SweepConfig, *tables: str) -> Axes:
    return {
        f"{table}.{key}": values for table in tables for key, values in config.params[table].items()
    }


def _setting_axes(config: SweepConfig) -> Axes:
    axes: Axes = {"world": config.worlds, "command": config.commands, "range": config.ranges}
    return {**axes, **_params_axes(config, "sensor"), "seed": config.seeds}


def _arm_axes(config: SweepConfig, policy: str) -> Axes:
    """Axes of a policy's arms; a baseline varies only the motion model."""
    motion = _params_axes(config, "motion")
    if policy not in POLICIES:  # a baseline has no parameters of the navigator
        return motion
    return {**motion, "particles": config.particles, **_params_axes(config, "map", "planner")}


def _grid_size(axes: Axes) -> int:
    return math.prod(map(len, axes.values()))


def _grid_point(axes: Axes, index: int) -> dict[str, Any]:
    """Compute the point of a grid with an index: a value for each name."""
    indices = np.unravel_index(index, [len(values) for values in axes.values()])
    return {name: values[int(i)] for (name, values), i in zip(axes.items(), indices, strict=True)}


def _table_values(point: Mapping[str, Any], *tables: str) -> dict[str, float]:
    """Select the values of the given tables, by key."""
    keys = ((name.partition("."), value) for name, value in point.items())
    return {key: value for (table, _, key), value in keys if table in tables}


def _setting(config: SweepConfig, index: int) -> Cell:
    point = _grid_point(_setting_axes(config), index)
    command, custom = point["command"], config.custom_worlds.get(point["world"])
    return Cell(
        world=point["world"],
        relation=command.relation,
        instruction_index=config.commands.index(command),
        sensor=default_sensor(point["range"], **_table_values(point, "sensor")),
        seed=point["seed"],
        environments=config.environments,
        scenario=None if custom is None else jax.tree.map(np.asarray, custom.scenario),
        labels={**point, "command": command.text, "relation": command.relation},
    )


def _params(point: Mapping[str, Any]) -> NavigatorParams:
    return set_params(_table_values(point, "motion", "map", "planner"), params=default_params())


def parse_shard(text: str) -> tuple[int, int]:
    """Parse a shard "i/n": chunks i, i + n, i + 2n, …; ``ValueError`` for anything else."""
    match = re.fullmatch(r"\s*(\d+)\s*/\s*(\d+)\s*", text)
    if match is None:
        raise ValueError(f'shard is "{text}", but must be i/n, such as 1/4')
    i, n = int(match[1]), int(match[2])
    if not 1 <= i <= n:
        raise ValueError(f'shard is "{text}", but i must be from 1 to n: 1/{n} to {n}/{n}')
    return i, n
