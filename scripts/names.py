"""Names that mean two things: public names defined at the top of two or more modules.

    python scripts/names.py

A name counts where modules define it for others: functions, classes, constants and aliases
without a leading underscore, whatever they mean: who searches for one finds both.
"""

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent / "jaxlangnav"


def defined(source: str) -> set[str]:
    """List the public names that a module defines at its top."""
    found: set[str] = set()
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Assign):
            found |= {name for target in node.targets for name in _bound(target)}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found.add(node.target.id)
    return {name for name in found if not name.startswith("_")}


def _bound(target: ast.expr) -> set[str]:
    """List the names that the target of an assignment binds: one, or a row of them."""
    parts = (one for one in ast.walk(target) if isinstance(one, ast.Name))
    return {one.id for one in parts if isinstance(one.ctx, ast.Store)}


def twice(package: Path = PACKAGE) -> dict[str, list[str]]:
    """Find the names that several modules define, and which modules."""
    places: defaultdict[str, list[str]] = defaultdict(list)
    for path in sorted(package.rglob("*.py")):
        for name in defined(path.read_text("utf-8")):
            places[name].append(str(path.relative_to(package)))
    return {name: of for name, of in sorted(places.items()) if len(of) > 1}


if __name__ == "__main__":
    found = twice()
    for name, modules in found.items():
        print(f"{name:20} {', '.join(modules)}")
    print(f"{len(found)} names mean two things")
