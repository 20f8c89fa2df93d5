"""Static configuration of the planner: policy and array sizes; registry of policies."""

import dataclasses
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

import jax

from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.planner.faithful import Faithful, WaypointKeeping
from jaxlangnav.planner.informed import Informed
from jaxlangnav.planner.policy import Policy, Situation, Valuation

SHIPPED: Mapping[str, Policy] = MappingProxyType({"faithful": Faithful(), "informed": Informed()})
"""The policies that ship with the package, by name: the only list of them."""
POLICIES = tuple(SHIPPED)
AnyPolicy: TypeAlias = str | Policy | Callable[[Situation], Valuation]
"""A name, a custom policy, or a function that values nodes and needs no memory."""
_NAMES = ", ".join(POLICIES)
_MEMBERS = ("check", "init", "map_params", "name", "portrayal", "step", "takes_likeliest")


def as_policy(given: AnyPolicy) -> Policy:
    """Look up a policy by name, or validate a custom one.

    Args:
        given: a name, a policy, or a function from a situation to the values of its nodes, which
            then keeps its waypoints as the paper's policy does.

    Raises:
        ValueError: unknown name, or not a policy; names what is missing.
    """
    if isinstance(given, str):
        if given not in SHIPPED:
            raise ValueError(f"policy is {given!r}, but must be one of {_NAMES}")
        return SHIPPED[given]
    if isinstance(given, type):
        name = given.__name__
        raise ValueError(f"policy is the class {name}, but must be an object: write {name}(...)")
    type_name = type(given).__name__
    missing = [name for name in _MEMBERS if not hasattr(given, name)]
    is_function = callable(given) and {"init", "step"} <= set(missing)
    if missing and not is_function:
        raise ValueError(
            f"policy is a {type_name} without {', '.join(missing)}, but must be one of {_NAMES}, "
            "or have them: derive its class from jaxlangnav.planner.policy.Policy and write init "
            "and step"
        )
    try:
        hash(given)
    except TypeError as error:
        raise ValueError(
            f"policy is a {type_name}, but must be hashable ({error}): make its class a frozen "
            "dataclass of plain numbers and tuples, or of arrays a pytree for split_arrays"
        ) from error
    return given if isinstance(given, Policy) else WaypointKeeping(given)


def split_arrays(policy: AnyPolicy) -> tuple[AnyPolicy, Any]:
    """Split a policy that is a pytree, such as a trained network, into static part and arrays.

    The first, for ``PlannerConfig``, has shapes and dtypes in place of arrays. The second, for
    ``NavigatorParams``, is the policy itself, whose arrays are traced; None if it has none.
    """
    is_plain = jax.tree_util.all_leaves([policy])
    return (policy, None) if is_plain else (jax.eval_shape(lambda: policy), policy)


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlannerConfig:
    """Configuration of the planner: policy and sizes; static and hashable, a change recompiles."""

    policy: AnyPolicy = "faithful"
    """One of ``POLICIES`` ("informed": ours, "faithful": the paper's), or a custom policy."""
    num_visited: int = 16  # capacity of the buffer of visited positions
    num_blocks: int = 6  # blocks per side of the area, each with at most one frontier

    def __post_init__(self) -> None:
        """Raise a ValueError for an invalid policy or size."""
        as_policy(self.policy)
        check_minimum(1, num_visited=self.num_visited, num_blocks=self.num_blocks)

    @property
    def chosen(self) -> Policy:
        """The policy object."""
        return as_policy(self.policy)
