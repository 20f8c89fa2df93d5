"""Regenerate stale outputs in notebooks, README and docs: ``make frozen``.

    python scripts/frozen.py            # everything that is old
    python scripts/frozen.py --check    # only say what is old; exit code 1 if anything is
    python scripts/frozen.py --results results COMMIT   # the results page too, from such a folder

Frozen are: blocks of README and docs that begin with ``$ jaxlangnav ...`` (what follows is what the
command prints on a terminal of a hundred columns), the picture of the demo, the README's short
Table 2 (it follows from the results page), the notebooks, and the results page with its pictures,
which follows from ``jaxlangnav reproduce all`` and takes an hour. How old they are stands in
``ages.json``; texts are compared with what is printed now.
"""

import argparse
import contextlib
import io
import os
import re
import shlex
import shutil
import sys
import tempfile
import textwrap
from decimal import ROUND_HALF_UP, Decimal
from pathlib import Path
from unittest import mock

import ages

ROOT = ages.ROOT
README, RESULTS = ROOT / "README.md", ROOT / "docs" / "results.md"
PICTURE = ROOT / "docs" / "follow.gif"
COLUMNS = 100
COMMAND_BLOCK = re.compile(r"(?ms)^```\n\$ (jaxlangnav [^\n]*)\n(.*?)^```$")
_ESCAPES = re.compile(r"\x1b\[[0-9;]*m")
_POLICIES = ("faithful", "informed")
_HEAD = "| world | range | relation | `faithful` | `informed` | paper | known map (paper) |"
_SHORT_TABLE = re.compile(rf"(?m)^{re.escape(_HEAD)}\n(?:\|.*\n)+")


class _Terminal(io.StringIO):
    """A text stream that claims to be a terminal."""

    def isatty(self) -> bool:
        return True


def pages() -> list[Path]:
    """List the pages that may contain command output."""
    return [README, *sorted((ROOT / "docs").rglob("*.md"))]


def shown(page: Path) -> list[tuple[str, str]]:
    """List the commands of a page with the output that it shows."""
    return COMMAND_BLOCK.findall(page.read_text("utf-8"))


def printed(command: str, folder: Path) -> str:
    """Run a command in a folder and capture its output on a terminal of a hundred columns.

    Args:
        command: such as ``jaxlangnav parse "go to the cone"``.
        folder: where it may write.

    Returns:
        Lines, standard output if it succeeds and the refusal if not.
    """
    from jaxlangnav.cli import main as cli

    out, err = _Terminal(), io.StringIO()
    with (
        contextlib.chdir(folder),
        mock.patch.dict(os.environ, COLUMNS=str(COLUMNS), NO_COLOR="1"),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        code = cli.main(shlex.split(command)[1:])
    text = _ESCAPES.sub("", (err if code else out).getvalue())
    return "".join(f"{_fold(line)}\n" for line in text.rstrip().splitlines())


def _fold(line: str) -> str:
    """Wrap a line that is wider than the terminal."""
    return line.rstrip() if len(line) <= COLUMNS else textwrap.fill(line, COLUMNS)


def short_table(results: str) -> str:
    """Build the README's Table 2 (Markdown) from the results page."""
    table: dict[tuple[str, ...], dict[str, list[str]]] = {}
    section = results.partition("## Table 2\n")[2].partition("\n## ")[0]
    for line in re.findall(r"(?m)^\| (\d.*) \|$", section):
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) > 9:
            table.setdefault(tuple(cells[:3]), {})[cells[3]] = [c.split(" (")[0] for c in cells]
    lines = [_HEAD, "|---" * 7 + "|"]
    for (world, sensing_range, relation), rows in table.items():
        ours = [f"{rows[name][4]} % · {_tenths(rows[name][6])} m" for name in _POLICIES]
        row = rows["faithful"]
        paper = [f"{row[5]} % · {row[7]} m", f"{row[8]} ({row[9]}) m"]
        lines.append(f"| {' | '.join([world, f'{sensing_range} m', relation, *ours, *paper])} |")
    return "\n".join(lines) + "\n"


def _tenths(number: str) -> Decimal:
    """Round half up to one decimal."""
    return Decimal(number).quantize(Decimal("0.1"), ROUND_HALF_UP)


def remake_page(page: Path, folder: Path) -> str:
    """Regenerate a page's text, running its commands in a folder."""

    def rerun(block: re.Match[str]) -> str:
        return f"```\n$ {block[1]}\n{printed(block[1], folder)}```"

    text = COMMAND_BLOCK.sub(rerun, page.read_text("utf-8"))
    if page == README:
        table = short_table(RESULTS.read_text("utf-8"))
        text = _SHORT_TABLE.sub(lambda _: table, text)
    return text


def old_pages(folder: Path) -> dict[Path, str]:
    """Regenerate all pages; returns those whose text has changed."""
    new_texts = {page: remake_page(page, folder) for page in pages()}
    return {page: text for page, text in new_texts.items() if text != page.read_text("utf-8")}


def remake(texts: dict[Path, str], picture: Path) -> None:
    """Write the changed pages, and the demo's picture, which a page's command has drawn."""
    for page, text in texts.items():
        page.write_text(text, "utf-8")
    if not ages.is_current(PICTURE):
        shutil.copy(picture, PICTURE)
        ages.record(PICTURE)


def main() -> int:
    """Regenerate, or list, the stale files."""
    parser = argparse.ArgumentParser(description="Make anew what is frozen and old.")
    parser.add_argument("--check", action="store_true", help="only say what is old")
    parser.add_argument("--results", nargs=2, metavar=("DIR", "COMMIT"), help="of reproduce all")
    arguments = parser.parse_args()
    import results_page

    import notebooks

    if arguments.results:
        results_page.write(Path(arguments.results[0]), arguments.results[1])
    books = [path for path in notebooks.sources() if not notebooks.is_current(path)]
    with tempfile.TemporaryDirectory() as name:
        texts = old_pages(Path(name))
        old = [*texts, *(path for path in (PICTURE, RESULTS) if not ages.is_current(path))]
        for path in dict.fromkeys([*old, *books]):
            print(f"old: {path.relative_to(ROOT)}", flush=True)
        if arguments.check:
            return int(bool(old or books))
        remake(texts, Path(name) / "demo" / "episode.gif")
    for path in books:
        if why := notebooks.lacking(path):
            print(f"left as it is: {path.relative_to(ROOT)}: {why}")
            continue
        print(f"made: {notebooks.build(path).relative_to(ROOT)}", flush=True)
    if not ages.is_current(RESULTS):
        print("then: jaxlangnav reproduce all --out results, and --results results COMMIT")
    return 0


if __name__ == "__main__":
    sys.exit(main())
