"""Mutation testing: check that the quick tests fail for each of a list of code changes.

    python scripts/mutants.py                 all of ``mutants.toml``
    python scripts/mutants.py --only claim    those whose name has "claim" in it

Each mutant changes one expression in a copy of the working tree, runs the quick tests that are
named with it there, and lives where they pass. A mutant whose expression is no longer in the file
is an error: the list is kept true by being run.
"""

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]


class Mutant(NamedTuple):
    """A mutation of one expression."""

    name: str
    file: str  # in the package
    before: str
    after: str
    tests: list[str]  # files in ``tests/`` that are to fail, without "test_" and ".py"


def read_mutants(path: Path, only: str) -> list[Mutant]:
    """Read the list, and check that every expression is still in its file.

    Raises:
        ValueError: an expression is not in its file exactly once.
    """
    mutants = [Mutant(**entry) for entry in tomllib.loads(path.read_text())["mutant"]]
    for entry in mutants:
        count = (ROOT / "jaxlangnav" / entry.file).read_text().count(entry.before)
        if count != 1:
            raise ValueError(
                f"{entry.name}: its expression is {count} times in {entry.file}, but must be once: "
                f"mend it in {path.name}"
            )
    return [entry for entry in mutants if only in entry.name]


def copy_tree(folder: Path) -> None:
    """Copy the tracked files of the working tree, and share the compilation cache."""
    output = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    for name in filter(None, output.stdout.split("\0")):
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, target)
    cache = ROOT / ".pytest_cache" / "jax"
    cache.mkdir(parents=True, exist_ok=True)
    (folder / ".pytest_cache").mkdir()
    (folder / ".pytest_cache" / "jax").symlink_to(cache.resolve())


def is_killed(mutant: Mutant, tree: Path) -> bool:
    """Run the tests of a mutant in a tree; whether one of them fails.

    Raises:
        ValueError: the tests cannot be run.
    """
    path = tree / "jaxlangnav" / mutant.file
    original = path.read_text()
    path.write_text(original.replace(mutant.before, mutant.after))
    tests = [f"tests/test_{name}.py" for name in mutant.tests]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", *tests]
    try:
        result = subprocess.run(command, cwd=tree, capture_output=True, text=True)
    finally:
        path.write_text(original)
    # 0: all passed; 1: one failed; anything else: they did not run.
    if result.returncode not in (0, 1):
        raise ValueError(f"{mutant.name}: the tests did not run:\n{result.stdout[-2000:]}")
    return result.returncode == 1


def main() -> int:
    """Run the mutants and print which survive."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", default="", help="run those whose name has this in it")
    mutants = read_mutants(Path(__file__).with_suffix(".toml"), parser.parse_args().only)
    survivors = []
    with tempfile.TemporaryDirectory() as folder:
        copy_tree(Path(folder))
        for case in mutants:
            begin = time.perf_counter()
            died = is_killed(case, Path(folder))
            survivors += [] if died else [case.name]
            seconds = time.perf_counter() - begin
            print(f"{'killed' if died else 'LIVES '}  {case.name:48} {seconds:4.0f} s", flush=True)
    print(f"{len(mutants) - len(survivors)} of {len(mutants)} killed")
    return 1 if survivors else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except ValueError as error:
        sys.exit(f"error: {error}")
