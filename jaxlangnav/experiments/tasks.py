"""The episodes of an experiment: worlds, keys, sentences, sensors (section 4.2).

Episode i of a world has its scenario and its noise from (seed, world, i) alone, whatever the
policy, range or batch. Commands share them too: "null" and "behind" are asked for in the same
places, as in the paper.
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
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.limits import refuse_below
from jaxlangnav.inputs.program_cache import cached_jit
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.world.places import PlaceLaw, draw_place
from jaxlangnav.world.scenario import draw_scenario, scenario_law
from jaxlangnav.world.simulator import known_distance
from jaxlangnav.world.state import Scenario, empty_scenario

SENTENCES = {
    "null": "go to the hydrant",
    "behind": "go to the hydrant behind the cone",
    "nearest": "go to the hydrant nearest to the cone",
}
"""The three commands of Table 2 by their relation; none of them is in a training corpus."""
SEED_LIMIT = 2**32  # seeds lie below it: they are the root of the keys, 32 bits
BLOCK = 256  # worlds drawn in one call
Numbers = Mapping[str, float]  # values of fields of a record of Params


@dataclasses.dataclass(frozen=True, kw_only=True)
class GroundedSentences:
    """Sentences as the engine takes them, and the models that read them."""

    instructions: Instruction  # leaves [I, …], in the order of the sentences
    models: Any  # the trained weights, for a manifest's hash


def ground_sentences(texts: Sequence[str]) -> GroundedSentences:
    """Parse and ground at least one sentence with the shipped models; refuses as ``check_task``."""
    if not texts:
        raise ValueError("no sentence given")
    from jaxlangnav.grounding.instruction import understand
    from jaxlangnav.grounding.weights import load_shipped

    models = load_shipped()
    understood = [understand(text, models) for text in texts]
    for one in understood:
        one.check_task()
    told = (one.instruction for one in understood)
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *told)
    return GroundedSentences(instructions=stacked, models=models)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cell:
    """One cell of a grid: episodes that share everything but their keys; arms are compared in it.

    Detector and odometry are the default ones unless they are given.
    """

    world: str
    relation: str
    instruction_index: int
    sensor: SensorParams = dataclasses.field(default_factory=default_sensor)
    motion: MotionParams = dataclasses.field(default_factory=default_motion)
    episodes: int = 1  # how many ``make_tasks`` draws; a grid has a number of its own
    seed: int
    first_episode: int = 0
    environments: int = 0
    """Different worlds, taken in turn (the paper has ten); 0 for a fresh one per episode."""
    scenario: Scenario | None = None
    """A world of somebody's own; None draws worlds of the template that ``world`` names."""
    place: PlaceLaw | None = None
    """Places to draw in place of a template's; those of one name in ``world`` share their keys."""
    told: SensorParams | None = None  # what the robot takes its detector for; the truth if None
    labels: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """What the columns of a table say of it, by name."""
    believed: Numbers = dataclasses.field(default_factory=dict)
    """Single numbers of the navigator that are other there than its arm's (``with_numbers``)."""

    def __post_init__(self) -> None:
        """Refuse a seed that another one would stand for."""
        if not 0 <= self.seed < SEED_LIMIT:
            raise ValueError(f"seed is {self.seed}, but must lie between 0 and {SEED_LIMIT - 1}")


def cell(
    world: str,
    relation: str,
    instruction_index: int,
    sensing_range: float,
    episodes: int,
    seed: int,
) -> Cell:
    """Build a cell with the default noise."""
    return Cell(
        world=world,
        relation=relation,
        instruction_index=instruction_index,
        sensor=default_sensor(sensing_range),
        episodes=episodes,
        seed=seed,
    )


@cached_jit()
def _draw(described: dict[str, Any], *of_episode: ArrayLike) -> Task:
    """Draw each episode's key by its number and its world by the world's; leaves [BLOCK, …].

    ``of_episode``: seeds, names of worlds, numbers and worlds, u32[BLOCK] each.
    """

    def one(cell: dict[str, Any], seed: Array, name: Array, number: Array, world: Array) -> Task:
        # Policies, commands, ranges and noise levels share a cell's key, to be paired.
        root = jax.random.fold_in(jax.random.key(seed), name)
        of_number, of_world = jax.vmap(
            lambda index: jax.random.split(jax.random.fold_in(root, index))
        )(jnp.stack([number, world]))
        if "place" in cell:
            scenario = draw_place(of_world[0], cell["place"])
        else:
            drawn, is_own = draw_scenario(of_world[0], cell["law"]), cell["is_own"]
            given = cell["scenario"], drawn
            scenario = jax.tree.map(lambda own, new: jnp.where(is_own, own, new), *given)
        return Task(
            key=of_number[1],
            scenario=scenario,
            instruction_index=cell["instruction_index"],
            sensor=cell["sensor"],
            motion=cell["motion"],
            told=cell["told"],
        )

    return jax.vmap(one)(described, *map(jnp.asarray, of_episode))


@cached_jit(static_argnames=("number",))
def _first(tasks: Task, *, number: int) -> Task:
    """Take the first of some tasks: one program for all leaves."""
    return jax.tree.map(lambda leaf: leaf[:number], tasks)


def draw_tasks(cells: Sequence[Cell], index: np.ndarray, numbers: np.ndarray) -> Task:
    """Draw the worlds and keys of any selection of episodes, leaves [E, …].

    ``index``: i[E], which cell each is of; ``numbers``: i[E], its number within the cell's (seed,
    world); ``episodes`` and ``first_episode`` of the cells are not read. ``ValueError``: unknown
    world or relation, or places beside templates.
    """
    if len({one.place is None for one in cells}) > 1:
        raise ValueError("places and templates cannot be drawn at once: they differ in size")
    described = [_describe(one) for one in cells]
    stacked = jax.tree.map(lambda *leaves: np.stack([*map(np.asarray, leaves)]), *described)
    seeds = np.array([one.seed for one in cells], np.uint32)
    names = np.array([zlib.crc32(one.world.encode()) for one in cells], np.uint32)
    cycle = np.array([one.environments for one in cells])[index]
    worlds = np.where(cycle > 0, numbers % np.maximum(cycle, 1), numbers)
    parts = []
    # Drawn in blocks of one shape, filled up with the first: one program for any number.
    for start in range(0, len(index), BLOCK):
        at = np.arange(start, start + BLOCK)
        at = np.where(at < len(index), at, start)
        mine = jax.tree.map(lambda leaf, at=at: leaf[index[at]], stacked)
        which = numbers[at].astype(np.uint32), worlds[at].astype(np.uint32)
        parts.append(_draw(mine, seeds[index[at]], names[index[at]], *which))
    return _first(concatenate(parts) if len(parts) > 1 else parts[0], number=len(index))


def _describe(one: Cell) -> dict[str, Any]:
    """Gather what the tasks of a cell have in common; leaves are single values."""
    common = {name: getattr(one, name) for name in ("sensor", "motion", "told")}
    common["instruction_index"] = np.int32(one.instruction_index)
    if one.place is not None:
        return common | {"place": one.place}
    # The world of somebody's own is put in place of a drawn one, which then does not matter.
    drawn = (one.world, one.relation) if one.scenario is None else ("1H1C", "null")
    return common | {
        "law": scenario_law(template=drawn[0], relation=drawn[1]),
        "is_own": np.asarray(one.scenario is not None),
        "scenario": empty_scenario() if one.scenario is None else one.scenario,
    }


def make_tasks(one: Cell) -> Task:
    """Draw the worlds and keys of a cell, at least one, leaves [E, …]."""
    refuse_below(1, episodes=one.episodes)
    refuse_below(0, environments=one.environments)
    numbers = one.first_episode + np.arange(one.episodes)
    return draw_tasks([one], np.zeros(one.episodes, np.int32), numbers)


def take_tasks(tasks: Task, index: np.ndarray) -> Task:
    """Pick tasks by their numbers, i[n]: leaves [n, …] of [E, …]."""
    at = jnp.asarray(index)
    return jax.tree.map(lambda leaf: leaf[at], tasks)


def concatenate(parts: Sequence[Task]) -> Task:
    """Put the tasks of several cells behind one another."""
    return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *parts)


def known_distances(tasks: Task) -> np.ndarray:
    """Measure the straight way from start to goal of each task, f32[E] metres."""
    return np.asarray(jax.vmap(known_distance)(tasks.scenario))
