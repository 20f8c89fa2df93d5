"""Measure the house: lines by floor, records and traced operations inside one decision.

    python scripts/house.py           # everything
    python scripts/house.py --budget  # lines and files beside what pyproject.toml allows

Lines are those of Python files: all of them; of code, imports counted by themselves; and of
docstrings. Records are the classes of this package of which an instance is made while
``navigator.step`` is traced once. Operations are the equations of that trace, nested programs
included, and stand by the file that wrote them. Last come names that several modules define.
"""

import ast
import inspect
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
from types import FrameType
from typing import Any

import jax
import jax.numpy as jnp

import jaxlangnav
from jaxlangnav import navigator
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import Observation, default_sensor
from jaxlangnav.navigator import NavigatorConfig

PACKAGE = Path(jaxlangnav.__file__).parent
ROOT = Path(__file__).resolve().parent.parent
OTHER_PYTHON = ("scripts", "benchmarks", "notebooks", "examples")
WORD_LISTS = ("lexicon.toml", "nouns.toml", "words.toml", "not_errors.txt")
"""Data of the language that list words and give no rules."""
ENGINE = [
    "messages",
    "pytree",
    "numerics",
    "relations",
    "semantic_map",
    "planner",
    "navigator",
    "episode",
]
"""From messages to episode; ``grounding`` is read after lunch."""
NUM_DETECTIONS = 8
MOST_FILES = 20
"""Files that are listed, of those that write the most operations."""


KINDS = ("lines", "code", "imports", "docstrings")


def _span(node: ast.AST) -> range:
    """List the lines that a part of a file takes."""
    return range(getattr(node, "lineno", 0), getattr(node, "end_lineno", 0) + 1)


def lines_of(source: str) -> Counter[str]:
    """Count the lines of a file by ``KINDS``; what is left over is blank or a comment."""
    docstrings, imports = set[int](), set[int]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            docstrings.update(_span(node))
        elif isinstance(node, ast.Import | ast.ImportFrom):
            imports.update(_span(node))
    lines = source.splitlines()
    written = {n for n, line in enumerate(lines, 1) if line.strip() and line.strip()[0] != "#"}
    numbers = len(lines), len(written - docstrings - imports), len(imports), len(docstrings)
    return Counter(dict(zip(KINDS, numbers, strict=True)))


def lines_by_floor() -> dict[str, Counter[str]]:
    """Count the lines of every top-level module and package by ``KINDS``."""
    found: dict[str, Counter[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        floor = path.relative_to(PACKAGE).with_suffix("").parts[0]
        found.setdefault(floor, Counter()).update(lines_of(path.read_text("utf-8")))
    return found


def budget() -> dict[str, tuple[int, int]]:
    """Read what the repository may take, and measure what it takes, by name: lines or files."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["jaxlangnav"]
    package = sum(lines_by_floor().values(), Counter())
    data = [*PACKAGE.glob("language/data/*.toml"), *PACKAGE.glob("language/data/*.txt")]
    taken = {
        "package-lines": package["lines"],
        "package-code": package["code"],
        "package-files": len([*PACKAGE.rglob("*.py")]),
        "other-python": _lines(path for of in OTHER_PYTHON for path in (ROOT / of).rglob("*.py")),
        "tests": _lines((ROOT / "tests").rglob("*.py")),
        "language-rules": _lines(path for path in data if path.name not in WORD_LISTS),
    }
    return {name: (taken[name], most) for name, most in table["budget"].items()}


def _lines(paths: Iterable[Path]) -> int:
    return sum(len(path.read_text("utf-8").splitlines()) for path in paths)


def defined(source: str) -> set[str]:
    """List the public names that a module defines at its top."""
    found: set[str] = set()
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            parts = (one for target in targets for one in ast.walk(target))
            names = [one for one in parts if isinstance(one, ast.Name)]
            found |= {one.id for one in names if isinstance(one.ctx, ast.Store)}
    return {name for name in found if not name.startswith("_")}


def defined_twice() -> dict[str, list[str]]:
    """Find the names that several modules define, and which modules."""
    places: defaultdict[str, list[str]] = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for name in defined(path.read_text("utf-8")):
            places[name].append(str(path.relative_to(PACKAGE)))
    return {name: of for name, of in sorted(places.items()) if len(of) > 1}


def arguments() -> tuple[Any, ...]:
    """Make what ``navigator.step`` is traced with."""
    config = NavigatorConfig()
    instruction = understand("go to the hydrant behind the cone", load_shipped()).instruction
    area = jnp.array([0.0, 13.0, -9.0, 9.0])
    state = navigator.start(instruction, jnp.zeros(3), area, config=config)
    observation = Observation(
        pose=jnp.zeros(3),
        detection_type=jnp.zeros(NUM_DETECTIONS, jnp.int32),
        detection_range=jnp.ones(NUM_DETECTIONS),
        detection_bearing=jnp.zeros(NUM_DETECTIONS),
        is_detection=jnp.zeros(NUM_DETECTIONS, bool),
        sensor=default_sensor(),
    )
    return jax.random.key(0), state, observation


def written_in(equation: Any) -> str | None:
    """Tell which file of the package wrote an equation; None: none did."""
    trace = equation.source_info.traceback
    names = () if trace is None else (Path(frame.file_name) for frame in trace.frames)
    own = (name for name in names if name.is_relative_to(PACKAGE))
    return next((str(name.relative_to(PACKAGE)) for name in own), None)


def count_operations(jaxpr: Any, caller: str | None = None) -> Counter[str]:
    """Count the equations of a trace by file, those of nested programs included.

    What stands inside a function of JAX's own, which is traced once for all who call it, counts for
    the caller.
    """
    found: Counter[str] = Counter()
    for equation in jaxpr.eqns:
        file = caller or written_in(equation) or "JAX"
        found[file] += 1
        is_shared = equation.primitive.name in ("jit", "pjit", "custom_jvp_call")
        for value in equation.params.values():
            for one in value if isinstance(value, tuple | list) else (value,):
                one = getattr(one, "jaxpr", one)
                if hasattr(one, "eqns"):
                    found += count_operations(one, file if is_shared else caller)
    return found


def traced() -> tuple[Any, set[str]]:
    """Trace one decision; return it, and the records made on the way."""
    params, config, records = navigator.default_params(), NavigatorConfig(), set[str]()

    def note(frame: FrameType, event: str, _: Any) -> None:
        names = frame.f_locals
        if event != "call" or not (frame.f_code.co_name == "__init__" or "_cls" in names):
            return
        # A NamedTuple is made by a function of its class, everything else by ``__init__``.
        first = next(iter(names.values()), None)
        made = first if inspect.isclass(first) else type(first)
        if made.__module__.startswith("jaxlangnav."):
            records.add(f"{made.__module__.removeprefix('jaxlangnav.')}.{made.__name__}")

    def step(key: Any, state: Any, observation: Any) -> Any:
        return navigator.step(key, state, observation, params=params, config=config)

    given = arguments()
    sys.setprofile(note)
    try:
        jaxpr = jax.make_jaxpr(step)(*given)
    finally:
        sys.setprofile(None)
    return jaxpr, records


def main() -> None:
    """Print the measures."""
    if "--budget" in sys.argv:
        for name, (taken, most) in budget().items():
            print(f"{name:<16}{taken:>8} of {most}" + (" TOO MUCH" if taken > most else ""))
        return
    floors = lines_by_floor()
    print(*(f"{kind:>10}" for kind in KINDS))
    rows = sorted(floors.items(), key=lambda item: -item[1]["lines"])
    engine = sum((floors[floor] for floor in ENGINE), Counter())
    rows += [("package", sum(floors.values(), Counter())), (f"engine: {', '.join(ENGINE)}", engine)]
    for name, number in rows:
        print(*(f"{number[kind]:>10}" for kind in KINDS), name)
    jaxpr, records = traced()
    print(f"{len(records):6}  records inside one navigator.step: {', '.join(sorted(records))}")
    operations = count_operations(jaxpr.jaxpr)
    print(f"{operations.total():6}  traced operations of one navigator.step")
    for file, number in operations.most_common(MOST_FILES):
        print(f"{number:6}  {file}")
    shared = defined_twice()
    print(f"{len(shared):6}  names that several modules define: {', '.join(shared)}")


if __name__ == "__main__":
    main()
