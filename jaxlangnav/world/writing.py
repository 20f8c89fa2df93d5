"""Writing world files: the inverse of ``files.load_world``, exact to the last float32 bit."""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jax import Array

from jaxlangnav.files.whole import write_text
from jaxlangnav.kinds import group_of, words_of
from jaxlangnav.messages import DRIFTS
from jaxlangnav.world.fields import WorldFileError
from jaxlangnav.world.reading import WorldFile
from jaxlangnav.world.state import Scenario


def save_world(world: WorldFile, path: str | Path) -> None:
    """Write a world file; a sampled scenario becomes a file that people can edit.

    Args:
        world: what to write.
        path: a .toml or .json file; overwritten.

    Raises:
        WorldFileError: the name ends in neither, or the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind not in (".toml", ".json"):
        raise WorldFileError(f"{path}: a world file's name must end in .toml or .json")
    table = world_to_dict(world)
    text = json.dumps(table, indent=2) + "\n" if kind == ".json" else _to_toml(table)
    try:
        write_text(text, path)
    except OSError as error:
        raise WorldFileError(f"{path}: cannot be written: {error.strerror}") from None


def world_to_dict(world: WorldFile) -> dict[str, Any]:
    """Turn a world into tables of the world format.

    Args:
        world: the world.

    Returns:
        Tables that ``reading.world_from_dict`` reads back to the same world.
    """
    scenario, names = world.scenario, _object_names(world)
    area = ("x_min", "x_max", "y_min", "y_max")
    return {
        "name": world.name,
        **({"instruction": world.instruction} if world.instruction else {}),
        "area": {key: _length(value) for key, value in zip(area, scenario.area, strict=True)},
        "start": {
            "x": _length(scenario.start[0]),
            "y": _length(scenario.start[1]),
            "heading": _degrees(scenario.start[2]),
        },
        **({"goal": _goal(scenario, names)} if world.has_goal else {}),
        "sensor": {
            "range": _length(world.sensor.range_max),
            "field_of_view": _degrees(world.sensor.field_of_view),
            "detection_probability": _length(world.sensor.detection_probability),
            "noise": _length(world.sensor.noise),
        },
        "motion": {
            "step_length": _length(world.motion.step_length),
            "odometry_noise": _length(world.motion.odometry_noise),
            **{
                name: _degrees(value)
                for name in DRIFTS
                if (value := getattr(world.motion, name)) > 0.0
            },
        },
        "objects": _objects(scenario, names, world.type_names),
    }


def _goal(scenario: Scenario, names: list[str]) -> dict[str, Any]:
    """Say which object is the goal, or where it is."""
    goal_index = int(scenario.goal_index)
    if goal_index >= 0:
        return {"object": names[goal_index]}
    return {"x": _length(scenario.goal[0]), "y": _length(scenario.goal[1])}


def _objects(
    scenario: Scenario, names: list[str], type_names: Sequence[str]
) -> list[dict[str, Any]]:
    """List the objects."""
    return [
        {
            "type": type_names[int(scenario.object_type[slot])],
            **({"name": names[slot]} if names[slot] else {}),
            "x": _length(scenario.object_x[slot]),
            "y": _length(scenario.object_y[slot]),
            **_looks(scenario, int(slot)),
        }
        for slot in np.flatnonzero(np.asarray(scenario.is_object))
    ]


def _looks(scenario: Scenario, slot: int) -> dict[str, str]:
    """List the attributes of an object by group."""
    if scenario.object_attribute is None:
        return {}
    words = words_of(int(scenario.object_attribute[slot]))
    return {str(group_of(word)): word for word in words}


def _object_names(world: WorldFile) -> list[str]:
    """List the names per slot; the goal object is given one if it has none."""
    names = [*world.object_names, *[""] * (world.scenario.is_object.size)]
    goal_index = int(world.scenario.goal_index)
    if goal_index >= 0 and not names[goal_index]:
        name = "goal"
        while name in names:
            name += "'"
        names[goal_index] = name
    return names


def _length(value: Array) -> float:
    """Find the shortest decimal that reads back as the same float32."""
    return float(str(np.float32(value)))


def _degrees(value: Array) -> float:
    """Find the shortest decimal of degrees that reads back as the same float32 of radians."""
    radians = np.float32(value)
    degrees = math.degrees(float(radians))
    for digits in range(12):
        if np.float32(math.radians(round(degrees, digits))) == radians:
            return round(degrees, digits)
    return degrees


def _to_toml(table: dict[str, Any]) -> str:
    """Write the tables of the world format, the only ones needed: keys, tables, lists of tables."""
    lines: list[str] = []
    for key, value in table.items():
        if isinstance(value, dict):
            lines += ["", f"[{key}]", *_pairs(value)]
        elif isinstance(value, list):
            for entry in value:
                lines += ["", f"[[{key}]]", *_pairs(entry)]
        else:
            lines += _pairs({key: value})
    return "\n".join(lines) + "\n"


def _pairs(table: dict[str, Any]) -> list[str]:
    """Write key = value lines; JSON's texts and numbers are TOML's too."""
    return [f"{key} = {json.dumps(value)}" for key, value in table.items()]
