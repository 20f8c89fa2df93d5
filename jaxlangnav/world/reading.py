"""Checking the tables of a world file and building its scenario; ``files`` tells the format."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxlangnav.detections import SLOTS
from jaxlangnav.files.limits import RANGES, SHORTEST, SMALLEST
from jaxlangnav.kinds import ATTRIBUTES, attributes
from jaxlangnav.language.lexicon import load_lexicon, type_called
from jaxlangnav.language.spelling import repair
from jaxlangnav.language.tokens import is_word, plainly
from jaxlangnav.messages import (
    DRIFTS,
    NONE,
    MotionParams,
    SensorParams,
    default_motion,
    default_sensor,
)
from jaxlangnav.plain_text import LONGEST_NAME, cut, printable, shown
from jaxlangnav.world.fields import Fields
from jaxlangnav.world.state import Scenario

Point = tuple[float, float]
Bounds = tuple[float, float, float, float]
"""x_min, x_max, y_min, y_max, metres."""
_NARROWEST = 0.1
"""Metres that an area measures at least, each way."""
_LEAST_VIEW = 0.1
"""Degrees of the narrowest field of view."""
MOST_OBJECTS = SLOTS[-1]
"""Objects of a world file: as many as may be in view."""
_LONGEST_INSTRUCTION = 1000
"""Characters of a sentence in a world file."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class WorldFile:
    """What a world file holds, ready for the simulator."""

    name: str
    scenario: Scenario
    sensor: SensorParams
    motion: MotionParams
    instruction: str | None = None
    has_goal: bool = True
    """Whether it says what counts as success; else the scenario's goal is its start."""
    object_names: tuple[str, ...] = ()
    """One per slot, empty where the object has no name."""
    type_names: tuple[str, ...] = dataclasses.field(
        default_factory=lambda: load_lexicon().type_names
    )
    """Object types by index: those of the lexicon, then others that the file names."""
    attribute_groups: tuple[str, ...] = ()
    """What the detector reports of things besides their type: groups of ``kinds.ATTRIBUTES``."""


def world_from_dict(table: Any, *, file: str, num_slots: int | None = None) -> WorldFile:
    """Check tables of the world format and build the world.

    Args:
        table: the tables, as read.
        file: the file's name, for messages.
        num_slots: O, object slots of the scenario; if None the least of ``detections.SLOTS`` that
            holds its objects, so that worlds of like sizes share their compiled programs.

    Returns:
        The world.

    Raises:
        WorldFileError: anything is missing, unknown or outside its limits.
    """
    file = cut(printable(file), LONGEST_NAME)
    top = Fields(table, file=file, where="")
    area = _read_area(top.table("area"))
    start = (0.0, 0.0, 0.0)
    if top.has("start"):
        fields = top.table("start")
        heading = math.radians(fields.number("heading", low=-360.0, high=360.0, default=0.0))
        start = (*_read_place(fields, area, default=0.0), heading)
        fields.close()
    elif not (area[0] <= 0.0 <= area[1] and area[2] <= 0.0 <= area[3]):
        raise top.fail("start", "is missing, and its default 0, 0 lies outside the area: add it")
    things = _read_objects(top, area, num_slots or MOST_OBJECTS)
    names = things.names
    if num_slots is None:
        num_slots = next(size for size in SLOTS if size >= len(names))
    has_goal = top.has("goal")
    goal, goal_index = (
        _read_goal(top.table("goal"), area, names, things.places) if has_goal else (start[:2], NONE)
    )
    world = WorldFile(
        name=top.text("name", default=Path(file).stem),
        instruction=_read_instruction(top),
        scenario=_to_scenario(things, goal, goal_index, start, area, num_slots),
        sensor=_read_sensor(top.table("sensor")) if top.has("sensor") else default_sensor(),
        motion=_read_motion(top.table("motion")) if top.has("motion") else default_motion(),
        has_goal=has_goal,
        object_names=(*names, *[""] * (num_slots - len(names))),
        type_names=tuple(things.type_names),
        attribute_groups=tuple(
            group for group in ATTRIBUTES if any(group in looks for looks in things.looks)
        ),
    )
    top.close("start", "goal", "sensor", "motion", "name", "instruction")
    return world


def _read_instruction(top: Fields) -> str | None:
    """Read what to ask in this world, if it says so."""
    if not top.has("instruction"):
        return None
    return top.text("instruction", longest=_LONGEST_INSTRUCTION)


def _read_area(fields: Fields) -> Bounds:
    """Read the operating area: x_min, x_max, y_min, y_max."""
    x_min, y_min = fields.number("x_min"), fields.number("y_min")
    x_max = fields.number("x_max", low=x_min + _NARROWEST)
    y_max = fields.number("y_max", low=y_min + _NARROWEST)
    fields.close()
    return x_min, x_max, y_min, y_max


def _read_place(fields: Fields, area: Bounds, *, default: float | None = None) -> Point:
    """Read x and y and require them to lie in the area."""
    place = fields.number("x", default=default), fields.number("y", default=default)
    for name, value, low, high in zip("xy", place, area[::2], area[1::2], strict=True):
        if not low <= value <= high:
            raise fields.fail(
                name,
                f"is {value!r} but the area reaches from {low:g} to {high:g}: "
                "move it or enlarge [area]",
            )
    return place


@dataclasses.dataclass
class _Things:
    """The objects of a file, each list by object but for the types."""

    type_names: list[str]
    types: list[int] = dataclasses.field(default_factory=list)
    names: list[str] = dataclasses.field(default_factory=list)
    places: list[Point] = dataclasses.field(default_factory=list)
    looks: list[dict[str, str]] = dataclasses.field(default_factory=list)


def _read_objects(top: Fields, area: Bounds, most: int) -> _Things:
    """Read the objects: types, names (empty where there is none), places and attributes."""
    things = _Things(list(load_lexicon().type_names))
    for fields in top.tables("objects", least=1, most=most):
        things.types.append(_read_type(fields, things.type_names))
        name = fields.text("name") if fields.has("name") else ""
        if name and name in things.names:
            twin = things.names.index(name)
            raise fields.fail("name", f"is {name!r} as is objects[{twin}]: rename one")
        things.names.append(name)
        things.places.append(_read_place(fields, area))
        things.looks.append(
            {
                group: fields.choice(group, values, what=f"a {group}")
                for group, values in ATTRIBUTES.items()
                if fields.has(group)
            }
        )
        fields.close("name", *ATTRIBUTES)
    return things


def _read_type(fields: Fields, type_names: list[str]) -> int:
    """Read a type: by any of its names, or any noun, which is known from then on."""
    name = " ".join(plainly(fields.text("type")).split())
    name = type_called(name) or name
    if name not in type_names:
        slip = repair(name, is_noun=True)
        if slip is not None:
            raise fields.fail("type", f"is {name!r}, which looks mistyped. Did you mean {slip!r}?")
        if not all(is_word(word) for word in name.split()):
            raise fields.fail("type", f"is {shown(name)} but must be a noun, in plain letters")
        type_names.append(name)
    return type_names.index(name)


def _read_goal(
    fields: Fields,
    area: Bounds,
    names: list[str],
    places: list[Point],
) -> tuple[Point, int]:
    """Read the goal: its place, and the slot of its object or NONE."""
    if fields.has("object"):
        known = [name for name in names if name]
        name = fields.choice("object", known, what="the name of an object of this file")
        fields.close()
        return places[names.index(name)], names.index(name)
    if not (fields.has("x") or fields.has("y")):
        raise fields.fail("object", "is missing: name an object, or give x and y")
    place = _read_place(fields, area)
    fields.close("object")
    return place, NONE


def _read_sensor(fields: Fields) -> SensorParams:
    """Read the detector's specification."""
    reach = fields.number("range", low=RANGES[0], high=RANGES[1], default=3.0)
    sensor = SensorParams(
        range_max=jnp.float32(reach),
        field_of_view=jnp.float32(
            math.radians(fields.number("field_of_view", low=_LEAST_VIEW, high=360.0, default=360.0))
        ),
        detection_probability=jnp.float32(
            fields.number("detection_probability", low=SMALLEST, high=1.0, default=0.95)
        ),
        noise=jnp.float32(fields.number("noise", low=0.0, high=reach, default=min(0.1, reach))),
    )
    fields.close("range", "field_of_view", "detection_probability", "noise")
    return sensor


def _read_motion(fields: Fields) -> MotionParams:
    """Read the specification of motion and odometry."""
    motion = MotionParams(
        step_length=jnp.float32(fields.number("step_length", low=SHORTEST, default=1.0)),
        odometry_noise=jnp.float32(
            fields.number("odometry_noise", low=0.0, high=1.0, default=0.02)
        ),
        **{
            name: jnp.float32(math.radians(fields.number(name, low=0.0, high=180.0, default=0.0)))
            for name in DRIFTS
        },
    )
    fields.close("step_length", "odometry_noise", *DRIFTS)
    return motion


def _to_scenario(
    things: _Things,
    goal: Point,
    goal_index: int,
    start: tuple[float, float, float],
    area: Bounds,
    num_slots: int,
) -> Scenario:
    """Pad the objects to slots."""
    types = things.types
    num_empty = num_slots - len(types)
    x, y = np.pad(np.array(things.places, np.float32), ((0, num_empty), (0, 0))).T
    codes = [attributes(*look.values()) for look in things.looks]
    return Scenario(
        object_type=jnp.array([*types, *[NONE] * num_empty], jnp.int32),
        object_x=jnp.asarray(x),
        object_y=jnp.asarray(y),
        is_object=jnp.arange(num_slots) < len(types),
        goal=jnp.array(goal, jnp.float32),
        goal_index=jnp.int32(goal_index),
        start=jnp.array(start, jnp.float32),
        area=jnp.array(area, jnp.float32),
        is_valid=jnp.array(True),
        object_attribute=jnp.array(codes + [0] * num_empty, jnp.int32) if any(codes) else None,
    )
