"""Entry point of the command line, ``jaxlangnav COMMAND ...``: dispatch and error reporting.

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
from jaxlangnav.cli.output import UsageError
from jaxlangnav.inputs.sanitize import did_you_mean, sanitize

PROGRAM = "jaxlangnav"
DEBUG = "JAXLANGNAV_DEBUG"
XLA_LOG_LEVEL = "TF_CPP_MIN_LOG_LEVEL"
"""Environment variable read by XLA: level 3 hides all but fatal messages."""
_BOX_CHARS = " \t│╭╮╰╯"
_MAX_WIDTH = 88  # columns of a help paragraph
_BOX_RULE = re.compile(r"^[─-]{8,}")
_USAGE = """\
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
        # Hide XLA's warnings of slow compilation; failures are raised all the same.
        os.environ.setdefault(XLA_LOG_LEVEL, "3")
    if isinstance(sys.stdout, io.TextIOWrapper):
        # Characters that the terminal cannot encode are escaped, as on standard error.
        sys.stdout.reconfigure(errors="backslashreplace")
    if not words or words[0] in ("-h", "--help", "help"):
        width = max(map(len, SUMMARIES))
        commands = "\n".join(f"  {name:<{width}}  {text}" for name, text in SUMMARIES.items())
        usage = _USAGE.format(program=PROGRAM, commands=commands)
        print(usage, file=sys.stdout if words else sys.stderr)
        return 0 if words else 2
    if words[0] in ("-V", "--version"):
        print(f"{PROGRAM} {__version__}")
        return 0
    try:
        return _run(parse_arguments(words))
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 0
    except KeyboardInterrupt:
        return _print_error("interrupted", code=130)
    except BrokenPipeError:
        # The reader has gone (`| head`): say nothing, and keep Python from flushing into the void.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except Exception as error:
        if os.environ.get(DEBUG) and not isinstance(error, UsageError):
            raise
        if output.is_user_error(error):
            return _print_error(output.one_line(error), code=2)
        if fault := output.platform_fault(error):
            return _print_error(fault, code=2)
        fault = f"internal error: {type(error).__name__}: {output.one_line(error)}"
        return _print_error(f"{fault} ({DEBUG}=1 shows the traceback)", code=1)


def _run(command: Any) -> int:
    """Run a command; with ``--json`` print only its document on standard output."""
    # Stray prints go to standard error where a script reads the document.
    with contextlib.redirect_stdout(sys.stderr if command.json else sys.stdout):
        document = command.run(output.Output(is_json=command.json))
    if command.json:
        output.write_document(document)
    sys.stdout.flush()
    return 0


def _print_error(message: str, *, code: int) -> int:
    print(f"{PROGRAM}: {sanitize(message)}", file=sys.stderr)
    return code


def parse_arguments(arguments: Sequence[str]) -> Any:
    """Parse a command and its options; ``UsageError`` for bad ones, ``SystemExit`` after help."""
    name, *options = arguments
    if name.startswith("-"):
        raise UsageError(f'expected a command before "{name}" (see {PROGRAM} --help)')
    if name not in SUMMARIES:
        hint = did_you_mean(name, SUMMARIES) or f"; choose from {', '.join(SUMMARIES)}"
        raise UsageError(f'unknown command "{name}"{hint}')
    module = importlib.import_module(f"jaxlangnav.cli.{MODULES.get(name, name)}")
    command_class, program = getattr(module, name.capitalize()), f"{PROGRAM} {name}"
    import tyro

    groups: tuple[str, ...] = getattr(command_class, "SETTINGS", ())
    if groups and any(settings.is_option(word) for word in options):
        command_class = settings.with_options(command_class)
        options = ["--help" if word == settings.HELP_ALL else word for word in options]
    stderr = io.StringIO()
    try:
        with contextlib.redirect_stderr(stderr):
            return tyro.cli(
                command_class,
                prog=program,
                description=_format_help(command_class),
                args=list(options),
                config=(tyro.conf.FlagCreatePairsOff, tyro.conf.PositionalMetavarFromFieldName),
            )
    except SystemExit as end:
        if not end.code:
            raise
        message = _explain_error(stderr.getvalue(), command_class, options)
        raise UsageError(f"{message} (see {program} --help)") from None


def _format_help(command_class: type[Any]) -> str:
    """Wrap a command's docstring to the terminal width for its help text."""
    width = min(shutil.get_terminal_size().columns, _MAX_WIDTH)
    first, *rest = inspect.cleandoc(command_class.__doc__ or "").split("\n\n")
    paragraphs = [first]
    for paragraph in rest:
        filled = textwrap.fill(" ".join(paragraph.split()), width, subsequent_indent="  ")
        paragraphs.append(paragraph if "\n  " in paragraph else filled)
    return "\n\n".join(paragraphs)


def _explain_error(stderr: str, command_class: type[Any], options: Sequence[str]) -> str:
    """Explain in one line why tyro could not parse the options."""
    import tyro

    markers = {tyro.conf.Positional, tyro.conf.Suppress}
    fields = {
        f"--{field.name.replace('_', '-')}": field
        for field in dataclasses.fields(command_class)
        if markers.isdisjoint(marker for marker in getattr(field.type, "__metadata__", ()))
    }
    groups: tuple[str, ...] = getattr(command_class, "SETTINGS", ())
    for option in options:
        flag, is_assigned, _ = option.partition("=")
        if groups and settings.is_option(flag):
            if flag not in (setting.flag for setting in settings.options(groups)):
                return f'unknown option "{flag}"{settings.suggestion(flag, groups, fields)}'
        elif flag.startswith("--") and flag not in fields:
            names = ["--help", *fields, *([settings.HELP_ALL] if groups else [])]
            return f'unknown option "{flag}"{did_you_mean(flag, names)}'
        if is_assigned and flag in fields and fields[flag].type in (bool, "bool"):
            return f'{flag} takes no value, not "{option}"'
    return _rephrase(*_parse_box(stderr))


def _rephrase(title: str, message: str) -> str:
    """Rephrase an error message of tyro in the style of the other errors."""
    if title.startswith("Unrecognized"):
        words = message.removeprefix("Unrecognized options:").strip()
        return f'unexpected "{words}"; a sentence of several words goes in quotes'
    if title.startswith("Required"):
        message = re.sub(r"^Missing from .*?: ", "", message)
        parts = [part.strip(" .") for part in message.split("(required)") if part.strip(" .")]
        return "missing " + "; ".join(
            re.sub(r"^(--\S+ \S+|[A-Z]+) ", r"\1: ", part) for part in parts
        )
    if match := re.match(r"Missing value for argument '(\S+)'", message):
        return f"{match[1]} needs a value"
    if match := re.match(r"[Ii]nvalid choice '(.*)' for argument '(\S+)'.*?\((.*)\)", message):
        choices = re.findall(r"'([^']*)'", match[3])
        hint = did_you_mean(match[1], choices)
        return f'{match[2]} is "{match[1]}", but must be one of {", ".join(choices)}{hint}'
    if match := re.match(r"Error parsing (\S+): .*(int\(\)|to float).*?: '(.*)'$", message):
        expected = "a whole number" if match[2] == "int()" else "a number"
        return f'{match[1]} is "{match[3]}", but must be {expected}'
    return message[:1].lower() + message[1:].rstrip(".")


def _parse_box(box: str) -> tuple[str, str]:
    """Extract the title and the first paragraph from tyro's error box."""
    lines = [line.strip(_BOX_CHARS) for line in box.splitlines()]
    title = next((line.strip("─- ") for line in lines if line.strip("─- ")), "bad arguments")
    paragraph: list[str] = []
    for line in lines[1:]:
        if _BOX_RULE.match(line):
            if paragraph:
                break
        elif line:
            paragraph.append(line)
    return title, " ".join(" ".join(paragraph).split())
