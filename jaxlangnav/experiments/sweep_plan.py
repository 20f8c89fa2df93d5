"""The plan of a sweep: which episodes there are, and which of them make up a file.

The grid falls into *arms* (policy, particles, Params of map, planner and motion: what one call of
the compiled program shares) and *settings* (world, command, range, detector, seed). An arm's
episodes are cut into chunks of the size the compiled program takes; a chunk is a file. The plan
depends on the configuration alone. Arm, setting and chunk are worked out from their number, so that
a part of a billion episodes costs what that part costs.
"""

import bisect
import dataclasses
import functools
import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import jax
import numpy as np

from jaxlangnav.experiments.experiment import Grid
from jaxlangnav.experiments.monte_carlo import CHUNK
from jaxlangnav.experiments.policies import DEFAULT_PARTICLES, Arm, navigator_config, policy_arm
from jaxlangnav.experiments.sizes import check_engine, readable_count
from jaxlangnav.experiments.sweep_config import SweepConfig
from jaxlangnav.experiments.tasks import Cell
from jaxlangnav.messages import default_sensor
from jaxlangnav.navigator import NavigatorParams, check, default_params
from jaxlangnav.navigator.deployment import with_numbers
from jaxlangnav.planner.config import POLICIES, SHIPPED
from jaxlangnav.pytree import replace

MOST_FILES = 1_000_000
"""Files of a folder: file systems grow slow with more, and their names have six digits."""
_T = TypeVar("_T")
Axes = dict[str, Sequence[Any]]
"""What is varied, the slowest first: the values that a column takes, by its name."""


class LazySequence(Sequence[_T]):
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
class SweepPlan:
    """All files of a sweep, by their number."""

    config: SweepConfig

    @functools.cached_property
    def grid(self) -> Grid:
        """The grid of the sweep; settings and arms are worked out when they are asked for."""
        config = self.config
        numbers = [_size(_arm_axes(config, policy)) for policy in config.policies]
        firsts = [0, *itertools.accumulate(numbers)]
        of_navigator = dict.fromkeys(("particles", *_params_axes(config, "map", "planner")))

        def arm(place: int) -> Arm:
            which = bisect.bisect(firsts, place) - 1
            policy = config.policies[which]
            picked = _pick(_arm_axes(config, policy), place - firsts[which])
            params = _params(picked)
            return policy_arm(
                policy,
                num_particles=picked.get("particles", DEFAULT_PARTICLES),
                params=params,
                motion=params.map.motion,
                told={"policy": policy, **of_navigator, **picked},
            )

        params = _params_axes(config, "sensor", "motion", "map", "planner")
        return Grid(
            settings=LazySequence(_size(_setting_axes(config)), lambda at: _setting(config, at)),
            arms=LazySequence(firsts[-1], arm),
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
        return -(-self.episodes_of_arm // CHUNK)

    @property
    def num_files(self) -> int:
        """Count the files."""
        return len(self.grid.arms) * self.files_of_arm

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
        return min(CHUNK, self.episodes_of_arm - index % self.files_of_arm * CHUNK)

    def arm(self, index: int) -> Arm:
        """Work out the arm of a file."""
        return self.grid.arms[index // self.files_of_arm]

    def places(self, index: int) -> np.ndarray:
        """Number the episodes of a file among the arm's."""
        return index % self.files_of_arm * CHUNK + np.arange(self.size(index))

    def kind(self, index: int) -> tuple[str, int | None]:
        """Work out which program runs a file: policy, and particles if it has any."""
        arm = self.arm(index)
        return arm.policy, arm.told["particles"]


def make_plan(config: SweepConfig) -> SweepPlan:
    """Lay out a sweep.

    ``ValueError``: Params with which the robot could never stop, more particles than memory holds,
    or more files than a folder does.
    """
    plan = SweepPlan(config=config)
    arms, settings = len(plan.grid.arms), len(plan.grid.settings)
    if plan.num_files > MOST_FILES:
        fit = MOST_FILES // arms * CHUNK // settings
        remedy = f"at most {fit:,} episodes a cell fit" if fit else "not even one a cell fits"
        raise ValueError(
            f"the sweep has {readable_count(arms * settings)} cells times "
            f"{readable_count(config.episodes)} episodes, "
            f"which make {readable_count(plan.num_files)} files, but a folder holds "
            f"{MOST_FILES:,}: {remedy}; or divide the lists (seeds, worlds, ...) among several "
            "sweeps"
        )
    for policy in config.policies:
        if policy in POLICIES:
            check_engine(navigator_config(policy, max(config.particles)))
            # A limit of ``check`` is passed upwards or downwards: the ends stand for all arms.
            axes = _params_axes(config, "motion", "map", "planner").items()
            least, most = (
                _params({name: sorted(values)[at] for name, values in axes}) for at in (0, -1)
            )
            check(least, policy=SHIPPED[policy])
            unclumped = replace(most.map, clumping=least.map.clumping)
            check(replace(most, map=unclumped), policy=SHIPPED[policy])
    return plan


def _params_axes(config: SweepConfig, *tables: str) -> Axes:
    return {
        f"{table}.{key}": values for table in tables for key, values in config.params[table].items()
    }


def _setting_axes(config: SweepConfig) -> Axes:
    where: Axes = {"world": config.worlds, "command": config.commands, "range": config.ranges}
    return {**where, **_params_axes(config, "sensor"), "seed": config.seeds}


def _arm_axes(config: SweepConfig, policy: str) -> Axes:
    """List the values of everything that makes up a policy's arms; a baseline has few."""
    motion = _params_axes(config, "motion")
    if policy not in POLICIES:  # the navigator's numbers are none of its own
        return motion
    return {**motion, "particles": config.particles, **_params_axes(config, "map", "planner")}


def _size(axes: Axes) -> int:
    return math.prod(map(len, axes.values()))


def _pick(axes: Axes, place: int) -> dict[str, Any]:
    """Take a member of a grid by its number: a value for each name."""
    digits = np.unravel_index(place, [len(values) for values in axes.values()])
    return {name: of[int(at)] for (name, of), at in zip(axes.items(), digits, strict=True)}


def _numbers(picked: Mapping[str, Any], *tables: str) -> dict[str, float]:
    """Take the numbers of some tables, by their keys."""
    own = ((name.partition("."), value) for name, value in picked.items())
    return {key: value for (of, _, key), value in own if of in tables}


def _setting(config: SweepConfig, place: int) -> Cell:
    picked = _pick(_setting_axes(config), place)
    command, own = picked["command"], config.own_worlds.get(picked["world"])
    return Cell(
        world=picked["world"],
        relation=command.relation,
        instruction_index=config.commands.index(command),
        sensor=default_sensor(picked["range"], **_numbers(picked, "sensor")),
        seed=picked["seed"],
        environments=config.environments,
        scenario=None if own is None else jax.tree.map(np.asarray, own.scenario),
        labels={**picked, "command": command.text, "relation": command.relation},
    )


def _params(picked: Mapping[str, Any]) -> NavigatorParams:
    return with_numbers(_numbers(picked, "motion", "map", "planner"), params=default_params())


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
