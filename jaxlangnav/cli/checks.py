"""Limits of options that several commands have; each says the value, the limit and the remedy."""

import importlib.util
import math
import os
from pathlib import Path
from typing import Annotated

import tyro

from jaxlangnav.cli.output import UsageError
from jaxlangnav.inputs.limits import RANGES

Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
Metres = Annotated[float | None, tyro.conf.arg(metavar="METRES", help_behavior_hint="")]
ByStep = Annotated[str, tyro.conf.arg(metavar="STEP:TEXT")]
WorldName = Annotated[str | None, tyro.conf.arg(metavar="WORLD", help_behavior_hint="")]
Number = Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")]
Ranges = Annotated[str | None, tyro.conf.arg(metavar="METRES", help_behavior_hint="")]


def check_seed(value: int) -> None:
    """Refuse a seed that does not fit into the root of the keys."""
    if not 0 <= value < 2**32:
        raise UsageError(f"--seed is {value}, but must lie between 0 and 4294967295")


def check_range(value: float | None) -> None:
    """Refuse a sensing range that is no length, or one that single precision cannot hold."""
    if value is None:
        return
    if not (math.isfinite(value) and value > 0):
        raise UsageError(f"--range is {value:g}, but must be a length above 0 m")
    low, high = RANGES
    if not low <= value <= high:
        raise UsageError(f"--range is {value:g}, but must be between {low:g} m and {high:g} m")


def check_folder(option: str, path: Path | None) -> None:
    """Refuse, before anything runs, a folder that could not be written to afterwards."""
    if path is None:
        return
    existing = path
    while not existing.exists() and existing != existing.parent:
        existing = existing.parent
    if not existing.is_dir():
        raise UsageError(f"{option} is {path}, but {existing} is a file: name a folder")
    if not os.access(existing, os.W_OK):
        raise UsageError(f"{option} is {path}, but {existing} cannot be written to")


def check_file(option: str, path: Path | None, suffix: str) -> None:
    """Refuse, before anything runs, a file that could not be written afterwards."""
    if path is None:
        return
    if path.suffix != suffix:
        raise UsageError(f"{option} is {path}, but its name must end in {suffix}")
    if path.is_dir():
        raise UsageError(f"{option} is {path}, but that is a folder: name a file")
    check_folder(option, path.parent)


def check_extra(what: str, module: str, extra: str) -> None:
    """Refuse what needs a library of an extra that is not installed."""
    if importlib.util.find_spec(module) is None:
        raise UsageError(f'{what}: pip install "jaxlangnav[{extra}]"')
