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
import shutil
import textwrap
from collections.abc import Sequence
from typing import Any

from jaxlangnav.cli import MODULES, SUMMARIES, settings
from jaxlangnav.cli.output import UsageError, did_you_mean

PROGRAM = "jaxlangnav"
_FRAME = " \t│╭╮╰╯"
_COMFORTABLE = 88  # columns that a paragraph takes at most: longer lines are hard to read
_RULE = re.compile(r"^[─-]{8,}")


def parse_arguments(arguments: Sequence[str]) -> Any:
    """Read a command and its options; ``UsageError`` for bad ones, ``SystemExit`` after help."""
    name, *options = arguments
    if name.startswith("-"):
        raise UsageError(f'expected a command before "{name}" (see {PROGRAM} --help)')
    if name not in SUMMARIES:
        hint = did_you_mean(name, SUMMARIES) or f"; choose from {', '.join(SUMMARIES)}"
        raise UsageError(f'unknown command "{name}"{hint}')
    kind, program = _command_class(name), f"{PROGRAM} {name}"
    import tyro

    groups: tuple[str, ...] = getattr(kind, "SETTINGS", ())
    if groups and any(settings.is_setting(word) for word in options):
        kind = settings.with_settings(kind)
        options = ["--help" if word == settings.HELP_ALL else word for word in options]
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                kind,
                prog=program,
                description=_lay_out_help(kind),
                args=list(options),
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.PositionalMetavarFromFieldName),
            )
    except SystemExit as end:
        if not end.code:
            raise
        message = _explain(complaint.getvalue(), kind, options)
        raise UsageError(f"{message} (see {program} --help)") from None


def _command_class(name: str) -> type[Any]:
    module = importlib.import_module(f"jaxlangnav.cli.{MODULES.get(name, name)}")
    return getattr(module, name.capitalize())


def _lay_out_help(kind: type[Any]) -> str:
    """Lay out a command's docstring for its help, as wide as the terminal but for comfort."""
    width = min(shutil.get_terminal_size().columns, _COMFORTABLE)
    first, *others = inspect.cleandoc(kind.__doc__ or "").split("\n\n")
    laid = [first]
    for paragraph in others:
        is_list = "\n  " in paragraph
        filled = textwrap.fill(" ".join(paragraph.split()), width, subsequent_indent="  ")
        laid.append(paragraph if is_list else filled)
    return "\n\n".join(laid)


def _explain(complaint: str, kind: type[Any], options: Sequence[str]) -> str:
    """Say in one line why the options could not be read."""
    import tyro

    unnamed = {tyro.conf.Positional, tyro.conf.Suppress}
    fields = {
        f"--{field.name.replace('_', '-')}": field
        for field in dataclasses.fields(kind)
        if unnamed.isdisjoint(one for one in getattr(field.type, "__metadata__", ()))
    }
    groups: tuple[str, ...] = getattr(kind, "SETTINGS", ())
    for option in options:
        flag, is_assigned, _ = option.partition("=")
        if groups and settings.is_setting(flag):
            if flag not in (one.flag for one in settings.options(groups)):
                return f'unknown option "{flag}"{settings.suggestion(flag, groups, fields)}'
        elif flag.startswith("--") and flag not in fields:
            known = ["--help", *fields, *([settings.HELP_ALL] if groups else [])]
            return f'unknown option "{flag}"{did_you_mean(flag, known)}'
        if is_assigned and flag in fields and fields[flag].type in (bool, "bool"):
            return f'{flag} takes no value, not "{option}"'
    return _say(*_fold(complaint))


def _say(title: str, message: str) -> str:
    """Say a complaint of tyro's in the words of the other refusals."""
    if title.startswith("Unrecognized"):
        words = message.removeprefix("Unrecognized options:").strip()
        return f'unexpected "{words}"; a sentence of several words goes in quotes'
    if title.startswith("Required"):
        message = re.sub(r"^Missing from .*?: ", "", message)
        parts = [part.strip(" .") for part in message.split("(required)") if part.strip(" .")]
        return "missing " + "; ".join(
            re.sub(r"^(--\S+ \S+|[A-Z]+) ", r"\1: ", part) for part in parts
        )
    if found := re.match(r"Missing value for argument '(\S+)'", message):
        return f"{found[1]} needs a value"
    if found := re.match(r"[Ii]nvalid choice '(.*)' for argument '(\S+)'.*?\((.*)\)", message):
        choices = re.findall(r"'([^']*)'", found[3])
        hint = did_you_mean(found[1], choices)
        return f'{found[2]} is "{found[1]}", but must be one of {", ".join(choices)}{hint}'
    if found := re.match(r"Error parsing (\S+): .*(int\(\)|to float).*?: '(.*)'$", message):
        kind = "a whole number" if found[2] == "int()" else "a number"
        return f'{found[1]} is "{found[3]}", but must be {kind}'
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
