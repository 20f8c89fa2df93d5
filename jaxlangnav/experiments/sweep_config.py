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
import difflib
import hashlib
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxlangnav.experiments.policies import DEFAULT_PARTICLES, check_policies
from jaxlangnav.experiments.tasks import SEED_LIMIT, SENTENCES
from jaxlangnav.files.documents import DocumentError, parse_toml, read_text
from jaxlangnav.files.whole import read_file
from jaxlangnav.messages import default_sensor
from jaxlangnav.plain_text import cut, fault_of_name, shown
from jaxlangnav.quantities import FIELDS, LENGTH
from jaxlangnav.world.files import LARGEST_WORLD_FILE, WorldFile, open_world
from jaxlangnav.world.scenario import NUM_SLOTS, scenario_law
from jaxlangnav.world.templates import Template, check_relation

_KEYS = (
    "name",
    "episodes",
    "environments",
    "seeds",
    "worlds",
    "commands",
    "ranges",
    "policies",
    "particles",
)
_LONGEST_TEXT = 1000
"""Characters of a sentence, or of the path of a world."""
_LARGEST_FILE = 1 << 20
"""Bytes of a configuration."""
Choices = dict[str, tuple[float, ...]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Command:
    """A sentence and the law by which a template's worlds are drawn for it."""

    text: str
    relation: str


@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepConfig:
    """A grid; every field a tuple of the values it takes."""

    name: str
    episodes: int
    environments: int
    """Worlds of a template, taken in turn; 0 for a fresh one per episode."""
    seeds: tuple[int, ...]
    worlds: tuple[str, ...]
    commands: tuple[Command, ...]
    ranges: tuple[float, ...]
    policies: tuple[str, ...]
    particles: tuple[int, ...]
    params: dict[str, Choices]
    """By table (sensor, motion, map, planner), then by key."""
    own_worlds: dict[str, WorldFile]
    """Worlds that are no template, by their entry in ``worlds``."""
    world_hashes: dict[str, str]
    """SHA-256 of the world files, by their entry in ``worlds``."""

    def document(self) -> dict[str, Any]:
        """Write the configuration out in full, for the manifest."""
        return {
            "name": self.name,
            "episodes": self.episodes,
            "environments": self.environments,
            "seeds": list(self.seeds),
            "worlds": list(self.worlds),
            "commands": [dataclasses.asdict(one) for one in self.commands],
            "ranges": list(self.ranges),
            "policies": list(self.policies),
            "particles": list(self.particles),
            **{
                table: {key: list(values) for key, values in keys.items()}
                for table, keys in self.params.items()
            },
            "world_hashes": self.world_hashes,
        }


def read_config(
    path: str | Path, *, overrides: Mapping[str, Mapping[str, Any]] | None = None
) -> SweepConfig:
    """Read and check a sweep's configuration.

    Args:
        path: a TOML file; world files in it are relative to its folder.
        overrides: by table (sensor, motion, map, planner) and key, in place of the file's values.

    Returns:
        The configuration.

    Raises:
        ValueError: unreadable, or anything in it is wrong; one line.
    """
    path = Path(path)
    try:
        text = read_text(path, at_most=_LARGEST_FILE)
    except FileNotFoundError:
        raise ValueError(f"{path}: no such file") from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from None
    try:
        table = parse_toml(text)
    except DocumentError as error:
        raise ValueError(f"{path}: {error}") from None
    for name, keys in (overrides or {}).items():
        if isinstance(table.setdefault(name, {}), dict):
            table[name] |= keys
    try:
        return config_from_dict(table, folder=path.parent)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def config_from_dict(table: Mapping[str, Any], *, folder: Path = Path()) -> SweepConfig:
    """Check a configuration.

    Args:
        table: its keys, as in the file.
        folder: to which world files are relative.

    Returns:
        The configuration.

    Raises:
        ValueError: an unknown key, an empty list, a wrong value or unit; one line.
    """
    _check_keys(table, (*_KEYS, *FIELDS), "")
    for key in ("worlds", "commands"):
        if key not in table:
            raise ValueError(f"{key} is missing: the grid would be empty")
    worlds = _texts(table, "worlds", ())
    own, hashes = _open_worlds(worlds, folder)
    config = SweepConfig(
        name=_name(table.get("name", "sweep")),
        episodes=_integers(table, "episodes", (100,), least=1, is_list=False)[0],
        environments=_integers(
            table, "environments", (0,), least=0, limit=SEED_LIMIT, is_list=False
        )[0],
        seeds=_integers(table, "seeds", (0,), least=0, limit=SEED_LIMIT),
        worlds=worlds,
        commands=tuple(_command(one) for one in _listed(table["commands"], "commands")),
        ranges=tuple(
            LENGTH.read(one, "ranges") for one in _listed(table.get("ranges", 3), "ranges")
        ),
        policies=check_policies(_texts(table, "policies", ("informed",))),
        particles=_integers(table, "particles", (DEFAULT_PARTICLES,), least=2),
        params={name: _params(table.get(name, {}), name) for name in FIELDS},
        own_worlds=own,
        world_hashes=hashes,
    )
    _check_distinct(config)
    for reach in config.ranges:
        for noise in config.params["sensor"].get("noise", (0.1,)):
            default_sensor(reach, noise=noise)
    for world in config.worlds:
        for command in config.commands:
            if world not in own:
                scenario_law(template=world, relation=command.relation)
    return config


def _check_keys(table: Mapping[str, Any], known: Iterable[str], where: str) -> None:
    """Refuse keys nobody reads."""
    names = list(known)
    for key in table:
        if key not in names:
            near = difflib.get_close_matches(cut(key), names, n=1)
            hint = f'; did you mean "{near[0]}"?' if near else f": choose from {', '.join(names)}"
            raise ValueError(f'unknown key "{where}{cut(key)}"{hint}')


def _name(value: Any) -> str:
    """Read the sweep's name, which heads its tables."""
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f"name is {shown(value)}, but must be a text that is not empty")
    if fault := fault_of_name(value):
        raise ValueError(f"name {fault}")
    return value


def _listed(value: Any, name: str) -> list[Any]:
    """Take one value or a list of them; refuse an empty list."""
    values = value if isinstance(value, list) else [value]
    if not values:
        raise ValueError(f"{name} is empty: the grid would be empty")
    return values


def _texts(table: Mapping[str, Any], name: str, default: tuple[str, ...]) -> tuple[str, ...]:
    """Read one text or a list of them."""
    values = _listed(table.get(name, list(default)), name)
    for value in values:
        if not isinstance(value, str) or not value.strip():
            raise ValueError(f"{name} holds {shown(value)}, but must hold texts")
        _check_text(value, f"a text of {name}")
    return tuple(values)


def _check_text(value: str, what: str) -> None:
    """Refuse a text that could not be shown to people."""
    if fault := fault_of_name(value, longest=_LONGEST_TEXT):
        raise ValueError(f"{what} {fault}")


def _integers(
    table: Mapping[str, Any],
    name: str,
    default: tuple[int, ...],
    *,
    least: int,
    limit: int | None = None,
    is_list: bool = True,
) -> tuple[int, ...]:
    """Read one whole number or a list of them."""
    value = table.get(name, list(default))
    if not is_list and name in table and isinstance(value, list):
        raise ValueError(f"{name} is a list, but must be one whole number")
    values = _listed(value, name)
    for one in values:
        if not isinstance(one, int) or isinstance(one, bool):
            raise ValueError(f"{name} is {shown(one)}, but must be a whole number")
        if one < least:
            raise ValueError(f"{name} is {shown(one)}, but must be at least {least}")
        if limit is not None and one >= limit:
            raise ValueError(f"{name} is {shown(one)}, but must be below {limit}")
    return tuple(values)


def _command(value: Any) -> Command:
    """Read a command: the name of one of Table 2's, a sentence, or a table with its relation."""
    if isinstance(value, Mapping):
        _check_keys(value, ("text", "relation"), "commands.")
        if not isinstance(value.get("text"), str) or not value["text"].strip():
            raise ValueError('a command\'s "text" is missing or empty')
        _check_text(value["text"], "a command")
        relation = value.get("relation", "null")
        if not isinstance(relation, str):
            raise ValueError(f"a command's relation is {shown(relation)}, but must be a text")
        _check_text(relation, "a command's relation")
        check_relation(relation)
        return Command(text=value["text"], relation=relation)
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f"commands holds {shown(value)}, but must hold sentences")
    _check_text(value, "a command")
    if value in SENTENCES:
        return Command(text=SENTENCES[value], relation=value)
    for relation, text in SENTENCES.items():
        if value == text:
            return Command(text=text, relation=relation)
    raise ValueError(
        f'command "{cut(value)}": say by which relation the worlds are drawn, '
        f'{{ text = "{cut(value)}", relation = "behind" }} (null, behind or nearest)'
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
                f"world {cut(entry)} has {number} objects, but a sweep's worlds have at most "
                f"{NUM_SLOTS}: remove some, or run it alone with jaxlangnav follow --world"
            )
        if not found.has_goal:
            raise ValueError(
                f"world {cut(entry)} has no [goal], by which a sweep tells success: add it"
            )
        own[entry] = found
        if is_beside:
            hashes[entry] = hashlib.sha256(
                read_file(beside, at_most=LARGEST_WORLD_FILE)
            ).hexdigest()
    return own, hashes


def _params(table: Any, name: str) -> Choices:
    """Read one of the tables of Params."""
    if not isinstance(table, Mapping):
        raise ValueError(f"{name} is {shown(table)}, but must be a table: [{name}]")
    _check_keys(table, FIELDS[name], f"{name}.")
    return {
        key: tuple(FIELDS[name][key].read(one, f"{name}.{key}") for one in _listed(value, key))
        for key, value in table.items()
    }


def _check_distinct(config: SweepConfig) -> None:
    """Refuse values listed twice: their rows could not be told apart."""
    lists: dict[str, tuple[Any, ...]] = {
        "seeds": config.seeds,
        "worlds": config.worlds,
        "commands": config.commands,
        "ranges": config.ranges,
        "particles": config.particles,
    }
    for table, keys in config.params.items():
        lists |= {f"{table}.{key}": values for key, values in keys.items()}
    for name, values in lists.items():
        if len(set(values)) < len(values):
            raise ValueError(f"{name} lists a value twice")
