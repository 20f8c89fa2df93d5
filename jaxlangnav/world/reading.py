"""The schema of a world file, and its scenario both ways; ``files`` tells the format."""

import dataclasses
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from msgspec import Meta, field, structs, to_builtins

from jaxlangnav.inputs.limits import FARTHEST, RANGES, SHORTEST, SMALLEST
from jaxlangnav.inputs.object_types import ATTRIBUTES, attribute_code, attribute_words, group_of
from jaxlangnav.inputs.observations import SLOTS
from jaxlangnav.inputs.sanitize import LONGEST_NAME, as_text, sanitize, shorten
from jaxlangnav.inputs.schema import Name, PlainText, Schema, convert, no_choice
from jaxlangnav.language.lexicon import find_type, load_lexicon
from jaxlangnav.language.spelling import repair
from jaxlangnav.language.tokens import is_word, normalize
from jaxlangnav.messages import DRIFTS, NONE, MotionParams, SensorParams
from jaxlangnav.terrain import OPEN
from jaxlangnav.terrain.geodesic import among_walls
from jaxlangnav.world.state import Scenario, placed, walls_of

MOST_WALLS = 32
MOST_OBJECTS = SLOTS[-1]
"""Objects of a world file: as many as may be in view."""
_NARROWEST = 0.1
"""Metres that an area measures at least, each way."""
_Place = Annotated[float, Meta(ge=-FARTHEST, le=FARTHEST)]
_Share = Annotated[float, Meta(ge=0.0, le=1.0)]
_Drift = Annotated[float, Meta(ge=0.0, le=180.0)]


class WorldFileError(ValueError):
    """A world file cannot be used; the message is one line for the person who wrote it."""


class _Area(Schema):
    x_min: _Place
    x_max: _Place
    y_min: _Place
    y_max: _Place

    def axes(self) -> tuple[tuple[str, float, float], ...]:
        """List the axes with where the area begins and ends."""
        return ("x", self.x_min, self.x_max), ("y", self.y_min, self.y_max)

    def __post_init__(self) -> None:
        for axis, low, high in self.axes():
            if high < low + _NARROWEST:
                least = f"at least {low + _NARROWEST:g}: {_NARROWEST} m above {axis}_min"
                raise ValueError(f"{axis}_max is {high}, but must be {least}")

    def check(self, where: str, x: float, y: float) -> None:
        """Refuse a place outside."""
        for value, (axis, low, high) in zip((x, y), self.axes(), strict=True):
            if not low <= value <= high:
                reach = f"the area reaches from {low:g} to {high:g}: move it or enlarge [area]"
                raise ValueError(f"{where}.{axis} is {value}, but {reach}")


class _Start(Schema):
    x: _Place = 0.0
    y: _Place = 0.0
    heading: Annotated[float, Meta(ge=-360.0, le=360.0)] = 0.0


class _Goal(Schema, omit_defaults=True):
    object: Name | None = None
    x: _Place | None = None
    y: _Place | None = None

    def __post_init__(self) -> None:
        if self.object is None and (self.x is None or self.y is None):
            raise ValueError("object is missing: name an object, or give x and y")
        if self.object is not None and (self.x, self.y) != (None, None):
            raise ValueError("object is given, and x or y as well: leave one out")
        super().__post_init__()


class _Object(Schema, omit_defaults=True, kw_only=True):
    type: Name
    name: Name | None = None
    x: _Place
    y: _Place
    colour: Name | None = None
    material: Name | None = None
    size: Name | None = None
    height: Name | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for group, word in self.looks.items():
            if word not in ATTRIBUTES[group]:
                raise ValueError(no_choice(group, word, ATTRIBUTES[group], f"a {group}"))

    @property
    def looks(self) -> dict[str, str]:
        """List the attributes by their groups."""
        found = {group: getattr(self, group) for group in ATTRIBUTES}
        return {group: word for group, word in found.items() if word is not None}


class _Wall(Schema):
    ends: tuple[tuple[_Place, _Place], tuple[_Place, _Place]]

    def __post_init__(self) -> None:
        if self.ends[0] == self.ends[1]:
            raise ValueError(f"ends are both {list(self.ends[0])}: give two places")


class _Sensor(Schema):
    range_max: Annotated[float, Meta(ge=RANGES[0], le=RANGES[1])] = field(default=3.0, name="range")
    field_of_view: Annotated[float, Meta(ge=0.1, le=360.0)] = 360.0
    detection_probability: Annotated[float, Meta(ge=SMALLEST, le=1.0)] = 0.95
    noise: Annotated[float, Meta(ge=0.0)] | None = None

    def __post_init__(self) -> None:
        if self.noise is None:
            self.noise = min(0.1, self.range_max)
        if self.noise > self.range_max:
            most = f"at most {self.range_max:g}, the range"
            raise ValueError(f"noise is {as_text(self.noise)}, but must be {most}")


class _Motion(Schema):
    step_length: Annotated[float, Meta(ge=SHORTEST, le=FARTHEST)] = 1.0
    odometry_noise: _Share = 0.02
    heading_bias: _Drift = 0.0
    heading_noise: _Drift = 0.0
    turn_noise: _Drift = 0.0


_IN_DEGREES = ("field_of_view", *DRIFTS)


def _to_arrays(part: _Sensor | _Motion) -> dict[str, Array]:
    """Convert degrees, and numbers to arrays."""
    return {
        name: jnp.float32(math.radians(value) if name in _IN_DEGREES else value)
        for name, value in structs.asdict(part).items()
    }


def _to_numbers(record: SensorParams | MotionParams, names: Iterable[str]) -> dict[str, float]:
    """Write arrays as the shortest numbers that are read back the same."""
    return {
        name: (_degrees if name in _IN_DEGREES else _decimal)(getattr(record, name))
        for name in names
    }


class _World(Schema, omit_defaults=True, kw_only=True):
    name: Name | None = None
    instruction: PlainText | None = None
    area: _Area
    start: _Start | None = None
    goal: _Goal | None = None
    sensor: _Sensor = field(default_factory=_Sensor)
    motion: _Motion = field(default_factory=_Motion)
    objects: Annotated[list[_Object], Meta(min_length=1, max_length=MOST_OBJECTS)]
    walls: Annotated[list[_Wall], Meta(max_length=MOST_WALLS)] = field(default_factory=list)


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
    """What the detector reports of things besides their type: groups of ``ATTRIBUTES``."""


def world_from_dict(table: Any, *, file: str) -> WorldFile:
    """Check tables of the world format and build the world.

    Its scenario has the least of ``observations.SLOTS`` that holds the objects, so that worlds of
    like sizes share their compiled programs.

    Args:
        table: the tables, as read.
        file: the file's name, for messages.

    Raises:
        WorldFileError: anything is missing, unknown or outside its limits.
    """
    file = shorten(sanitize(file), LONGEST_NAME)
    try:
        return _to_world(convert(table, _World), Path(file).stem)
    except ValueError as error:
        raise WorldFileError(f"{file}: {error}") from None


def _to_world(world: _World, stem: str) -> WorldFile:
    """Check what the parts of a world have to do with one another, and build it."""
    number, start = len(world.objects), world.start or _Start()
    num_slots = next(size for size in SLOTS if size >= number)
    if world.start is None and not (
        world.area.x_min <= 0.0 <= world.area.x_max and world.area.y_min <= 0.0 <= world.area.y_max
    ):
        raise ValueError("start is missing, and its default 0, 0 lies outside the area: add it")
    world.area.check("start", start.x, start.y)
    names = [one.name or "" for one in world.objects]
    type_names, types = list(load_lexicon().type_names), []
    for index, one in enumerate(world.objects):
        where = f"objects[{index}]"
        world.area.check(where, one.x, one.y)
        twin = names.index(names[index])
        if one.name and twin < index:
            raise ValueError(f"{where}.name is {one.name!r} as is objects[{twin}]: rename one")
        types.append(_type_index(one.type, type_names, where))
    for index, one in enumerate(world.walls):
        for place in one.ends:
            world.area.check(f"walls[{index}].ends", *place)
    goal, goal_index = _goal(world, start, names)
    codes = [attribute_code(*one.looks.values()) for one in world.objects]
    codes += [0] * (num_slots - number)
    return WorldFile(
        name=world.name or stem,
        instruction=world.instruction,
        scenario=placed(
            [(kind, one.x, one.y) for kind, one in zip(types, world.objects, strict=True)],
            slots=num_slots,
            area=structs.astuple(world.area),
            goal=np.array(goal, np.float32),
            goal_index=np.asarray(goal_index, np.int32),
            start=np.array([start.x, start.y, math.radians(start.heading)], np.float32),
            object_attribute=np.array(codes, np.int32) if any(codes) else None,
            terrain=among_walls(*((*a, *b) for a, b in (one.ends for one in world.walls)))
            if world.walls
            else OPEN,
        ),
        sensor=SensorParams(**_to_arrays(world.sensor)),
        motion=MotionParams(**_to_arrays(world.motion)),
        has_goal=world.goal is not None,
        object_names=(*names, *[""] * (num_slots - number)),
        type_names=tuple(type_names),
        attribute_groups=tuple(
            group for group in ATTRIBUTES if any(group in one.looks for one in world.objects)
        ),
    )


def _type_index(text: str, type_names: list[str], where: str) -> int:
    """Find a type by any of its names, or any noun, which is known from then on."""
    name = " ".join(normalize(text).split())
    name = find_type(name) or name
    if name not in type_names:
        slip = repair(name, is_noun=True)
        if slip is not None:
            hint = f"which looks mistyped. Did you mean {slip!r}?"
            raise ValueError(f"{where}.type is {name!r}, {hint}")
        if not all(map(is_word, name.split())):
            raise ValueError(
                f"{where}.type is {as_text(name)}, but must be a noun, in plain letters"
            )
        type_names.append(name)
    return type_names.index(name)


def _goal(world: _World, start: _Start, names: list[str]) -> tuple[tuple[float, float], int]:
    """Find the goal: its place, and the slot of its object or NONE."""
    goal = world.goal
    if goal is None:
        return (start.x, start.y), NONE
    if goal.x is not None and goal.y is not None:
        world.area.check("goal", goal.x, goal.y)
        return (goal.x, goal.y), NONE
    if goal.object not in names:
        what = "the name of an object of this file"
        raise ValueError(no_choice("goal.object", goal.object, filter(None, names), what))
    index = names.index(goal.object)
    return (world.objects[index].x, world.objects[index].y), index


def world_to_dict(world: WorldFile) -> dict[str, Any]:
    """Turn a world into tables that ``world_from_dict`` reads back to the same world."""
    scenario = world.scenario
    names = [*world.object_names, *[""] * scenario.is_object.size]
    goal, goal_index = None, int(scenario.goal_index)
    if goal_index >= 0 and not names[goal_index]:
        # A file calls the goal by its object's name.
        ticks = ("goal" + "'" * size for size in range(len(names)))
        names[goal_index] = next(name for name in ticks if name not in names)
    if world.has_goal:
        x, y = map(_decimal, scenario.goal)
        goal = _Goal(object=names[goal_index]) if goal_index >= 0 else _Goal(x=x, y=y)
    no_codes = np.zeros(scenario.is_object.size, np.int32)
    codes = no_codes if scenario.object_attribute is None else scenario.object_attribute
    table = _World(
        name=world.name,
        instruction=world.instruction or None,
        area=_Area(*(_decimal(one) for one in scenario.area)),
        start=_Start(
            x=_decimal(scenario.start[0]),
            y=_decimal(scenario.start[1]),
            heading=_degrees(scenario.start[2]),
        ),
        goal=goal,
        sensor=_Sensor(**_to_numbers(world.sensor, _Sensor.__struct_fields__)),
        motion=_Motion(**_to_numbers(world.motion, _Motion.__struct_fields__)),
        objects=[
            _Object(
                type=world.type_names[int(scenario.object_type[slot])],
                name=names[slot] or None,
                x=_decimal(scenario.object_x[slot]),
                y=_decimal(scenario.object_y[slot]),
                **{str(group_of(word)): word for word in attribute_words(int(codes[slot]))},
            )
            for slot in np.flatnonzero(np.asarray(scenario.is_object))
        ],
        walls=[
            _Wall(ends=((_decimal(a), _decimal(b)), (_decimal(c), _decimal(d))))
            for a, b, c, d in walls_of(scenario)
        ],
    )
    return to_builtins(table)


def _decimal(value: Array) -> float:
    """Find the shortest decimal that reads back as the same float32."""
    return float(str(np.float32(value)))


def _degrees(value: Array) -> float:
    """Find the shortest decimal of degrees that reads back as the same float32 of radians."""
    radians = np.float32(value)
    degrees = math.degrees(float(radians))
    shorter = (round(degrees, digits) for digits in range(12))
    return next((one for one in shorter if np.float32(math.radians(one)) == radians), degrees)
