"""The agent: one decision cycle from an observation to an action (Figure 2 of the paper).

``step`` is a pure function of arrays: filter the semantic map, infer the behavior in every
particle, choose a waypoint. It knows nothing of where observations come from; a simulated world,
a physics simulator and a robot drive it alike.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.grounding.behavior import infer_behaviors as infer_topologies
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.program import NUM_TYPES
from jaxlangnav.messages import ACTIONS, MODES, NONE, REGIONS, Action, Behavior, Observation
from jaxlangnav.planner import graph, policy, search, tours
from jaxlangnav.planner.goals import Goals, gather
from jaxlangnav.planner.information import squared_distance_to_segment
from jaxlangnav.planner.params import PlannerConfig, PlannerParams, default_planner_params
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map import summary
from jaxlangnav.semantic_map.filter import FilterInfo, ParticleBelief
from jaxlangnav.semantic_map.params import MapConfig, MapParams, default_map_params

_PLANNING = 77
"""Folded into a cycle's key for the planner; beyond the keys that the filter splits it into."""
BLOCK = 8
"""Topologies whose behavior is inferred at a time."""


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
    is_done: Array  # bool[]


@pytree
class NavigatorInfo:
    """What a person or a test wants to know of one decision."""

    filter: FilterInfo
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
    instruction: Instruction, pose: Array, area: Array, *, config: NavigatorConfig
) -> NavigatorState:
    """Build the state of a robot that has just been told what to do.

    Args:
        instruction: grounded sentence.
        pose: f32[3], x, y, heading, metres and radians, map frame.
        area: f32[4], operating area x_min, x_max, y_min, y_max, metres.
        config: sizes.

    Returns:
        The state before the first observation.
    """
    num_mentions = instruction.readings.mention_type.shape[-1]
    return NavigatorState(
        belief=semantic_filter.start(pose, area, num_mentions, config.map),
        instruction=instruction,
        clause=jnp.int32(0),
        previous_goal=jnp.int32(NONE),
        visited=graph.nowhere(config.planner.num_visited),
        commitment=policy.no_commitment(),
        tour=tours.no_tour(pose[0], pose[1]),
        is_done=jnp.asarray(False),
    )


def hear(state: NavigatorState, instruction: Instruction, pose: Array) -> NavigatorState:
    """Take in another instruction: the map is kept, the words are grounded anew.

    Args:
        state: of a robot under way or at its goal.
        instruction: the new sentence, grounded.
        pose: f32[3], where the robot is as it hears it, map frame.

    Returns:
        The state, to be followed by the next observation.
    """
    belief = replace(state.belief, viewer=pose, must_ground=jnp.asarray(True))
    return replace(
        state,
        belief=belief,
        instruction=instruction,
        clause=jnp.int32(0),
        commitment=policy.no_commitment(),
        is_done=jnp.asarray(False),
    )


def infer_behaviors(state: NavigatorState) -> Behavior:
    """Infer the behavior of the present clause in every particle (section 3.3).

    The behavior model sees a particle's topology only, so each distinct topology is inferred
    once, ``BLOCK`` of them at a time, and handed to all particles that share it.

    Args:
        state: after the filter step.

    Returns:
        Behaviors, leaves [..., P].
    """
    program = jax.tree.map(lambda leaf: leaf[state.clause], state.instruction.program)
    particles = state.belief.particles
    number = particles.reading.shape[-1]
    block = min(BLOCK, number)
    topology, representative, count = summary.distinct_topologies(particles, NUM_TYPES)
    padding = jnp.full((-number) % block, number, representative.dtype)
    representative = jnp.append(representative, padding)

    def infer(index: Array, behaviors: Behavior) -> Behavior:
        chosen = jax.lax.dynamic_slice_in_dim(representative, index * block, block)
        chosen = jnp.minimum(chosen, number - 1)
        worlds = jax.vmap(summary.behavior_world, in_axes=(-1, None, None), out_axes=-1)(
            jax.tree.map(lambda leaf: leaf[..., chosen], particles),
            state.instruction.readings,
            state.previous_goal,
        )
        inferred = infer_topologies(program, worlds, num_phrases=program.num_phrases)
        place = topology - index * block

        def hand_out(new: Array, old: Array) -> Array:
            # Selects vectorise over particles, where a gather would go element by element.
            for own in range(block):
                old = jnp.where(place == own, new[..., own : own + 1], old)
            return old

        return jax.tree.map(hand_out, inferred, behaviors)

    num_slots = particles.object_type.shape[0] + particles.referent.shape[0] + 1
    nothing = Behavior(
        action=jnp.zeros((len(ACTIONS), number), jnp.float32),
        mode=jnp.zeros((len(MODES), number), jnp.float32),
        goal=jnp.zeros((len(REGIONS), num_slots, number), jnp.float32),
        constraint=jnp.zeros((len(REGIONS), num_slots, number), jnp.float32),
    )
    return jax.lax.fori_loop(0, (count + block - 1) // block, infer, nothing)


def _constraint_cost(
    state: NavigatorState,
    behavior: Behavior,
    nodes: graph.Nodes,
    robot_x: Array,
    robot_y: Array,
    params: NavigatorParams,
) -> Array:
    """Charge each node for the probability that the way to it enters a forbidden region."""
    particles = state.belief.particles
    weight = jnp.exp(state.belief.log_weight)
    num_objects = particles.object_type.shape[0]
    forbidden = jnp.max(behavior.constraint, axis=0)[:num_objects]  # [O, P]
    share = jnp.sum(forbidden * weight[None, :], axis=1)  # [O]
    x = jnp.sum(particles.mean_x[:num_objects] * weight[None, :], axis=1)
    y = jnp.sum(particles.mean_y[:num_objects] * weight[None, :], axis=1)
    squared = squared_distance_to_segment(
        x[None, :], y[None, :], robot_x, robot_y, nodes.x[:, None], nodes.y[:, None]
    )
    near = squared <= jnp.square(2.0)
    return params.planner.constraint_cost * jnp.max(jnp.where(near, share[None, :], 0.0), axis=1)


def _plan(
    key: Array,
    state: NavigatorState,
    observation: Observation,
    robot_x: Array,
    robot_y: Array,
    params: NavigatorParams,
) -> tours.Plan:
    """Plan tours to what has not been seen; the key is that of the whole cycle."""
    return tours.plan(
        jax.random.fold_in(key, _PLANNING),
        state.tour,
        search.search_map(state.belief, params.planner.prior_share),
        robot_x,
        robot_y,
        observation.sensor.range_max,
        state.belief.coverage.area,
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

    Args:
        key: random key, consumed.
        state: after the last cycle.
        observation: pose and detections now.
        params: traced numbers.
        config: sizes and policy.

    Returns:
        The new state, what the robot is to do, and why.
    """
    # The paper's own policy takes every word to be true.
    trusts = config.planner.policy == "faithful"
    map_params = replace(params.map, misleading=jnp.float32(0.0)) if trusts else params.map
    belief, filter_info = semantic_filter.step(
        key, state.belief, state.instruction.readings, observation, params=map_params
    )
    state = replace(state, belief=belief)
    behavior = infer_behaviors(state)
    goals = gather(belief, behavior, params.map.relations)
    robot_x, robot_y = semantic_filter.robot_position(belief)
    visited = graph.visit(state.visited, robot_x, robot_y, params.planner.visit_spacing)
    plan = None
    if config.planner.policy == "informed":
        plan = _plan(key, state, observation, robot_x, robot_y, params)
    nodes = graph.nodes(
        belief.coverage,
        visited,
        goals.object_x,
        goals.object_y,
        goals.is_object,
        config.planner,
        params.planner,
        None if plan is None else (plan.tours.x[:, 0], plan.tours.y[:, 0]),
    )
    weight = jnp.exp(belief.log_weight)
    expected = jax.tree.map(
        lambda leaf: jnp.sum(leaf * jnp.broadcast_to(weight, leaf.shape), axis=-1), behavior
    )
    choice = policy.choose(
        belief,
        nodes,
        goals,
        robot_x,
        robot_y,
        state.commitment,
        filter_info.is_news,
        expected.action[1],
        observation.sensor.range_max,
        _constraint_cost(state, behavior, nodes, robot_x, robot_y, params),
        params=params.planner,
        config=config.planner,
        plan=plan,
    )
    # A command carried out makes way for the next one, if the instruction has one.
    is_last = state.clause + 1 >= state.instruction.num_clauses
    is_stop = choice.is_stop & is_last
    advances = choice.is_stop & ~is_last
    # Of the objects that would do, the last command ended at the one gone up to.
    away = jnp.hypot(goals.object_x - robot_x, goals.object_y - robot_y)[:-1]
    will_do = goals.object_accepted[:-1] * params.planner.discount**away
    goal_slot = jnp.argmax(will_do).astype(jnp.int32)
    mode = jnp.argmax(expected.mode)
    speed, clearance = params.mode_speed[mode], params.mode_clearance[mode]
    span_x, span_y = choice.waypoint_x - robot_x, choice.waypoint_y - robot_y
    distance = jnp.sqrt(span_x * span_x + span_y * span_y + 1e-9)
    # A thing is gone up to, not into; anything else is a place to stand on.
    spare = jnp.where(choice.kind == graph.OBJECT, 0.9 * params.planner.reach, 0.0)
    length = jnp.clip(distance - spare, 0.0, params.map.motion.step_length * speed)
    length = jnp.where(choice.is_stop, 0.0, length)
    action = Action(
        waypoint=jnp.stack([choice.waypoint_x, choice.waypoint_y]),
        step=jnp.stack([span_x, span_y]) / distance * length,
        is_stop=is_stop,
        speed=speed,
        clearance=clearance,
    )
    state = replace(
        state,
        clause=state.clause + advances.astype(jnp.int32),
        previous_goal=jnp.where(choice.is_stop, goal_slot, state.previous_goal),
        visited=visited,
        commitment=policy.Commitment(
            x=choice.waypoint_x,
            y=choice.waypoint_y,
            kind=choice.kind,
            is_active=~choice.is_stop,
        ),
        tour=state.tour if plan is None else tours.take(plan, choice.value),
        is_done=state.is_done | is_stop,
    )
    info = NavigatorInfo(
        filter=filter_info,
        choice=choice,
        nodes=nodes,
        goals=goals,
        behavior=expected,
        robot=jnp.stack([robot_x, robot_y]),
    )
    return state, action, info
