"""The engine's numbers and sizes on the command line: ``--params.planner.discount 0.9``.

Options are made from the records themselves: names, help (``pytree.field``), defaults, and the
limits of a sweep's configuration; only where somebody uses one, so that plain help is instant.
"""

import dataclasses
import difflib
import functools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from jaxlangnav.cli.output import UsageError

if TYPE_CHECKING:
    from jaxlangnav.navigator import NavigatorParams
    from jaxlangnav.task.opening import Prepared

_T = TypeVar("_T")
SettingPath = tuple[str, ...]  # where a value stands: ("params", "planner", "discount")
GROUPS = ("params", "config", "sensor", "motion")
HELP_ALL = "--help-params"  # the help with all of these options

_UNSET = "\0"  # what nobody can type
_ELSEWHERE = {
    ("config", "map", "num_particles"): "--particles",
    ("config", "planner", "policy"): "--policy",
    ("sensor", "range_max"): "--range",
}
"""What has an option of its own."""
_NOT_OFFERED = {("params", "map", "motion")}  # the belief is told the world's own motion
_GREEK = {"alpha": "α", "gamma": "γ", "kappa": "κ", "mu": "μ", "sigma": "σ", "tau": "τ"}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Option:
    """One value that can be set."""

    path: SettingPath
    default: Any  # a number, or a tuple of them
    help: str
    is_whole: bool

    @property
    def flag(self) -> str:
        """What is typed."""
        return "--" + ".".join(self.path).replace("_", "-")

    def read(self, text: str) -> Any:
        """Read a number, perhaps with a unit, or several with commas between; refuses all else."""
        if not isinstance(self.default, tuple):
            return self._one(text)
        parts = [part.strip() for part in text.split(",")]
        if len(parts) != len(self.default):
            number = len(self.default)
            raise UsageError(f'{self.flag} is "{text}", but needs {number} numbers, a comma apart')
        return tuple(self._one(part) for part in parts)

    def _one(self, text: str) -> float | int:
        given: str | float = text
        try:
            given = int(text) if self.is_whole else float(text)
        except ValueError:
            if self.is_whole:
                message = f'{self.flag} is "{text}", but must be a whole number'
                raise UsageError(message) from None
        return int(given) if self.is_whole else _quantity(self.path).read(given, self.flag)

    def metavar(self) -> str:
        """Name the kind of value, such as LENGTH; "3xLENGTH" for three with commas between."""
        kind = "INT" if self.is_whole else _quantity(self.path).kind.upper()
        return f"{len(self.default)}x{kind}" if isinstance(self.default, tuple) else kind


def is_setting(word: str) -> bool:
    """Tell whether a word of the command line asks for these options: it has a dot in its name."""
    return word == HELP_ALL or re.match(r"--[\w-]+\.", word) is not None


def options(groups: Iterable[str]) -> list[Option]:
    """List the options of some of ``GROUPS``, or of one record in it, such as "params.planner"."""
    from jaxlangnav.messages import default_motion, default_sensor
    from jaxlangnav.navigator import NavigatorConfig
    from jaxlangnav.task.follow import navigator_params

    roots = {
        "params": navigator_params,
        "config": NavigatorConfig,
        "sensor": default_sensor,
        "motion": default_motion,
    }
    found: list[Option] = []
    for root, *below in (group.split(".") for group in groups):
        all_of_it = _walk(roots[root](), (root,))
        found += [one for one in all_of_it if not below or one.path[:-1] == (root, *below)]
    return found


def with_settings(kind: type[Any]) -> type[Any]:
    """Add the options of its ``SETTINGS`` to a command that has a field ``settings``."""
    import tyro

    tree = _record_of("Settings", options(kind.SETTINGS), depth=0)
    field = ("settings", Annotated[tree, tyro.conf.arg(name="")], dataclasses.field(default=tree()))
    form: dict[str, Any] = {"bases": (kind,), "frozen": True, "kw_only": True}
    form["namespace"] = {"__doc__": kind.__doc__}
    return dataclasses.make_dataclass(kind.__name__, [field], **form)


def read_settings(settings: Any, groups: Sequence[str]) -> dict[SettingPath, Any]:
    """Read what was typed, values by path; refuses those that are none or out of their limits."""
    if settings is None:
        return {}
    typed = [(one, functools.reduce(getattr, one.path, settings)) for one in options(groups)]
    return {one.path: one.read(text) for one, text in typed if text != _UNSET}


def apply(record: _T, values: Mapping[SettingPath, Any], root: str) -> _T:
    """Set the values of one group in its record; the very same record where nothing is set."""
    mine = {path[1:]: value for path, value in values.items() if path[0] == root}
    return _applied(record, mine) if mine else record


def equip(
    prepared: "Prepared", values: Mapping[SettingPath, Any], *, params: "NavigatorParams"
) -> "tuple[Prepared, NavigatorParams]":
    """Set detector and odometry of a task; the belief is told the odometry."""
    own = {name: apply(getattr(prepared.task, name), values, name) for name in ("sensor", "motion")}
    prepared = dataclasses.replace(prepared, task=dataclasses.replace(prepared.task, **own))
    told = dataclasses.replace(params.map, motion=own["motion"])
    return prepared, dataclasses.replace(params, map=told)


def suggestion(flag: str, groups: Sequence[str], plain: Iterable[str]) -> str:
    """Suggest what may have been meant by an option with a dot in it, or where all are listed."""
    path = tuple(flag[2:].replace("-", "_").split("."))
    # Where several may be given it is "--ranges".
    elsewhere = {one[-1]: (option, f"{option}s") for one, option in _ELSEWHERE.items()}
    if path[-1] in elsewhere:
        near = [one for one in plain if one in elsewhere[path[-1]]]
    else:
        found = options(groups)
        names = difflib.get_close_matches(path[-1], [one.path[-1] for one in found], n=1)
        near = [one.flag for one in found if one.path[-1] in names]
        symbol = _GREEK.get(path[-1])
        if symbol and not near:
            near = [one.flag for one in found if re.match(rf"{symbol}\b", one.help)]
    return f'; did you mean "{near[0]}"?' if near else f"; see {HELP_ALL}"


def _walk(record: Any, path: SettingPath) -> list[Option]:
    """List the options of a record and of those in it."""
    record = _as_typed(record)
    found: list[Option] = []
    for field in dataclasses.fields(record):
        here, value = (*path, field.name), getattr(record, field.name)
        if here in _ELSEWHERE or here in _NOT_OFFERED:
            continue
        if dataclasses.is_dataclass(value):
            found += _walk(value, here)
        elif (default := _numbers(value)) is not None:
            text = field.metadata.get("help", "")
            is_whole = isinstance(value, int)
            found.append(Option(path=here, default=default, help=text, is_whole=is_whole))
    return found


def _as_typed(record: Any) -> Any:
    """Take the free parameters of the relations, of which the filter's tables are made."""
    from jaxlangnav.relations import RelationModel, default_params

    return default_params() if isinstance(record, RelationModel) else record


def _numbers(value: Any) -> float | int | tuple[float, ...] | None:
    """Turn a leaf into numbers; None where it is none that could be typed."""
    import numpy as np

    if isinstance(value, int) and not isinstance(value, bool):
        return value
    if isinstance(value, str | bool):
        return None
    array = np.asarray(value)
    if array.ndim > 1 or not np.issubdtype(array.dtype, np.floating):
        return None
    rounded = tuple(float(f"{float(one):.6g}") for one in array.ravel())
    return rounded if array.ndim else rounded[0]


def _quantity(path: SettingPath) -> Any:
    """Find kind and limits of a number; the limits are those of a sweep's configuration."""
    from jaxlangnav.inputs.limits import Quantity
    from jaxlangnav.navigator.deployment import FIELDS

    known = {
        "mode_speed": Quantity(is_low_open=True),
        "mode_clearance": Quantity(kind="length"),
        "log_distance_sd": Quantity(is_low_open=True),
        "concentration": Quantity(),
        "axis": Quantity(kind="angle", low=-math.inf),
        **FIELDS.get(path[-2], {}),
    }
    return known.get(path[-1], Quantity(low=-math.inf))


def _record_of(name: str, found: Sequence[Option], *, depth: int) -> type[Any]:
    """Build the nested dataclass that tyro reads."""
    import tyro

    fields: list[tuple[str, Any, Any]] = []
    for key in dict.fromkeys(one.path[depth] for one in found):
        below = [one for one in found if one.path[depth] == key]
        if len(below[0].path) == depth + 1:
            (one,) = below
            numbers = one.default if isinstance(one.default, tuple) else (one.default,)
            given = f"(default: {','.join(f'{number:g}' for number in numbers)})"
            hint = tyro.conf.arg(
                metavar=one.metavar(), help=one.help or None, help_behavior_hint=given
            )
            fields.append((key, Annotated[str, hint], _UNSET))
        else:
            kind = _record_of(key.capitalize(), below, depth=depth + 1)
            fields.append((key, kind, dataclasses.field(default=kind())))
    return dataclasses.make_dataclass(name, fields, frozen=True, kw_only=True)


def _applied(record: Any, values: Mapping[SettingPath, Any]) -> Any:
    """Set values in a record and in those in it."""
    import jax.numpy as jnp

    from jaxlangnav.relations import RelationModel, prepare

    is_model = isinstance(record, RelationModel)
    record = _as_typed(record)
    changes: dict[str, Any] = {}
    for name in dict.fromkeys(path[0] for path in values):
        mine = {path[1:]: value for path, value in values.items() if path[0] == name}
        if () in mine:
            value = mine[()]
            changes[name] = value if isinstance(value, int) else jnp.asarray(value, jnp.float32)
        else:
            changes[name] = _applied(getattr(record, name), mine)
    changed = dataclasses.replace(record, **changes)
    return prepare(changed) if is_model else changed
