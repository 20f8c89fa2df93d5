"""Schema of world files, and conversion from and to scenarios; ``files`` has the format."""

import dataclasses
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from msgspec import Meta, field, structs, to_builtins

from jaxlangnav.inputs.documents import error_prefix
from jaxlangnav.inputs.limits import MAX_METRES, MIN_STEP, MIN_VALUE, RANGES
from jaxlangnav.inputs.object_types import ATTRIBUTES, attribute_code, attribute_words, group_of
from jaxlangnav.inputs.observations import SLOTS
from jaxlangnav.inputs.sanitize import MAX_NAME, as_text, sanitize, shorten
from jaxlangnav.inputs.schema import Name, PlainText, Schema, bad_choice, convert
from jaxlangnav.language.lexicon import find_type, is_reserved, load_lexicon
from jaxlangnav.language.spelling import repair
from jaxlangnav.language.tokens import is_word, normalize
from jaxlangnav.messages import DRIFTS, NONE, MotionParams, SensorParams
from jaxlangnav.terrain import OPEN
from jaxlangnav.terrain.geodesic import among_walls
from jaxlangnav.world.state import Scenario, make_scenario, walls_of

MAX_WALLS = 32
MAX_OBJECTS = SLOTS[-1]
"""Limit of objects in a world file, which may all be in view."""
_MIN_EXTENT = 0.1
"""Minimum extent of an area along each axis, metres."""
_Coordinate = Annotated[float, Meta(ge=-MAX_METRES, le=MAX_METRES)]
_Drift = Annotated[float, Meta(ge=0.0, le=180.0)]


class _Area(Schema):
    x_min: _Coordinate
    x_max: _Coordinate
    y_min: _Coordinate
    y_max: _Coordinate

    def axes(self) -> tuple[tuple[str, float, float], ...]:
        """List the axes with the limits of the area."""
        return ("x", self.x_min, self.x_max), ("y", self.y_min, self.y_max)

    def __post_init__(self) -> None:
        for axis, lower, upper in self.axes():
            if upper < lower + _MIN_EXTENT:
                bound = f"at least {lower + _MIN_EXTENT:g}: {_MIN_EXTENT} m above {axis}_min"
                raise ValueError(f"{axis}_max is {upper}, but must be {bound}")

    def check(self, where: str, x: float, y: float) -> None:
        """Raise ``ValueError`` for a point outside the area."""
        for value, (axis, lower, upper) in zip((x, y), self.axes(), strict=True):
            if not lower <= value <= upper:
                remedy = f"the area reaches from {lower:g} to {upper:g}: move it or enlarge [area]"
                raise ValueError(f"{where}.{axis} is {value}, but {remedy}")


class _Start(Schema):
    x: _Coordinate = 0.0
    y: _Coordinate = 0.0
    heading: Annotated[float, Meta(ge=-360.0, le=360.0)] = 0.0


class _Goal(Schema, omit_defaults=True):
    object: Name | None = None
    x: _Coordinate | None = None
    y: _Coordinate | None = None

    def __post_init__(self) -> None:
        if self.object is None and (self.x is None or self.y is None):
            raise ValueError("object is missing: name an object, or give x and y")
        if self.object is not None and (self.x, self.y) != (None, None):
            raise ValueError("object is given, and x or y as well: leave one out")
        super().__post_init__()


class _Object(Schema, omit_defaults=True, kw_only=True):
    type: Name
    name: Name | None = None
    x: _Coordinate
    y: _Coordinate
    colour: Name | None = None
    material: Name | None = None
    size: Name | None = None
    height: Name | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        for group, word in self.attributes.items():
            if word not in ATTRIBUTES[group]:
                raise ValueError(bad_choice(group, word, ATTRIBUTES[group], f"a {group}"))

    @property
    def attributes(self) -> dict[str, str]:
        """Return the attributes by group."""
        values = {group: getattr(self, group) for group in ATTRIBUTES}
        return {group: word for group, word in values.items() if word is not None}


class _Wall(Schema):
    ends: tuple[tuple[_Coordinate, _Coordinate], tuple[_Coordinate, _Coordinate]]

    def __post_init__(self) -> None:
        if self.ends[0] == self.ends[1]:
            raise ValueError(f"ends are both {list(self.ends[0])}: give two places")


class _Sensor(Schema):
    range_max: Annotated[float, Meta(ge=RANGES[0], le=RANGES[1])] = field(default=3.0, name="range")
    field_of_view: Annotated[float, Meta(ge=0.1, le=360.0)] = 360.0
    detection_probability: Annotated[float, Meta(ge=MIN_VALUE, le=1.0)] = 0.95
    noise: Annotated[float, Meta(ge=0.0)] | None = None

    def __post_init__(self) -> None:
        if self.noise is None:
            self.noise = min(0.1, self.range_max)
        if self.noise > self.range_max:
            limit = f"at most {self.range_max:g}, the range"
            raise ValueError(f"noise is {as_text(self.noise)}, but must be {limit}")


class _Motion(Schema):
    step_length: Annotated[float, Meta(ge=MIN_STEP, le=MAX_METRES)] = 1.0
    odometry_noise: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.02
    heading_bias: _Drift = 0.0
    heading_noise: _Drift = 0.0
    turn_noise: _Drift = 0.0


_DEGREE_FIELDS = ("field_of_view", *DRIFTS)


def _to_arrays(section: _Sensor | _Motion) -> dict[str, Array]:
    """Convert degrees to radians, and numbers to arrays."""
    return {
        name: jnp.float32(math.radians(value) if name in _DEGREE_FIELDS else value)
        for name, value in structs.asdict(section).items()
    }


def _to_numbers(record: SensorParams | MotionParams, names: Iterable[str]) -> dict[str, float]:
    """Convert arrays to the shortest decimals that round-trip."""
    return {
        name: (_degrees if name in _DEGREE_FIELDS else _decimal)(getattr(record, name))
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
    objects: Annotated[list[_Object], Meta(min_length=1, max_length=MAX_OBJECTS)]
    walls: Annotated[list[_Wall], Meta(max_length=MAX_WALLS)] = field(default_factory=list)


@dataclasses.dataclass(frozen=True, kw_only=True)
class WorldFile:
    """The contents of a world file, ready for the simulator."""

    name: str
    scenario: Scenario
    sensor: SensorParams
    motion: MotionParams
    instruction: str | None = None
    has_goal: bool = True
    """Whether the file has a goal; else the scenario's goal is its start."""
    object_names: tuple[str, ...] = ()
    """One per slot, empty where the object has no name."""
    type_names: tuple[str, ...] = dataclasses.field(
        default_factory=lambda: load_lexicon().type_names
    )
    """Object types by index: those of the lexicon, then others in the file."""
    attribute_groups: tuple[str, ...] = ()
    """Attribute groups that the detector reports: keys of ``ATTRIBUTES``."""


def world_from_dict(table: Any, *, file: str) -> WorldFile:
    """Validate tables of the world format and build the world.

    Its scenario has the smallest sufficient number of ``observations.SLOTS``, so that worlds of
    similar sizes share their compiled programs.

    Args:
        table: the tables, as read.
        file: the file's name, for messages.

    Raises:
        ValueError: anything is missing, unknown or outside its limits.
    """
    file = shorten(sanitize(file), MAX_NAME)
    with error_prefix(file):
        return _to_world(convert(table, _World), Path(file).stem)


def _to_world(world: _World, stem: str) -> WorldFile:
    """Validate the constraints between the parts of a world, and build it."""
    count, start = len(world.objects), world.start or _Start()
    num_slots = next(size for size in SLOTS if size >= count)
    if world.start is None and not all(low <= 0.0 <= high for _, low, high in world.area.axes()):
        raise ValueError("start is missing, and its default 0, 0 lies outside the area: add it")
    world.area.check("start", start.x, start.y)
    names = [item.name or "" for item in world.objects]
    type_names, types = list(load_lexicon().type_names), []
    for index, item in enumerate(world.objects):
        where = f"objects[{index}]"
        world.area.check(where, item.x, item.y)
        other = names.index(names[index])
        if item.name and other < index:
            raise ValueError(f"{where}.name is {item.name!r} as is objects[{other}]: rename one")
        types.append(_type_index(item.type, type_names, where))
    for index, item in enumerate(world.walls):
        for point in item.ends:
            world.area.check(f"walls[{index}].ends", *point)
    goal, goal_index = _goal(world, start, names)
    ends = [(*a, *b) for a, b in (item.ends for item in world.walls)]
    codes = [attribute_code(*item.attributes.values()) for item in world.objects]
    codes += [0] * (num_slots - count)
    return WorldFile(
        name=world.name or stem,
        instruction=world.instruction,
        scenario=make_scenario(
            [(kind, item.x, item.y) for kind, item in zip(types, world.objects, strict=True)],
            slots=num_slots,
            area=structs.astuple(world.area),
            goal=np.array(goal, np.float32),
            goal_index=np.asarray(goal_index, np.int32),
            start=np.array([start.x, start.y, math.radians(start.heading)], np.float32),
            object_attribute=np.array(codes, np.int32) if any(codes) else None,
            terrain=among_walls(*ends) if ends else OPEN,
        ),
        sensor=SensorParams(**_to_arrays(world.sensor)),
        motion=MotionParams(**_to_arrays(world.motion)),
        has_goal=world.goal is not None,
        object_names=(*names, *[""] * (num_slots - count)),
        type_names=tuple(type_names),
        attribute_groups=tuple(
            group for group in ATTRIBUTES if any(group in item.attributes for item in world.objects)
        ),
    )


def _type_index(text: str, type_names: list[str], where: str) -> int:
    """Look up a type by any of its names; another noun is appended as a new type."""
    name = " ".join(normalize(text).split())
    name = find_type(name) or name
    if name not in type_names:
        if (correction := repair(name, is_noun=True)) is not None:
            hint = f"which looks mistyped. Did you mean {correction!r}?"
            raise ValueError(f"{where}.type is {name!r}, {hint}")
        if is_reserved(name):
            hint = "which has a meaning of its own in every sentence: choose another name"
            raise ValueError(f"{where}.type is {name!r}, {hint}")
        if not all(map(is_word, name.split())):
            raise ValueError(
                f"{where}.type is {as_text(name)}, but must be a noun, in plain letters"
            )
        type_names.append(name)
    return type_names.index(name)


def _goal(world: _World, start: _Start, names: list[str]) -> tuple[tuple[float, float], int]:
    """Return the goal's position, and the slot of its object or NONE."""
    goal = world.goal
    if goal is None:
        return (start.x, start.y), NONE
    if goal.x is not None and goal.y is not None:
        world.area.check("goal", goal.x, goal.y)
        return (goal.x, goal.y), NONE
    if goal.object not in names:
        expected = "the name of an object of this file"
        raise ValueError(bad_choice("goal.object", goal.object, filter(None, names), expected))
    index = names.index(goal.object)
    return (world.objects[index].x, world.objects[index].y), index


def world_to_dict(world: WorldFile) -> dict[str, Any]:
    """Convert a world to tables; ``world_from_dict`` restores the same world.

    A heading of more than a full turn is wrapped.
    """
    scenario = world.scenario
    names = [*world.object_names, *[""] * scenario.is_object.size]
    goal, goal_index = None, int(scenario.goal_index)
    if goal_index >= 0 and not names[goal_index]:
        # A file identifies the goal by its object's name.
        candidates = ("goal" + "'" * size for size in range(len(names)))
        names[goal_index] = next(name for name in candidates if name not in names)
    if world.has_goal:
        x, y = map(_decimal, scenario.goal)
        goal = _Goal(object=names[goal_index]) if goal_index >= 0 else _Goal(x=x, y=y)
    no_codes = np.zeros(scenario.is_object.size, np.int32)
    codes = no_codes if scenario.object_attribute is None else scenario.object_attribute
    heading = _degrees(scenario.start[2])
    table = _World(
        name=world.name,
        instruction=world.instruction or None,
        area=_Area(*map(_decimal, scenario.area)),
        start=_Start(
            *map(_decimal, scenario.start[:2]),
            heading=heading if abs(heading) <= 360.0 else math.remainder(heading, 360.0),
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
    """Return the shortest decimal that round-trips as float32."""
    return float(str(np.float32(value)))


def _degrees(value: Array) -> float:
    """Return the shortest decimal in degrees that round-trips as float32 radians."""
    radians = np.float32(value)
    degrees = math.degrees(float(radians))
    rounded = (round(degrees, digits) for digits in range(12))
    return next((d for d in rounded if np.float32(math.radians(d)) == radians), degrees)
