"""Loading of an episode's task: a world for a sentence, and the goal that the sentence means there.

The world is a file, or sampled from a template so that the sentence is true in it. A missing world
or a bad file raises a ``ValueError`` wherever it is named.
"""

import dataclasses
import math
from collections.abc import Sequence

import jax
import numpy as np

from jaxlangnav.episode import MAX_STEPS, Task
from jaxlangnav.experiments.tasks import Cell, make_tasks
from jaxlangnav.grounding.binding import Detector
from jaxlangnav.grounding.instruction import Understanding
from jaxlangnav.grounding.worlds import explain_mismatch
from jaxlangnav.inputs.limits import check_seed
from jaxlangnav.messages import default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.task.labelled import intended_goals, is_among, placed_world, with_goal
from jaxlangnav.world.files import WorldFile, WorldSource, shipped_worlds
from jaxlangnav.world.state import Scenario
from jaxlangnav.world.templates import Template

_MAX_TRIES = 64
"""Maximum number of worlds sampled in search of one in which the sentence is true."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class PreparedTask:
    """A task, and how its success is evaluated."""

    world: str  # its name
    task: Task
    is_find_task: bool  # success is to have the goal in view
    goal_exists: bool  # some place there fits the sentence
    via: tuple[tuple[float, float], ...]  # end positions of the commands before the last, metres
    num_tied: int  # equally good goals of the sentence; 1 where the world names its goal
    missing: tuple[str, ...]  # mentions without a referent there, where no place fits

    @property
    def unscored(self) -> str:
        """Reason why success is undefined; empty where it is defined."""
        if not self.goal_exists:
            details = f" ({'; '.join(self.missing)})" if self.missing else ""
            return f"nothing there fits the sentence{details}"
        if self.num_tied == 1:
            return ""
        return f"{self.num_tied} places fit the sentence alike, and nothing says which is meant"


def load_task(
    source: WorldSource, understood: Understanding, *, sensing_range: float | None, seed: int
) -> PreparedTask:
    """Build the task of one episode in a world file or a world sampled from a template.

    Args:
        source: of ``open_world``.
        understood: the sentence; a template's world is sampled so that it is true there.
        sensing_range: metres; that of the world, 3 m for a template, where None.
        seed: of world and noise.

    Raises:
        ValueError: a template that has nothing of what is asked, or no seed.
    """
    check_seed(seed)
    if isinstance(source, WorldFile):
        sensor = source.sensor
        if sensing_range is not None:
            sensor = replace(sensor, range_max=default_sensor(sensing_range).range_max)
        task = Task(
            key=jax.random.key(seed),
            scenario=source.scenario,
            instruction_index=jax.device_put(np.int32(0)),
            sensor=sensor,
            motion=source.motion,
        )
        texts = (source.instruction or "", understood.parse.instruction)
        expected, given = (" ".join(phrase.lower().split()).rstrip(".!") for phrase in texts)
        # The world's goal is that of its own instruction.
        is_default, has_goal = source.has_goal and expected == given, source.has_goal
        return _set_goal(source.name, task, understood, is_default=is_default, has_goal=has_goal)
    return _sample_task(source, understood, 3.0 if sensing_range is None else sensing_range, seed)


def detector_of(source: WorldSource, type_names: Sequence[str]) -> Detector:
    """Build the detector of a world: its object types and attribute groups."""
    if isinstance(source, WorldFile):
        return Detector(source.type_names, source.attribute_groups)
    return Detector(type_names)


def step_limit(task: Task) -> int:
    """Compute the default step limit: steps for 120 m, or three sweeps of the area if longer."""
    x_min, x_max, y_min, y_max = np.asarray(task.scenario.area).tolist()
    sweep = (x_max - x_min) * (y_max - y_min) / (2.0 * float(task.sensor.range_max))  # metres
    return math.ceil(max(MAX_STEPS, 3.0 * sweep) / min(float(task.motion.step_length), 1.0))


def mismatch_message(world: str, counts: Sequence[tuple[str, int]], missing: Sequence[str]) -> str:
    """Compose the error message for a template that does not fit a sentence, one line."""
    objects = " and ".join(f"{count} {name}{'s' * (count > 1)}" for name, count in counts)
    lack = f"no {missing[0]}" if missing else "nothing that fits the sentence"
    return (
        f"world {world} has {lack}, only {objects}: choose another template, "
        f"a shipped world ({', '.join(shipped_worlds())}) or a file with --world"
    )


def absent_types(counts: Sequence[tuple[str, int]], understood: Understanding) -> list[str]:
    """List the types of a sentence's probable annotations that are not in ``count_types``."""
    likely = [item for item in understood.annotations if item["probability"] >= 0.5]
    mentioned = dict.fromkeys(item[role] for item in likely for role in ("figure", "landmark"))
    names = set(understood.type_names) - set(dict(counts))
    return [name for name in mentioned if name in names]


def count_types(scenario: Scenario, names: Sequence[str]) -> list[tuple[str, int]]:
    """Count the objects of a world by type; types without objects are left out."""
    types = [int(code) for code in np.asarray(scenario.object_type)[np.asarray(scenario.is_object)]]
    return [(names[index], types.count(index)) for index in dict.fromkeys(types)]


def _set_goal(
    name: str,
    task: Task,
    understood: Understanding,
    *,
    is_default: bool = False,
    has_goal: bool = True,
) -> PreparedTask:
    """Set the goal to the sentence's; the world's own goal is kept if it fits as well."""
    (*earlier, goals), is_find_task = intended_goals(understood, task.scenario)
    is_given = is_default or (has_goal and is_among(task.scenario, goals))
    goal_exists = is_default or bool(goals)
    missing: Sequence[str] = ()
    if not goal_exists:
        types = understood.type_names
        placed = placed_world(task.scenario, types)
        missing = explain_mismatch(placed, types, understood.instruction.readings)
    if goals and not is_given:
        task = replace(task, scenario=with_goal(task.scenario, goals[0]))
    return PreparedTask(
        world=name,
        task=task,
        is_find_task=is_find_task,
        goal_exists=goal_exists,
        via=tuple(ends[0].position for ends in earlier if ends),
        num_tied=1 if is_given else max(len(goals), 1),
        missing=tuple(missing),
    )


def _sample_task(
    template: Template, understood: Understanding, sensing_range: float, seed: int
) -> PreparedTask:
    """Sample a world of a template in which the sentence is true (rejection sampling).

    The first proposal is the world of the first episode of the tables with this seed.
    """
    counts = [("hydrant", template.num_hydrants), ("cone", template.num_cones)]
    counts = [(name, count) for name, count in counts if count]
    if missing := absent_types(counts, understood):
        raise ValueError(mismatch_message(template.name, counts, missing))
    # Templates of Table 2's commands make these true.
    relations = {"behind": "behind", "near": "nearest"}
    matches = (
        relations[item["relation"]]
        for item in understood.annotations
        if (item["figure"], item["landmark"]) == ("hydrant", "cone")
        and (item["relation"] == "behind" or (item["relation"] == "near" and item["superlative"]))
    )
    tasks = _sample_tasks(template, next(matches, "null"), sensing_range, seed, 1)
    prepared = _set_goal(template.name, tasks[0], understood)
    if prepared.goal_exists:
        return prepared
    # "nearest" places each cone anywhere around its hydrant, so other relations may hold too.
    for task in _sample_tasks(template, "nearest", sensing_range, seed, _MAX_TRIES):
        other = _set_goal(template.name, task, understood)
        if other.goal_exists:
            return other
    return prepared


def _sample_tasks(
    template: Template, relation: str, sensing_range: float, seed: int, count: int
) -> list[Task]:
    """Sample the tasks of the first episodes of a table's row, unstacked on the host."""
    relation = relation if template.num_cones else "null"
    sensor = default_sensor(sensing_range)
    cell = Cell(world=template.name, relation=relation, sensor=sensor, seed=seed)
    tasks = make_tasks(cell, count)
    # On the host: unstacking on the device would compile a small program for each leaf.
    batch = jax.device_get(replace(tasks, key=jax.random.key_data(tasks.key)))
    host = (jax.tree.map(lambda leaf, i=index: leaf[i], batch) for index in range(count))
    first = jax.device_put(np.int32(0))
    wrap = jax.random.wrap_key_data
    return [replace(task, key=wrap(task.key), instruction_index=first) for task in host]
