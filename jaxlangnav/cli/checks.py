"""Validation of options shared by several commands; errors state value, limit and remedy."""

import importlib.util
import os
from pathlib import Path
from typing import Annotated

import tyro

from jaxlangnav.cli.output import UsageError

Folder = Annotated[Path | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]
File = Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")]
OptionalMetres = Annotated[float | None, tyro.conf.arg(metavar="METRES", help_behavior_hint="")]
StepText = Annotated[str, tyro.conf.arg(metavar="STEP:TEXT")]
WorldName = Annotated[str | None, tyro.conf.arg(metavar="WORLD", help_behavior_hint="")]
OptionalInt = Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")]
Ranges = Annotated[str | None, tyro.conf.arg(metavar="METRES", help_behavior_hint="")]


def check_folder(option: str, path: Path | None) -> None:
    """Raise UsageError for an output folder that cannot be created or written."""
    if path is None:
        return
    ancestor = next(one for one in (path, *path.parents) if one.exists())
    if not ancestor.is_dir():
        raise UsageError(f"{option} is {path}, but {ancestor} is a file: name a folder")
    if not os.access(ancestor, os.W_OK):
        raise UsageError(f"{option} is {path}, but {ancestor} cannot be written to")


def check_file(option: str, path: Path | None, suffix: str) -> None:
    """Raise UsageError for an output file that cannot be written or has another extension."""
    if path is None:
        return
    if path.suffix != suffix:
        raise UsageError(f"{option} is {path}, but its name must end in {suffix}")
    if path.is_dir():
        raise UsageError(f"{option} is {path}, but that is a folder: name a file")
    check_folder(option, path.parent)


def check_extra(what: str, module: str, extra: str) -> None:
    """Raise UsageError if a library of an optional extra is not installed."""
    if importlib.util.find_spec(module) is None:
        raise UsageError(f'{what}: pip install "jaxlangnav[{extra}]"')
