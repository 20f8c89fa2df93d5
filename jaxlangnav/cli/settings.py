"""Command-line options for numeric parameters, such as ``--params.planner.discount 0.9``.

Options are made from the records themselves: names, help (``pytree.field``), defaults, and the
limits of a sweep's configuration; only where somebody uses one, so that plain help is instant.
"""

import contextlib
import dataclasses
import functools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from jaxlangnav.cli.output import UsageError
from jaxlangnav.inputs.sanitize import closest

if TYPE_CHECKING:
    from jaxlangnav.task.follow import PreparedEpisode

_T = TypeVar("_T")
OptionPath = tuple[str, ...]  # such as ("params", "planner", "discount")
HELP_ALL = "--help-params"  # prints the help with all of these options

_UNSET = "\0"  # sentinel: cannot be typed
_DEDICATED_FLAGS = {
    ("config", "map", "num_particles"): "--particles",
    ("config", "planner", "policy"): "--policy",
    ("sensor", "range_max"): "--range",
}
"""Parameters that have a dedicated option."""
_EXCLUDED = {("params", "map", "motion")}  # the filter uses the world's motion model
_SYMBOLS = {"alpha": "α", "gamma": "γ", "kappa": "κ", "mu": "μ", "sigma": "σ", "tau": "τ"}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Option:
    """A command-line option for one parameter."""

    path: OptionPath
    default: Any  # a number, or a tuple of them
    help: str

    @property
    def flag(self) -> str:
        """The flag, such as "--params.planner.discount"."""
        return "--" + ".".join(self.path).replace("_", "-")

    def read(self, text: str) -> Any:
        """Parse one number, with or without a unit, or several separated by commas."""
        if not isinstance(self.default, tuple):
            return self._parse(text)
        parts = [part.strip() for part in text.split(",")]
        if len(parts) != len(self.default):
            count = len(self.default)
            raise UsageError(f'{self.flag} is "{text}", but needs {count} numbers, a comma apart')
        return tuple(self._parse(part) for part in parts)

    def _parse(self, text: str) -> float | int:
        if isinstance(self.default, int):
            try:
                return int(text)
            except ValueError:
                raise UsageError(f'{self.flag} is "{text}", but must be a whole number') from None
        value: str | float = text
        with contextlib.suppress(ValueError):
            value = float(text)
        return _quantity(self.path).read(value, self.flag)

    def metavar(self) -> str:
        """Return the placeholder in the help, such as LENGTH or 3xLENGTH."""
        name = "INT" if isinstance(self.default, int) else _quantity(self.path).kind.upper()
        return f"{len(self.default)}x{name}" if isinstance(self.default, tuple) else name


def is_option(word: str) -> bool:
    """Test whether an argument is such an option (a dot in its name) or the help on them."""
    return word == HELP_ALL or re.match(r"--[\w-]+\.", word) is not None


def options(groups: Iterable[str]) -> list[Option]:
    """List the options of groups, or of one record in a group, such as "params.planner"."""
    from jaxlangnav.messages import default_motion, default_sensor
    from jaxlangnav.navigator import NavigatorConfig
    from jaxlangnav.task.follow import navigator_params

    roots = {
        "params": navigator_params,
        "config": NavigatorConfig,
        "sensor": default_sensor,
        "motion": default_motion,
    }
    result: list[Option] = []
    for root, *below in (group.split(".") for group in groups):
        all_options = _list_options(roots[root](), (root,))
        result += [opt for opt in all_options if not below or opt.path[:-1] == (root, *below)]
    return result


def with_options(command: type[Any]) -> type[Any]:
    """Derive a command class with the options of its ``SETTINGS`` in a field ``settings``."""
    import tyro

    tree = _options_class("Settings", options(command.SETTINGS), depth=0)
    field = ("settings", Annotated[tree, tyro.conf.arg(name="")], dataclasses.field(default=tree()))
    return dataclasses.make_dataclass(
        command.__name__, [field], bases=(command,), namespace={"__doc__": command.__doc__},
        frozen=True, kw_only=True,
    )  # fmt: skip


def read_options(settings: Any, groups: Sequence[str]) -> dict[OptionPath, Any]:
    """Parse the given options into values by path; ``UsageError`` for invalid ones."""
    if settings is None:
        return {}
    texts = [(opt, functools.reduce(getattr, opt.path, settings)) for opt in options(groups)]
    return {opt.path: opt.read(text) for opt, text in texts if text != _UNSET}


def apply(record: _T, values: Mapping[OptionPath, Any], root: str) -> _T:
    """Set the values of one group in its record; returns the same record if there are none."""
    group_values = {path[1:]: value for path, value in values.items() if path[0] == root}
    return _set_values(record, group_values) if group_values else record


def apply_to_episode(
    opened: "PreparedEpisode", values: Mapping[OptionPath, Any]
) -> "PreparedEpisode":
    """Set the values of all groups; the filter assumes the motion model of the world."""
    from jaxlangnav.experiments.policies import set_heading_bias

    task = opened.prepared.task
    motion = apply(task.motion, values, "motion")
    task = dataclasses.replace(task, sensor=apply(task.sensor, values, "sensor"), motion=motion)
    params = apply(opened.params, values, "params")
    return dataclasses.replace(
        opened,
        prepared=dataclasses.replace(opened.prepared, task=task),
        params=dataclasses.replace(params, map=dataclasses.replace(params.map, motion=motion)),
        config=set_heading_bias(apply(opened.config, values, "config"), motion),
    )


def suggestion(flag: str, groups: Sequence[str], undotted: Iterable[str]) -> str:
    """Suggest the closest option for an unknown flag with a dot, or point to the list."""
    path = tuple(flag[2:].replace("-", "_").split("."))
    # Some commands have the plural, "--ranges".
    dedicated = {key[-1]: (flag, f"{flag}s") for key, flag in _DEDICATED_FLAGS.items()}
    if path[-1] in dedicated:
        matches = [option for option in undotted if option in dedicated[path[-1]]]
    else:
        known = options(groups)
        name = closest(path[-1], [option.path[-1] for option in known])
        matches = [option.flag for option in known if option.path[-1] == name]
        symbol = _SYMBOLS.get(path[-1])
        if symbol and not matches:
            matches = [option.flag for option in known if re.match(rf"{symbol}\b", option.help)]
    return f'; did you mean "{matches[0]}"?' if matches else f"; see {HELP_ALL}"


def _list_options(record: Any, path: OptionPath) -> list[Option]:
    record = _raw_params(record)
    result: list[Option] = []
    for field in dataclasses.fields(record):
        field_path, value = (*path, field.name), getattr(record, field.name)
        if field_path in _DEDICATED_FLAGS or field_path in _EXCLUDED:
            continue
        if dataclasses.is_dataclass(value):
            result += _list_options(value, field_path)
        elif (default := _as_numbers(value)) is not None:
            doc = field.metadata.get("help", "")
            result.append(Option(path=field_path, default=default, help=doc))
    return result


def _raw_params(record: Any) -> Any:
    """Replace a relation model by the parameters from which its tables are computed."""
    from jaxlangnav.relations import RelationModel, default_params

    return default_params() if isinstance(record, RelationModel) else record


def _as_numbers(value: Any) -> float | int | tuple[float, ...] | None:
    """Convert a leaf to numbers; None if it is no whole number, float or vector of floats."""
    import numpy as np

    if isinstance(value, int) and not isinstance(value, bool):
        return value
    array = np.asarray(value)
    if array.ndim > 1 or not np.issubdtype(array.dtype, np.floating):
        return None
    rounded = tuple(float(f"{float(value):.6g}") for value in array.ravel())
    return rounded if array.ndim else rounded[0]


def _quantity(path: OptionPath) -> Any:
    """Return the unit and limits of a parameter, as in a sweep's configuration."""
    from jaxlangnav.inputs.limits import Quantity
    from jaxlangnav.navigator.deployment import FIELDS

    quantities = {
        "mode_speed": Quantity(is_low_open=True),
        "mode_clearance": Quantity(kind="length"),
        "log_distance_sd": Quantity(is_low_open=True),
        "concentration": Quantity(),
        "axis": Quantity(kind="angle", low=-math.inf),
        **FIELDS.get(path[-2], {}),
    }
    return quantities.get(path[-1], Quantity(low=-math.inf))


def _options_class(name: str, group: Sequence[Option], *, depth: int) -> type[Any]:
    """Build the nested dataclass that tyro parses."""
    import tyro

    fields: list[tuple[str, Any, Any]] = []
    for key in dict.fromkeys(option.path[depth] for option in group):
        members = [option for option in group if option.path[depth] == key]
        if len(members[0].path) == depth + 1:
            (option,) = members
            numbers = option.default if isinstance(option.default, tuple) else (option.default,)
            default = f"(default: {','.join(f'{number:g}' for number in numbers)})"
            hint = tyro.conf.arg(
                metavar=option.metavar(), help=option.help or None, help_behavior_hint=default
            )
            fields.append((key, Annotated[str, hint], _UNSET))
        else:
            nested = _options_class(key.capitalize(), members, depth=depth + 1)
            fields.append((key, nested, dataclasses.field(default=nested())))
    return dataclasses.make_dataclass(name, fields, frozen=True, kw_only=True)


def _set_values(record: Any, values: Mapping[OptionPath, Any]) -> Any:
    """Set values below a record or, where the path ends, the number itself."""
    import jax.numpy as jnp

    from jaxlangnav.relations import prepare

    if () in values:
        value = values[()]
        return value if isinstance(value, int) else jnp.asarray(value, jnp.float32)
    raw = _raw_params(record)
    names = {path[0] for path in values}
    changed = dataclasses.replace(
        raw, **{name: apply(getattr(raw, name), values, name) for name in names}
    )
    return changed if raw is record else prepare(changed)
