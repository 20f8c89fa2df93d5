"""World files: people bring their own world (the environments of section 4.2).

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
                                       # what the detector reports of it (``kinds.ATTRIBUTES``)

    [sensor]                           # optional, each key too
    range = 3.0
    field_of_view = 360.0
    detection_probability = 0.95
    noise = 0.1                        # of a relative position, each axis

    [motion]                           # optional, each key too
    step_length = 1.0                  # in one decision cycle
    odometry_noise = 0.02              # as a share of the way
    heading_bias = 0.0                 # degrees a metre by which the heading drifts; 0: a compass
    heading_noise = 0.0                # degrees per root of a metre, standard deviation
    turn_noise = 0.0                   # degrees per root of a radian turned, likewise
"""

import os
from importlib import resources
from pathlib import Path
from typing import Any

from jaxlangnav.files.documents import DocumentError, parse_json, parse_toml, read_text
from jaxlangnav.plain_text import cut, shown
from jaxlangnav.world.fields import WorldFileError, closest_choice
from jaxlangnav.world.reading import MOST_OBJECTS, WorldFile, world_from_dict
from jaxlangnav.world.templates import TEMPLATE_NAMES, Template, parse_template
from jaxlangnav.world.writing import save_world

__all__ = [
    "WorldFile",
    "WorldFileError",
    "load_world",
    "open_world",
    "save_world",
    "shipped_worlds",
]

LARGEST_WORLD_FILE = 256 * 1024
"""Bytes of a world file; one of sixty-four objects takes eight thousand."""


def load_world(path: str | Path, *, num_slots: int | None = None) -> WorldFile:
    """Read and check a world file.

    Args:
        path: a .toml or .json file.
        num_slots: O, object slots of the scenario; as many as its objects need if None.

    Returns:
        The world.

    Raises:
        WorldFileError: unreadable, or anything in it is wrong; one line that says what to do.
    """
    path = Path(path)
    return world_from_dict(
        _read(path, num_slots or MOST_OBJECTS), file=path.name, num_slots=num_slots
    )


def shipped_worlds() -> tuple[str, ...]:
    """List the names of the worlds that come with the package."""
    data = resources.files("jaxlangnav.world") / "data"
    return tuple(sorted(Path(entry.name).stem for entry in data.iterdir()))


def open_world(text: str, *, num_slots: int | None = None) -> Template | WorldFile:
    """Find what a person means by a world: a template, a shipped world, or a file.

    Args:
        text: "2H1C", the name of a shipped world, or the path of a .toml or .json file.
        num_slots: O, object slots of a scenario read from a file; as needed if None.

    Returns:
        A template to sample from, or a world.

    Raises:
        ValueError: none of the three, or the file is wrong.
    """
    if text in shipped_worlds():
        data = resources.files("jaxlangnav.world") / "data" / f"{text}.toml"
        table = parse_toml(data.read_text(encoding="utf-8"))
        return world_from_dict(table, file=f"{text}.toml", num_slots=num_slots)
    is_path = "/" in text or Path(text).suffix.lower() in (".toml", ".json")
    # Unlike Path.is_file, it takes a name that is too long for one as no file.
    if is_path or os.path.isfile(text):
        return load_world(text, num_slots=num_slots)
    if text.strip()[:1].isdigit():
        return parse_template(text)
    shipped = ", ".join(shipped_worlds())
    hint = closest_choice(cut(text), (*shipped_worlds(), *TEMPLATE_NAMES))
    raise ValueError(
        f"unknown world {shown(text)}: give a template ({', '.join(TEMPLATE_NAMES)}), a shipped "
        f"world ({shipped}), or a .toml or .json file{hint}"
    )


def _read(path: Path, most: int) -> Any:
    """Read a file into tables, or say why not."""
    kind = path.suffix.lower()
    if kind not in (".toml", ".json"):
        raise WorldFileError(f"{path}: a world file's name must end in .toml or .json")
    try:
        text = read_text(path, at_most=LARGEST_WORLD_FILE)
        _check_objects(text, path, most)
        return parse_toml(text) if kind == ".toml" else parse_json(text)
    except FileNotFoundError:
        raise WorldFileError(
            f"{path}: no such file; shipped worlds are {', '.join(shipped_worlds())}"
        ) from None
    except OSError as error:
        raise WorldFileError(f"{path}: cannot be read: {error.strerror}") from None
    except DocumentError as error:
        raise WorldFileError(f"{path}: {error}") from None
    except ValueError as error:
        raise WorldFileError(str(error)) from None


def _check_objects(text: str, path: Path, most: int) -> None:
    """Refuse a world of too many objects before it is parsed: of a million that takes long."""
    number = f"\n{text}".count("\n[[objects]]")
    if number > most:
        raise WorldFileError(
            f"{path.name}: objects has {number:,} entries but must have 1 to {most}: remove"
        )
