"""The command line: ``jaxlangnav COMMAND ...`` (design: what people touch).

tyro reads the options from the command's dataclass and writes the help. Its error messages are
boxes of several lines; scripts and people get one line instead, with the nearest valid name.

Exit codes: 0 done; 1 a failure of ours; 2 bad input, said in one line; 130 interrupted.
Nothing heavy is imported before a command runs, so help and errors are instant.
"""

import contextlib
import dataclasses
import importlib
import inspect
import io
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Sequence
from typing import Any

from jaxlangnav import __version__
from jaxlangnav.cli import MODULES, SUMMARIES, output, settings
from jaxlangnav.cli.output import UsageError, did_you_mean
from jaxlangnav.inputs.sanitize import sanitize

PROGRAM = "jaxlangnav"
DEBUG = "JAXLANGNAV_DEBUG"
XLA_LOG_LEVEL = "TF_CPP_MIN_LOG_LEVEL"
"""Read by XLA as it is loaded. A slow compilation is to it an error: 3 leaves only fatal ones."""
_FRAME = " \t│╭╮╰╯"
_COMFORTABLE = 88  # columns that a paragraph takes at most: longer lines are hard to read
_RULE = re.compile(r"^[─-]{8,}")
_STORY = """\
usage: {program} COMMAND ... [--json] [--help]

You tell a robot "go to the hydrant behind the cone". It has never been here and sees neither.
jaxlangnav takes the sentence as a sensor: it believes many maps at once, weighs them by what the
robot sees and does not see, and goes where it is best on average, until it says stop.

commands:
{commands}

examples:
  {program} follow "go to the hydrant behind the cone"
  {program} follow "go to the hydrant nearest to the cone" --world 2H1C --range 5 --out pictures
  {program} ground "move behind the cone" --json
  {program} reproduce table2 --episodes 100

Each command explains itself: {program} follow --help
--json prints one document on standard output. Bad input ends with one line and exit code 2."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command, that of the process by default; return the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not os.environ.get(DEBUG):
        # That a compilation is slow is said in our words; what fails in it is raised all the same.
        os.environ.setdefault(XLA_LOG_LEVEL, "3")
    if isinstance(sys.stdout, io.TextIOWrapper):
        # What the terminal's alphabet lacks is written as an escape, as on standard error.
        sys.stdout.reconfigure(errors="backslashreplace")
    if not words or words[0] in ("-h", "--help", "help"):
        width = max(map(len, SUMMARIES))
        commands = "\n".join(f"  {name:<{width}}  {text}" for name, text in SUMMARIES.items())
        story = _STORY.format(program=PROGRAM, commands=commands)
        print(story, file=sys.stdout if words else sys.stderr)
        return 0 if words else 2
    if words[0] in ("-V", "--version"):
        print(f"{PROGRAM} {__version__}")
        return 0
    try:
        return _run(parse_arguments(words))
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    except KeyboardInterrupt:
        return _complain("interrupted", code=130)
    except BrokenPipeError:
        # The reader has gone (`| head`): say nothing, and keep Python from flushing into the void.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if os.environ.get(DEBUG) and not isinstance(error, UsageError):
            raise
        if output.is_refusal(error):
            return _complain(output.one_line(error), code=2)
        if fault := output.platform_fault(error):
            return _complain(fault, code=2)
        fault = f"internal error: {type(error).__name__}: {output.one_line(error)}"
        return _complain(f"{fault} ({DEBUG}=1 shows the traceback)", code=1)


def _run(command: Any) -> int:
    """Run a command; under ``--json`` print its document, and only that, on standard output."""
    # Stray prints go to standard error where a script reads the document.
    with contextlib.redirect_stdout(sys.stderr if command.json else sys.stdout):
        document = command.run(output.Output(is_json=command.json))
    if command.json:
        output.write_document(document)
    sys.stdout.flush()
    return 0


def _complain(message: str, *, code: int) -> int:
    print(f"{PROGRAM}: {sanitize(message)}", file=sys.stderr)
    return code


def parse_arguments(arguments: Sequence[str]) -> Any:
    """Read a command and its options; ``UsageError`` for bad ones, ``SystemExit`` after help."""
    name, *options = arguments
    if name.startswith("-"):
        raise UsageError(f'expected a command before "{name}" (see {PROGRAM} --help)')
    if name not in SUMMARIES:
        hint = did_you_mean(name, SUMMARIES) or f"; choose from {', '.join(SUMMARIES)}"
        raise UsageError(f'unknown command "{name}"{hint}')
    module = importlib.import_module(f"jaxlangnav.cli.{MODULES.get(name, name)}")
    kind, program = getattr(module, name.capitalize()), f"{PROGRAM} {name}"
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
