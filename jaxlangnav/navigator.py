"""The agent: one decision cycle from an observation to an action (Figure 2 of the paper).

``step`` is a pure function of arrays: filter the semantic map, infer the behavior in every
particle, choose a waypoint. It knows nothing of where observations come from; a simulated world,
a physics simulator and a robot drive it alike.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import chex
import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav import conversation
from jaxlangnav.conversation import Conversation, Words
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.kinds import MOST_LABELS, is_anything, label_of
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
from jaxlangnav.numerics.batching import row_of
from jaxlangnav.planner import graph, policy
from jaxlangnav.planner.blocked import Way, keep_watch, start_of_way
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.planner.goals import Goals, gather
from jaxlangnav.planner.params import PlannerParams, default_planner_params
from jaxlangnav.planner.relevance import bears_on_goal, believed_groups, has_open_partner
from jaxlangnav.pytree import field, pytree, replace, strong
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.behaviors import infer_clause_behaviors
from jaxlangnav.semantic_map.belief import (
    ParticleBelief,
    about_robot,
    mean_drift,
    robot_position,
)
from jaxlangnav.semantic_map.filter import FilterInfo
from jaxlangnav.semantic_map.motion import rotated
from jaxlangnav.semantic_map.params import MapConfig, MapParams, default_map_params
from jaxlangnav.semantic_map.things import placed
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
    patience: int = field(
        "cycles without any way made after which a waypoint is given up", default=10
    )
    num_detours: int = field(
        "waypoints that may be given up before the way counts as blocked", default=3
    )

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
        terrain: how far one sees and walks in the area; the open field by default.
        words: what the readings are about, where more may be said (``hearing``); by default the
            task speaks of all of it.

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
        talk=conversation.begin_conversation(
            instruction, belief.last_pose, config.map.num_objects, words
        ),
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
    params = _as_told(state, params)
    state, filter_info = _observe(key, state, observation, params, config)
    is_asked = (state.instruction.num_clauses > 0) | (state.status == Status.IDLE)
    fault = filter_info.fault + jnp.where(is_asked, 0, int(Fault.COMMAND))
    range_max = jnp.where(fault == 0, observation.sensor.range_max, default_sensor().range_max)
    outlook = _infer(state, fault, params)
    state, choice = _decide(key, state, outlook, range_max, filter_info.is_news, params, config)
    after = _carry_on(state, outlook, choice, params, config)
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


def _as_told(state: NavigatorState, params: NavigatorParams) -> NavigatorParams:
    """Go as close as the robot has been told to; a place told in metres is stood on."""
    reach = params.planner.reach * state.talk.closeness
    reach = jnp.where(_metres(state) > 0.0, policy.UNDERFOOT, reach)
    return replace(params, planner=replace(params.planner, reach=reach))


def _metres(state: NavigatorState) -> Array:
    """Look up how far from its landmark the present command ends, f32[]; 0: nobody has said."""
    return row_of(state.instruction.metres, state.clause)


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
    # A command is meant as it was seen from where it was heard.
    viewer = row_of(state.talk.viewer, state.clause)
    belief, info = semantic_filter.step(
        key,
        replace(state.belief, viewer=viewer),
        state.instruction.readings,
        observation,
        params=config.planner.chosen.map_params(params.map),
        told=state.talk.told,
        is_sparse=True,
        farthest=farthest,
        spoken=_spoken(state) if config.map.num_bystanders else None,
    )
    return replace(state, belief=belief), info


def _spoken(state: NavigatorState) -> Array:
    """Tell of which types the task speaks, or what was gone up to is: bool[T]."""
    told, slots = state.instruction, state.belief.particles.object_type

    def type_at(slot: Array) -> Array:
        return jnp.where(slot == NONE, NONE, row_of(slots, jnp.maximum(slot, 0))[0])

    gone_to = [type_at(state.previous_goal), type_at(state.talk.approached)]
    words = told.program.own.reshape(-1), told.readings.mention_type.reshape(-1)
    named = label_of(jnp.concatenate([*words, jnp.stack(gone_to)]))
    # What is negative, such as NONE, falls out of the table.
    index = jnp.where(named < 0, MOST_LABELS, named)
    spoken = jnp.zeros(MOST_LABELS, bool).at[index].set(True, mode="drop")
    return spoken | jnp.any(is_anything(named))


def _infer(state: NavigatorState, fault: Array, params: NavigatorParams) -> _Outlook:
    """Infer the behavior of the present clause, and where its goal may be (section 3.3)."""
    belief = state.belief
    behavior = infer_clause_behaviors(
        belief.particles, state.instruction, state.clause, state.previous_goal
    )
    readings, talk = state.instruction.readings, state.talk
    behavior = placed(behavior, belief.particles, readings, talk.told, params.map.relations)
    behavior = conversation.without(behavior, talk.ruled_out)
    behavior = conversation.pinned(
        behavior, belief.particles, readings.mention_type, talk.words, state.clause
    )
    behavior = conversation.avoided(behavior, belief.particles, readings.mention_type, talk.words)
    belief = replace(belief, particles=conversation.focus(belief.particles, talk.words))
    belief = about_robot(belief)
    group = believed_groups(readings, belief.particles)
    weight = jnp.exp(belief.log_weight)
    robot_x, robot_y = robot_position(belief)
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
        is_relevant=bears_on_goal(group, belief.particles, behavior),
        goals=gather(
            belief,
            behavior,
            params.map.relations,
            has_open_partner(group, belief.particles),
            _metres(state),
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
    view = outlook.belief.terrain.view
    eye = Eye(robot_x, robot_y, range_max)
    may_stop = policy.may_stop(goals, eye, is_find, params=planner, view=view)
    situation = policy.Situation(
        belief=outlook.belief,
        nodes=graph.known_nodes(visited, goals.object_x, goals.object_y, goals.is_object),
        goals=goals,
        constraint=outlook.behavior.constraint,
        is_relevant=outlook.is_relevant,
        robot_x=robot_x,
        robot_y=robot_y,
        range_max=range_max,
        way=state.way,
        may_ask=state.talk.may_ask,
        has_chosen=state.talk.approached != NONE,
        is_find=is_find,
        is_news=is_news | state.way.is_news,
        stands=outlook.stands,
        may_stop=may_stop & ~outlook.stands,
        params=planner,
        map_params=params.map,
        num_blocks=config.planner.num_blocks,
    )
    memory, choice = policy.choose(
        config.planner.chosen, jax.random.fold_in(key, _PLANNING), state.memory, situation
    )
    robot, waypoint = (robot_x, robot_y), (choice.waypoint_x, choice.waypoint_y)
    is_under_way = ~outlook.stands & ~choice.is_stop & ~choice.is_not_found & ~choice.doubt.asks
    way = keep_watch(state.way, waypoint, robot, is_under_way, patience=config.patience)
    return replace(state, visited=visited, memory=memory, way=way), choice


def _is_last_clause(state: NavigatorState) -> Array:
    """Tell whether nothing follows the present command, bool[]."""
    return state.clause + 1 >= state.instruction.num_clauses


def _status(
    state: NavigatorState, outlook: _Outlook, choice: policy.Decision, config: NavigatorConfig
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
    stands = outlook.stands | (state.is_done & ~choice.is_stop)
    waypoint = jnp.where(stands, robot, waypoint)
    travel = state.belief.terrain.travel
    here, there = (outlook.robot_x, outlook.robot_y), tuple(waypoint)
    next_x, next_y = travel.next_place(*here, *there)
    left, distance = travel.metres(*here, *there), travel.metres(*here, next_x, next_y)
    # A thing is gone up to, not into; anything else is a place to stand on.
    spare = jnp.where(choice.kind == graph.OBJECT_NODE, _APPROACH * params.planner.reach, 0.0)
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


def _carry_on(
    state: NavigatorState,
    outlook: _Outlook,
    choice: policy.Decision,
    params: NavigatorParams,
    config: NavigatorConfig,
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
