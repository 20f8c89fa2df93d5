"""The structure: layers, names, signatures, and how much there may be of everything.

Imports run downhill: each layer of the package imports only itself and the layers before it. The
belief and the ground truth do not import each other at all, so that what the robot believes cannot
peek at what is true. In public functions ``params`` and ``config`` are keyword-only, unless they
stand first as what the function is about: ``check(params)``.
"""

import ast
import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import house
import pytest

import jaxlangnav

LAYERS = (
    ("pytree", "numerics"),
    ("inputs",),
    ("messages",),
    ("terrain", "relations"),
    ("language",),
    ("grounding",),
    ("training", "semantic_map"),
    ("planner", "dialogue"),
    ("navigator", "world"),
    ("episode",),
    ("experiments",),
    ("task", "viz"),
    ("environments", "robots", "serve"),
    ("cli",),
    ("__main__",),
)
"""Lowest first; what stands beside each other in a layer does not import each other either.
``jaxlangnav/__init__.py`` is the facade: it names things from everywhere."""

LEVEL = {floor: level for level, floors in enumerate(LAYERS) for floor in floors}
BELIEF = ("grounding", "training", "semantic_map", "planner", "dialogue", "navigator")
TRUTH = "world"
PACKAGE = Path(__file__).parent.parent / "jaxlangnav"


def imported_layers(source: str) -> Iterator[tuple[int, str]]:
    """Yield line number and layer of every import from jaxlangnav, nested and guarded ones too."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level:
            names = ["jaxlangnav.<relative import>"]
        elif isinstance(node, ast.ImportFrom) and node.module == "jaxlangnav":
            names = [f"jaxlangnav.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        else:
            continue
        for name in names:
            parts = name.split(".")
            if parts[0] == "jaxlangnav" and len(parts) > 1:
                yield node.lineno, parts[1]


def violations(layer: str, source: str) -> list[str]:
    found = []
    for line, target in imported_layers(source):
        if target.startswith("__version"):
            continue
        if target not in LEVEL:
            found.append(f"line {line}: {target} is no layer (import from the module itself)")
        elif target != layer and LEVEL[target] >= LEVEL[layer]:
            found.append(f"line {line}: {layer} imports {target}, which does not stand below it")
        elif (layer == TRUTH and target in BELIEF) or (layer in BELIEF and target == TRUTH):
            found.append(f"line {line}: {layer} imports {target}: belief and truth stay apart")
    return found


MODULES = sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_run_downhill(path: Path) -> None:
    layer = path.relative_to(PACKAGE).with_suffix("").parts[0]
    assert layer in LEVEL, f"{layer} has no place in LAYERS"
    assert violations(layer, path.read_text("utf-8")) == []


@pytest.mark.parametrize(
    ("layer", "source", "number"),
    [
        ("language", "def f():\n    import jaxlangnav.grounding.search", 1),
        ("world", "from jaxlangnav import grounding", 1),
        ("navigator", "from jaxlangnav.world.scenario import Scenario", 1),
        ("planner", "from . import values", 1),
        ("planner", "if TYPE_CHECKING:\n    from jaxlangnav.navigator import Navigator", 1),
        ("episode", "from jaxlangnav import Navigator", 1),
        ("viz", "from jaxlangnav.task.follow import follow", 1),
        ("world", "import jax\nfrom jaxlangnav import __version__, messages, relations", 0),
        ("episode", "from jaxlangnav.world import scenario\nfrom jaxlangnav import navigator", 0),
    ],
)
def test_an_uphill_import_is_found(layer: str, source: str, number: int) -> None:
    assert len(violations(layer, source)) == number


def test_the_budget_holds() -> None:
    """If this fails: take something out; pyproject.toml's table only falls."""
    assert not {name: of for name, of in house.budget().items() if of[0] > of[1]}


@pytest.mark.parametrize("path", [*PACKAGE.rglob("*.py")], ids=lambda path: path.stem)
def test_files_have_350_lines_and_functions_60_at_most(path: Path) -> None:
    parts = [one for one in ast.walk(ast.parse(path.read_text())) if isinstance(one, ast.stmt)]
    sizes = [house._span(one) for one in parts if isinstance(one, ast.FunctionDef)]
    assert max(map(len, sizes), default=0) <= 60
    assert path.read_text().count("\n") <= 350


MOST_SHARED = 11
"""Names that several modules may define: those of doors that stand on several floors (``step``)."""


def test_few_names_mean_two_things() -> None:
    found = house.defined_twice()
    assert len(found) <= MOST_SHARED, f"find one of its own for each new one: {sorted(found)}"


def test_what_counts_as_a_name() -> None:
    source = "A = 1\nB, _b = 2, 2\nC: int = 3\ndef d(): ...\nclass E: ...\nfrom x import f\n"
    assert house.defined(source) == {"A", "B", "C", "d", "E"}


BY_NAME = ("params", "config")
AS_GYMNAX = "jaxlangnav.environments.functional"
"""``step(key, state, action, params)`` is the order of gymnax, whose users call it by place."""


def by_place(function: Callable[..., Any]) -> list[str]:
    """List the names that a function takes by place though they do not stand first."""
    given = [one for one in inspect.signature(function).parameters.values() if one.name != "self"]
    return [
        one.name
        for place, one in enumerate(given)
        if place and one.name in BY_NAME and one.kind is not inspect.Parameter.KEYWORD_ONLY
    ]


def public_functions(module: Any) -> Iterator[tuple[str, Callable[..., Any]]]:
    """Yield what a module defines for others: functions, and the methods of its classes."""
    for name, one in vars(module).items():
        if name.startswith("_") or getattr(one, "__module__", None) != module.__name__:
            continue
        if inspect.isclass(one):
            for inner, method in vars(one).items():
                if inspect.isfunction(method) and (inner == "__init__" or inner[0] != "_"):
                    yield f"{name}.{inner}", method
        elif callable(one):
            yield name, one


NAMES_OF_MODULES = [
    one.name
    for one in pkgutil.walk_packages(jaxlangnav.__path__, "jaxlangnav.")
    if one.name not in (AS_GYMNAX, "jaxlangnav.__main__")
]


@pytest.mark.parametrize("name", NAMES_OF_MODULES)
def test_params_and_config_go_by_name(name: str) -> None:
    module = importlib.import_module(name)
    found = {place: by_place(one) for place, one in public_functions(module)}
    assert {place: names for place, names in found.items() if names} == {}


def test_a_number_by_place_is_found() -> None:
    def step(key: int, params: int) -> int: ...
    def check(params: int, *, config: int) -> int: ...

    assert by_place(step) == ["params"]
    assert by_place(check) == []
