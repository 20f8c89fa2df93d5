"""An episode to run: a world opened for a sentence, with the goal that the sentence means there.

A world is drawn from a template so that the sentence is true in it, or is somebody's own. One that
does not exist, or whose file is bad, is refused by a ``ValueError`` wherever it is named.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.episode import MAX_STEPS, Task
from jaxlangnav.experiments.tasks import cell, make_tasks
from jaxlangnav.grounding.binding import Detector
from jaxlangnav.grounding.instruction import Understanding
from jaxlangnav.grounding.worlds import explain_mismatch
from jaxlangnav.messages import SensorParams, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.task.labelled import is_among, meant_goals, place_scenario, with_goal
from jaxlangnav.world.files import WorldFile, open_world, shipped_worlds
from jaxlangnav.world.state import Scenario, empty_scenario
from jaxlangnav.world.templates import Template

AnnotationDocument = Mapping[str, Any]
"""An annotation: ``figure``, ``relation``, ``landmark``, ``superlative``, ``probability``."""
_NUM_TRIES = 64
"""Worlds drawn in search of one in which the sentence is true."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Prepared:
    """An episode to run, and what a person means in its world."""

    world: str  # its name
    task: Task
    is_find: bool  # having the goal in view is enough
    is_meant: bool  # something there fits the sentence
    is_drawn: bool  # the world has been drawn from a template
    via: tuple[tuple[float, float], ...] = ()
    """Where the commands before the last end, metres."""
    num_alike: int = 1
    """Places there that fit the sentence alike, where nothing says which of them is meant."""
    missing: tuple[str, ...] = ()
    """What the sentence speaks of and is not there, where nothing fits."""

    @property
    def unjudged(self) -> str:
        """Why success cannot be told; empty where it can."""
        if not self.is_meant:
            why = f" ({'; '.join(self.missing)})" if self.missing else ""
            return f"nothing there fits the sentence{why}"
        if self.num_alike == 1:
            return ""
        return f"{self.num_alike} places fit the sentence alike, and nothing says which is meant"


def open_task(
    world: str, understood: Understanding, *, sensing_range: float | None, seed: int
) -> Prepared:
    """Prepare one episode, in a world drawn from a template or in somebody's own.

    Args:
        world: a template ("2H1C"), a shipped world or a file.
        understood: the sentence; a template's world is drawn so that it is true there.
        sensing_range: metres; that of the world, 3 m for a template, where None.
        seed: of world and noise.

    Raises:
        ValueError: no such world, a bad file, or a template that has nothing of what is asked.
    """
    place = open_world(world)
    if isinstance(place, WorldFile):
        task = Task(
            key=jax.random.key(seed),
            scenario=place.scenario,
            instruction_index=jax.device_put(np.int32(0)),
            sensor=sensor_of(world, sensing_range),
            motion=place.motion,
        )
        words = (place.instruction or "", understood.parse.instruction)
        own, said = (" ".join(one.lower().split()).rstrip(".!") for one in words)
        # Whether it is the sentence that the world's goal has been written for.
        is_own = place.has_goal and own == said
        return _judge(place.name, task, understood, is_own=is_own, has_goal=place.has_goal)
    return _draw(place, understood, sensing_range or 3.0, seed)


def refuse_what_it_lacks(world: str, understood: Understanding) -> None:
    """Refuse a template that has nothing of a type that is spoken of, before anything is drawn.

    Raises:
        ValueError: one line that says what there is.
    """
    place = open_world(world)
    if isinstance(place, WorldFile):
        return
    counts = [("hydrant", place.num_hydrants), ("cone", place.num_cones)]
    there = [(name, number) for name, number in counts if number]
    missing = _lacking(there, understood.annotations, understood.type_names)
    if missing:
        raise ValueError(nothing_there(place.name, there, missing))


def detector_of(world: str, type_names: Sequence[str]) -> Detector:
    """Build the detector of a world: what it tells apart, and what it reports of things."""
    place = open_world(world)
    if isinstance(place, WorldFile):
        return Detector(place.type_names, place.attribute_groups)
    return Detector(type_names)


def emptied(world: str) -> Scenario:
    """Take all things out of a world; its slots and walls are what compiled programs go by."""
    place = open_world(world)
    if not isinstance(place, WorldFile):
        return empty_scenario()
    return replace(empty_scenario(place.scenario.is_object.size), terrain=place.scenario.terrain)


def sensor_of(world: str, sensing_range: float | None) -> SensorParams:
    """Tell what a world says of the detector; another range, metres, in place of its own."""
    place = open_world(world)
    sensor = place.sensor if isinstance(place, WorldFile) else default_sensor()
    if sensing_range is None:
        return sensor
    return replace(sensor, range_max=jnp.float32(sensing_range))


def usual_steps(scenario: Scenario, sensor: SensorParams) -> int:
    """Count enough decisions: 120, or three sweeps of the area, area / (2 range) metres each."""
    x_min, x_max, y_min, y_max = np.asarray(scenario.area).tolist()
    sweep = (x_max - x_min) * (y_max - y_min) / (2.0 * float(sensor.range_max))
    return max(MAX_STEPS, math.ceil(3.0 * sweep))


def nothing_there(world: str, counts: Sequence[tuple[str, int]], missing: Sequence[str]) -> str:
    """Say in one line that a template has nothing of what is asked for, and how many of what."""
    there = " and ".join(f"{number} {name}{'s' * (number > 1)}" for name, number in counts)
    lack = f"no {missing[0]}" if missing else "nothing that fits the sentence"
    return (
        f"world {world} has {lack}, only {there}: choose another template, "
        f"a shipped world ({', '.join(shipped_worlds())}) or a file with --world"
    )


def absent_types(
    scenario: Scenario, annotations: Iterable[AnnotationDocument], names: Sequence[str]
) -> list[str]:
    """List the types that annotations speak of and a world lacks, in their order."""
    return _lacking(count_types(scenario, names), annotations, names)


def _lacking(
    counts: Sequence[tuple[str, int]],
    annotations: Iterable[AnnotationDocument],
    names: Sequence[str],
) -> list[str]:
    """List what the sentence speaks of and is not among what is there."""
    likely = [said for said in annotations if said["probability"] >= 0.5]
    spoken = dict.fromkeys(said[role] for said in likely for role in ("figure", "landmark"))
    return [name for name in spoken if name in names and name not in dict(counts)]


def count_types(scenario: Scenario, names: Sequence[str]) -> list[tuple[str, int]]:
    """Count the objects of a world: each type that is there, and how many of it."""
    kinds = np.asarray(scenario.object_type)[np.asarray(scenario.is_object)]
    types = [int(kind) for kind in kinds]
    return [(names[kind], types.count(kind)) for kind in dict.fromkeys(types)]


def _judge(
    name: str,
    task: Task,
    understood: Understanding,
    *,
    is_drawn: bool = False,
    is_own: bool = False,
    has_goal: bool = True,
) -> Prepared:
    """Set the goal that the sentence means; that of the world where it is as good as any."""
    (*earlier, goals), is_find = meant_goals(understood, task.scenario)
    is_given = is_own or (has_goal and is_among(task.scenario, goals))
    is_meant = is_own or bool(goals)
    missing: Sequence[str] = ()
    if not is_meant:
        types = understood.type_names
        placed = place_scenario(task.scenario, types)
        missing = explain_mismatch(placed, types, understood.instruction.readings)
    if goals and not is_given:
        task = replace(task, scenario=with_goal(task.scenario, goals[0]))
    return Prepared(
        world=name,
        task=task,
        is_find=is_find,
        is_meant=is_meant,
        is_drawn=is_drawn,
        via=tuple(found[0].position for found in earlier if found),
        num_alike=1 if is_given else max(len(goals), 1),
        missing=tuple(missing),
    )


def _draw(
    template: Template, understood: Understanding, sensing_range: float, seed: int
) -> Prepared:
    """Draw a world of a template in which the sentence is true.

    The first one tried is that of the first episode of the tables with this seed.
    """
    # Table 2's commands have worlds of their own in which they are true.
    relations = {"behind": "behind", "near": "nearest"}
    said = (
        relations[one["relation"]]
        for one in understood.annotations
        if (one["figure"], one["landmark"]) == ("hydrant", "cone")
        and (one["relation"] == "behind" or (one["relation"] == "near" and one["superlative"]))
    )
    relation = next(said, "null")
    tasks = _tasks_of(template, relation, sensing_range, seed, 1)
    prepared = _judge(template.name, tasks[0], understood, is_drawn=True)
    absent = absent_types(tasks[0].scenario, understood.annotations, understood.type_names)
    if prepared.is_meant or absent:
        return prepared
    # Here each cone stands anywhere around its hydrant: the sentence may be true in some of them.
    for task in _tasks_of(template, "nearest", sensing_range, seed, _NUM_TRIES):
        other = _judge(template.name, task, understood, is_drawn=True)
        if other.is_meant:
            return other
    return prepared


def _tasks_of(
    template: Template, relation: str, sensing_range: float, seed: int, number: int
) -> list[Task]:
    """Draw the first episodes of a row of the tables, leaf by leaf on the host."""
    relation = relation if template.num_cones else "null"
    tasks = make_tasks(cell(template.name, relation, 0, sensing_range, number, seed))
    # On the host: taken apart on the device, each leaf would be a small program of its own.
    batch = jax.device_get(replace(tasks, key=jax.random.key_data(tasks.key)))
    rows = (jax.tree.map(lambda leaf, i=index: leaf[i], batch) for index in range(number))
    first = jax.device_put(np.int32(0))
    return [
        replace(row, key=jax.random.wrap_key_data(row.key), instruction_index=first) for row in rows
    ]
