"""The agent: one decision cycle from an observation to an action (Figure 2 of the paper).

``step`` is a pure function of arrays: filter the semantic map, infer the behavior in every
particle, choose a waypoint. It knows nothing of where observations come from; a simulated world,
a physics simulator and a robot drive it alike.
"""

import dataclasses
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.kinds import MOST_LABELS
from jaxlangnav.language.halting import Act
from jaxlangnav.messages import (
    ACTIONS,
    NONE,
    Action,
    Behavior,
    Fault,
    Observation,
    Status,
    assert_observation,
    default_sensor,
)
from jaxlangnav.planner import graph, policy
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.planner.goals import Goals, gather
from jaxlangnav.planner.params import PlannerParams, default_planner_params
from jaxlangnav.planner.relevance import bears_on_goal, group_of, has_open_partner
from jaxlangnav.pytree import field, pytree, replace, strong
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.behaviors import infer_behaviors
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.filter import FilterInfo
from jaxlangnav.semantic_map.params import MapConfig, MapParams, default_map_params
from jaxlangnav.semantic_map.soundness import is_pose
from jaxlangnav.sensing import DEVIATIONS
from jaxlangnav.terrain import OPEN, Eye, Terrain

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
    mode_speed: Array = field("factor on the step length: normal, quickly, carefully")  # f32[3]
    mode_clearance: Array = field("metres kept from objects")  # f32[3]


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
        self.planner.chosen.check(self.map)


@pytree
class NavigatorState:
    """What the next decision needs."""

    belief: ParticleBelief
    instruction: Instruction
    clause: Array  # i32[] which of the instruction's commands is being carried out
    previous_goal: Array  # i32[] observed slot at which the last command ended; NONE at first
    visited: graph.Visited
    memory: Any  # of the policy
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
    choice: policy.Decision
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
    num_types: int = MOST_LABELS,
    terrain: Terrain = OPEN,
) -> NavigatorState:
    """Build the state of a robot that has just been told what to do.

    With a pose or an area that cannot be, as a batch may hold, it will stand still and say so.

    Args:
        instruction: grounded sentence.
        pose: f32[3], x, y, heading, metres and radians, map frame.
        area: f32[4], operating area x_min, x_max, y_min, y_max, metres.
        config: sizes.
        num_types: object types that a detection may name.
        terrain: how far one sees and walks in the area; the open field by default.

    Returns:
        The state before the first observation.
    """
    chex.assert_shape([pose, area], [(3,), (4,)])
    num_mentions = instruction.readings.mention_type.shape[-1]
    belief = semantic_filter.start(
        pose, area, num_mentions, config=config.map, num_types=num_types, terrain=terrain
    )
    return NavigatorState(
        belief=belief,
        instruction=instruction,
        clause=jnp.int32(0),
        previous_goal=jnp.int32(NONE),
        visited=graph.nowhere(config.planner.num_visited),
        memory=strong(config.planner.chosen.init(belief)),
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
    is_relevant: Array  # bool[M, P] mentions that bear on the goal of the present command
    goals: Goals


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
    assert_observation(observation)
    chex.assert_rank([state.clause, state.status, state.is_halted, state.previous_goal], 0)
    chex.assert_type([state.clause, state.status, state.is_halted], [int, int, bool])
    chex.assert_equal_shape([params.mode_speed, params.mode_clearance])
    state, filter_info = _observe(key, state, observation, params, config)
    is_asked = (state.instruction.num_clauses > 0) | (state.status == Status.IDLE)
    fault = filter_info.fault + jnp.where(is_asked, 0, int(Fault.COMMAND))
    range_max = jnp.where(fault == 0, observation.sensor.range_max, default_sensor().range_max)
    outlook = _infer(state, fault, params)
    state, choice = _decide(key, state, outlook, range_max, filter_info.is_news, params, config)
    after = _carry_on(state, outlook, choice, params)
    action = _act(after, outlook, choice, params)
    info = NavigatorInfo(
        filter=filter_info,
        fault=fault,
        choice=choice,
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
    motion = params.map.motion
    # One cycle's step at the highest speed, as far as odometry may be out.
    farthest = jnp.max(params.mode_speed) * motion.step_length
    farthest = farthest * (1.0 + DEVIATIONS * motion.odometry_noise) + _SPARE
    belief, info = semantic_filter.step(
        key,
        state.belief,
        state.instruction.readings,
        observation,
        params=config.planner.chosen.map_params(params.map),
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
    group = group_of(state.instruction.readings, belief.particles)
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
        is_relevant=bears_on_goal(group, belief.particles, behavior),
        goals=gather(
            belief, behavior, params.map.relations, has_open_partner(group, belief.particles)
        ),
    )


def _decide(
    key: Array,
    state: NavigatorState,
    outlook: _Outlook,
    range_max: Array,
    is_news: Array,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> tuple[NavigatorState, policy.Decision]:
    """Have the policy decide where to go (section 3.4); ``key`` is the whole cycle's."""
    goals, planner = outlook.goals, params.planner
    robot_x, robot_y = outlook.robot_x, outlook.robot_y
    visited = graph.visit(state.visited, robot_x, robot_y, planner.visit_spacing)
    is_find = outlook.expected.action[ACTIONS.index("find")]
    view = state.belief.terrain.view
    eye = Eye(robot_x, robot_y, range_max)
    may_stop = policy.may_stop(goals, eye, is_find, params=planner, view=view)
    situation = policy.Situation(
        belief=state.belief,
        nodes=graph.known_nodes(visited, goals.object_x, goals.object_y, goals.is_object),
        goals=goals,
        constraint=outlook.behavior.constraint,
        is_relevant=outlook.is_relevant,
        robot_x=robot_x,
        robot_y=robot_y,
        range_max=range_max,
        is_find=is_find,
        is_news=is_news,
        stands=outlook.stands,
        may_stop=may_stop & ~outlook.stands,
        params=planner,
        map_params=params.map,
        num_blocks=config.planner.num_blocks,
    )
    memory, choice = policy.choose(
        config.planner.chosen, jax.random.fold_in(key, _PLANNING), state.memory, situation
    )
    return replace(state, visited=visited, memory=memory), choice


def _is_last_clause(state: NavigatorState) -> Array:
    """Tell whether nothing follows the present command, bool[]."""
    return state.clause + 1 >= state.instruction.num_clauses


def _status(state: NavigatorState, outlook: _Outlook, choice: policy.Decision) -> Array:
    """Tell what becomes of the task, i32[] a Status: what it was where the robot stands still."""
    under_way = jnp.where(choice.is_approach, int(Status.APPROACHING), int(Status.SEARCHING))
    is_arrived = choice.is_stop & _is_last_clause(state)
    ended = jnp.where(choice.is_not_found, int(Status.NOT_FOUND), under_way)
    status = jnp.where(is_arrived, int(Status.ARRIVED), ended)
    return jnp.where(outlook.stands, state.status, status)


def _act(
    state: NavigatorState, outlook: _Outlook, choice: policy.Decision, params: NavigatorParams
) -> Action:
    """Turn the choice into a step in the manner asked for: quickly, carefully.

    Where it stands the waypoint is where the robot believes itself to be. The state is the new one.
    """
    mode = jnp.argmax(outlook.expected.mode)
    speed, clearance = params.mode_speed[mode], params.mode_clearance[mode]
    robot = jnp.stack([outlook.robot_x, outlook.robot_y])
    waypoint = jnp.stack([choice.waypoint_x, choice.waypoint_y])
    waypoint = jnp.where(outlook.stands | choice.is_not_found, robot, waypoint)
    travel = state.belief.terrain.travel
    here, there = (outlook.robot_x, outlook.robot_y), tuple(waypoint)
    next_x, next_y = travel.next_place(*here, *there)
    left, distance = travel.metres(*here, *there), travel.metres(*here, next_x, next_y)
    # A thing is gone up to, not into; anything else is a place to stand on.
    spare = jnp.where(choice.kind == graph.OBJECT, _APPROACH * params.planner.reach, 0.0)
    length = jnp.clip(left - spare, 0.0, params.map.motion.step_length * speed)
    length = jnp.where(choice.is_stop, 0.0, jnp.minimum(length, distance))
    is_idle = state.instruction.num_clauses == 0
    status = jnp.where(is_idle, int(Status.IDLE), state.status)
    return Action(
        waypoint=waypoint,
        step=jnp.stack([next_x - here[0], next_y - here[1]]) / distance * length,
        is_stop=state.is_done & ~state.is_halted & (outlook.fault == 0),
        status=jnp.where(state.is_halted, int(Status.HALTED), status),
        speed=speed,
        clearance=clearance,
    )


def _carry_on(
    state: NavigatorState, outlook: _Outlook, choice: policy.Decision, params: NavigatorParams
) -> NavigatorState:
    """Remember what the next decision needs.

    A command carried out makes way for the next one, if the instruction has one.
    """
    is_last = _is_last_clause(state)
    # Of the objects that would do, the last command ended at the one gone up to.
    goals, robot_x, robot_y = outlook.goals, outlook.robot_x, outlook.robot_y
    travel = state.belief.terrain.travel
    away = travel.metres(robot_x, robot_y, goals.object_x, goals.object_y)[:-1]
    will_do = goals.object_accepted[:-1] * params.planner.discount**away
    goal_slot = jnp.argmax(will_do).astype(jnp.int32)
    return replace(
        state,
        clause=state.clause + (choice.is_stop & ~is_last).astype(jnp.int32),
        previous_goal=jnp.where(choice.is_stop, goal_slot, state.previous_goal),
        status=_status(state, outlook, choice),
    )
