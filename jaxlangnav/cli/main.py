"""The command line: ``jaxlangnav COMMAND ...`` (design: what people touch).

Exit codes: 0 done; 1 a failure of ours; 2 bad input, said in one line; 130 interrupted.
Nothing heavy is imported before a command runs, so help and errors are instant.
"""

import contextlib
import io
import os
import sys
from collections.abc import Sequence
from typing import Any

from jaxlangnav import __version__
from jaxlangnav.cli import SUMMARIES, output
from jaxlangnav.cli.arguments import PROGRAM, parse_arguments
from jaxlangnav.inputs.sanitize import printable

DEBUG = "JAXLANGNAV_DEBUG"
XLA_LOG_LEVEL = "TF_CPP_MIN_LOG_LEVEL"
"""Read by XLA as it is loaded. A slow compilation is to it an error: 3 leaves only fatal ones."""
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
        if os.environ.get(DEBUG) and not isinstance(error, output.UsageError):
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
    print(f"{PROGRAM}: {printable(message)}", file=sys.stderr)
    return code
