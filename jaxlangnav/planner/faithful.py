"""The paper's policy: maximum QMDP value, annotations assumed true (section 3.4, eq. 9-12).

Two points that the paper leaves open are resolved as follows. A chosen waypoint is kept until it
is reached, is no longer a frontier or a new object is observed, or the policy would limit-cycle.
And a_stop is allowed only if the goal probability within reach exceeds τ, as its value ties with
that of a node at the robot's position.
"""

import dataclasses
from collections.abc import Callable

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner import graph, qmdp
from jaxlangnav.planner.graph import FRONTIER, OBJECT_NODE
from jaxlangnav.planner.policy import (
    ARRIVAL_RADIUS,
    Decision,
    Policy,
    PolicyDescription,
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
    """Compute the paper's QMDP values of the nodes (eq. 11, 12), without information value."""
    params, goals = situation.params, situation.goals
    robot = situation.robot_x, situation.robot_y
    terrain, nodes = situation.belief.terrain, situation.nodes
    near_mass, _ = qmdp.mass_within(*robot, goals, params.reach, terrain.view)
    _, view_mass = qmdp.mass_within(*robot, goals, situation.range_max, terrain.view)
    value = qmdp.values(nodes.x, nodes.y, goals, params.discount, terrain.travel)
    near_mass = jnp.where(situation.is_find > 0.5, jnp.maximum(view_mass, near_mass), near_mass)
    return Valuation(goal_value=value, information_value=jnp.zeros_like(value), stop_mass=near_mass)


@dataclasses.dataclass(frozen=True)
class WaypointKeeping(Policy):
    """Policy that values the paper's nodes by a function, and keeps its waypoint while valid.

    Its memory is the current waypoint.
    """

    value: Callable[[Situation], Valuation]
    """Function from a situation to values of its nodes and goal probability within reach."""
    portrayal = PolicyDescription(place="the frontier")

    @property
    def name(self) -> str:
        """Name of the function."""
        return getattr(self.value, "__name__", "own")

    def init(self, belief: ParticleBelief) -> Waypoint:
        """Begin without an active waypoint."""
        zero = jnp.float32(0.0)
        return Waypoint(x=zero, y=zero, kind=jnp.int32(0), is_active=jnp.asarray(False))

    def step(self, key: Array, memory: Waypoint, situation: Situation) -> tuple[Waypoint, Decision]:
        """Keep the current waypoint, or select the best node."""
        # The paper's nodes: frontiers, visited positions, observed objects (eq. 9).
        coverage, miss_frac = situation.belief.coverage, situation.params.frontier_miss
        frontiers = graph.frontiers(coverage, situation.num_blocks, miss_frac)
        situation = replace(situation, nodes=graph.prepend_nodes(*frontiers, situation.nodes))
        is_kept = ~situation.is_news & _is_still_valid(memory, situation)
        decision = decide(situation, self.value(situation), replace(memory, is_active=is_kept))
        x, y, is_active = decision.waypoint_x, decision.waypoint_y, ~decision.is_stop
        return Waypoint(x=x, y=y, kind=decision.kind, is_active=is_active), decision


@dataclasses.dataclass(frozen=True)
class Faithful(WaypointKeeping):
    """The paper's policy: QMDP values over frontiers, visited positions and objects."""

    value: Callable[[Situation], Valuation] = qmdp_value
    portrayal = PolicyDescription(
        place="the frontier",
        reason="of {number} places the nearest to the goal, over all maps (value {value:.2f})",
        is_field=True,
    )

    @property
    def name(self) -> str:
        """Name of the policy in the tables."""
        return "faithful"

    def map_params(self, params: MapParams) -> MapParams:
        """Assume that every annotation is true, ε = 0."""
        return replace(params, misleading=jnp.float32(0.0))


def _is_still_valid(waypoint: Waypoint, situation: Situation) -> Array:
    """Test whether the current waypoint is neither reached nor a frontier observed meanwhile."""
    params, coverage = situation.params, situation.belief.coverage
    squared = (waypoint.x - situation.robot_x) ** 2 + (waypoint.y - situation.robot_y) ** 2
    reach = jnp.where(waypoint.kind == OBJECT_NODE, params.reach, ARRIVAL_RADIUS)
    is_pending = waypoint.is_active & (jnp.sqrt(squared) > reach)
    # A frontier is valid while an unexplored cell is left within a cell of it.
    unexplored = graph.unexplored_cells(coverage, params.frontier_miss)
    (size_x, size_y), (centre_x, centre_y) = cell_size(coverage), cell_centres(coverage)
    is_near_x = jnp.abs(centre_x - waypoint.x) <= 1.01 * size_x
    is_near_y = jnp.abs(centre_y - waypoint.y) <= 1.01 * size_y
    is_frontier = jnp.any(unexplored & is_near_y[:, None] & is_near_x[None, :])
    return is_pending & ((waypoint.kind != FRONTIER) | is_frontier)
