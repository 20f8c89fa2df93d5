"""What several commands need of the engine: models, sizes, and an episode in a world."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.episode import Task
from jaxlangnav.experiments.monte_carlo import cell, make_tasks
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.planner.params import PlannerConfig
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.world.files import open_world
from jaxlangnav.world.reading import World
from jaxlangnav.world.templates import Template

Said = Mapping[str, Any]
"""An annotation: ``figure``, ``relation``, ``landmark``, ``superlative``, ``probability``."""


def navigator_config(policy: str, particles: int) -> NavigatorConfig:
    """Build the navigator's sizes.

    Args:
        policy: "faithful" or "informed".
        particles: P, at least 2.

    Returns:
        The configuration.
    """
    return NavigatorConfig(
        map=MapConfig(num_particles=particles), planner=PlannerConfig(policy=policy)
    )


def relation_said(annotations: Iterable[Said]) -> str:
    """Tell for which of Table 2's commands to draw a world, so that the sentence is true in it.

    Args:
        annotations: likeliest first.

    Returns:
        "behind", "nearest" or "null".
    """
    for said in annotations:
        if (said["figure"], said["landmark"]) == ("hydrant", "cone"):
            if said["relation"] == "behind":
                return "behind"
            if said["relation"] == "near" and said["superlative"]:
                return "nearest"
    return "null"


def open_task(
    world: str, annotations: Sequence[Said], *, sensing_range: float | None, seed: int
) -> tuple[str, Task]:
    """Prepare one episode, in a world drawn from a template or in somebody's own.

    Args:
        world: a template ("2H1C"), a shipped world or a file.
        annotations: what the sentence says, so that a template's world makes it true.
        sensing_range: metres; that of the world, 3 m for a template, where None.
        seed: of world and noise.

    Returns:
        The world's name and the task.

    Raises:
        ValueError: no such world, or a bad file.
    """
    place = open_world(world)
    if isinstance(place, World):
        return place.name, _task_in(place, sensing_range, seed)
    return place.name, _task_of(place, relation_said(annotations), sensing_range or 3.0, seed)


def missing_types(task: Task, annotations: Iterable[Said], names: Sequence[str]) -> list[str]:
    """List what the sentence speaks of and the world does not have.

    Args:
        task: with the scenario.
        annotations: what the sentence says.
        names: object types by index.

    Returns:
        Names of types, in the order of the annotations.
    """
    is_object = np.asarray(task.scenario.is_object)
    there = {names[index] for index in np.asarray(task.scenario.object_type)[is_object]}
    likely = [said for said in annotations if said["probability"] >= 0.5]
    spoken = dict.fromkeys(said[role] for said in likely for role in ("figure", "landmark"))
    return [name for name in spoken if name in names and name not in there]


def _task_in(world: World, sensing_range: float | None, seed: int) -> Task:
    """Prepare an episode in a world that somebody has written down."""
    sensor = world.sensor
    if sensing_range is not None:
        sensor = replace(sensor, range_max=jnp.float32(sensing_range))
    return Task(
        key=jax.random.key(seed),
        scenario=world.scenario,
        instruction_index=jnp.int32(0),
        sensor=sensor,
        motion=world.motion,
    )


def _task_of(template: Template, relation: str, sensing_range: float, seed: int) -> Task:
    """Draw a world of a template: the first episode of that seed in the tables is the same one."""
    drawn_for = relation if template.num_cones else "null"
    tasks = make_tasks(cell(template.name, drawn_for, 0, sensing_range, 1, seed))
    return jax.tree.map(lambda leaf: leaf[0], tasks)
