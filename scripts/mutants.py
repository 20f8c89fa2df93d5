"""Do the quick tests notice a wrong engine? Wrong it, one place at a time, and see.

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
    """One wrong expression."""

    name: str
    file: str  # in the package
    before: str
    after: str
    tests: list[str]  # files in ``tests/`` that are to fail, without "test_" and ".py"


def read_mutants(path: Path, only: str) -> list[Mutant]:
    """Read the list, refusing what is no longer in the files.

    Raises:
        ValueError: an expression is not in its file exactly once.
    """
    mutants = [Mutant(**one) for one in tomllib.loads(path.read_text())["mutant"]]
    for one in mutants:
        found = (ROOT / "jaxlangnav" / one.file).read_text().count(one.before)
        if found != 1:
            raise ValueError(
                f"{one.name}: its expression is {found} times in {one.file}, but must be once: "
                f"mend it in {path.name}"
            )
    return [one for one in mutants if only in one.name]


def copy_tree(to: Path) -> None:
    """Copy what git tracks of the working tree, and share the cache of compiled programs."""
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True
    )
    for name in filter(None, listed.stdout.split("\0")):
        target = to / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, target)
    cache = ROOT / ".pytest_cache" / "jax"
    cache.mkdir(parents=True, exist_ok=True)
    (to / ".pytest_cache").mkdir()
    (to / ".pytest_cache" / "jax").symlink_to(cache.resolve())


def is_killed(mutant: Mutant, tree: Path) -> bool:
    """Run the tests of a mutant in a tree; whether one of them fails.

    Raises:
        ValueError: the tests cannot be run.
    """
    path = tree / "jaxlangnav" / mutant.file
    sound = path.read_text()
    path.write_text(sound.replace(mutant.before, mutant.after))
    tests = [f"tests/test_{name}.py" for name in mutant.tests]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", *tests]
    try:
        done = subprocess.run(command, cwd=tree, capture_output=True, text=True)
    finally:
        path.write_text(sound)
    # 0: all passed; 1: one failed; anything else: they did not run.
    if done.returncode not in (0, 1):
        raise ValueError(f"{mutant.name}: the tests did not run:\n{done.stdout[-2000:]}")
    return done.returncode == 1


def main() -> int:
    """Run the mutants and print which live."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", default="", help="run those whose name has this in it")
    mutants = read_mutants(Path(__file__).with_suffix(".toml"), parser.parse_args().only)
    living = []
    with tempfile.TemporaryDirectory() as folder:
        copy_tree(Path(folder))
        for one in mutants:
            begin = time.perf_counter()
            died = is_killed(one, Path(folder))
            living += [] if died else [one.name]
            seconds = time.perf_counter() - begin
            print(f"{'killed' if died else 'LIVES ':6}  {one.name:48} {seconds:4.0f} s", flush=True)
    print(f"{len(mutants) - len(living)} of {len(mutants)} killed")
    return 1 if living else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except ValueError as error:
        sys.exit(f"error: {error}")
