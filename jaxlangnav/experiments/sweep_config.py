"""The configuration of a sweep: a TOML file, checked in full before anything runs (section 4.2).

    name = "range and detector"               # optional
    episodes = 100                            # of each cell of the grid
    environments = 10                         # worlds taken in turn; 0 (default): always fresh
    seeds = [0, 1]
    worlds = ["1H1C", "2H1C", "yard.toml"]    # templates, shipped worlds, files
    commands = ["behind", "nearest", { text = "drive to the hydrant", relation = "null" }]
    ranges = [2, 3, "500 cm"]                 # metres
    policies = ["informed", "faithful", "frontier"]  # ours, the paper's, nearest frontier
    particles = [64, 256]

    [sensor]                                  # each key: a value or a list of values
    detection_probability = [0.9, "95 %"]
    field_of_view = "360 deg"
    noise = "10 cm"

    [motion]                                  # of the world, and assumed by the filter
    odometry_noise = "2 %"

    [map]
    concentration = [0.1, 0.3]                # expected count of further objects per type

    [planner]
    discount = 0.8

Only ``worlds`` and ``commands`` are required. "null", "behind" and "nearest" stand for the
commands of Table 2; for another sentence, ``relation`` selects the distribution of a template's
worlds. The grid is the product of everything that is listed.
"""

import dataclasses
import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, field

from jaxlangnav.experiments.policies import DEFAULT_PARTICLES, check_policies
from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.inputs.atomic_files import read_file
from jaxlangnav.inputs.documents import error_prefix, read_document
from jaxlangnav.inputs.limits import LENGTH, MAX_SEED
from jaxlangnav.inputs.sanitize import shorten
from jaxlangnav.inputs.schema import Name, PlainText, Schema, convert, unknown_key
from jaxlangnav.messages import default_sensor
from jaxlangnav.navigator.deployment import FIELDS
from jaxlangnav.world.files import MAX_FILE_BYTES, WorldFile, open_world
from jaxlangnav.world.scenario import scenario_params
from jaxlangnav.world.state import NUM_SLOTS, walls_of
from jaxlangnav.world.templates import Template, check_relation

_MAX_BYTES = 1 << 20  # bytes of a configuration
_NONEMPTY = Meta(min_length=1)
_UInt32 = Annotated[int, Meta(ge=0, le=MAX_SEED)]
_Particles = Annotated[int, Meta(ge=2)]
Choices = dict[str, tuple[float, ...]]


class Command(Schema):
    """A sentence, and the relation for which a template's worlds are sampled."""

    text: PlainText
    relation: Name = "null"


class _SweepSchema(Schema):
    worlds: PlainText | Annotated[list[PlainText], _NONEMPTY]
    commands: PlainText | Command | Annotated[list[PlainText | Command], _NONEMPTY]
    name: Name = "sweep"
    episodes: Annotated[int, Meta(ge=1)] = 100
    environments: _UInt32 = 0
    seeds: _UInt32 | Annotated[list[_UInt32], _NONEMPTY] = 0
    ranges: float | int | str | Annotated[list[float | int | str], _NONEMPTY] = 3
    policies: PlainText | Annotated[list[PlainText], _NONEMPTY] = "informed"
    particles: _Particles | Annotated[list[_Particles], _NONEMPTY] = DEFAULT_PARTICLES
    sensor: dict[str, Any] = field(default_factory=dict)
    motion: dict[str, Any] = field(default_factory=dict)
    map: dict[str, Any] = field(default_factory=dict)
    planner: dict[str, Any] = field(default_factory=dict)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepConfig:
    """A validated grid: the tuple of values of every parameter."""

    name: str
    episodes: int
    environments: int  # worlds of a template, used cyclically; 0: a new one per episode
    seeds: tuple[int, ...]
    worlds: tuple[str, ...]
    commands: tuple[Command, ...]
    ranges: tuple[float, ...]
    policies: tuple[str, ...]
    particles: tuple[int, ...]
    params: dict[str, Choices]  # by table (sensor, motion, map, planner), then key
    custom_worlds: dict[str, WorldFile]  # worlds that are not templates, by entry in ``worlds``
    world_hashes: dict[str, str]  # SHA-256 of the world files, by their entry in ``worlds``

    def document(self) -> dict[str, Any]:
        """Convert the configuration to JSON types, for the manifest."""
        document = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        del document["params"], document["custom_worlds"], document["world_hashes"]
        document["commands"] = [msgspec.structs.asdict(item) for item in self.commands]
        return document | self.params | {"world_hashes": self.world_hashes}


def read_config(
    path: str | Path, *, overrides: Mapping[str, Mapping[str, Any]] | None = None
) -> SweepConfig:
    """Read and validate a sweep's TOML file; world files in it are relative to its folder.

    ``overrides``: by table (sensor, motion, map, planner) and key, in place of the file's values.
    ``ValueError``, in one line: the file is unreadable or invalid.
    """
    path = Path(path)
    table = read_document(path, max_bytes=_MAX_BYTES)
    for name, keys in (overrides or {}).items():
        if isinstance(table, dict) and isinstance(table.setdefault(name, {}), dict):
            table[name] |= keys
    with error_prefix(path):
        return config_from_dict(table, folder=path.parent)


def config_from_dict(table: Mapping[str, Any], *, folder: Path = Path()) -> SweepConfig:
    """Validate a configuration as ``read_config``; world files are relative to ``folder``."""
    raw = convert(table, _SweepSchema)
    sequences = {name: tuple(_as_list(item)) for name, item in msgspec.structs.asdict(raw).items()}
    custom, hashes = _open_worlds(sequences["worlds"], folder)
    fields: dict[str, Any] = {
        item: getattr(raw, item) for item in ("name", "episodes", "environments")
    }
    fields |= {name: sequences[name] for name in ("seeds", "worlds", "particles")}
    config = SweepConfig(
        **fields,
        commands=tuple(map(_parse_command, sequences["commands"])),
        ranges=tuple(LENGTH.read(item, "ranges") for item in sequences["ranges"]),
        policies=check_policies(sequences["policies"]),
        params={name: _params(getattr(raw, name), name) for name in FIELDS},
        custom_worlds=custom,
        world_hashes=hashes,
    )
    axes: dict[str, Any] = {"commands": [(item.text, item.relation) for item in config.commands]}
    axes |= {name: getattr(config, name) for name in ("seeds", "worlds", "ranges", "particles")}
    for name, keys in config.params.items():
        axes |= {f"{name}.{key}": values for key, values in keys.items()}
    for name, values in axes.items():
        if len(set(values)) < len(values):
            raise ValueError(f"{name} lists a value twice")  # rows could not be told apart
    # Noise is checked against the range: largest noise, shortest and longest range.
    for range_max in (min(config.ranges), max(config.ranges)):
        default_sensor(range_max, noise=max(config.params["sensor"].get("noise", (0.1,))))
    for world in (item for item in config.worlds if item not in custom):
        for command in config.commands:
            scenario_params(template=world, relation=command.relation)
    return config


def _as_list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def _parse_command(entry: str | Command) -> Command:
    """Read a command: the name of one of Table 2's, a sentence, or a table with its relation."""
    if isinstance(entry, Command):
        check_relation(entry.relation)
        return entry
    for relation, text in SENTENCES.items():
        if entry in (relation, text):
            return Command(text=text, relation=relation)
    raise ValueError(
        f'command "{shorten(entry)}": say by which relation the worlds are drawn, '
        f'{{ text = "{shorten(entry)}", relation = "behind" }} (null, behind or nearest)'
    )


def _open_worlds(
    worlds: tuple[str, ...], folder: Path
) -> tuple[dict[str, WorldFile], dict[str, str]]:
    """Open the worlds that are not templates, and hash their files."""
    custom: dict[str, WorldFile] = {}
    hashes: dict[str, str] = {}
    for entry in worlds:
        path = folder / entry
        is_file = os.path.isfile(path)
        opened = open_world(str(path) if is_file else entry)
        if isinstance(opened, Template):
            continue
        count, slots = int(opened.scenario.is_object.sum()), opened.scenario.is_object.size
        if slots > NUM_SLOTS:
            raise ValueError(
                f"world {shorten(entry)} has {count} objects, but a sweep's worlds have at most "
                f"{NUM_SLOTS}: remove some, or run it alone with jaxlangnav follow --world"
            )
        if len(walls_of(opened.scenario)):
            raise ValueError(
                f"world {shorten(entry)} has walls, which a sweep's worlds have not: run it alone "
                "with jaxlangnav follow --world"
            )
        if not opened.has_goal:
            raise ValueError(
                f"world {shorten(entry)} has no [goal], by which a sweep tells success: add it"
            )
        custom[entry] = opened
        if is_file:
            hashes[entry] = hashlib.sha256(read_file(path, max_bytes=MAX_FILE_BYTES)).hexdigest()
    return custom, hashes


def _params(table: Mapping[str, Any], name: str) -> Choices:
    """Read the values of one table of Params."""
    choices: Choices = {}
    for key, value in table.items():
        if key not in FIELDS[name]:
            raise ValueError(f"{name}.{unknown_key(key, FIELDS[name])}")
        values = _as_list(value)
        if not values:
            raise ValueError(f"{name}.{key} is empty: the grid would be empty")
        choices[key] = tuple(FIELDS[name][key].read(value, f"{name}.{key}") for value in values)
    return choices
