"""Tasks of an experiment: worlds, keys, sentences and sensors of its episodes (section 4.2).

Scenario and noise of episode i of a world depend on (seed, world, i) alone, not on policy, range or
batch. Commands share them too: "null" and "behind" are given in the same worlds, as in the
paper.
"""

import dataclasses
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from jaxlangnav.episode import Task
from jaxlangnav.grounding.instruction import Instruction, understand
from jaxlangnav.grounding.weights import load_shipped
from jaxlangnav.inputs.limits import check_minimum, check_seed
from jaxlangnav.inputs.program_cache import cached_jit
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.world.places import WorldParams, draw_world
from jaxlangnav.world.scenario import draw_scenario, scenario_params
from jaxlangnav.world.simulator import known_distance
from jaxlangnav.world.state import Scenario, make_scenario

SENTENCES = {
    "null": "go to the hydrant",
    "behind": "go to the hydrant behind the cone",
    "nearest": "go to the hydrant nearest to the cone",
}
"""The three commands of Table 2, by relation; none of them is in a training corpus."""
BLOCK = 256  # worlds drawn in one call
Overrides = Mapping[str, float]  # parameter values by field name


@dataclasses.dataclass(frozen=True, kw_only=True)
class GroundedSentences:
    """Grounded sentences, and the language models that grounded them."""

    instructions: Instruction  # leaves [I, …], in the order of the sentences
    models: Any  # trained weights, for the manifest's hash


def ground_sentences(texts: Sequence[str]) -> GroundedSentences:
    """Parse and ground sentences with the shipped models; ``ValueError``: none or no command."""
    if not texts:
        raise ValueError("no sentence given")
    models = load_shipped()
    understood = [understand(text, models) for text in texts]
    for sentence in understood:
        sentence.check_task()
    instructions = (sentence.instruction for sentence in understood)
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *instructions)
    return GroundedSentences(instructions=stacked, models=models)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cell:
    """An experimental setting: episodes that share everything but their random keys.

    Sensor and motion model are the default ones unless given.
    """

    world: str  # name of a template, or of a custom world
    relation: str  # of the command, for which a template's worlds are sampled
    instruction_index: int = 0  # of the command, among the instructions of the batch
    sensor: SensorParams = dataclasses.field(default_factory=default_sensor)
    motion: MotionParams = dataclasses.field(default_factory=default_motion)
    seed: int
    environments: int = 0
    """Number of worlds, used cyclically (ten in the paper); 0: a new one per episode."""
    scenario: Scenario | None = None
    """A custom world; None: sample worlds of the template that ``world`` names."""
    world_params: WorldParams | None = None
    """Distribution of worlds in place of a template; equal names in ``world`` share keys."""
    assumed_sensor: SensorParams | None = None  # sensor model of the filter; the true one if None
    labels: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Label columns of a table, by name."""
    overrides: Overrides = dataclasses.field(default_factory=dict)
    """Parameters of the navigator that replace its arm's (``set_params``)."""

    def __post_init__(self) -> None:
        """Raise ``ValueError`` for a seed outside 32 bits."""
        check_seed(self.seed)


@cached_jit()
def _draw(shared: dict[str, Any], *ids: ArrayLike) -> Task:
    """Sample the tasks of a block of episodes from their indices; leaves [BLOCK, …].

    ``ids``: seeds, hashes of world names, indices of episodes and of worlds, u32[BLOCK] each.
    """

    def draw(cell: dict[str, Any], seed: Array, name: Array, episode: Array, world: Array) -> Task:
        # Policies, commands, ranges and noise levels share a cell's key, to be paired.
        root = jax.random.fold_in(jax.random.key(seed), name)
        keys, world_keys = jax.vmap(
            lambda index: jax.random.split(jax.random.fold_in(root, index))
        )(jnp.stack([episode, world]))
        if "world_params" in cell:
            scenario = draw_world(world_keys[0], cell["world_params"])
        else:
            sampled, is_custom = draw_scenario(world_keys[0], cell["params"]), cell["is_custom"]
            candidates = cell["scenario"], sampled
            scenario = jax.tree.map(lambda a, b: jnp.where(is_custom, a, b), *candidates)
        return Task(key=keys[1], scenario=scenario, **cell["task"])

    return jax.vmap(draw)(shared, *map(jnp.asarray, ids))


@cached_jit(static_argnames=("count",))
def _take_first(tasks: Task, *, count: int) -> Task:
    """Select the first tasks: one program for all leaves."""
    return jax.tree.map(lambda leaf: leaf[:count], tasks)


def draw_tasks(cells: Sequence[Cell], index: np.ndarray, episodes: np.ndarray) -> Task:
    """Sample the worlds and keys of any selection of episodes, leaves [E, …].

    ``index``: i[E], the cell of each; ``episodes``: i[E], its index within the cell's (seed,
    world). ``ValueError``: unknown world or relation, or cells with and without ``world_params``.
    """
    if len({cell.world_params is None for cell in cells}) > 1:
        raise ValueError("places and templates cannot be drawn at once: they differ in size")
    shared = [_shared_fields(cell) for cell in cells]
    stacked = jax.tree.map(lambda *leaves: np.stack([*map(np.asarray, leaves)]), *shared)
    seeds = np.array([cell.seed for cell in cells], np.uint32)
    world_hashes = np.array([zlib.crc32(cell.world.encode()) for cell in cells], np.uint32)
    cycles = np.array([cell.environments for cell in cells])[index]
    world_ids = np.where(cycles > 0, episodes % np.maximum(cycles, 1), episodes)
    parts = []
    # Sampled in blocks of one shape, padded with the first: one program for any number.
    for start in range(0, len(index), BLOCK):
        i = np.arange(start, start + BLOCK)
        i = np.where(i < len(index), i, start)
        part = jax.tree.map(lambda leaf, i=i: leaf[index[i]], stacked)
        ids = episodes[i].astype(np.uint32), world_ids[i].astype(np.uint32)
        parts.append(_draw(part, seeds[index[i]], world_hashes[index[i]], *ids))
    return _take_first(concatenate(parts) if len(parts) > 1 else parts[0], count=len(index))


def _shared_fields(cell: Cell) -> dict[str, Any]:
    """Collect what all tasks of a cell share: fields of ``Task``, and those of its worlds."""
    task = {name: getattr(cell, name) for name in ("sensor", "motion", "assumed_sensor")}
    task["instruction_index"] = np.int32(cell.instruction_index)
    if cell.world_params is not None:
        return {"task": task, "world_params": cell.world_params}
    # A custom world replaces a sampled one, so any template will do.
    template = (cell.world, cell.relation) if cell.scenario is None else ("1H1C", "null")
    return {
        "task": task,
        "params": scenario_params(template=template[0], relation=template[1]),
        "is_custom": np.asarray(cell.scenario is not None),
        "scenario": make_scenario() if cell.scenario is None else cell.scenario,
    }


def make_tasks(cell: Cell, count: int, *, first: int = 0) -> Task:
    """Sample the worlds and keys of a cell's episodes from ``first`` on, leaves [E, …]."""
    check_minimum(1, episodes=count)
    check_minimum(0, environments=cell.environments)
    return draw_tasks([cell], np.zeros(count, np.int32), first + np.arange(count))


def take_tasks(tasks: Task, index: np.ndarray) -> Task:
    """Select tasks by index, i[n]: leaves [n, …] of [E, …]."""
    i = jnp.asarray(index)
    return jax.tree.map(lambda leaf: leaf[i], tasks)


def concatenate(parts: Sequence[Task]) -> Task:
    """Concatenate tasks along their leading axis."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def known_distances(tasks: Task) -> np.ndarray:
    """Compute the shortest path length from start to goal of each task, f32[E] metres."""
    return np.asarray(jax.vmap(known_distance)(tasks.scenario))
