"""The episodes of a sweep's file: what is run, and the columns that say which they are."""

from typing import Any

import jax
import numpy as np

from jaxlangnav.episode import Task
from jaxlangnav.experiments.sweep_config import SweepConfig
from jaxlangnav.experiments.sweep_plan import Arm, Chunk, Plan, Setting
from jaxlangnav.experiments.tasks import Cell, draw_tasks


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
    cells = [_cell(plan.config, plan.setting(int(at)), chunk.arm) for at in used]
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
    used, index = np.unique(where, return_inverse=True)
    found = [plan.setting(int(at)) for at in used]
    settings = [found[at] for at in index]
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
