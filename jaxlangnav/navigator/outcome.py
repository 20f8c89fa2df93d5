"""What comes of a decision: the step that is taken, how the task stands, what is remembered."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.conversation import Conversation
from jaxlangnav.messages import Action, Status
from jaxlangnav.navigator.records import NavigatorConfig, NavigatorParams, NavigatorState, Outlook
from jaxlangnav.planner import graph, policy
from jaxlangnav.planner.goals import Goals
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import mean_drift
from jaxlangnav.semantic_map.motion import rotated


def _is_last_clause(state: NavigatorState) -> Array:
    """Tell whether nothing follows the present command, bool[]."""
    return state.clause + 1 >= state.instruction.num_clauses


def _status(
    state: NavigatorState, outlook: Outlook, choice: policy.Decision, config: NavigatorConfig
) -> Array:
    """Tell what becomes of the task, i32[] a Status: what it was where the robot stands still."""
    under_way = jnp.where(choice.is_approach, int(Status.APPROACHING), int(Status.SEARCHING))
    is_arrived = choice.is_stop & _is_last_clause(state)
    ended = jnp.where(choice.is_not_found, int(Status.NOT_FOUND), under_way)
    status = jnp.where(is_arrived, int(Status.ARRIVED), ended)
    status = jnp.where(choice.doubt.asks, int(Status.WHICH_ONE), status)
    is_blocked = state.way.num_closed > config.num_detours
    status = jnp.where(is_blocked & ~choice.is_stop, int(Status.BLOCKED), status)
    return jnp.where(outlook.stands, state.status, status)


def act(
    state: NavigatorState, outlook: Outlook, choice: policy.Decision, *, params: NavigatorParams
) -> Action:
    """Turn the choice into a step in the manner asked for: quickly, carefully.

    Limits: where it stands, the waypoint is where the robot believes itself to be.

    Args:
        state: the new one, of ``carry_on``.
        outlook: what the belief comes to.
        choice: of the policy.
        params: traced numbers.

    Returns:
        What the robot is to do.
    """
    mode = jnp.argmax(outlook.expected.mode)
    speed, clearance = params.mode_speed[mode], params.mode_clearance[mode]
    robot = jnp.stack([outlook.robot_x, outlook.robot_y])
    waypoint = jnp.stack([choice.next_x, choice.next_y])
    stands = outlook.stands | (state.is_done & ~choice.is_stop)
    waypoint = jnp.where(stands, robot, waypoint)
    travel = state.belief.terrain.travel
    here, there = (outlook.robot_x, outlook.robot_y), tuple(waypoint)
    next_x, next_y = travel.next_place(*here, *there)
    left, distance = travel.metres(*here, *there), travel.metres(*here, next_x, next_y)
    # A thing is gone up to, not into; anything else is a place to stand on.
    is_thing = (choice.kind == graph.OBJECT_NODE) & ~choice.turns
    spare = jnp.where(is_thing, policy.APPROACH * params.planner.reach, 0.0)
    length = jnp.clip(left - spare, 0.0, params.map.motion.step_length * speed)
    length = jnp.where(choice.is_stop, 0.0, jnp.minimum(length, distance))
    is_idle = state.instruction.num_clauses == 0
    step_x, step_y = next_x - here[0], next_y - here[1]
    drift = mean_drift(state.belief)
    if drift is not None:
        step_x, step_y = rotated(step_x, step_y, -drift)
    status = jnp.where(is_idle, int(Status.IDLE), state.status)
    return Action(
        waypoint=waypoint,
        step=jnp.stack([step_x, step_y]) / distance * length,
        is_stop=state.is_done & ~state.is_halted & (outlook.fault == 0),
        status=jnp.where(state.is_halted, int(Status.HALTED), status),
        speed=speed,
        clearance=clearance,
    )


def carry_on(
    state: NavigatorState,
    outlook: Outlook,
    choice: policy.Decision,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> NavigatorState:
    """Remember what the next decision needs.

    A command carried out makes way for the next one, if the instruction has one.

    Args:
        state: as the policy decided.
        outlook: what the belief comes to.
        choice: of the policy.
        params: traced numbers.
        config: how many waypoints may be given up.

    Returns:
        The state after the cycle.
    """
    is_last = _is_last_clause(state)
    # Of the objects that would do, the last command ended at the one gone up to.
    goals, robot_x, robot_y = outlook.goals, outlook.robot_x, outlook.robot_y
    travel = state.belief.terrain.travel
    away = travel.metres(robot_x, robot_y, goals.object_x, goals.object_y)[:-1]
    will_do = goals.object_accepted[:-1] * params.planner.discount**away
    goal_slot = jnp.argmax(will_do).astype(jnp.int32)
    moves_on = choice.is_stop & ~is_last
    return replace(
        state,
        clause=state.clause + moves_on.astype(jnp.int32),
        previous_goal=jnp.where(choice.is_stop, goal_slot, state.previous_goal),
        status=_status(state, outlook, choice, config),
        talk=_recall(state.talk, goals, choice, goal_slot, moves_on),
        way=replace(state.way, num_closed=jnp.where(moves_on, 0, state.way.num_closed)),
    )


def _recall(
    talk: Conversation, goals: Goals, choice: policy.Decision, goal_slot: Array, moves_on: Array
) -> Conversation:
    """Remember what the robot goes up to, for what may be said of it."""
    away = jnp.hypot(goals.object_x - choice.waypoint_x, goals.object_y - choice.waypoint_y)
    is_goal = goals.is_object & (goals.object_accepted >= policy.LEAST_GOAL)
    aimed = jnp.argmin(jnp.where(is_goal, away, jnp.inf)[:-1]).astype(jnp.int32)
    approached = jnp.where(choice.is_approach, aimed, talk.approached)
    goal_slot = jnp.where(jnp.any(is_goal[:-1]), goal_slot, talk.approached)
    return replace(
        talk,
        approached=jnp.where(choice.is_stop, goal_slot, approached),
        ruled_out=jnp.where(moves_on, 0, talk.ruled_out),
        closeness=jnp.where(moves_on, 1.0, talk.closeness),
        candidate=jnp.where(goals.is_object, goals.object_mass, 0.0)[:-1],
    )
