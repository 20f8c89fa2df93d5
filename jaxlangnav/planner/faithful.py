"""The paper's policy: the node of highest QMDP value (section 3.4, eq. 9-12).

Two things the paper leaves open are read as follows. A chosen waypoint is kept until it is
reached, is no frontier any more or something new has been seen; without this the policy
limit-cycles between a frontier and a visited node. And a_stop is open only where the goal
probability within reach exceeds τ, for its value ties with that of the node underfoot.

It takes every word to be true.
"""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner import graph, qmdp
from jaxlangnav.planner.graph import FRONTIER, OBJECT_NODE
from jaxlangnav.planner.policy import (
    UNDERFOOT,
    Decision,
    Policy,
    Portrayal,
    Situation,
    Valuation,
    Waypoint,
    decide,
)
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.coverage import cell_size
from jaxlangnav.semantic_map.params import MapParams


def no_waypoint() -> Waypoint:
    """Build the waypoint of a robot that has not chosen yet."""
    zero = jnp.float32(0.0)
    return Waypoint(x=zero, y=zero, kind=jnp.int32(0), is_active=jnp.asarray(False))


def with_frontiers(situation: Situation) -> Situation:
    """Show the paper's nodes: frontiers, places visited, objects seen (eq. 9)."""
    places = graph.frontiers(
        situation.belief.coverage, situation.num_blocks, situation.params.frontier_miss
    )
    return replace(situation, nodes=graph.put_first(*places, situation.nodes))


def qmdp_value(situation: Situation) -> Valuation:
    """Value nodes as the paper does (eq. 11, 12): by the goals that lie near, and nothing else.

    Args:
        situation: nodes, goals, where the robot is.

    Returns:
        Values, and the goal probability within reach.
    """
    params, goals = situation.params, situation.goals
    here = situation.robot_x, situation.robot_y
    terrain, nodes = situation.belief.terrain, situation.nodes
    within_reach, _ = qmdp.mass_within(*here, goals, params.reach, terrain.view)
    _, in_view = qmdp.mass_within(*here, goals, situation.range_max, terrain.view)
    goal_value = qmdp.values(nodes.x, nodes.y, goals, params.discount, terrain.travel)
    return Valuation(
        goal_value=goal_value,
        information_value=jnp.zeros_like(goal_value),
        stop_mass=jnp.where(
            situation.is_find > 0.5, jnp.maximum(in_view, within_reach), within_reach
        ),
    )


@dataclasses.dataclass(frozen=True)
class Keeping(Policy):
    """Values the paper's nodes by a function, and keeps its waypoint while it is worth it.

    Its memory is the waypoint under way.
    """

    value: Callable[[Situation], Valuation]
    """What the nodes of a situation are worth, and how sure it is that the goal is within reach."""

    @property
    def name(self) -> str:
        """That of the function."""
        return getattr(self.value, "__name__", "own")

    @property
    def portrayal(self) -> Portrayal:
        """Its own waypoints are frontiers."""
        return Portrayal(place="the frontier")

    def init(self, belief: ParticleBelief) -> Waypoint:
        """Begin on the way to nowhere."""
        del belief
        return no_waypoint()

    def step(self, key: Array, memory: Waypoint, situation: Situation) -> tuple[Waypoint, Decision]:
        """Go on to the waypoint under way, or to the best node."""
        del key
        situation = with_frontiers(situation)
        keeps = ~situation.is_news & _is_worth_keeping(memory, situation)
        decision = decide(situation, self.value(situation), replace(memory, is_active=keeps))
        after = Waypoint(
            x=decision.waypoint_x,
            y=decision.waypoint_y,
            kind=decision.kind,
            is_active=~decision.is_stop,
        )
        return after, decision


@dataclasses.dataclass(frozen=True)
class Faithful(Keeping):
    """The paper's own."""

    value: Callable[[Situation], Valuation] = qmdp_value

    @property
    def name(self) -> str:
        """As the tables have it."""
        return "faithful"

    @property
    def portrayal(self) -> Portrayal:
        """Its values are defined between the nodes, too."""
        return Portrayal(
            place="the frontier",
            reason="of {number} places the nearest to the goal, over all maps (value {value:.2f})",
            is_field=True,
        )

    def map_params(self, params: MapParams) -> MapParams:
        """Take every word to be true."""
        return replace(params, misleading=jnp.float32(0.0))


def _is_worth_keeping(waypoint: Waypoint, situation: Situation) -> Array:
    """Tell whether the waypoint under way is neither reached nor a frontier looked at by now."""
    params = situation.params
    remaining = jnp.sqrt(
        (waypoint.x - situation.robot_x) ** 2 + (waypoint.y - situation.robot_y) ** 2
    )
    return (
        waypoint.is_active
        & (remaining > jnp.where(waypoint.kind == OBJECT_NODE, params.reach, UNDERFOOT))
        & (
            (waypoint.kind != FRONTIER)
            | _is_still_frontier(situation.belief, waypoint.x, waypoint.y, params.frontier_miss)
        )
    )


def _is_still_frontier(belief: ParticleBelief, x: Array, y: Array, frontier_miss: Array) -> Array:
    """Tell whether anything unexplored is left within a cell of a frontier node."""
    coverage = belief.coverage
    unexplored = graph.unexplored_cells(coverage, frontier_miss)
    size_x, size_y = cell_size(coverage)
    steps = jnp.arange(coverage.log_miss.shape[-1]) + 0.5
    near_x = jnp.abs(coverage.area[0] + steps * size_x - x) <= 1.01 * size_x
    near_y = jnp.abs(coverage.area[2] + steps * size_y - y) <= 1.01 * size_y
    return jnp.any(unexplored & near_y[:, None] & near_x[None, :])
