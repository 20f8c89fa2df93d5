"""The decision cycle: filter, behavior inference, planning (Figure 2 of the paper).

``step`` is a pure function of arrays: update the semantic map, infer the behavior in every
particle, choose a waypoint.
"""

import chex
import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav import dialogue
from jaxlangnav.dialogue import DiscourseInfo
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.object_types import MAX_LABELS, is_anything, label_of
from jaxlangnav.inputs.observations import GATE_SIGMAS
from jaxlangnav.messages import (
    ACTIONS,
    NONE,
    Action,
    Behavior,
    Fault,
    Observation,
    SensorParams,
    Status,
    default_sensor,
)
from jaxlangnav.navigator.records import (
    InferredTask,
    NavigatorConfig,
    NavigatorParams,
    NavigatorState,
    make_action,
    update_task_state,
)
from jaxlangnav.numerics.batching import select_row
from jaxlangnav.planner import graph, policy
from jaxlangnav.planner.blocked import init_progress, sidestep, update_progress
from jaxlangnav.planner.goals import Goals, gather
from jaxlangnav.planner.relevance import links_to_goal, links_to_unseen, particle_groups
from jaxlangnav.pytree import pytree, replace, strong_types
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.behaviors import filter_untyped_goals, infer_clause_behaviors
from jaxlangnav.semantic_map.belief import align_on_robot, robot_position
from jaxlangnav.semantic_map.filter import FilterInfo
from jaxlangnav.semantic_map.proposal.relation_query import Utterances
from jaxlangnav.terrain import OPEN, RANGING, SensorModel, Terrain

_PLANNER_KEY = 77  # folded into a cycle's key for the planner
_ROUNDING = 0.01  # metres, margin for rounding in odometry


@pytree
class NavigatorInfo:
    """Diagnostics of one decision cycle."""

    filter: FilterInfo
    fault: Array  # i32[] bits of messages.Fault: why the robot stands still; 0: no fault
    choice: policy.Decision
    goals: Goals
    behavior: Behavior  # expectation over particles
    robot: Array  # f32[2] believed position, metres, map frame


def start(
    instruction: Instruction,
    pose: Array,
    area: Array,
    *,
    config: NavigatorConfig,
    num_types: int = MAX_LABELS,
    terrain: Terrain = OPEN,
    sensor_model: SensorModel = RANGING,
    words: DiscourseInfo | None = None,
) -> NavigatorState:
    """Build the initial state of a robot with an instruction.

    With an invalid pose or area, as in a batch, it will stand still at a fault.

    Args:
        instruction: grounded sentence.
        pose: f32[3], x, y, heading, metres and radians, map frame.
        area: f32[4], operating area x_min, x_max, y_min, y_max, metres.
        config: capacities and policy.
        num_types: number of object types of the detector.
        terrain: lines of sight and travel distances; the open field by default.
        sensor_model: observation model; range and bearing by default.
        words: dialogue state of the readings, for further utterances (``speech_acts``); by default
            all mentions belong to the task.
    """
    chex.assert_shape([pose, area], [(3,), (4,)])
    belief = semantic_filter.start(
        pose,
        area,
        instruction.readings.mention_type.shape[-1],
        config=config.map,
        num_types=num_types,
        terrain=terrain,
        sensor_model=sensor_model,
    )
    home, num_slots = belief.last_pose, config.map.num_objects
    return NavigatorState(
        belief=belief,
        instruction=instruction,
        clause=jnp.int32(0),
        previous_goal=jnp.int32(NONE),
        visited=graph.empty_visited(config.planner.num_visited),
        memory=strong_types(config.planner.chosen.init(belief)),
        status=jnp.int32(Status.SEARCHING),
        is_halted=jnp.asarray(False),
        talk=dialogue.begin_conversation(instruction, home, num_slots, words),
        progress=init_progress(home),
    )


def step(
    key: Array,
    state: NavigatorState,
    observation: Observation,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> tuple[NavigatorState, Action, NavigatorInfo]:
    """Run one decision cycle: from an observation to an action.

    An impossible observation is rejected as a whole (``semantic_map.gating``): the robot stands
    still without ending its task, and ``info.fault`` gives the reason, until a valid one comes.

    Args:
        key: random key, consumed.
        state: after the last cycle.
        observation: pose and detections now.
        params: traced parameters.
        config: capacities and policy.

    Returns:
        The new state, the action, and diagnostics.
    """
    chex.assert_rank([state.clause, state.status, state.is_halted, state.previous_goal], 0)
    chex.assert_type([state.clause, state.status, state.is_halted], [int, int, bool])
    chex.assert_equal_shape([params.mode_speed, params.mode_clearance])
    # Closer if so told; a metric goal is a position to reach.
    reach = params.planner.reach * state.talk.closeness
    reach = jnp.where(_metres(state) > 0.0, policy.ARRIVAL_RADIUS, reach)
    params = replace(params, planner=replace(params.planner, reach=reach))
    state, filter_info = _observe(key, state, observation, params, config)
    is_command_missing = (state.instruction.num_clauses == 0) & (state.status != Status.IDLE)
    fault = filter_info.fault + jnp.where(is_command_missing, int(Fault.COMMAND), 0)
    default = default_sensor()
    sensor = jax.tree.map(lambda a, b: jnp.where(fault == 0, a, b), observation.sensor, default)
    task = _infer(state, fault, params)
    state, choice = _decide(key, state, task, sensor, filter_info.is_news, params, config)
    after = update_task_state(state, task, choice, params=params, config=config)
    action = make_action(after, task, choice, sensor, params=params)
    info = NavigatorInfo(
        filter=filter_info,
        fault=fault,
        choice=choice,
        goals=task.goals,
        behavior=task.expected,
        robot=jnp.stack(task.robot),
    )
    return after, action, info


def _metres(state: NavigatorState) -> Array:
    """Look up the stated distance of the current goal from its landmark, f32[] metres; 0: none."""
    return select_row(state.instruction.metres, state.clause)


def _observe(
    key: Array,
    state: NavigatorState,
    observation: Observation,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> tuple[NavigatorState, FilterInfo]:
    """Update the semantic map with the observation and the utterance (section 3.2)."""
    motion = params.map.motion
    # The longest step of a cycle, with the error of odometry.
    max_travel = jnp.max(params.mode_speed) * motion.step_length
    max_travel = max_travel * (1.0 + GATE_SIGMAS * motion.odometry_noise) + _ROUNDING
    belief, info = semantic_filter.step(
        key,
        # Relations of a command are relative to the pose at which it was heard.
        replace(state.belief, viewer=select_row(state.talk.viewer, state.clause)),
        state.instruction.readings,
        observation,
        params=params.policy_of(config).map_params(params.map),
        context=state.talk.context,
        max_travel=max_travel,
        mentioned=_mentioned_types(state) if config.map.num_bystanders else None,
        pools_counts=config.map.pools_counts,
    )
    is_held = jnp.any(belief.particles.is_observed, axis=1)
    talk, previous = dialogue.forget_slots(state.talk, is_held), state.previous_goal
    previous = jnp.where(select_row(is_held, previous), previous, NONE)
    return replace(state, belief=belief, talk=talk, previous_goal=previous), info


def _mentioned_types(state: NavigatorState) -> Array:
    """Mark the object types of the task's mentions and of approached objects, bool[T]."""
    instruction, object_type = state.instruction, state.belief.particles.object_type

    def type_at(slot: Array) -> Array:
        return jnp.where(slot == NONE, NONE, select_row(object_type, jnp.maximum(slot, 0))[0])

    approached = jnp.stack([type_at(state.previous_goal), type_at(state.talk.approached)])
    types = [instruction.clauses.named_types, instruction.readings.mention_type, approached]
    label = label_of(jnp.concatenate([leaf.reshape(-1) for leaf in types]))
    # Negative labels, such as NONE, are dropped.
    index = jnp.where(label < 0, MAX_LABELS, label)
    is_mentioned = jnp.zeros(MAX_LABELS, bool).at[index].set(True, mode="drop")
    return is_mentioned | jnp.any(is_anything(label))


def _infer(state: NavigatorState, fault: Array, params: NavigatorParams) -> InferredTask:
    """Infer the behavior of the current command and its goal distribution (section 3.3)."""
    particles, talk, clause = state.belief.particles, state.talk, state.clause
    readings, relations = state.instruction.readings, params.map.relations
    behavior = infer_clause_behaviors(particles, state.instruction, clause, state.previous_goal)
    behavior = filter_untyped_goals(behavior, particles, readings, talk.context, relations)
    behavior = dialogue.apply_answers(behavior, particles, talk)
    behavior = dialogue.pin_goals(behavior, particles, readings.mention_type, talk.words, clause)
    behavior = dialogue.add_avoidance(behavior, particles, readings.mention_type, talk.words)
    particles = dialogue.task_mentions(particles, talk.words)
    belief = align_on_robot(replace(state.belief, particles=particles))
    group = particle_groups(readings, belief.particles)
    weight, robot = jnp.exp(belief.log_weight), robot_position(belief)
    has_unseen = links_to_unseen(group, belief.particles)
    return InferredTask(
        fault=fault,
        belief=belief,
        is_still=(fault != 0) | state.is_resting,
        robot=robot,
        behavior=behavior,
        expected=jax.tree.map(
            lambda leaf: jnp.sum(leaf * jnp.broadcast_to(weight, leaf.shape), axis=-1), behavior
        ),
        is_relevant=links_to_goal(group, belief.particles, behavior),
        goals=gather(belief, behavior, relations, has_unseen, _metres(state)),
    )


def _decide(
    key: Array,
    state: NavigatorState,
    task: InferredTask,
    sensor: SensorParams,
    is_news: Array,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> tuple[NavigatorState, policy.Decision]:
    """Run the policy (section 3.4); ``key`` is the key of the cycle."""
    goals, planner = task.goals, params.planner
    robot_x, robot_y = task.robot
    visited = graph.add_visited(state.visited, robot_x, robot_y, planner.visit_spacing)
    readings, context = state.instruction.readings, state.talk.context
    situation = policy.Situation(
        belief=task.belief,
        nodes=graph.known_nodes(visited, goals.object_x, goals.object_y, goals.is_object),
        goals=goals,
        forbidden_prob=task.behavior.constraint,
        is_relevant=task.is_relevant,
        robot_x=robot_x,
        robot_y=robot_y,
        sensor=sensor,
        progress=state.progress,
        may_ask=state.talk.may_ask,
        has_chosen=state.talk.approached != NONE,
        is_find=task.expected.action[ACTIONS.index("find")],
        is_news=is_news | state.progress.is_news,
        is_still=task.is_still,
        params=planner,
        map_params=params.map,
        utterances=Utterances(readings=readings, context=context, params=params.map),
        num_blocks=config.planner.num_blocks,
    )
    key = jax.random.fold_in(key, _PLANNER_KEY)
    memory, choice = policy.choose(params.policy_of(config), key, state.memory, situation)
    is_moving = ~task.is_still & ~choice.is_stop & ~choice.is_not_found & ~choice.question.asks
    progress = update_progress(
        state.progress,
        (choice.next_x, choice.next_y),
        task.robot,
        is_moving,
        may_sidestep=~jnp.any(situation.forbidden.cost > 0.0),
        patience=config.patience,
    )
    x_min, x_max, y_min, y_max = task.belief.coverage.area
    side_x, side_y = sidestep(progress)
    next_x = jnp.where(progress.leg > 0, jnp.clip(side_x, x_min, x_max), choice.next_x)
    next_y = jnp.where(progress.leg > 0, jnp.clip(side_y, y_min, y_max), choice.next_y)
    choice = replace(choice, next_x=next_x, next_y=next_y)
    return replace(state, visited=visited, memory=memory, progress=progress), choice
