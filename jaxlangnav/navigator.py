"""The agent: one decision cycle from an observation to an action (Figure 2 of the paper).

``step`` is a pure function of arrays: filter the semantic map, infer the behavior in every
particle, choose a waypoint. It knows nothing of where observations come from; a simulated world,
a physics simulator and a robot drive it alike.
"""

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.program import NUM_TYPES
from jaxlangnav.language.halting import Act
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
from jaxlangnav.semantic_map.soundness import DEVIATIONS, is_pose

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

    @property
    def is_done(self) -> Array:
        """Whether the task has ended: it is carried out, or cannot be. bool[]."""
        return (self.status == Status.ARRIVED) | (self.status == Status.NOT_FOUND)

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
) -> NavigatorState:
    """Build the state of a robot that has just been told what to do.

    With a pose or an area that cannot be, as a batch may hold, it will stand still and say so.

    Args:
        instruction: grounded sentence.
        pose: f32[3], x, y, heading, metres and radians, map frame.
        area: f32[4], operating area x_min, x_max, y_min, y_max, metres.
        config: sizes.
        num_types: object types that a detection may name.

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
    )


def hear(state: NavigatorState, instruction: Instruction, pose: Array) -> NavigatorState:
    """Take in another command: the map is kept, the words are grounded anew.

    A robot that has been halted goes on, with the new task.

    Limits: what asks for nothing, such as a statement, changes nothing.

    Args:
        state: of a robot under way or at its goal.
        instruction: the new sentence, grounded.
        pose: f32[3], where the robot is as it hears it, map frame; one that cannot be is taken to
            be where it last was.

    Returns:
        The state, to be followed by the next observation.
    """
    belief = state.belief
    viewer = jnp.where(is_pose(pose, belief.coverage.area), pose, belief.last_pose)
    told = replace(
        state,
        belief=replace(belief, viewer=viewer, must_ground=jnp.asarray(True)),
        instruction=instruction,
        clause=jnp.int32(0),
        commitment=policy.no_commitment(),
        status=jnp.int32(Status.SEARCHING),
        is_halted=jnp.asarray(False),
    )
    asks = instruction.num_clauses > 0
    return jax.tree.map(
        lambda new, old: old if new is old else jnp.where(asks, new, old), told, state
    )


def obey(state: NavigatorState, act: Act) -> NavigatorState:
    """Halt, go on, or drop the task, whatever the robot is at; nothing is computed or compiled.

    Halted it stands still, however often it is stepped, and keeps looking about; to go on is to
    take up the same task where it was. To cancel leaves it idle until another command is heard;
    what the sentence said of the map stays.

    Args:
        state: of any robot, or of a batch of them, leaves [...].
        act: what it was told.

    Returns:
        The state, to be followed by the next observation.
    """

    def everywhere(value: int | bool, like: Array) -> Array:
        return jnp.asarray(np.full(like.shape, value, like.dtype))

    is_halted = everywhere(act == Act.HALT, state.is_halted)
    if act != Act.CANCEL:
        return replace(state, is_halted=is_halted)
    told = state.instruction
    return replace(
        state,
        instruction=replace(told, num_clauses=everywhere(0, told.num_clauses)),
        status=everywhere(Status.IDLE, state.status),
        is_halted=is_halted,
    )


class _Outlook(NamedTuple):
    """What a belief comes to: where the robot is, what it is asked to do, and where."""

    fault: Array  # i32[] bits of Fault; 0 for a sound look and a task
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
    state, filter_info = _observe(key, state, observation, params, config)
    is_asked = (state.instruction.num_clauses > 0) | (state.status == Status.IDLE)
    fault = filter_info.fault + jnp.where(is_asked, 0, int(Fault.COMMAND))
    range_max = jnp.where(fault == 0, observation.sensor.range_max, default_sensor().range_max)
    outlook = _infer(state, fault, params)
    decision = _decide(key, state, outlook, range_max, filter_info.is_news, params, config)
    after = _carry_on(state, outlook, decision, params)
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
    belief, info = semantic_filter.step(
        key,
        state.belief,
        state.instruction.readings,
        observation,
        params=map_params,
        is_sparse=True,
        farthest=farthest,
        spoken=_spoken(state) if config.map.num_bystanders else None,
    )
    return replace(state, belief=belief), info


def _spoken(state: NavigatorState) -> Array:
    """Tell of which types the task speaks, or the goal before was: bool[T]."""
    told, slots = state.instruction, state.belief.particles.object_type
    spoken = jnp.any(told.program.own, axis=(0, 1))
    types = jnp.arange(spoken.shape[0])
    before = row_of(slots, jnp.maximum(state.previous_goal, 0))[0]
    before = jnp.where(state.previous_goal == NONE, NONE, before)
    named = jnp.append(told.readings.mention_type, before)
    return spoken | jnp.any(named[:, None] == types[None], axis=0)


def _infer(state: NavigatorState, fault: Array, params: NavigatorParams) -> _Outlook:
    """Infer the behavior of the present clause, and where its goal may be (section 3.3)."""
    belief = state.belief
    behavior = infer_behaviors(
        belief.particles, state.instruction, state.clause, state.previous_goal
    )
    weight = jnp.exp(belief.log_weight)
    robot_x, robot_y = semantic_filter.robot_position(belief)
    return _Outlook(
        fault=fault,
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
    belief, goals = state.belief, outlook.goals
    robot = outlook.robot_x, outlook.robot_y
    visited = graph.visit(state.visited, *robot, params.planner.visit_spacing)
    plan = first_stops = chance = None
    if config.planner.policy == "informed":
        unseen = search.search_map(belief, params.planner.prior_share)
        plan_key = jax.random.fold_in(key, _PLANNING)
        chance = chance_left(
            unseen.unseen, params.map.concentration, params.map.misleading, params.map.clumping
        )
        plan = tours.plan(plan_key, state.tour, unseen, *robot, range_max, belief.coverage.area)
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
    choice = policy.choose(
        belief,
        nodes,
        goals,
        *robot,
        state.commitment,
        is_news,
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
    choice = replace(
        choice,
        is_stop=choice.is_stop & ~outlook.stands,
        is_not_found=choice.is_not_found & ~choice.is_stop & ~outlook.stands,
    )
    return _Decision(visited=visited, plan=plan, nodes=nodes, choice=choice)


def _is_last_clause(state: NavigatorState) -> Array:
    """Tell whether nothing follows the present command, bool[]."""
    return state.clause + 1 >= state.instruction.num_clauses


def _status(state: NavigatorState, outlook: _Outlook, choice: policy.Choice) -> Array:
    """Tell what becomes of the task, i32[] a Status: what it was where the robot stands still."""
    under_way = jnp.where(choice.is_approach, int(Status.APPROACHING), int(Status.SEARCHING))
    is_arrived = choice.is_stop & _is_last_clause(state)
    ended = jnp.where(choice.is_not_found, int(Status.NOT_FOUND), under_way)
    status = jnp.where(is_arrived, int(Status.ARRIVED), ended)
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
    waypoint = jnp.where(outlook.stands | choice.is_not_found, robot, waypoint)
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
    state: NavigatorState, outlook: _Outlook, decision: _Decision, params: NavigatorParams
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
    return replace(
        state,
        clause=state.clause + (choice.is_stop & ~is_last).astype(jnp.int32),
        previous_goal=jnp.where(choice.is_stop, goal_slot, state.previous_goal),
        visited=decision.visited,
        commitment=policy.Commitment(
            x=choice.waypoint_x,
            y=choice.waypoint_y,
            kind=choice.kind,
            is_active=~choice.is_stop,
        ),
        tour=state.tour if decision.plan is None else tours.take(decision.plan, choice.value),
        status=_status(state, outlook, choice),
    )
