"""Modules of the reference that stand elsewhere now: their old names work, and warn."""

import importlib
import importlib.abc
import importlib.machinery
import sys
import warnings
from collections.abc import Sequence
from types import ModuleType

from jaxlangnav.inputs.documents import parse_toml, read_shipped

_TABLE = parse_toml(read_shipped("inputs", "old_names.toml"))
MOVED: dict[str, str] = _TABLE["moved"]
"""In the package: old names and new ones."""
RENAMED: dict[str, dict[str, str]] = _TABLE["renamed"]
"""Of a module that has moved: what it called otherwise."""


class _Moved(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds a module of an old name as a copy of the names of the new one."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Know the old names."""
        name = fullname.removeprefix("jaxlangnav.")
        # A package of which all modules have moved is found too, empty.
        is_parent = any(old.startswith(f"{name}.") for old in MOVED)
        if name not in MOVED and not is_parent:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, is_package=is_parent)

    def exec_module(self, module: ModuleType) -> None:
        """Take over what the new module defines."""
        old = module.__name__.removeprefix("jaxlangnav.")
        if old not in MOVED:
            return
        new = f"jaxlangnav.{MOVED[old]}"
        warnings.warn(f"jaxlangnav.{old} is now {new}", DeprecationWarning, stacklevel=2)
        names = vars(importlib.import_module(new))
        vars(module).update({name: one for name, one in names.items() if name[:2] != "__"})
        vars(module).update({name: names[now] for name, now in RENAMED.get(old, {}).items()})


def know_old_names() -> None:
    """Let old names be imported; asked last, when nothing else has found a module."""
    sys.meta_path.append(_Moved())
