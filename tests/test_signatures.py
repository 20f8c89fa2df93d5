"""Numbers and sizes go by name: ``params`` and ``config`` are keyword-only in public functions.

What a function is about stands first and may be given by place: ``check(params)``.
"""

import importlib
import inspect
import pkgutil
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import jaxlangnav

NAMES = ("params", "config")
AS_GYMNAX = "jaxlangnav.environments.functional"
"""``step(key, state, action, params)`` is the order of gymnax, whose users call it by place."""


def by_place(function: Callable[..., Any]) -> list[str]:
    """List the names that a function takes by place though they do not stand first."""
    given = [one for one in inspect.signature(function).parameters.values() if one.name != "self"]
    return [
        one.name
        for place, one in enumerate(given)
        if place and one.name in NAMES and one.kind is not inspect.Parameter.KEYWORD_ONLY
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


MODULES = [
    one.name
    for one in pkgutil.walk_packages(jaxlangnav.__path__, "jaxlangnav.")
    if one.name not in (AS_GYMNAX, "jaxlangnav.__main__")
]


@pytest.mark.parametrize("name", MODULES)
def test_params_and_config_go_by_name(name: str) -> None:
    module = importlib.import_module(name)
    found = {place: by_place(one) for place, one in public_functions(module)}
    assert {place: names for place, names in found.items() if names} == {}


def test_a_number_by_place_is_found() -> None:
    def step(key: int, params: int) -> int: ...
    def check(params: int, *, config: int) -> int: ...

    assert by_place(step) == ["params"]
    assert by_place(check) == []
