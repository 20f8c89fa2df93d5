"""The agent: one decision cycle from an observation to an action (Figure 2 of the paper).

``step`` is a pure function of arrays: filter the semantic map, infer the behavior in every
particle, choose a waypoint. It knows nothing of where observations come from; a simulated world,
a physics simulator and a robot drive it alike.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav import conversation
from jaxlangnav.conversation import Conversation, Words
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.program import NUM_TYPES
from jaxlangnav.messages import (
    ACTIONS,
    NONE,
    Action,
    Behavior,
    Fault,
    Observation,
    Status,
    default_sensor,
)
from jaxlangnav.numerics.batching import row_of
from jaxlangnav.planner import graph, policy, search, tours
from jaxlangnav.planner.asking import Doubt, doubt_of
from jaxlangnav.planner.blocked import Way, open_nodes, start_of_way, watch
from jaxlangnav.planner.constraints import constraint_cost
from jaxlangnav.planner.endings import chance_left
from jaxlangnav.planner.goals import Goals, gather
from jaxlangnav.planner.params import PlannerConfig, PlannerParams, default_planner_params
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.behaviors import infer_behaviors
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.filter import FilterInfo
from jaxlangnav.semantic_map.params import MapConfig, MapParams, default_map_params
from jaxlangnav.semantic_map.soundness import DEVIATIONS

_PLANNING = 77
"""Folded into a cycle's key for the planner; beyond the keys that the filter splits it into."""
_SPARE = 0.01
"""Metres by which odometry may round up what the robot has been sent."""
_APPROACH = 0.9
"""Share of ``reach`` at which the robot halts before an object that it goes to."""


@pytree
class NavigatorParams:
    """Everything a sweep may vary; traced."""

    map: MapParams
    planner: PlannerParams
    mode_speed: Array  # f32[3] factor on the step length: normal, quickly, carefully
    mode_clearance: Array  # f32[3] metres kept from objects


@dataclasses.dataclass(frozen=True, kw_only=True)
class NavigatorConfig:
    """Sizes and policy; hashable, a change recompiles."""

    map: MapConfig = dataclasses.field(default_factory=MapConfig)
    planner: PlannerConfig = dataclasses.field(default_factory=PlannerConfig)
    patience: int = 10
    """Cycles without any way made after which a waypoint is given up for another."""
    num_detours: int = 3
    """Waypoints that may be given up before the way counts as blocked."""

    def __post_init__(self) -> None:
        """Refuse sizes that do not fit together."""
        if self.map.num_cells % self.planner.num_blocks:
            raise ValueError(
                f"num_cells is {self.map.num_cells}, but must be a multiple of "
                f"num_blocks, {self.planner.num_blocks}"
            )
        if self.planner.policy == "informed" and self.map.num_cells % search.CELLS:
            raise ValueError(
                f"num_cells is {self.map.num_cells}, but must be a multiple of {search.CELLS} "
                "for the informed policy's search map"
            )


@pytree
class NavigatorState:
    """What the next decision needs."""

    belief: ParticleBelief
    instruction: Instruction
    clause: Array  # i32[] which of the instruction's commands is being carried out
    previous_goal: Array  # i32[] observed slot at which the last command ended; NONE at first
    visited: graph.Visited
    commitment: policy.Commitment
    tour: tours.Tour  # where ``informed`` is looking next, and after that
    status: Array  # i32[] a Status: of the task after the last cycle, whether halted or not
    is_halted: Array  # bool[] it was told to halt
    talk: Conversation  # what has been said besides, and ruled out
    way: Way  # whether it gets on, and the waypoints given up

    @property
    def is_done(self) -> Array:
        """Whether the task has ended, unless more is heard: it is carried out, or cannot be.

        bool[].
        """
        endings = (Status.ARRIVED, Status.NOT_FOUND, Status.WHICH_ONE, Status.BLOCKED)
        return functools.reduce(jnp.logical_or, [self.status == one for one in endings])

    @property
    def is_resting(self) -> Array:
        """Whether the robot stands still until it hears something, bool[]."""
        return self.is_halted | self.is_done | (self.status == Status.IDLE)


@pytree
class NavigatorInfo:
    """What a person or a test wants to know of one decision."""

    filter: FilterInfo
    fault: Array  # i32[] bits of messages.Fault: why the robot stands still; 0: it need not
    choice: policy.Choice
    nodes: graph.Nodes
    goals: Goals
    behavior: Behavior  # expectation over particles
    robot: Array  # f32[2] believed position, metres, map frame


def default_params() -> NavigatorParams:
    """Build the parameters used in all tables unless they say otherwise."""
    return NavigatorParams(
        map=default_map_params(),
        planner=default_planner_params(),
        mode_speed=jnp.array([1.0, 1.5, 0.6], jnp.float32),
        mode_clearance=jnp.array([0.3, 0.2, 0.6], jnp.float32),
    )


def check(params: NavigatorParams) -> None:
    """Refuse parameters with which the robot could never stop (host only).

    With one candidate seen and nothing else explored, its posterior is 1 / (1 + α): a τ above
    that sends the robot through the whole area first.

    Args:
        params: concrete parameters.

    Raises:
        ValueError: names the value, the limit and the remedy.
    """
    alpha = float(jnp.max(params.map.concentration))
    tau = float(jnp.max(params.planner.stop_probability))
    gamma = float(jnp.max(params.planner.discount))
    limit = 1.0 / (1.0 + alpha)
    if not 0.0 < gamma < 1.0:
        raise ValueError(f"discount is {gamma:g}, but must lie between 0 and 1")
    if not 0.0 < tau < 1.0:
        raise ValueError(f"stop_probability is {tau:g}, but must lie between 0 and 1")
    if alpha <= 0.0:
        raise ValueError(f"concentration is {alpha:g}, but must be positive")
    if tau >= limit:
        raise ValueError(
            f"stop_probability is {tau:g}, but with concentration {alpha:g} the first candidate "
            f"seen has probability {limit:.2f}: lower stop_probability below it or lower "
            "concentration"
        )


def start(
    instruction: Instruction,
    pose: Array,
    area: Array,
    *,
    config: NavigatorConfig,
    num_types: int = NUM_TYPES,
    words: Words | None = None,
) -> NavigatorState:
    """Build the state of a robot that has just been told what to do.

    With a pose or an area that cannot be, as a batch may hold, it will stand still and say so.

    Args:
        instruction: grounded sentence.
        pose: f32[3], x, y, heading, metres and radians, map frame.
        area: f32[4], operating area x_min, x_max, y_min, y_max, metres.
        config: sizes.
        num_types: object types that a detection may name.
        words: what the readings are about, where more may be said (``hearing``); by default the
            task speaks of all of it.

    Returns:
        The state before the first observation.
    """
    num_mentions = instruction.readings.mention_type.shape[-1]
    belief = semantic_filter.start(pose, area, num_mentions, config.map, num_types=num_types)
    return NavigatorState(
        belief=belief,
        instruction=instruction,
        clause=jnp.int32(0),
        previous_goal=jnp.int32(NONE),
        visited=graph.nowhere(config.planner.num_visited),
        commitment=policy.no_commitment(),
        tour=tours.no_tour(belief.last_pose[0], belief.last_pose[1]),
        status=jnp.int32(Status.SEARCHING),
        is_halted=jnp.asarray(False),
        talk=conversation.begin(instruction, belief.last_pose, config.map.num_objects, words),
        way=start_of_way(belief.last_pose),
    )


class _Outlook(NamedTuple):
    """What a belief comes to: where the robot is, what it is asked to do, and where."""

    fault: Array  # i32[] bits of Fault; 0 for a sound look and a task
    belief: ParticleBelief  # as far as the task speaks of it
    stands: Array  # bool[] the robot stands still: for a fault, or as it has been told or has ended
    robot_x: Array  # f32[] believed position, metres, map frame
    robot_y: Array  # f32[]
    behavior: Behavior  # leaves [..., P]
    expected: Behavior  # expectation over particles
    goals: Goals


class _Decision(NamedTuple):
    """What the planner has found and chosen."""

    visited: graph.Visited
    plan: tours.Plan | None  # of ``informed``
    nodes: graph.Nodes
    choice: policy.Choice
    way: Way
    doubt: Doubt


def step(
    key: Array,
    state: NavigatorState,
    observation: Observation,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> tuple[NavigatorState, Action, NavigatorInfo]:
    """Run one decision cycle: from an observation to an action.

    An observation that cannot be is left out as a whole (``semantic_map.soundness``): the robot
    stands still, does not stop, and ``info.fault`` says why, until a sound one comes.

    Args:
        key: random key, consumed.
        state: after the last cycle.
        observation: pose and detections now.
        params: traced numbers.
        config: sizes and policy.

    Returns:
        The new state, what the robot is to do, and why.
    """
    params = _as_told(state, params)
    state, filter_info = _observe(key, state, observation, params, config)
    is_asked = (state.instruction.num_clauses > 0) | (state.status == Status.IDLE)
    fault = filter_info.fault + jnp.where(is_asked, 0, int(Fault.COMMAND))
    range_max = jnp.where(fault == 0, observation.sensor.range_max, default_sensor().range_max)
    outlook = _infer(state, fault, params)
    decision = _decide(key, state, outlook, range_max, filter_info.is_news, params, config)
    after = _carry_on(state, outlook, decision, params, config)
    action = _act(after, outlook, decision.choice, params)
    info = NavigatorInfo(
        filter=filter_info,
        fault=fault,
        choice=decision.choice,
        nodes=decision.nodes,
        goals=outlook.goals,
        behavior=outlook.expected,
        robot=jnp.stack([outlook.robot_x, outlook.robot_y]),
    )
    return after, action, info


def _as_told(state: NavigatorState, params: NavigatorParams) -> NavigatorParams:
    """Go as close as the robot has been told to."""
    reach = params.planner.reach * state.talk.closeness
    return replace(params, planner=replace(params.planner, reach=reach))


def _observe(
    key: Array,
    state: NavigatorState,
    observation: Observation,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> tuple[NavigatorState, FilterInfo]:
    """Filter the semantic map by what is seen and by what the words say of it (section 3.2)."""
    # The paper's own policy takes every word to be true.
    trusts = config.planner.policy == "faithful"
    map_params = replace(params.map, misleading=jnp.float32(0.0)) if trusts else params.map
    motion = params.map.motion
    # One cycle's step at the highest speed, as far as odometry may be out.
    farthest = jnp.max(params.mode_speed) * motion.step_length
    farthest = farthest * (1.0 + DEVIATIONS * motion.odometry_noise) + _SPARE
    # A command is meant as it was seen from where it was heard.
    viewer = row_of(state.talk.viewer, state.clause)
    belief, info = semantic_filter.step(
        key,
        replace(state.belief, viewer=viewer),
        state.instruction.readings,
        observation,
        params=map_params,
        told=state.talk.told,
        is_sparse=True,
        farthest=farthest,
    )
    return replace(state, belief=belief), info


def _infer(state: NavigatorState, fault: Array, params: NavigatorParams) -> _Outlook:
    """Infer the behavior of the present clause, and where its goal may be (section 3.3)."""
    belief = state.belief
    behavior = infer_behaviors(
        belief.particles, state.instruction, state.clause, state.previous_goal
    )
    readings, talk = state.instruction.readings, state.talk
    behavior = conversation.without(behavior, talk.ruled_out)
    behavior = conversation.pinned(
        behavior, belief.particles, readings.mention_type, talk.words, state.clause
    )
    behavior = conversation.avoided(behavior, belief.particles, readings.mention_type, talk.words)
    belief = replace(belief, particles=conversation.focus(belief.particles, talk.words))
    weight = jnp.exp(belief.log_weight)
    robot_x, robot_y = semantic_filter.robot_position(belief)
    return _Outlook(
        fault=fault,
        belief=belief,
        stands=(fault != 0) | state.is_resting,
        robot_x=robot_x,
        robot_y=robot_y,
        behavior=behavior,
        expected=jax.tree.map(
            lambda leaf: jnp.sum(leaf * jnp.broadcast_to(weight, leaf.shape), axis=-1), behavior
        ),
        goals=gather(belief, behavior, params.map.relations),
    )


def _decide(
    key: Array,
    state: NavigatorState,
    outlook: _Outlook,
    range_max: Array,
    is_news: Array,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> _Decision:
    """Choose among the graph's nodes or to stop (section 3.4); ``key`` is the whole cycle's."""
    belief, goals = outlook.belief, outlook.goals
    robot = outlook.robot_x, outlook.robot_y
    visited = graph.visit(state.visited, *robot, params.planner.visit_spacing)
    plan = first_stops = chance = None
    if config.planner.policy == "informed":
        unseen = search.search_map(belief, params.planner.prior_share)
        plan_key = jax.random.fold_in(key, _PLANNING)
        chance = chance_left(unseen.unseen, params.map.concentration, params.map.misleading)
        plan = tours.plan(plan_key, state.tour, unseen, *robot, range_max, belief.coverage.area)
    has_looked = False if chance is None else chance < params.planner.give_up
    doubt = doubt_of(goals, params.planner.question_cost, has_looked, state.talk.may_ask)
    if plan is not None:
        plan = replace(plan, hung=jnp.where(doubt.looks_on, jnp.inf, plan.hung))
        first_stops = plan.tours.x[:, 0], plan.tours.y[:, 0]
    nodes = graph.nodes(
        belief.coverage,
        visited,
        goals.object_x,
        goals.object_y,
        goals.is_object,
        config.planner,
        params.planner,
        first_stops,
    )
    nodes = open_nodes(nodes, state.way)
    # While there is more to be seen first, nothing is gone up to.
    is_open = ~doubt.looks_on | (nodes.kind != graph.OBJECT)
    nodes = replace(nodes, is_node=nodes.is_node & is_open)
    choice = policy.choose(
        belief,
        nodes,
        goals,
        *robot,
        state.commitment,
        is_news | state.way.is_news,
        outlook.expected.action[ACTIONS.index("find")],
        range_max,
        constraint_cost(
            belief, outlook.behavior.constraint, nodes, *robot, params.planner.constraint_cost
        ),
        params=params.planner,
        config=config.planner,
        plan=plan,
        chance_left=chance,
    )
    doubt = replace(doubt, asks=doubt.asks & ~outlook.stands)
    is_stop = choice.is_stop & ~outlook.stands & ~doubt.looks_on & ~doubt.asks
    choice = replace(
        choice,
        is_stop=is_stop,
        is_not_found=choice.is_not_found & ~choice.is_stop & ~outlook.stands & ~doubt.asks,
    )
    is_under_way = ~outlook.stands & ~is_stop & ~choice.is_not_found & ~doubt.asks
    way = watch(state.way, choice, *robot, is_under_way, patience=config.patience)
    return _Decision(visited=visited, plan=plan, nodes=nodes, choice=choice, way=way, doubt=doubt)


def _is_last_clause(state: NavigatorState) -> Array:
    """Tell whether nothing follows the present command, bool[]."""
    return state.clause + 1 >= state.instruction.num_clauses


def _status(
    state: NavigatorState, outlook: _Outlook, decision: _Decision, config: NavigatorConfig
) -> Array:
    """Tell what becomes of the task, i32[] a Status: what it was where the robot stands still."""
    choice = decision.choice
    under_way = jnp.where(choice.is_approach, int(Status.APPROACHING), int(Status.SEARCHING))
    is_arrived = choice.is_stop & _is_last_clause(state)
    ended = jnp.where(choice.is_not_found, int(Status.NOT_FOUND), under_way)
    status = jnp.where(is_arrived, int(Status.ARRIVED), ended)
    status = jnp.where(decision.doubt.asks, int(Status.WHICH_ONE), status)
    is_blocked = decision.way.num_closed > config.num_detours
    status = jnp.where(is_blocked & ~choice.is_stop, int(Status.BLOCKED), status)
    return jnp.where(outlook.stands, state.status, status)


def _act(
    state: NavigatorState, outlook: _Outlook, choice: policy.Choice, params: NavigatorParams
) -> Action:
    """Turn the choice into a step in the manner asked for: quickly, carefully.

    Where it stands the waypoint is where the robot believes itself to be. The state is the new one.
    """
    mode = jnp.argmax(outlook.expected.mode)
    speed, clearance = params.mode_speed[mode], params.mode_clearance[mode]
    robot = jnp.stack([outlook.robot_x, outlook.robot_y])
    waypoint = jnp.stack([choice.waypoint_x, choice.waypoint_y])
    stands = outlook.stands | (state.is_done & ~choice.is_stop)
    waypoint = jnp.where(stands, robot, waypoint)
    span_x, span_y = waypoint - robot
    distance = jnp.sqrt(span_x * span_x + span_y * span_y + 1e-9)
    # A thing is gone up to, not into; anything else is a place to stand on.
    spare = jnp.where(choice.kind == graph.OBJECT, _APPROACH * params.planner.reach, 0.0)
    length = jnp.clip(distance - spare, 0.0, params.map.motion.step_length * speed)
    length = jnp.where(choice.is_stop, 0.0, length)
    is_idle = state.instruction.num_clauses == 0
    status = jnp.where(is_idle, int(Status.IDLE), state.status)
    return Action(
        waypoint=waypoint,
        step=jnp.stack([span_x, span_y]) / distance * length,
        is_stop=state.is_done & ~state.is_halted & (outlook.fault == 0),
        status=jnp.where(state.is_halted, int(Status.HALTED), status),
        speed=speed,
        clearance=clearance,
    )


def _carry_on(
    state: NavigatorState,
    outlook: _Outlook,
    decision: _Decision,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> NavigatorState:
    """Remember what the next decision needs.

    A command carried out makes way for the next one, if the instruction has one.
    """
    choice, is_last = decision.choice, _is_last_clause(state)
    # Of the objects that would do, the last command ended at the one gone up to.
    goals, robot_x, robot_y = outlook.goals, outlook.robot_x, outlook.robot_y
    away = jnp.hypot(goals.object_x - robot_x, goals.object_y - robot_y)[:-1]
    will_do = goals.object_accepted[:-1] * params.planner.discount**away
    goal_slot = jnp.argmax(will_do).astype(jnp.int32)
    moves_on = choice.is_stop & ~is_last
    return replace(
        state,
        clause=state.clause + moves_on.astype(jnp.int32),
        previous_goal=jnp.where(choice.is_stop, goal_slot, state.previous_goal),
        visited=decision.visited,
        commitment=policy.Commitment(
            x=choice.waypoint_x,
            y=choice.waypoint_y,
            kind=choice.kind,
            is_active=~choice.is_stop,
        ),
        tour=state.tour if decision.plan is None else tours.take(decision.plan, choice.value),
        status=_status(state, outlook, decision, config),
        talk=_recall(state.talk, goals, choice, goal_slot, moves_on),
        way=replace(decision.way, num_closed=jnp.where(moves_on, 0, decision.way.num_closed)),
    )


def _recall(
    talk: Conversation, goals: Goals, choice: policy.Choice, goal_slot: Array, moves_on: Array
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
