"""The ``Policy`` protocol: its inputs, its decision, and the rules for all policies (section 3.4).

    memory = policy.init(belief)
    memory, decision = policy.step(key, memory, situation)

A policy is written for ONE robot in operations that JAX can trace. It has its own memory and
randomness and, optionally, its own waypoints (``ahead``). ``decide`` turns the values of waypoints
into a waypoint or a stop (eq. 10), by rules that are the same for all policies: detours around
keep-out zones cost value, the robot's position is no waypoint, and a stop needs an observed object
within reach that may be the goal.
"""

import dataclasses
from abc import abstractmethod
from typing import Any, ClassVar, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.numerics.batching import select_row
from jaxlangnav.planner import graph
from jaxlangnav.planner.blocked import open_nodes
from jaxlangnav.planner.detours import detours
from jaxlangnav.planner.goals import MIN_GOAL_PROB as MIN_GOAL_PROB, has_goal
from jaxlangnav.planner.graph import FRONTIER, OBJECT_NODE
from jaxlangnav.planner.questions import AskDecision, decide_question
from jaxlangnav.planner.situation import (
    Decision as Decision,
    Situation as Situation,
    Valuation as Valuation,
    Waypoint as Waypoint,
)
from jaxlangnav.pytree import replace, strong_types
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapConfig, MapParams

ARRIVAL_RADIUS = 0.25
"""Metres within which a waypoint counts as reached; for objects see ``APPROACH``."""
APPROACH = 0.9
"""Fraction of ``reach`` at which the robot halts before an object that it approaches."""
_HALF_VALUE = 10.0  # metres of detour that halve the value of a waypoint


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

    portrayal: ClassVar[PolicyDescription] = PolicyDescription()
    """Texts by which reports and figures describe its choices."""
    takes_likeliest: ClassVar[bool] = False
    """Whether it accepts the likeliest observed object once the search is nearly exhausted."""

    @property
    def name(self) -> str:
        """Name of the policy for users."""
        return type(self).__name__.lower()

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


def ahead(situation: Situation, x: Array, y: Array) -> Situation:
    """Prepend a policy's custom waypoints to the common nodes.

    Limits: a position that is not finite is no waypoint.

    Args:
        situation: as given to the policy.
        x: f32[K], metres, map frame.
        y: f32[K], metres.
    """
    is_node = jnp.isfinite(x) & jnp.isfinite(y)
    return replace(situation, nodes=graph.prepend_nodes(x, y, is_node, situation.nodes))


def _value(
    situation: Situation, valuation: Valuation, detour: Array, ask: AskDecision
) -> tuple[Array, Array]:
    """Compute the nodes' values, f32[A], −∞ where not allowed, and their detour penalties."""
    nodes, shape = situation.nodes, situation.nodes.x.shape
    for name in ("goal_value", "information_value"):
        actual = jnp.shape(getattr(valuation, name))
        if actual != shape:
            raise ValueError(
                f"{name} has shape {actual}, but must have {shape}: one value for each of "
                "situation.nodes"
            )
    total = valuation.goal_value + valuation.information_value
    frac = detour / (detour + _HALF_VALUE)
    cost = jnp.where(detour > 0.0, frac * jnp.minimum(jnp.abs(total), 1e9), 0.0)
    value = total - cost
    is_object = nodes.kind == OBJECT_NODE
    # Standing still gives no information: at the robot's own position only a_stop applies.
    is_away = situation.distance > jnp.where(is_object, situation.params.reach, ARRIVAL_RADIUS)
    # While the robot searches on for more candidates, it approaches no object.
    is_open = open_nodes(nodes, situation.progress).is_node & (~ask.searches_on | ~is_object)
    return jnp.where(is_open & is_away & ~jnp.isnan(value), value, -jnp.inf), cost


def decide(
    situation: Situation,
    valuation: Valuation,
    kept: Waypoint | None = None,
    question: AskDecision | None = None,
) -> Decision:
    """Select the waypoint of highest value, or stop (eq. 10).

    Limits: no stop without an observed goal within reach; NaN as a value closes its node, and if
    all are closed the waypoint is the robot's position.

    Args:
        situation: nodes, goals, position of the robot.
        valuation: values of the nodes, and the probability that decides on a stop.
        kept: the current waypoint; if active it is kept, whatever the values.
        question: whether to ask which object is meant; by default among the observed ones.

    Raises:
        ValueError: the values are not one for each node.
    """
    nodes, params = situation.nodes, situation.params
    x, y, false = situation.robot_x, situation.robot_y, jnp.asarray(False)
    robot = Waypoint(x=x, y=y, kind=jnp.int32(FRONTIER), is_active=false)
    kept = robot if kept is None else kept
    # The last entry is the current waypoint, or the robot's position.
    fallback = jax.tree.map(lambda a, b: jnp.where(kept.is_active, a, b), kept, robot)
    x, y = jnp.append(nodes.x, fallback.x), jnp.append(nodes.y, fallback.y)
    kind = jnp.append(nodes.kind, fallback.kind)
    route = detours(situation, x, y, jnp.where(kind == OBJECT_NODE, APPROACH * params.reach, 0.0))
    if question is None:  # a policy without tours does not search on for unseen candidates
        options = {"no_search": True, "may_ask": situation.may_ask}
        question = decide_question(situation.goals, jnp.float32(0.0), params=params, **options)
    value, cost = _value(situation, valuation, route[0][:-1], question)
    uses_fallback = kept.is_active | jnp.all(value == -jnp.inf)
    index = jnp.where(uses_fallback, value.shape[0], jnp.argmax(value))
    to_x, to_y, to_kind = select_row((x, y, kind), index)
    _, first_x, first_y = select_row(route, index)
    mass = valuation.stop_mass
    is_confident = (mass >= params.stop_probability) & jnp.isfinite(mass)
    question = replace(question, asks=question.asks & ~situation.is_still)
    is_goal = has_goal(situation.goals, to_x, to_y, params.reach, situation.belief.terrain.view)
    return Decision(
        waypoint_x=to_x,
        waypoint_y=to_y,
        kind=to_kind,
        is_stop=is_confident & situation.may_stop & ~question.searches_on & ~question.asks,
        next_x=first_x,
        next_y=first_y,
        is_approach=(to_kind == OBJECT_NODE) & is_goal,
        is_not_found=false,
        is_kept=kept.is_active,
        nodes=nodes,
        value=value,
        goal_value=valuation.goal_value,
        information_value=valuation.information_value,
        cost=cost,
        stop_mass=mass,
        question=question,
    )
