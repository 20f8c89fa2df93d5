"""The configuration of a sweep: a TOML file, checked in full before anything runs (section 4.2).

    name = "range and detector"               # optional
    episodes = 100                            # of each cell of the grid
    environments = 10                         # worlds taken in turn; 0 (default): always fresh
    seeds = [0, 1]
    worlds = ["1H1C", "2H1C", "yard.toml"]    # templates, shipped worlds, files
    commands = ["behind", "nearest", { text = "drive to the hydrant", relation = "null" }]
    ranges = [2, 3, "500 cm"]                 # metres
    policies = ["informed", "faithful", "frontier"]
    particles = [64, 256]

    [sensor]                                  # each key: a value or a list of values
    detection_probability = [0.9, "95 %"]
    field_of_view = "360 deg"
    noise = "10 cm"

    [motion]                                  # holds for the world and is told to the belief
    odometry_noise = "2 %"

    [map]
    concentration = [0.1, 0.3]

    [planner]
    discount = 0.8

Only ``worlds`` and ``commands`` are required. "null", "behind" and "nearest" stand for the
commands of Table 2; another sentence says by ``relation`` which law the worlds of a template
follow. The grid is the product of everything that is listed.
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
from jaxlangnav.experiments.tasks import SEED_LIMIT, SENTENCES
from jaxlangnav.inputs.documents import naming, read_document
from jaxlangnav.inputs.limits import LENGTH
from jaxlangnav.inputs.sanitize import shorten
from jaxlangnav.inputs.schema import Name, PlainText, Schema, convert, unknown_key
from jaxlangnav.inputs.whole_files import read_file
from jaxlangnav.messages import default_sensor
from jaxlangnav.navigator.deployment import FIELDS
from jaxlangnav.world.files import LARGEST_WORLD_FILE, WorldFile, open_world
from jaxlangnav.world.scenario import scenario_law
from jaxlangnav.world.state import NUM_SLOTS, walls_of
from jaxlangnav.world.templates import Template, check_relation

_LARGEST_FILE = 1 << 20  # bytes of a configuration
_ANY = Meta(min_length=1)
_Seed = Annotated[int, Meta(ge=0, lt=SEED_LIMIT)]
_Particles = Annotated[int, Meta(ge=2)]
Choices = dict[str, tuple[float, ...]]


class Command(Schema):
    """A sentence and the law by which a template's worlds are drawn for it."""

    text: PlainText
    relation: Name = "null"


class _Sweep(Schema):
    worlds: PlainText | Annotated[list[PlainText], _ANY]
    commands: PlainText | Command | Annotated[list[PlainText | Command], _ANY]
    name: Name = "sweep"
    episodes: Annotated[int, Meta(ge=1)] = 100
    environments: _Seed = 0
    seeds: _Seed | Annotated[list[_Seed], _ANY] = 0
    ranges: float | int | str | Annotated[list[float | int | str], _ANY] = 3
    policies: PlainText | Annotated[list[PlainText], _ANY] = "informed"
    particles: _Particles | Annotated[list[_Particles], _ANY] = DEFAULT_PARTICLES
    sensor: dict[str, Any] = field(default_factory=dict)
    motion: dict[str, Any] = field(default_factory=dict)
    map: dict[str, Any] = field(default_factory=dict)
    planner: dict[str, Any] = field(default_factory=dict)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepConfig:
    """A grid; every field a tuple of the values it takes."""

    name: str
    episodes: int
    environments: int  # worlds of a template, taken in turn; 0 for a fresh one per episode
    seeds: tuple[int, ...]
    worlds: tuple[str, ...]
    commands: tuple[Command, ...]
    ranges: tuple[float, ...]
    policies: tuple[str, ...]
    particles: tuple[int, ...]
    params: dict[str, Choices]  # by table (sensor, motion, map, planner), then by key
    own_worlds: dict[str, WorldFile]  # worlds that are no template, by their entry in ``worlds``
    world_hashes: dict[str, str]  # SHA-256 of the world files, by their entry in ``worlds``

    def document(self) -> dict[str, Any]:
        """Write the configuration out in full, for the manifest."""
        found = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        del found["params"], found["own_worlds"], found["world_hashes"]
        found["commands"] = [msgspec.structs.asdict(one) for one in self.commands]
        return found | self.params | {"world_hashes": self.world_hashes}


def read_config(
    path: str | Path, *, overrides: Mapping[str, Mapping[str, Any]] | None = None
) -> SweepConfig:
    """Read and check a sweep's configuration, TOML; world files in it are relative to its folder.

    ``overrides``: by table (sensor, motion, map, planner) and key, in place of the file's values.
    ``ValueError``, in one line: unreadable, or anything in it is wrong.
    """
    path = Path(path)
    table = read_document(path, at_most=_LARGEST_FILE)
    for name, keys in (overrides or {}).items():
        if isinstance(table.setdefault(name, {}), dict):
            table[name] |= keys
    with naming(path):
        return config_from_dict(table, folder=path.parent)


def config_from_dict(table: Mapping[str, Any], *, folder: Path = Path()) -> SweepConfig:
    """Check a configuration as ``read_config``; world files are relative to ``folder``."""
    given = convert(table, _Sweep)
    listed = {name: tuple(_listed(value)) for name, value in msgspec.structs.asdict(given).items()}
    own, hashes = _open_worlds(listed["worlds"], folder)
    same: dict[str, Any] = {
        one: getattr(given, one) for one in ("name", "episodes", "environments")
    }
    same |= {name: listed[name] for name in ("seeds", "worlds", "particles")}
    config = SweepConfig(
        **same,
        commands=tuple(map(_command, listed["commands"])),
        ranges=tuple(LENGTH.read(one, "ranges") for one in listed["ranges"]),
        policies=check_policies(listed["policies"]),
        params={name: _params(getattr(given, name), name) for name in FIELDS},
        own_worlds=own,
        world_hashes=hashes,
    )
    lists: dict[str, Any] = {"commands": [(one.text, one.relation) for one in config.commands]}
    lists |= {name: getattr(config, name) for name in ("seeds", "worlds", "ranges", "particles")}
    for name, keys in config.params.items():
        lists |= {f"{name}.{key}": values for key, values in keys.items()}
    for name, values in lists.items():
        if len(set(values)) < len(values):
            raise ValueError(f"{name} lists a value twice")  # rows could not be told apart
    # Noise is held against the range: where the largest fits the shortest, all do.
    for reach in (min(config.ranges), max(config.ranges)):
        default_sensor(reach, noise=max(config.params["sensor"].get("noise", (0.1,))))
    for world in (one for one in config.worlds if one not in own):
        for command in config.commands:
            scenario_law(template=world, relation=command.relation)
    return config


def _listed(value: Any) -> list[Any]:
    """Take one value or a list of them as a list."""
    return value if isinstance(value, list) else [value]


def _command(given: str | Command) -> Command:
    """Read a command: the name of one of Table 2's, a sentence, or a table with its relation."""
    if isinstance(given, Command):
        check_relation(given.relation)
        return given
    for relation, text in SENTENCES.items():
        if given in (relation, text):
            return Command(text=text, relation=relation)
    raise ValueError(
        f'command "{shorten(given)}": say by which relation the worlds are drawn, '
        f'{{ text = "{shorten(given)}", relation = "behind" }} (null, behind or nearest)'
    )


def _open_worlds(
    worlds: tuple[str, ...], folder: Path
) -> tuple[dict[str, WorldFile], dict[str, str]]:
    """Open the worlds that are no template, and hash their files."""
    own: dict[str, WorldFile] = {}
    hashes: dict[str, str] = {}
    for entry in worlds:
        beside = folder / entry
        is_beside = os.path.isfile(beside)
        found = open_world(str(beside) if is_beside else entry)
        if isinstance(found, Template):
            continue
        number, slots = int(found.scenario.is_object.sum()), found.scenario.is_object.size
        if slots > NUM_SLOTS:
            raise ValueError(
                f"world {shorten(entry)} has {number} objects, but a sweep's worlds have at most "
                f"{NUM_SLOTS}: remove some, or run it alone with jaxlangnav follow --world"
            )
        if len(walls_of(found.scenario)):
            raise ValueError(
                f"world {shorten(entry)} has walls, which a sweep's worlds have not: run it alone "
                "with jaxlangnav follow --world"
            )
        if not found.has_goal:
            raise ValueError(
                f"world {shorten(entry)} has no [goal], by which a sweep tells success: add it"
            )
        own[entry] = found
        if is_beside:
            content = read_file(beside, at_most=LARGEST_WORLD_FILE)
            hashes[entry] = hashlib.sha256(content).hexdigest()
    return own, hashes


def _params(table: Mapping[str, Any], name: str) -> Choices:
    """Read one of the tables of Params."""
    found: Choices = {}
    for key, value in table.items():
        if key not in FIELDS[name]:
            raise ValueError(f"{name}.{unknown_key(key, FIELDS[name])}")
        values = _listed(value)
        if not values:
            raise ValueError(f"{name}.{key} is empty: the grid would be empty")
        found[key] = tuple(FIELDS[name][key].read(one, f"{name}.{key}") for one in values)
    return found
