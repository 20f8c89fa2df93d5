"""jaxlangnav: language-guided navigation in unknown places, on JAX.

The public names are loaded when first used, so that ``import jaxlangnav`` and the command line's
help stay instant; JAX is imported only once something computes.
"""

import importlib
import sys
from typing import TYPE_CHECKING, Any

from jaxlangnav.inputs.old_names import install_old_names as _install_old_names

if TYPE_CHECKING:
    from jaxlangnav.cli.runtime import keep_compiled_programs as keep_compiled_programs
    from jaxlangnav.grounding.annotated import AnnotationGrounder as AnnotationGrounder
    from jaxlangnav.language.parser import parse as parse
    from jaxlangnav.messages import (
        Action as Action,
        Behavior as Behavior,
        Fault as Fault,
        Observation as Observation,
        SensorParams as SensorParams,
        Status as Status,
        default_sensor as default_sensor,
    )
    from jaxlangnav.navigator.api import Navigator as Navigator
    from jaxlangnav.relations.fit import fit_relations as fit_relations
    from jaxlangnav.task.follow import follow as follow

__version__ = "0.2.0"

_MESSAGES = ("Action", "Behavior", "Fault", "Observation", "SensorParams", "Status")
_HOMES = dict.fromkeys((*_MESSAGES, "default_sensor"), "jaxlangnav.messages") | {
    "AnnotationGrounder": "jaxlangnav.grounding.annotated",
    "Navigator": "jaxlangnav.navigator.api",
    "fit_relations": "jaxlangnav.relations.fit",
    "follow": "jaxlangnav.task.follow",
    "keep_compiled_programs": "jaxlangnav.cli.runtime",
    "parse": "jaxlangnav.language.parser",
}

__all__ = [
    "Action",
    "AnnotationGrounder",
    "Behavior",
    "Fault",
    "Navigator",
    "Observation",
    "SensorParams",
    "Status",
    "__version__",
    "default_sensor",
    "fit_relations",
    "follow",
    "keep_compiled_programs",
    "parse",
]


_install_old_names()
if "gymnasium" in sys.modules:
    # Gymnasium looks for environments in modules that are named, as "jaxlangnav:jaxlangnav/…".
    importlib.import_module("jaxlangnav.environments")


def __getattr__(name: str) -> Any:
    """Load a public name from its module (PEP 562).

    Args:
        name: one of the names in ``__all__``.

    Returns:
        The object of that name.

    Raises:
        AttributeError: the package has no such public name.
    """
    if name not in _HOMES:
        raise AttributeError(f"module 'jaxlangnav' has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names."""
    return sorted(__all__)
