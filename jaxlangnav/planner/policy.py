"""Choosing the next waypoint, or to stop (section 3.4, eq. 9-12).

``faithful`` is the paper's policy: the node of highest QMDP value. Two things the paper leaves
open are read as follows. A chosen waypoint is kept until it is reached, is no frontier any more
or something new has been seen; without this the policy limit-cycles between a frontier and a
visited node. And a_stop is open only where the goal probability within reach exceeds τ, for its
value ties with that of the node underfoot.

``informed`` goes where the hypotheses are put to the test soonest, and accepts a goal only once
everything the sentence mentions has been observed.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner import qmdp
from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.graph import FRONTIER, OBJECT, Nodes, unexplored_cells
from jaxlangnav.planner.params import PlannerConfig, PlannerParams
from jaxlangnav.planner.search import latency, search_map
from jaxlangnav.pytree import pytree
from jaxlangnav.semantic_map.coverage import cell_size
from jaxlangnav.semantic_map.filter import ParticleBelief

_UNDERFOOT = 0.25
"""Metres from a place that count as standing on it; an object is reached from further off."""


@pytree
class Choice:
    """What the planner decided, and why."""

    waypoint_x: Array  # f32[] metres, map frame
    waypoint_y: Array  # f32[]
    kind: Array  # i32[] kind of node it goes to
    is_stop: Array  # bool[]
    is_kept: Array  # bool[] the former waypoint was kept
    value: Array  # f32[A] value of every node; −∞ where there is none
    goal_value: Array  # f32[A] part of it from goals
    information_value: Array  # f32[A] part of it from what the way would reveal
    cost: Array  # f32[A] part of it lost to constraint regions
    stop_mass: Array  # f32[] goal probability within reach


@pytree
class Commitment:
    """The waypoint the robot is on its way to."""

    x: Array  # f32[] metres, map frame
    y: Array  # f32[]
    kind: Array  # i32[]
    is_active: Array  # bool[]


def no_commitment() -> Commitment:
    """Build the commitment of a robot that has not chosen yet."""
    zero = jnp.float32(0.0)
    return Commitment(x=zero, y=zero, kind=jnp.int32(0), is_active=jnp.asarray(False))


def _is_still_frontier(belief: ParticleBelief, x: Array, y: Array, frontier_miss: Array) -> Array:
    """Tell whether anything unexplored is left within a cell of a frontier node."""
    coverage = belief.coverage
    unexplored = unexplored_cells(coverage, frontier_miss)
    size_x, size_y = cell_size(coverage)
    steps = jnp.arange(coverage.log_miss.shape[-1]) + 0.5
    near_x = jnp.abs(coverage.area[0] + steps * size_x - x) <= 1.01 * size_x
    near_y = jnp.abs(coverage.area[2] + steps * size_y - y) <= 1.01 * size_y
    return jnp.any(unexplored & near_y[:, None] & near_x[None, :])


def choose(
    belief: ParticleBelief,
    nodes: Nodes,
    goals: Goals,
    robot_x: Array,
    robot_y: Array,
    commitment: Commitment,
    is_news: Array,
    is_find: Array,
    range_max: Array,
    cost: Array,
    *,
    params: PlannerParams,
    config: PlannerConfig,
) -> Choice:
    """Pick the waypoint of highest value, or stop (eq. 10).

    Args:
        belief: weighted particles.
        nodes: candidate waypoints.
        goals: weighed goals.
        robot_x: f32[], metres, map frame.
        robot_y: f32[], metres.
        commitment: the waypoint under way.
        is_news: bool[], something new has been seen or heard in this step.
        is_find: f32[], probability that the action asked for is "find": stop once it is in view.
        range_max: f32[], sensing range, metres.
        cost: f32[A], cost of each node from constraint regions.
        params: traced numbers.
        config: policy.

    Returns:
        The choice.
    """
    distance = jnp.sqrt((nodes.x - robot_x) ** 2 + (nodes.y - robot_y) ** 2 + 1e-9)
    everything, confirmed = qmdp.mass_within(robot_x, robot_y, goals, params.reach)
    in_view, in_view_confirmed = qmdp.mass_within(robot_x, robot_y, goals, range_max)
    goal_value = qmdp.values(nodes.x, nodes.y, goals, params.discount)
    no_information = jnp.zeros_like(goal_value)
    if config.policy == "faithful":
        information_value = no_information
        value = goal_value - cost
        stop_mass = jnp.where(is_find > 0.5, jnp.maximum(in_view_confirmed, everything), everything)
        is_arrived = stop_mass >= params.stop_probability
    else:
        del in_view
        search = search_map(belief)
        _, rate, expected = latency(
            belief, search, robot_x, robot_y, range_max, params.information_offset
        )
        # What is still to be found, per metre until it is: viewpoints without a tour come last.
        left = jnp.sum(search.mass)
        metres = expected / jnp.maximum(left, 1e-6)
        rank = jnp.where(jnp.isfinite(expected), left / (1.0 + metres), 1e-3 * rate)
        information_value = jnp.zeros_like(goal_value).at[: rank.shape[0]].set(rank)
        best_confirmed = jnp.max(goals.object_confirmed)
        size = goals.object_x.shape[0]
        is_sure = jnp.arange(nodes.x.shape[0]) == (
            nodes.x.shape[0] - size + jnp.argmax(goals.object_confirmed)
        )
        is_settled = best_confirmed >= params.stop_probability
        # A settled goal is worth more than anything there is to learn.
        goal_value = jnp.where(is_sure & is_settled, 10.0, 0.01 * goal_value)
        value = goal_value + information_value - cost
        stop_mass = jnp.where(is_find > 0.5, in_view_confirmed, confirmed)
        is_arrived = stop_mass >= params.stop_probability
    # Standing still teaches nothing: the node underfoot is a_stop's business.
    is_open = nodes.is_node & (distance > jnp.where(nodes.kind == OBJECT, params.reach, _UNDERFOOT))
    value = jnp.where(is_open, value, -jnp.inf)
    best = jnp.argmax(value)
    remaining = jnp.sqrt((commitment.x - robot_x) ** 2 + (commitment.y - robot_y) ** 2)
    keeps = (
        commitment.is_active
        & ~is_news
        & (remaining > jnp.where(commitment.kind == OBJECT, params.reach, _UNDERFOOT))
        & (
            (commitment.kind != FRONTIER)
            | _is_still_frontier(belief, commitment.x, commitment.y, params.frontier_miss)
        )
        & ((commitment.kind != OBJECT) | (config.policy == "faithful"))
    )
    nowhere = ~jnp.any(is_open)
    waypoint_x = jnp.where(keeps, commitment.x, jnp.where(nowhere, robot_x, nodes.x[best]))
    waypoint_y = jnp.where(keeps, commitment.y, jnp.where(nowhere, robot_y, nodes.y[best]))
    return Choice(
        waypoint_x=waypoint_x,
        waypoint_y=waypoint_y,
        kind=jnp.where(keeps, commitment.kind, nodes.kind[best]),
        is_stop=is_arrived,
        is_kept=keeps,
        value=value,
        goal_value=goal_value,
        information_value=information_value,
        cost=cost,
        stop_mass=stop_mass,
    )
