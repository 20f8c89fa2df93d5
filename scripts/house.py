"""Measure the package: lines by floor, records and traced operations of one decision.

    python scripts/house.py           # everything
    python scripts/house.py --budget  # lines and files beside what pyproject.toml allows
    python scripts/house.py --picture # docs/house.svg: the floors and their lines of code

Lines are those of Python files: all of them; of code, imports counted by themselves; and of
docstrings. Operations are the equations of one traced ``navigator.step``, nested programs included,
and stand by the file that wrote them. Last come names that several modules define.
"""

import ast
import functools
import importlib
import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable
from pathlib import Path
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
"""The engine, from messages to episode, without ``grounding``."""
NUM_DETECTIONS = 8
NUM_FILES_LISTED = 20
"""Number of files listed, by most operations."""


KINDS = ("lines", "code", "imports", "docstrings")


def _span(node: ast.AST) -> range:
    """Return the line numbers of a syntax node."""
    return range(getattr(node, "lineno", 0), getattr(node, "end_lineno", 0) + 1)


def lines_of(source: str) -> Counter[str]:
    """Count the lines of a file by ``KINDS``; the remaining lines are blank or comments."""
    docstrings, imports = set[int](), set[int]()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            docstrings.update(_span(node))
        elif isinstance(node, ast.Import | ast.ImportFrom):
            imports.update(_span(node))
    lines = source.splitlines()
    nonblank = {n for n, line in enumerate(lines, 1) if line.strip() and line.strip()[0] != "#"}
    totals = len(lines), len(nonblank - docstrings - imports), len(imports), len(docstrings)
    return Counter(dict(zip(KINDS, totals, strict=True)))


def lines_by_floor() -> dict[str, Counter[str]]:
    """Count the lines of every top-level module and package by ``KINDS``."""
    counts: dict[str, Counter[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        floor = path.relative_to(PACKAGE).with_suffix("").parts[0]
        counts.setdefault(floor, Counter()).update(lines_of(path.read_text("utf-8")))
    return counts


def budget() -> dict[str, tuple[int, int]]:
    """Measure lines and files, by name, beside the limits of pyproject.toml."""
    table = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["jaxlangnav"]
    package = sum(lines_by_floor().values(), Counter())
    data = [*PACKAGE.glob("language/data/*.toml"), *PACKAGE.glob("language/data/*.txt")]
    counts = {
        "package-lines": package["lines"],
        "package-code": package["code"],
        "package-files": len([*PACKAGE.rglob("*.py")]),
        "other-python": _lines(path for of in OTHER_PYTHON for path in (ROOT / of).rglob("*.py")),
        "tests": _lines((ROOT / "tests").rglob("*.py")),
        "language-rules": _lines(path for path in data if path.name not in WORD_LISTS),
    }
    return {name: (counts[name], limit) for name, limit in table["budget"].items()}


def _lines(paths: Iterable[Path]) -> int:
    return sum(len(path.read_text("utf-8").splitlines()) for path in paths)


def defined(source: str) -> set[str]:
    """List the public names that a module defines at its top level."""
    names: set[str] = set()
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            nodes = (child for target in targets for child in ast.walk(target))
            assigned = [child for child in nodes if isinstance(child, ast.Name)]
            names |= {child.id for child in assigned if isinstance(child.ctx, ast.Store)}
    return {name for name in names if not name.startswith("_")}


def defined_twice() -> dict[str, list[str]]:
    """Find the names defined by several modules, with these modules."""
    modules: defaultdict[str, list[str]] = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        for name in defined(path.read_text("utf-8")):
            modules[name].append(str(path.relative_to(PACKAGE)))
    return {name: of for name, of in sorted(modules.items()) if len(of) > 1}


def arguments() -> tuple[Any, ...]:
    """Build the arguments with which ``navigator.step`` is traced."""
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
    """Find the file of the package that wrote an equation, or None."""
    trace = equation.source_info.traceback
    names = () if trace is None else (Path(frame.file_name) for frame in trace.frames)
    ours = (name for name in names if name.is_relative_to(PACKAGE))
    return next((str(name.relative_to(PACKAGE)) for name in ours), None)


def count_operations(jaxpr: Any, caller: str | None = None) -> Counter[str]:
    """Count the equations of a trace by file, those of nested programs included.

    What stands inside a function of JAX's own, which is traced once for all who call it, counts for
    the caller.
    """
    counts: Counter[str] = Counter()
    for equation in jaxpr.eqns:
        file = caller or written_in(equation) or "JAX"
        counts[file] += 1
        is_shared = equation.primitive.name in ("jit", "pjit", "custom_jvp_call")
        for value in equation.params.values():
            for item in value if isinstance(value, tuple | list) else (value,):
                item = getattr(item, "jaxpr", item)
                if hasattr(item, "eqns"):
                    counts += count_operations(item, file if is_shared else caller)
    return counts


def traced() -> Any:
    """Trace one decision."""
    params, config = navigator.default_params(), NavigatorConfig()
    return jax.make_jaxpr(functools.partial(navigator.step, params=params, config=config))(
        *arguments()
    )


def draw(path: Path) -> None:
    """Draw the floors layer by layer, the lowest first, with widths by lines of code."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    sys.path.insert(0, str(ROOT / "tests"))
    layers = importlib.import_module("test_layers").LAYERS

    num_layers, floors = len(layers), lines_by_floor()
    figure = Figure(figsize=(8.0, 0.4 * num_layers))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(-0.1, 11.0), ylim=(-0.2, num_layers))
    axes.axis("off")
    for row, layer in enumerate(layers):
        left = 0.0
        for floor in layer:
            code = floors[floor if floor in floors else f"{floor}.py"]["code"]
            name = f"{floor} {code:,}"
            width = max(code / 400.0, 0.19 * len(name))
            axes.barh(row + 0.4, width, 0.8, left, color="#dfe3e8")
            axes.text(left + 0.1, row + 0.4, name, va="center", fontsize=9)
            left += width + 0.1
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": path.name}):
        figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Print the measurements."""
    if "--picture" in sys.argv:
        return draw(ROOT / "docs" / "house.svg")
    if "--budget" in sys.argv:
        for name, (count, limit) in budget().items():
            print(f"{name:<16}{count:>8} of {limit}" + (" TOO MUCH" if count > limit else ""))
        return
    floors = lines_by_floor()
    print(*(f"{kind:>10}" for kind in KINDS))
    rows = sorted(floors.items(), key=lambda item: -item[1]["lines"])
    engine = sum((floors[floor] for floor in ENGINE), Counter())
    rows += [("package", sum(floors.values(), Counter())), (f"engine: {', '.join(ENGINE)}", engine)]
    for name, total in rows:
        print(*(f"{total[kind]:>10}" for kind in KINDS), name)
    operations = count_operations(traced().jaxpr)
    print(f"{operations.total():6}  traced operations of one navigator.step")
    for file, total in operations.most_common(NUM_FILES_LISTED):
        print(f"{total:6}  {file}")
    shared = defined_twice()
    print(f"{len(shared):6}  names that several modules define: {', '.join(shared)}")


if __name__ == "__main__":
    main()
