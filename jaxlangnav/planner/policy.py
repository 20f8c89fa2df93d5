"""The door for policies: what one is shown, what it answers, what holds for all (section 3.4).

    memory = policy.init(belief)
    memory, decision = policy.step(key, memory, situation)

A policy is written for ONE robot in operations that JAX can trace. It has its own memory, its own
randomness and, if it likes, waypoints of its own (``ahead``). ``decide`` makes a decision of what
the waypoints are worth, by rules that are the same for all (``deciding``).
"""

import dataclasses
from abc import abstractmethod
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner.deciding import (
    APPROACH as APPROACH,
    LEAST_GOAL as LEAST_GOAL,
    UNDERFOOT as UNDERFOOT,
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
from jaxlangnav.pytree import replace, strong
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapConfig, MapParams


@dataclasses.dataclass(frozen=True, kw_only=True)
class Portrayal:
    """How stories and pictures show a policy's choices."""

    place: str = "a place of its own choice"
    """What its own waypoints are called."""
    reason: str = "of {number} places it is worth most to its policy (value {value:.2f})"
    """Why a waypoint was taken; {tested} is the share of maps that the way puts to the test."""
    reason_object: str | None = None
    """The same where it is an object that has been seen; None: no other reason."""
    is_field: bool = False
    """Places between the nodes have values, too: those of eq. 11."""


@runtime_checkable
class Policy(Protocol):
    """How a robot decides where to go, and when it is there.

    A policy of one's own derives from this class and has ``init`` and ``step``; the rest has
    defaults. It is hashable, as a frozen dataclass of plain numbers is: with other values it is
    another policy, and another program is compiled. Or it is a ``pytree``: its arrays are traced
    in ``step`` and ``map_params``, and ShapeDtypeStructs elsewhere.
    """

    @property
    def name(self) -> str:
        """What people call it."""
        return type(self).__name__.lower()

    @property
    def portrayal(self) -> Portrayal:
        """How stories and pictures show its choices."""
        return Portrayal()

    @property
    def takes_likeliest(self) -> bool:
        """Whether it takes the likeliest thing seen once there is little left to look for."""
        return False

    @abstractmethod
    def init(self, belief: ParticleBelief, /) -> Any:
        """Build the memory of a robot that has not decided yet.

        Args:
            belief: before the first look: operating area, where the robot stands, sizes.

        Returns:
            Any pytree of arrays. It is kept over commands; ``Situation.is_news`` tells of them.
        """

    @abstractmethod
    def step(self, key: Array, memory: Any, situation: Situation, /) -> tuple[Any, Decision]:
        """Decide.

        Args:
            key: random key, consumed.
            memory: after the last decision.
            situation: now.

        Returns:
            The memory, of the same shapes and dtypes, and the decision.
        """

    def map_params(self, params: MapParams) -> MapParams:
        """Tell by which numbers the robot filters what it sees and hears: by those given."""
        return params

    def check(self, sizes: MapConfig) -> None:
        """Refuse, with a ValueError, sizes of the map that the policy cannot work with: none."""
        return


def choose(policy: Policy, key: Array, memory: Any, situation: Situation) -> tuple[Any, Decision]:
    """Let a policy decide, and hold it to what holds for all.

    It stops only where a stop is heard, and gives nothing up as not to be found on top of it. A
    ValueError: the answer is no decision, or a memory of other shapes than the one before.
    """
    after, decision = policy.step(key, memory, situation)
    if not isinstance(decision, Decision):
        raise ValueError(
            f"policy {policy.name} decides {type(decision).__name__}: its step must return its "
            "memory and a Decision, as policy.decide makes it"
        )

    def describe(leaf: Any) -> str:
        return f"{jnp.result_type(leaf)}{list(jnp.shape(leaf))}"

    had, has = jax.tree.map(describe, memory), jax.tree.map(describe, after)
    if had != has:
        raise ValueError(
            f"policy {policy.name} is given a memory of {had} and returns one of {has}: shapes and "
            "dtypes must stay as its init makes them"
        )
    is_stop = decision.is_stop & situation.may_stop & ~decision.doubt.asks
    is_not_found = decision.is_not_found & ~is_stop & ~situation.stands & ~decision.doubt.asks
    return strong(after), replace(decision, is_stop=is_stop, is_not_found=is_not_found)
