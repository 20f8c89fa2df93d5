"""Decision rules of all policies: from the values of waypoints to a waypoint or stop (eq. 10).

Detours around keep-out zones cost value, the robot's position is no waypoint, and a stop needs an
observed object within reach that may be the goal.
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
from jaxlangnav.planner.questions import AskDecision, decide_question
from jaxlangnav.planner.situation import Decision, Situation, Valuation, Waypoint
from jaxlangnav.pytree import replace
from jaxlangnav.terrain import OPEN, Eye, View

MIN_GOAL_PROB = 0.01
"""Minimum probability of an object to be a goal, that is to end a search or to allow a stop."""
ARRIVAL_RADIUS = 0.25
"""Metres within which a waypoint counts as reached; for objects see ``APPROACH``."""
APPROACH = 0.9
"""Fraction of ``reach`` at which the robot halts before an object that it approaches."""
_HALF_VALUE = 10.0  # metres of detour that halve the value of a waypoint


def has_goal(goals: Goals, x: Array, y: Array, radius: Array, view: View) -> Array:
    """Test whether an observed object that may be the goal is near and in view, bool[]."""
    is_near = view.sees(Eye(x, y, radius), goals.object_x, goals.object_y)
    accepted = jnp.where(is_near, goals.object_accepted, 0.0)
    return jnp.any(goals.is_object & jnp.isfinite(accepted) & (accepted >= MIN_GOAL_PROB))


def may_stop(
    goals: Goals, eye: Eye, is_find: Array, *, params: PlannerParams, view: View = OPEN.view
) -> Array:
    """Test whether an observed object that may be the goal is within reach, bool[].

    Otherwise there is no stop, whatever a policy decides.

    Args:
        goals: goal distribution.
        eye: position of the robot, and sensing range.
        is_find: f32[], probability of the action "find", for which having it in view is enough.
        params: reach.
        view: lines of sight; an object behind a wall is not within reach.
    """
    radius = jnp.where(is_find > 0.5, jnp.maximum(params.reach, eye.range_max), params.reach)
    return has_goal(goals, eye.x, eye.y, radius, view)


def ahead(situation: Situation, x: Array, y: Array, is_node: Array | None = None) -> Situation:
    """Prepend a policy's custom waypoints to the common nodes.

    Limits: a position that is not finite is no waypoint.

    Args:
        situation: as given to the policy.
        x: f32[K], metres, map frame.
        y: f32[K], metres.
        is_node: bool[K], which of them are waypoints; all of them by default.
    """
    is_finite = jnp.isfinite(x) & jnp.isfinite(y)
    is_node = is_finite if is_node is None else is_node & is_finite
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
