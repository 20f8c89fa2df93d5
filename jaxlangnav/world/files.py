"""World files: custom worlds in TOML or JSON (the environments of section 4.2).

A world file is TOML, or JSON with the same keys. Lengths are metres, angles degrees (counter-
clockwise from +x); the map frame is the file's own.

    name = "yard"                      # optional; the file's name otherwise
    instruction = "go to the hydrant behind the cone"   # optional; what to ask here

    [area]                             # the operating area, known to the robot
    x_min = 0.0
    x_max = 13.0
    y_min = -9.0
    y_max = 9.0

    [start]                            # optional; 0, 0, 0
    x = 0.0
    y = 0.0
    heading = 0.0

    [goal]                             # optional; an object by its name, or x and y: what counts
                                       # as success of the instruction above
    object = "far hydrant"

    [[objects]]                        # one to sixty-four, within the area
    type = "hydrant"                   # any noun
    name = "far hydrant"               # optional, unique
    x = 9.0
    y = 1.5
    colour = "red"                     # optional, as are material, size and height:
                                       # what the detector reports of it (``ATTRIBUTES``)

    [[walls]]                          # optional, up to 32: they hide what is behind them and halt
    ends = [[4.0, -2.0], [4.0, 2.0]]   # the robot, which knows them; x and y of both ends

    [sensor]                           # optional, each key too
    range = 3.0
    field_of_view = 360.0
    detection_probability = 0.95
    noise = 0.1                        # of a relative position, each axis

    [motion]                           # optional, each key too
    step_length = 1.0                  # in one decision cycle
    odometry_noise = 0.02              # relative to the distance
    heading_bias = 0.0                 # degrees a metre by which the heading drifts; 0: a compass
    heading_noise = 0.0                # degrees per root of a metre, standard deviation
    turn_noise = 0.0                   # degrees per root of a radian turned, likewise
"""

import json
import os
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias

from jaxlangnav.inputs.atomic_files import write_text
from jaxlangnav.inputs.documents import read_document, shipped_file
from jaxlangnav.inputs.sanitize import as_text, did_you_mean
from jaxlangnav.world.schema import (
    WorldFile as WorldFile,
    world_from_dict as world_from_dict,
    world_to_dict as world_to_dict,
)
from jaxlangnav.world.templates import TEMPLATE_NAMES, Template, parse_template

MAX_FILE_BYTES = 256 * 1024
"""Limit of a world file's bytes; one of sixty-four objects has eight thousand."""
WorldSource: TypeAlias = Template | WorldFile
"""What ``open_world`` opens: a template to sample worlds from, or one world."""


def load_world(path: str | Path) -> WorldFile:
    """Read and validate a world file, .toml or .json.

    Raises:
        ValueError: the file is unreadable or invalid; one line with the remedy.
    """
    path = _check_suffix(path)
    if not os.path.lexists(path):
        shipped = ", ".join(shipped_worlds())
        raise ValueError(f"{path}: no such file; shipped worlds are {shipped}")
    return world_from_dict(read_document(path, max_bytes=MAX_FILE_BYTES), file=path.name)


def shipped_worlds() -> tuple[str, ...]:
    """List the names of the worlds shipped with the package."""
    data = resources.files("jaxlangnav.world") / "data"
    return tuple(sorted(Path(entry.name).stem for entry in data.iterdir()))


def open_world(text: str) -> WorldSource:
    """Resolve a user's world argument: a template to sample from, a shipped world, or a file.

    Args:
        text: "2H1C", the name of a shipped world, or the path of a .toml or .json file.

    Raises:
        ValueError: none of the three, or the file is invalid.
    """
    if text in shipped_worlds():
        return load_world(shipped_file("world", f"{text}.toml"))
    is_path = "/" in text or Path(text).suffix.lower() in (".toml", ".json")
    # Unlike Path.is_file, it returns False for a name that is too long.
    if is_path or os.path.isfile(text):
        return load_world(text)
    if text.strip()[:1].isdigit():
        return parse_template(text)
    shipped = ", ".join(shipped_worlds())
    hint = did_you_mean(text, (*shipped_worlds(), *TEMPLATE_NAMES))
    raise ValueError(
        f"unknown world {as_text(text)}: give a template ({', '.join(TEMPLATE_NAMES)}), a shipped "
        f"world ({shipped}), or a .toml or .json file{hint}"
    )


def save_world(world: WorldFile, path: str | Path) -> None:
    """Write a world to a .toml or .json file; an existing one is replaced.

    Numbers round-trip exactly as float32; a heading of more than a full turn is wrapped.

    Raises:
        ValueError: the name ends in neither, or the file cannot be written.
    """
    path, table = _check_suffix(path), world_to_dict(world)
    text = to_toml(table) if path.suffix.lower() == ".toml" else json.dumps(table, indent=2)
    try:
        write_text(text + "\n", path)
    except OSError as error:
        raise ValueError(f"{path}: cannot be written: {error.strerror}") from None


def _check_suffix(path: str | Path) -> Path:
    """Raise ``ValueError`` for another suffix than .toml or .json."""
    if Path(path).suffix.lower() not in (".toml", ".json"):
        raise ValueError(f"{path}: a world file's name must end in .toml or .json")
    return Path(path)


def to_toml(table: dict[str, Any]) -> str:
    """Format keys, tables and lists of tables; JSON's numbers and unescaped texts are TOML."""
    lines: list[str] = []
    for key, value in table.items():
        for section in value if isinstance(value, list) else [value]:
            if isinstance(section, dict):
                lines += ["", f"[[{key}]]" if isinstance(value, list) else f"[{key}]"]
            entries = section if isinstance(section, dict) else {key: section}
            lines += [f"{k} = {json.dumps(v, ensure_ascii=False)}" for k, v in entries.items()]
    return "\n".join(lines)
