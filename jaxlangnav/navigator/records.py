"""Parameters, configuration and state of the navigator; its action and task-state update."""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxlangnav.dialogue import Conversation
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import NONE, Action, Behavior, SensorParams, Status
from jaxlangnav.planner import graph, policy
from jaxlangnav.planner.blocked import ProgressMonitor
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.planner.constraints import safe_fraction
from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.planner.policy import Policy
from jaxlangnav.pytree import field, pytree, replace
from jaxlangnav.semantic_map.belief import ParticleBelief, mean_drift
from jaxlangnav.semantic_map.params import MapConfig, MapParams, default_map_params
from jaxlangnav.terrain.view import rotate

_MAX_OBSERVED = 0.75  # fraction of the area to be observed first, above which it hardly ever stops


@pytree
class NavigatorParams:
    """All traced parameters of the navigator."""

    map: MapParams
    planner: PlannerParams
    mode_speed: Array = field("factor on the step length: normal, quickly, carefully")  # f32[3]
    mode_clearance: Array = field("metres kept from objects")  # f32[3]
    policy: Any = None  # one that holds arrays (``split_arrays``); None: the configuration's

    def policy_of(self, config: "NavigatorConfig") -> Policy:
        """Return the policy, with its arrays if it has any."""
        return config.planner.chosen if self.policy is None else self.policy


@dataclasses.dataclass(frozen=True, kw_only=True)
class NavigatorConfig:
    """Static configuration: capacities and policy; hashable, a change recompiles."""

    map: MapConfig = dataclasses.field(default_factory=MapConfig)
    planner: PlannerConfig = dataclasses.field(default_factory=PlannerConfig)
    patience: int = field("cycles without progress after which the robot steps aside", default=5)
    num_detours: int = field(
        "stalls at one obstacle after which the robot counts as blocked", default=8
    )

    def __post_init__(self) -> None:
        """Raise a ValueError for inconsistent sizes."""
        if self.map.num_cells % self.planner.num_blocks:
            raise ValueError(
                f"num_cells is {self.map.num_cells}, but must be a multiple of "
                f"num_blocks, {self.planner.num_blocks}"
            )
        self.planner.chosen.check(self.map)


@pytree
class NavigatorState:
    """State of the navigator between decision cycles."""

    belief: ParticleBelief
    instruction: Instruction
    clause: Array  # i32[] index of the current command
    previous_goal: Array  # i32[] observed slot at which the last command ended; NONE at first
    visited: graph.Visited
    memory: Any  # of the policy
    status: Array  # i32[] a Status: of the task after the last cycle, whether halted or not
    is_halted: Array  # bool[] it was told to halt
    talk: Conversation  # dialogue state
    progress: ProgressMonitor  # progress monitoring, and abandoned waypoints
    signature: Array | None = None  # u32[2] checksums of labels and policy name; None: unchecked

    @property
    def is_done(self) -> Array:
        """Whether the task has ended, bool[], successfully or not; an utterance may resume it."""
        terminal = (Status.ARRIVED, Status.NOT_FOUND, Status.WHICH_ONE, Status.BLOCKED)
        return functools.reduce(jnp.logical_or, [self.status == status for status in terminal])

    @property
    def is_resting(self) -> Array:
        """Whether the robot stands still until the next utterance, bool[]."""
        return self.is_halted | self.is_done | (self.status == Status.IDLE)


def default_params() -> NavigatorParams:
    """Build the default parameters, those of the results tables."""
    return NavigatorParams(
        map=default_map_params(),
        planner=PlannerParams(),
        mode_speed=jnp.array([1.0, 1.5, 0.6], jnp.float32),
        mode_clearance=jnp.array([0.3, 0.2, 0.6], jnp.float32),
    )


def check(params: NavigatorParams, *, policy: Policy) -> None:
    """Raise a ValueError for parameters with which the robot could never stop (host only).

    For a sentence without relations, the first candidate observed is the goal with probability
    1 / (1 + α (1 − s) / (1 + κ s)) once a fraction s of the area has been observed. The robot
    stops once this reaches τ; if that takes most of the area, the parameters are refused.

    Args:
        params: concrete parameters.
        policy: policy that uses them.

    Raises:
        ValueError: names the value, the limit and the remedy.
    """
    alpha, kappa = float(jnp.max(params.map.concentration)), float(jnp.min(params.map.clumping))
    tau = float(jnp.max(params.planner.stop_probability))
    gamma = float(jnp.max(params.planner.discount))
    for name, value in {"discount": gamma, "stop_probability": tau}.items():
        if not 0.0 < value < 1.0:
            raise ValueError(f"{name} is {value:g}, but must be above 0 and below 1")
    if not alpha > 0.0:
        raise ValueError(f"concentration is {alpha:g}, but must be positive")
    odds = 1.0 / tau - 1.0
    observed = (alpha - odds) / (alpha + odds * kappa)
    if observed > _MAX_OBSERVED and not policy.takes_likeliest:
        raise ValueError(
            f"stop_probability is {tau:g}, but with concentration {alpha:g} the first candidate "
            f"seen reaches it after {100.0 * observed:.0f} % of the area, and at most "
            f"{100.0 * _MAX_OBSERVED:g} % can be asked of {policy.name}: lower stop_probability or "
            "concentration"
        )


class InferredTask(NamedTuple):
    """Marginals of the belief for planning: robot position, behavior, goal distribution."""

    fault: Array  # i32[] bits of Fault; 0 for a valid observation and a task
    belief: ParticleBelief  # aligned on the robot, restricted to the task's mentions
    is_still: Array  # bool[] the robot stands still: at a fault, halted, idle or ended
    robot: tuple[Array, Array]  # f32[] x and y, believed position, metres, map frame
    behavior: Behavior  # leaves [..., P]
    expected: Behavior  # expectation over particles
    is_relevant: Array  # bool[M, P] mentions that bear on the goal of the present command
    goals: Goals


def make_action(
    state: NavigatorState,
    task: InferredTask,
    choice: policy.Decision,
    sensor: SensorParams,
    *,
    params: NavigatorParams,
) -> Action:
    """Build the action of a decision, with the speed and clearance of the behavior's mode.

    The state is the new one, of ``update_task_state``. Limits: the waypoint of a stationary robot
    is its believed position.
    """
    mode = jnp.argmax(task.expected.mode)
    speed, clearance = params.mode_speed[mode], params.mode_clearance[mode]
    waypoint = jnp.stack([choice.next_x, choice.next_y])
    is_still = task.is_still | (state.is_done & ~choice.is_stop)
    waypoint = jnp.where(is_still, jnp.stack(task.robot), waypoint)
    travel = state.belief.terrain.travel
    start, end = task.robot, tuple(waypoint)
    next_x, next_y = travel.next_place(*start, *end)
    remaining, distance = travel.metres(*start, *end), travel.metres(*start, next_x, next_y)
    # The robot stops in front of an object, but at any other waypoint.
    is_object = (choice.kind == graph.OBJECT_NODE) & ~choice.turns
    margin = jnp.where(is_object, policy.APPROACH * params.planner.reach, 0.0)
    length = jnp.clip(remaining - margin, 0.0, params.map.motion.step_length * speed)
    length = jnp.where(choice.is_stop, 0.0, jnp.minimum(length, distance))
    step_x, step_y = next_x - start[0], next_y - start[1]
    step, forbidden = jnp.stack([step_x, step_y]) / distance * length, task.behavior.constraint
    frac = safe_fraction(task.belief, forbidden, start, step, sensor, params.planner.unseen_risk)
    drift = mean_drift(state.belief)
    if drift is not None:
        step_x, step_y = rotate(step_x, step_y, -drift)
    status = jnp.where(state.instruction.num_clauses == 0, int(Status.IDLE), state.status)
    return Action(
        waypoint=waypoint,
        step=jnp.stack([step_x, step_y]) / distance * (length * frac),
        is_stop=state.is_done & ~state.is_halted & (task.fault == 0),
        status=jnp.where(state.is_halted, int(Status.HALTED), status),
        speed=speed,
        clearance=clearance,
    )


def update_task_state(
    state: NavigatorState,
    task: InferredTask,
    choice: policy.Decision,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> NavigatorState:
    """Update status, dialogue state and command index after a decision.

    The status is unchanged while the robot is stationary.
    """
    is_last = state.clause + 1 >= state.instruction.num_clauses
    status = jnp.where(choice.is_approach, int(Status.APPROACHING), int(Status.SEARCHING))
    status = jnp.where(choice.is_not_found, int(Status.NOT_FOUND), status)
    status = jnp.where(choice.is_stop & is_last, int(Status.ARRIVED), status)
    status = jnp.where(choice.question.asks, int(Status.WHICH_ONE), status)
    is_blocked = state.progress.num_stalls > config.num_detours
    status = jnp.where(is_blocked & ~choice.is_stop, int(Status.BLOCKED), status)
    # The goal of an ended command is the acceptable object of highest discounted probability.
    goals, travel = task.goals, state.belief.terrain.travel
    distance = travel.metres(*task.robot, goals.object_x, goals.object_y)[:-1]
    value = goals.object_accepted[:-1] * params.planner.discount**distance
    goal_slot = jnp.argmax(value).astype(jnp.int32)
    is_advanced, talk, progress = choice.is_stop & ~is_last, state.talk, state.progress
    # The object being approached is stored, as later utterances may refer to it.
    distance = jnp.hypot(goals.object_x - choice.waypoint_x, goals.object_y - choice.waypoint_y)
    is_goal = goals.is_object & (goals.object_accepted >= policy.MIN_GOAL_PROB)
    nearest = jnp.argmin(jnp.where(is_goal, distance, jnp.inf)[:-1]).astype(jnp.int32)
    approached = jnp.where(choice.is_approach, nearest, talk.approached)
    reached = jnp.where(jnp.any(is_goal[:-1]), goal_slot, talk.approached)
    talk = replace(
        talk,
        approached=jnp.where(choice.is_stop, reached, approached),
        ruled_out=jnp.where(is_advanced, 0, talk.ruled_out),
        chosen=jnp.where(is_advanced, NONE, talk.chosen),
        closeness=jnp.where(is_advanced, 1.0, talk.closeness),
        candidate=jnp.where(goals.is_object, goals.object_mass, 0.0)[:-1],
    )
    return replace(
        state,
        clause=state.clause + is_advanced.astype(jnp.int32),
        previous_goal=jnp.where(choice.is_stop, goal_slot, state.previous_goal),
        status=jnp.where(task.is_still, state.status, status),
        talk=talk,
        progress=replace(progress, num_stalls=jnp.where(is_advanced, 0, progress.num_stalls)),
    )
