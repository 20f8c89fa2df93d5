"""The plan of a sweep: which episodes there are, and which of them make up a file.

The grid falls into *arms* (policy, particles, Params of map, planner and motion: what one call
of the compiled program shares) and *settings* (world, command, range, detector, seed). An arm's
episodes are cut into chunks of the size the compiled program takes; a chunk is a file. The plan
depends on the configuration alone, so files are the same however the work is split.
"""

import dataclasses
import itertools
import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.episode import Task
from jaxlangnav.experiments.monte_carlo import CHUNK, Cell, draw_tasks
from jaxlangnav.experiments.sweep_config import SweepConfig, Values
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.navigator import NavigatorParams, check, default_params
from jaxlangnav.planner.params import POLICIES
from jaxlangnav.pytree import replace

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
    """All files of a sweep."""

    config: SweepConfig
    settings: tuple[Setting, ...]
    chunks: tuple[Chunk, ...]

    def episodes(self) -> int:
        """Count the rows of all files."""
        return sum(one.size for one in self.chunks)


def make_plan(config: SweepConfig) -> Plan:
    """Lay out a sweep.

    Args:
        config: the grid.

    Returns:
        The plan.

    Raises:
        ValueError: Params with which the robot could never stop.
    """
    settings = tuple(
        Setting(world=world, command=command, range=reach, sensor=sensor, seed=seed)
        for world in config.worlds
        for command in range(len(config.commands))
        for reach in config.ranges
        for sensor in _product(config.params["sensor"])
        for seed in config.seeds
    )
    chunks: list[Chunk] = []
    number = len(settings) * config.episodes
    for arm in _arms(config):
        if arm.policy in POLICIES:
            check(arm.params())
        for first in range(0, number, CHUNK):
            size = min(CHUNK, number - first)
            chunks.append(Chunk(index=len(chunks), arm=arm, first=first, size=size))
    return Plan(config=config, settings=settings, chunks=tuple(chunks))


def _arms(config: SweepConfig) -> list[Arm]:
    """List the arms; a baseline appears once, whatever the navigator's numbers."""
    arms = []
    for policy, motion in itertools.product(config.policies, _product(config.params["motion"])):
        if policy not in POLICIES:
            arms.append(Arm(policy=policy, particles=None, motion=motion, map=None, planner=None))
            continue
        arms += [
            Arm(policy=policy, particles=particles, motion=motion, map=map_, planner=planner)
            for particles in config.particles
            for map_ in _product(config.params["map"])
            for planner in _product(config.params["planner"])
        ]
    return arms


def _product(values: Values) -> list[Chosen]:
    """List all combinations of a table's values."""
    chosen = itertools.product(*values.values())
    return [dict(zip(values, one, strict=True)) for one in chosen]


def _as_arrays(chosen: Chosen) -> dict[str, Any]:
    """Turn numbers into the traced scalars of Params."""
    return {key: jnp.float32(value) for key, value in chosen.items()}


def _locate(plan: Plan, chunk: Chunk) -> tuple[np.ndarray, np.ndarray]:
    """Find setting and number of a chunk's episodes, i[E] each."""
    places = chunk.first + np.arange(chunk.size)
    return places // plan.config.episodes, places % plan.config.episodes


def chunk_tasks(plan: Plan, chunk: Chunk) -> Task:
    """Draw the tasks of a file.

    Args:
        plan: of the sweep.
        chunk: one of its chunks.

    Returns:
        Tasks, leaves [size, …].
    """
    where, numbers = _locate(plan, chunk)
    used, index = np.unique(where, return_inverse=True)
    cells = [_cell(plan.config, plan.settings[at], chunk.arm) for at in used]
    return draw_tasks(cells, index, numbers)


def _cell(config: SweepConfig, setting: Setting, arm: Arm) -> Cell:
    """Build the cell of a setting."""
    own = config.own_worlds.get(setting.world)
    return Cell(
        world=setting.world,
        relation=config.commands[setting.command].relation,
        instruction_index=setting.command,
        sensor=setting.sensor_params(),
        motion=arm.motion_params(),
        episodes=config.episodes,
        environments=config.environments,
        seed=setting.seed,
        scenario=None if own is None else jax.tree.map(np.asarray, own.scenario),
    )


def chunk_columns(plan: Plan, chunk: Chunk) -> dict[str, list[Any]]:
    """Say of every episode of a file which it is.

    Args:
        plan: of the sweep.
        chunk: one of its chunks.

    Returns:
        Lists of the chunk's size by name; what an arm does not have is None.
    """
    where, numbers = _locate(plan, chunk)
    settings = [plan.settings[at] for at in where]
    commands = [plan.config.commands[one.command] for one in settings]
    columns: dict[str, list[Any]] = {
        "world": [one.world for one in settings],
        "command": [one.text for one in commands],
        "relation": [one.relation for one in commands],
        "range": [one.range for one in settings],
        "policy": [chunk.arm.policy] * chunk.size,
        "particles": [chunk.arm.particles] * chunk.size,
    }
    for key in plan.config.params["sensor"]:
        columns[f"sensor.{key}"] = [one.sensor[key] for one in settings]
    for table in ("motion", "map", "planner"):
        for key in plan.config.params[table]:
            chosen = getattr(chunk.arm, table)
            columns[f"{table}.{key}"] = [None if chosen is None else chosen[key]] * chunk.size
    columns["seed"] = [one.seed for one in settings]
    columns["episode"] = [int(number) for number in numbers]
    return columns


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


def shard_chunks(plan: Plan, shard: str) -> list[Chunk]:
    """Pick the chunks of a shard.

    Args:
        plan: of the sweep.
        shard: "i/n".

    Returns:
        Its chunks.

    Raises:
        ValueError: the shard is not of this form.
    """
    part, parts = parse_shard(shard)
    return [one for one in plan.chunks if one.index % parts == part - 1]
