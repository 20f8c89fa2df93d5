"""The paper's policy: the node of highest QMDP value; every word is true (section 3.4, eq. 9-12).

Two things the paper leaves open are read as follows. A chosen waypoint is kept until it is
reached, is no frontier any more or something new has been seen, or the policy would limit-cycle.
And a_stop is open only where the goal probability within reach exceeds τ, for its value ties with
that of the node underfoot.
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
from jaxlangnav.semantic_map.coverage import cell_centres, cell_size
from jaxlangnav.semantic_map.params import MapParams


def qmdp_value(situation: Situation) -> Valuation:
    """Value nodes as the paper does (eq. 11, 12): by the goals that lie near, and nothing else."""
    params, goals = situation.params, situation.goals
    here = situation.robot_x, situation.robot_y
    terrain, nodes = situation.belief.terrain, situation.nodes
    mass, _ = qmdp.mass_within(*here, goals, params.reach, terrain.view)
    _, in_view = qmdp.mass_within(*here, goals, situation.range_max, terrain.view)
    value = qmdp.values(nodes.x, nodes.y, goals, params.discount, terrain.travel)
    mass = jnp.where(situation.is_find > 0.5, jnp.maximum(in_view, mass), mass)
    return Valuation(goal_value=value, information_value=jnp.zeros_like(value), stop_mass=mass)


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
        zero = jnp.float32(0.0)
        return Waypoint(x=zero, y=zero, kind=jnp.int32(0), is_active=jnp.asarray(False))

    def step(self, key: Array, memory: Waypoint, situation: Situation) -> tuple[Waypoint, Decision]:
        """Go on to the waypoint under way, or to the best node."""
        # The paper's nodes: frontiers, places visited, objects seen (eq. 9).
        coverage, least = situation.belief.coverage, situation.params.frontier_miss
        places = graph.frontiers(coverage, situation.num_blocks, least)
        situation = replace(situation, nodes=graph.put_first(*places, situation.nodes))
        keeps = ~situation.is_news & _is_worth_keeping(memory, situation)
        decision = decide(situation, self.value(situation), replace(memory, is_active=keeps))
        x, y, goes_on = decision.waypoint_x, decision.waypoint_y, ~decision.is_stop
        return Waypoint(x=x, y=y, kind=decision.kind, is_active=goes_on), decision


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
    params, coverage = situation.params, situation.belief.coverage
    squared = (waypoint.x - situation.robot_x) ** 2 + (waypoint.y - situation.robot_y) ** 2
    reach = jnp.where(waypoint.kind == OBJECT_NODE, params.reach, UNDERFOOT)
    is_on_the_way = waypoint.is_active & (jnp.sqrt(squared) > reach)
    # Of a frontier anything unexplored must be left within a cell.
    unexplored = graph.unexplored_cells(coverage, params.frontier_miss)
    (size_x, size_y), (centre_x, centre_y) = cell_size(coverage), cell_centres(coverage)
    near_x = jnp.abs(centre_x - waypoint.x) <= 1.01 * size_x
    near_y = jnp.abs(centre_y - waypoint.y) <= 1.01 * size_y
    is_frontier = jnp.any(unexplored & near_y[:, None] & near_x[None, :])
    return is_on_the_way & ((waypoint.kind != FRONTIER) | is_frontier)
