"""Choosing the next waypoint, or to stop (section 3.4, eq. 9-12).

``faithful`` is the paper's policy: the node of highest QMDP value. Two things the paper leaves
open are read as follows. A chosen waypoint is kept until it is reached, is no frontier any more
or something new has been seen; without this the policy limit-cycles between a frontier and a
visited node. And a_stop is open only where the goal probability within reach exceeds τ, for its
value ties with that of the node underfoot.

``informed`` takes the tour that puts the hypotheses to the test soonest, and accepts a goal only
once everything the sentence mentions has been observed and no rival is left near what has been.
Once what is missing is hardly there at all (``endings``), it takes the likeliest thing that it has
seen; where nothing seen will do, the goal is not to be found.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner import qmdp
from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.graph import FRONTIER, OBJECT, Nodes, unexplored_cells
from jaxlangnav.planner.own import Situation, Valuation
from jaxlangnav.planner.params import PlannerConfig, PlannerParams
from jaxlangnav.planner.tours import Plan
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.coverage import cell_size
from jaxlangnav.terrain import Eye, View

LEAST_GOAL = 0.01
"""Probability below which an object is no goal: nothing is settled and nothing stops for it."""
_SETTLED = 10.0
"""Value of a goal that is settled; information values stay below 1."""
_UNDERFOOT = 0.25
"""Metres from a place that count as standing on it; an object is reached from further off."""


@pytree
class Choice:
    """What the planner decided, and why."""

    waypoint_x: Array  # f32[] metres, map frame
    waypoint_y: Array  # f32[]
    kind: Array  # i32[] kind of node it goes to
    is_stop: Array  # bool[] the goal is within reach
    is_approach: Array  # bool[] the waypoint is a thing seen that may be the goal
    is_not_found: Array  # bool[] nothing is left to look for, and there is no goal
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


def _is_worth_keeping(
    belief: ParticleBelief,
    commitment: Commitment,
    robot_x: Array,
    robot_y: Array,
    params: PlannerParams,
) -> Array:
    """Tell whether the waypoint under way is neither reached nor a frontier looked at by now."""
    remaining = jnp.sqrt((commitment.x - robot_x) ** 2 + (commitment.y - robot_y) ** 2)
    return (
        commitment.is_active
        & (remaining > jnp.where(commitment.kind == OBJECT, params.reach, _UNDERFOOT))
        & (
            (commitment.kind != FRONTIER)
            | _is_still_frontier(belief, commitment.x, commitment.y, params.frontier_miss)
        )
    )


def faithful(situation: Situation) -> Valuation:
    """Value nodes as the paper does (eq. 11, 12): by the goals that lie near, and nothing else.

    Args:
        situation: nodes, goals, where the robot is.

    Returns:
        Values, and the goal probability within reach.
    """
    params, goals = situation.params, situation.goals
    here = situation.robot_x, situation.robot_y
    terrain = situation.belief.terrain
    within_reach, _ = qmdp.mass_within(*here, goals, params.reach, terrain.view)
    _, in_view = qmdp.mass_within(*here, goals, situation.range_max, terrain.view)
    goal_value = qmdp.values(
        situation.nodes.x, situation.nodes.y, goals, params.discount, terrain.travel
    )
    return Valuation(
        goal_value=goal_value,
        information_value=jnp.zeros_like(goal_value),
        stop_mass=jnp.where(
            situation.is_find > 0.5, jnp.maximum(in_view, within_reach), within_reach
        ),
    )


class _Judgement(NamedTuple):
    """What a policy makes of a situation."""

    valuation: Valuation
    is_sure: Array  # bool[] it may stop for all it knows
    is_not_found: Array  # bool[] nothing is left to look for, and there is no goal


def informed(situation: Situation, plan: Plan, chance_left: Array) -> _Judgement:
    """Value first stops of tours by how soon they find things, until the goal is settled.

    The information value of a tour is what is still to be found divided by the metres until it
    is. A goal is settled once its object and all that the sentence places it against have been
    seen and next to nothing speaks for an unseen rival beside things seen; the object is then
    worth more than anything there is to learn. Unsettled goals break ties. Where next to nothing
    is left to be found and several things may still be meant, the likeliest has to do; so it has
    where what the goal is placed against is hardly there at all.

    Args:
        situation: nodes (first stops of the plan's tours lead), goals, where the robot is.
        plan: candidate tours.
        chance_left: f32[], probability that what is spoken of, and has not been seen, is there.

    Returns:
        Values, with the confirmed goal probability within reach; whether no rival is left.
    """
    params, goals, nodes = situation.params, situation.goals, situation.nodes
    here = situation.robot_x, situation.robot_y
    has_looked = chance_left < params.give_up
    goals = replace(
        goals,
        object_confirmed=jnp.where(has_looked, goals.object_accepted, goals.object_confirmed),
    )
    terrain = situation.belief.terrain
    _, within_reach = qmdp.mass_within(*here, goals, params.reach, terrain.view)
    _, in_view = qmdp.mass_within(*here, goals, situation.range_max, terrain.view)
    metres = plan.latency / jnp.maximum(plan.mass, 1e-6)
    no_tours = jnp.zeros(nodes.x.shape[0] - metres.shape[0], jnp.float32)
    goal_value = 0.01 * qmdp.values(nodes.x, nodes.y, goals, params.discount, terrain.travel)
    confirmed = jnp.max(goals.object_confirmed)
    rest = jnp.sum(goals.hypothesis_mass)
    is_doubtful = (rest <= params.rest_share * confirmed) & (confirmed < params.stop_probability)
    is_exhausted = (is_doubtful | has_looked) & (confirmed >= LEAST_GOAL)
    is_sure = (plan.hung <= params.rival_share * confirmed) | is_exhausted
    is_settled = is_sure & ((confirmed >= params.stop_probability) | is_exhausted)
    arrived = jnp.where(situation.is_find > 0.5, in_view, within_reach)
    # The mass within reach of a candidate may be spread over neighbours: nine tenths of it count.
    will_do = is_exhausted & (arrived >= 0.9 * confirmed)
    first_object = nodes.x.shape[0] - goals.object_x.shape[0]
    is_goal = jnp.arange(nodes.x.shape[0]) == first_object + jnp.argmax(goals.object_confirmed)
    valuation = Valuation(
        goal_value=jnp.where(is_goal & is_settled, _SETTLED, goal_value),
        information_value=jnp.concatenate([plan.mass / (1.0 + metres), no_tours]),
        stop_mass=jnp.where(will_do, jnp.maximum(arrived, params.stop_probability), arrived),
    )
    return _Judgement(valuation, is_sure, has_looked & (confirmed < LEAST_GOAL))


def _judge(
    situation: Situation, plan: Plan | None, chance_left: Array | None, config: PlannerConfig
) -> _Judgement:
    """Value the nodes as the policy does."""
    if config.policy == "informed":
        if plan is None or chance_left is None:
            raise ValueError("the informed policy chooses among tours: plan them first")
        return informed(situation, plan, chance_left)
    valuation = config.policy(situation) if callable(config.policy) else faithful(situation)
    return _Judgement(valuation, jnp.asarray(True), jnp.asarray(False))


def _aim(
    situation: Situation, value: Array, commitment: Commitment, is_news: Array, *, may_keep: bool
) -> tuple[Commitment, Array]:
    """Pick the best open node, or keep the waypoint under way; bool[] tells whether it was kept."""
    nodes = situation.nodes
    robot_x, robot_y = situation.robot_x, situation.robot_y
    best = jnp.argmax(value)
    nowhere = jnp.all(value == -jnp.inf)
    chosen = Commitment(
        x=jnp.where(nowhere, robot_x, nodes.x[best]),
        y=jnp.where(nowhere, robot_y, nodes.y[best]),
        kind=nodes.kind[best],
        is_active=jnp.asarray(True),
    )
    if not may_keep:
        return chosen, jnp.asarray(False)
    keeps = ~is_news & _is_worth_keeping(
        situation.belief, commitment, robot_x, robot_y, situation.params
    )
    return jax.tree.map(lambda kept, new: jnp.where(keeps, kept, new), commitment, chosen), keeps


def _has_goal(goals: Goals, x: Array, y: Array, radius: Array, view: View) -> Array:
    """Tell whether something seen that may be the goal is in sight of a place and near, bool[]."""
    is_near = view.sees(Eye(x, y, radius), goals.object_x, goals.object_y)
    share = jnp.where(is_near, goals.object_accepted, 0.0)
    return jnp.any(goals.is_object & jnp.isfinite(share) & (share >= LEAST_GOAL))


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
    plan: Plan | None = None,
    chance_left: Array | None = None,
) -> Choice:
    """Pick the waypoint of highest value, or stop (eq. 10).

    Limits: no stop without a goal that has been seen and is within reach; a value that is no
    number closes its node, and with all of them closed the waypoint is where the robot stands.

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
        plan: candidate tours, whose first stops lead the nodes; for ``informed``.
        chance_left: f32[], probability that what is missing is there at all; for ``informed``.

    Returns:
        The choice.

    Raises:
        ValueError: ``informed`` without a plan or without that probability.
    """
    terrain = belief.terrain
    distance = terrain.travel.metres(robot_x, robot_y, nodes.x, nodes.y)
    situation = Situation(
        belief=belief,
        nodes=nodes,
        goals=goals,
        distance=distance,
        robot_x=robot_x,
        robot_y=robot_y,
        range_max=range_max,
        is_find=is_find,
        params=params,
    )
    valuation, is_sure, is_not_found = _judge(situation, plan, chance_left, config)
    value = valuation.goal_value + valuation.information_value - cost
    # Standing still teaches nothing: the node underfoot is a_stop's business.
    is_open = nodes.is_node & (distance > jnp.where(nodes.kind == OBJECT, params.reach, _UNDERFOOT))
    value = jnp.where(is_open & ~jnp.isnan(value), value, -jnp.inf)
    aim, is_kept = _aim(situation, value, commitment, is_news, may_keep=config.policy != "informed")
    # Of "find", it is enough to have it in view. Whatever a policy makes of it, there is no
    # arriving where there is no goal.
    reach = params.reach
    radius = jnp.where(is_find > 0.5, jnp.maximum(reach, range_max), reach)
    return Choice(
        waypoint_x=aim.x,
        waypoint_y=aim.y,
        kind=aim.kind,
        is_stop=(valuation.stop_mass >= params.stop_probability)
        & jnp.isfinite(valuation.stop_mass)
        & is_sure
        & _has_goal(goals, robot_x, robot_y, radius, terrain.view),
        is_approach=(aim.kind == OBJECT) & _has_goal(goals, aim.x, aim.y, reach, terrain.view),
        is_not_found=is_not_found,
        is_kept=is_kept,
        value=value,
        goal_value=valuation.goal_value,
        information_value=valuation.information_value,
        cost=cost,
        stop_mass=valuation.stop_mass,
    )
