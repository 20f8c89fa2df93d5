"""The ``Policy`` protocol: its inputs, its decision, and the rules for all policies (section 3.4).

    memory = policy.init(belief)
    memory, decision = policy.step(key, memory, situation)

A policy is written for ONE robot in operations that JAX can trace. It has its own memory and
randomness and, optionally, its own waypoints (``ahead``). ``decide`` turns the values of waypoints
into a decision, by rules that are the same for all policies (``deciding``).
"""

import dataclasses
from abc import abstractmethod
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.deciding import (
    APPROACH as APPROACH,
    ARRIVAL_RADIUS as ARRIVAL_RADIUS,
    MIN_GOAL_PROB as MIN_GOAL_PROB,
    ahead as ahead,
    decide as decide,
    may_stop as may_stop,
)
from jaxlangnav.planner.situation import (
    Decision as Decision,
    Situation as Situation,
    Valuation as Valuation,
    Waypoint as Waypoint,
)
from jaxlangnav.pytree import replace, strong_types
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapConfig, MapParams


@dataclasses.dataclass(frozen=True, kw_only=True)
class PolicyDescription:
    """Texts by which reports and figures describe a policy's choices."""

    place: str = "a place of its own choice"
    """Name of the policy's custom waypoints."""
    reason: str = "of {number} places it is worth most to its policy (value {value:.2f})"
    """Why a waypoint was chosen; {tested} is the fraction of maps that the path tests."""
    reason_object: str | None = None
    """The same for an observed object; None: no other reason."""
    is_field: bool = False
    """Whether positions between the nodes have values, too: those of eq. 11."""


@runtime_checkable
class Policy(Protocol):
    """Policy of the planner: decides on the next waypoint, and when to stop.

    A custom policy derives from this class and has ``init`` and ``step``; the rest has defaults.
    It is hashable, such as a frozen dataclass of plain numbers: other values are another policy and
    recompile. Or it is a ``pytree``: its arrays are traced in ``step`` and ``map_params``, and
    ShapeDtypeStructs elsewhere.
    """

    @property
    def name(self) -> str:
        """Name of the policy for users."""
        return type(self).__name__.lower()

    @property
    def portrayal(self) -> PolicyDescription:
        """Texts by which reports and figures describe its choices."""
        return PolicyDescription()

    @property
    def takes_likeliest(self) -> bool:
        """Whether it accepts the likeliest observed object once the search is nearly exhausted."""
        return False

    @abstractmethod
    def init(self, belief: ParticleBelief, /) -> Any:
        """Build the initial memory of the policy.

        Args:
            belief: before the first observation: operating area, position of the robot, shapes.

        Returns:
            Any pytree of arrays. It persists over commands; ``Situation.is_news`` signals them.
        """

    @abstractmethod
    def step(self, key: Array, memory: Any, situation: Situation, /) -> tuple[Any, Decision]:
        """Decide on the next waypoint or a stop.

        Args:
            key: random key, consumed.
            memory: after the last decision.
            situation: now.

        Returns:
            The memory, of the same shapes and dtypes, and the decision.
        """

    def map_params(self, params: MapParams) -> MapParams:
        """Return the filter's parameters under this policy; by default those given."""
        return params

    def check(self, sizes: MapConfig) -> None:
        """Raise a ValueError for map sizes that the policy cannot work with; by default none."""
        return


def choose(policy: Policy, key: Array, memory: Any, situation: Situation) -> tuple[Any, Decision]:
    """Run a policy's step and enforce the rules for all policies.

    It stops only where a stop is allowed, and a stop excludes "not found". Raises a ValueError if
    the result is no decision, or the memory has other shapes than before.
    """
    after, decision = policy.step(key, memory, situation)
    if not isinstance(decision, Decision):
        raise ValueError(
            f"policy {policy.name} decides {type(decision).__name__}: its step must return its "
            "memory and a Decision, as policy.decide makes it"
        )

    def describe(leaf: Any) -> str:
        return f"{jnp.result_type(leaf)}{list(jnp.shape(leaf))}"

    old, new = jax.tree.map(describe, memory), jax.tree.map(describe, after)
    if old != new:
        raise ValueError(
            f"policy {policy.name} is given a memory of {old} and returns one of {new}: shapes and "
            "dtypes must stay as its init makes them"
        )
    is_stop = decision.is_stop & situation.may_stop & ~decision.question.asks
    is_not_found = decision.is_not_found & ~is_stop & ~situation.is_still & ~decision.question.asks
    return strong_types(after), replace(decision, is_stop=is_stop, is_not_found=is_not_found)
