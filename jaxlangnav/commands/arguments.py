"""From the words on the command line to a command with its options.

tyro reads the options from the command's dataclass and writes the help. Its error messages are
boxes of several lines; scripts and people get one line instead, with the nearest valid name.
"""

import contextlib
import dataclasses
import importlib
import inspect
import io
import re
from collections.abc import Sequence
from typing import Any, Protocol

from jaxlangnav.commands import SUMMARIES
from jaxlangnav.commands.errors import UsageError, did_you_mean
from jaxlangnav.commands.output import Document, Output

PROGRAM = "jaxlangnav"
_FRAME = " \t│╭╮╰╯"
_RULE = re.compile(r"^[─-]{8,}")


class Command(Protocol):
    """A command: a dataclass of options that can be run."""

    json: bool

    def run(self, output: Output) -> Document:
        """Do the work, telling people about it through ``output``; return the document."""
        ...


def parse_arguments(arguments: Sequence[str]) -> Command:
    """Read a command and its options.

    Args:
        arguments: the words after the program's name; the first one names the command.

    Returns:
        The command, ready to run.

    Raises:
        UsageError: the command or an option is unknown, missing or of the wrong kind.
        SystemExit: help was asked for and has been printed.
    """
    name, *options = arguments
    if name.startswith("-"):
        raise UsageError(f'expected a command before "{name}" (see {PROGRAM} --help)')
    if name not in SUMMARIES:
        hint = did_you_mean(name, SUMMARIES) or f"; choose from {', '.join(SUMMARIES)}"
        raise UsageError(f'unknown command "{name}"{hint}')
    return _read(command_class(name), options, program=f"{PROGRAM} {name}")


def command_class(name: str) -> type[Any]:
    """Load a command's dataclass.

    Args:
        name: a key of ``SUMMARIES``.

    Returns:
        The class: "follow" is ``jaxlangnav.commands.follow.Follow``.
    """
    module = importlib.import_module(f"jaxlangnav.commands.{name}")
    return getattr(module, name.capitalize())


def _read(kind: type[Any], options: Sequence[str], *, program: str) -> Any:
    """Let tyro fill the dataclass; fold what it complains of into one line."""
    import tyro

    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                kind,
                prog=program,
                description=inspect.cleandoc(kind.__doc__ or ""),
                args=list(options),
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.PositionalMetavarFromFieldName),
            )
    except SystemExit as end:
        if not end.code:
            raise
        message = _explain(complaint.getvalue(), kind, options)
        raise UsageError(f"{message} (see {program} --help)") from None


def _explain(complaint: str, kind: type[Any], options: Sequence[str]) -> str:
    """Say in one line why the options could not be read."""
    fields = {f"--{field.name.replace('_', '-')}": field for field in dataclasses.fields(kind)}
    for option in options:
        flag, is_assigned, _ = option.partition("=")
        if flag.startswith("--") and flag not in fields:
            return f'unknown option "{flag}"{did_you_mean(flag, ["--help", *fields])}'
        if is_assigned and flag in fields and fields[flag].type in (bool, "bool"):
            return f'{flag} takes no value, not "{option}"'
    title, message = _fold(complaint)
    if title.startswith("Unrecognized"):
        words = message.removeprefix("Unrecognized options:").strip()
        return f'unexpected "{words}"; a sentence of several words goes in quotes'
    if title.startswith(("Required", "Missing")):
        missing = re.sub(r"^Missing from .*?: ", "", message).replace("(required)", "").strip()
        return "missing " + re.sub(r"^([A-Z]+) ", r"\1: ", missing).rstrip(".")
    return message[:1].lower() + message[1:].rstrip(".")


def _fold(complaint: str) -> tuple[str, str]:
    """Take title and first paragraph out of tyro's box, drawn or in plain text."""
    lines = [line.strip(_FRAME) for line in complaint.splitlines()]
    title = next((line.strip("─- ") for line in lines if line.strip("─- ")), "bad arguments")
    paragraph: list[str] = []
    for line in lines[1:]:
        if _RULE.match(line):
            if paragraph:
                break
        elif line:
            paragraph.append(line)
    return title, " ".join(" ".join(paragraph).split())
