"""From what waypoints are worth to a decision: rules that are the same for all policies (eq. 10).

A way round what is to be kept away from costs, nobody goes where he stands, and nobody stops unless
something that has been seen and may be the goal is within reach.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.numerics.batching import select_row
from jaxlangnav.planner import graph
from jaxlangnav.planner.blocked import open_nodes
from jaxlangnav.planner.detours import detours
from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.graph import FRONTIER, OBJECT_NODE
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.planner.questions import AskDecision, value_of_asking
from jaxlangnav.planner.situation import Decision, Situation, Valuation, Waypoint
from jaxlangnav.pytree import replace
from jaxlangnav.terrain import OPEN, Eye, View

LEAST_GOAL = 0.01
"""Probability below which an object is no goal: nothing is settled and nothing stops for it."""
UNDERFOOT = 0.25
"""Metres from a place that count as standing on it; an object is reached from further off."""
APPROACH = 0.9
"""Share of ``reach`` at which the robot halts before an object that it goes to."""
_HALF_WORTH = 10.0  # metres of detour for which a place is worth half as much


def has_goal(goals: Goals, x: Array, y: Array, radius: Array, view: View) -> Array:
    """Tell whether something seen that may be the goal is in sight of a place and near, bool[]."""
    is_near = view.sees(Eye(x, y, radius), goals.object_x, goals.object_y)
    share = jnp.where(is_near, goals.object_accepted, 0.0)
    return jnp.any(goals.is_object & jnp.isfinite(share) & (share >= LEAST_GOAL))


def may_stop(
    goals: Goals, eye: Eye, is_find: Array, *, params: PlannerParams, view: View = OPEN.view
) -> Array:
    """Tell whether something that has been seen and may be the goal is within reach, bool[].

    Whatever a policy says, otherwise there is no stop.

    Args:
        goals: weighed goals.
        eye: where the robot is, and how far it sees.
        is_find: f32[], probability that "find" is asked for: to have it in view is then enough.
        params: reach.
        view: what can be seen; a thing behind a wall is not within reach.
    """
    radius = jnp.where(is_find > 0.5, jnp.maximum(params.reach, eye.range_max), params.reach)
    return has_goal(goals, eye.x, eye.y, radius, view)


def ahead(situation: Situation, x: Array, y: Array, is_node: Array | None = None) -> Situation:
    """Put waypoints of a policy's own before those that every policy is shown.

    Limits: a place that is no number is no waypoint.

    Args:
        situation: as shown to the policy.
        x: f32[K], metres, map frame.
        y: f32[K], metres.
        is_node: bool[K], which of them are waypoints; all of them by default.
    """
    is_place = jnp.isfinite(x) & jnp.isfinite(y)
    is_node = is_place if is_node is None else is_node & is_place
    return replace(situation, nodes=graph.put_first(x, y, is_node, situation.nodes))


def _value(
    situation: Situation, valuation: Valuation, longer: Array, doubt: AskDecision
) -> tuple[Array, Array]:
    """Value the nodes, f32[A], −∞ where the robot may not go, and cost their longer ways."""
    nodes, shape = situation.nodes, situation.nodes.x.shape
    for name in ("goal_value", "information_value"):
        found = jnp.shape(getattr(valuation, name))
        if found != shape:
            raise ValueError(
                f"{name} has shape {found}, but must have {shape}: one value for each of "
                "situation.nodes"
            )
    worth = valuation.goal_value + valuation.information_value
    share = longer / (longer + _HALF_WORTH)
    cost = jnp.where(longer > 0.0, share * jnp.minimum(jnp.abs(worth), 1e9), 0.0)
    value = worth - cost
    is_object = nodes.kind == OBJECT_NODE
    # Standing still teaches nothing: the node underfoot is a_stop's business.
    is_away = situation.distance > jnp.where(is_object, situation.params.reach, UNDERFOOT)
    # While there is more to be seen first, nothing is gone up to.
    is_open = open_nodes(nodes, situation.way).is_node & (~doubt.looks_on | ~is_object)
    return jnp.where(is_open & is_away & ~jnp.isnan(value), value, -jnp.inf), cost


def decide(
    situation: Situation,
    valuation: Valuation,
    kept: Waypoint | None = None,
    doubt: AskDecision | None = None,
) -> Decision:
    """Pick the waypoint of highest value, or stop (eq. 10).

    Limits: no stop without a goal that has been seen and is within reach; a value that is no
    number closes its node, and with all of them closed the waypoint is where the robot stands.

    Args:
        situation: nodes, goals, where the robot is.
        valuation: what its nodes are worth, and whether to stop.
        kept: a waypoint that is gone on to, if it is active, whatever the nodes are worth.
        doubt: whether to ask which one is meant; by default among what has been seen.

    Raises:
        ValueError: the values are not one for each node.
    """
    nodes, params = situation.nodes, situation.params
    x, y, no = situation.robot_x, situation.robot_y, jnp.asarray(False)
    here = Waypoint(x=x, y=y, kind=jnp.int32(FRONTIER), is_active=no)
    kept = here if kept is None else kept
    # The last place is what is under way already, or where the robot is.
    last = jax.tree.map(lambda one, other: jnp.where(kept.is_active, one, other), kept, here)
    x, y = jnp.append(nodes.x, last.x), jnp.append(nodes.y, last.y)
    kind = jnp.append(nodes.kind, last.kind)
    way = detours(situation, x, y, jnp.where(kind == OBJECT_NODE, APPROACH * params.reach, 0.0))
    if doubt is None:  # who plans no tour does not look on for more than has been seen
        of_seen = {"has_looked": True, "may_ask": situation.may_ask}
        doubt = value_of_asking(situation.goals, jnp.float32(0.0), params=params, **of_seen)
    value, cost = _value(situation, valuation, way[0][:-1], doubt)
    is_last = kept.is_active | jnp.all(value == -jnp.inf)
    index = jnp.where(is_last, value.shape[0], jnp.argmax(value))
    to_x, to_y, to_kind = select_row((x, y, kind), index)
    _, first_x, first_y = select_row(way, index)
    mass = valuation.stop_mass
    is_sure = (mass >= params.stop_probability) & jnp.isfinite(mass)
    doubt = replace(doubt, asks=doubt.asks & ~situation.stands)
    is_goal = has_goal(situation.goals, to_x, to_y, params.reach, situation.belief.terrain.view)
    return Decision(
        waypoint_x=to_x,
        waypoint_y=to_y,
        kind=to_kind,
        is_stop=is_sure & situation.may_stop & ~doubt.looks_on & ~doubt.asks,
        next_x=first_x,
        next_y=first_y,
        is_approach=(to_kind == OBJECT_NODE) & is_goal,
        is_not_found=no,
        is_kept=kept.is_active,
        nodes=nodes,
        value=value,
        goal_value=valuation.goal_value,
        information_value=valuation.information_value,
        cost=cost,
        stop_mass=mass,
        doubt=doubt,
    )
