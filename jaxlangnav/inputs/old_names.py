"""Deprecated import paths: moved modules stay importable by their old names, with a warning."""

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
"""New module paths by old ones, relative to the package."""
RENAMED: dict[str, dict[str, str]] = _TABLE["renamed"]
"""Renamed attributes: old module path → {old name: new name}."""


class _MovedFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Import hook that finds a moved module by its old name, with the attributes of the new one."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Find a module by its old name."""
        name = fullname.removeprefix("jaxlangnav.")
        # A package whose modules have all moved is found too, empty.
        is_parent = any(old.startswith(f"{name}.") for old in MOVED)
        if name not in MOVED and not is_parent:
            return None
        return importlib.machinery.ModuleSpec(fullname, self, is_package=is_parent)

    def exec_module(self, module: ModuleType) -> None:
        """Copy the attributes of the new module, and warn."""
        old = module.__name__.removeprefix("jaxlangnav.")
        if old not in MOVED:
            return
        new = f"jaxlangnav.{MOVED[old]}"
        warnings.warn(f"jaxlangnav.{old} is now {new}", DeprecationWarning, stacklevel=2)
        attrs = vars(importlib.import_module(new))
        vars(module).update({name: value for name, value in attrs.items() if name[:2] != "__"})
        vars(module).update({name: attrs[target] for name, target in RENAMED.get(old, {}).items()})


def install_old_names() -> None:
    """Register the import hook, after all other finders."""
    sys.meta_path.append(_MovedFinder())
