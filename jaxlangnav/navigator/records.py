"""What a decision cycle is given and keeps, and what comes of it: step, status and memory."""

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
from jaxlangnav.planner.params import PlannerParams, default_planner_params
from jaxlangnav.planner.policy import Policy
from jaxlangnav.pytree import field, pytree, replace
from jaxlangnav.semantic_map.belief import ParticleBelief, mean_drift
from jaxlangnav.semantic_map.params import MapConfig, MapParams, default_map_params
from jaxlangnav.terrain.view import rotated

_MOST_LOOKED = 0.75  # share of the area beyond which a robot that waits as good as never stops


@pytree
class NavigatorParams:
    """All traced parameters."""

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
    """State between decision cycles."""

    belief: ParticleBelief
    instruction: Instruction
    clause: Array  # i32[] which of the instruction's commands is being carried out
    previous_goal: Array  # i32[] observed slot at which the last command ended; NONE at first
    visited: graph.Visited
    memory: Any  # of the policy
    status: Array  # i32[] a Status: of the task after the last cycle, whether halted or not
    is_halted: Array  # bool[] it was told to halt
    talk: Conversation  # what has been said besides, and ruled out
    way: ProgressMonitor  # whether it gets on, and the waypoints given up
    signature: Array | None = None  # u32[2] checksums of the labels and of the policy's name; None:
    # not checked

    @property
    def is_done(self) -> Array:
        """Whether the task has ended, bool[], unless more is heard: done, or it cannot be."""
        endings = (Status.ARRIVED, Status.NOT_FOUND, Status.WHICH_ONE, Status.BLOCKED)
        return functools.reduce(jnp.logical_or, [self.status == one for one in endings])

    @property
    def is_resting(self) -> Array:
        """Whether the robot stands still until it hears something, bool[]."""
        return self.is_halted | self.is_done | (self.status == Status.IDLE)


def default_params() -> NavigatorParams:
    """Build the parameters used in all tables unless they say otherwise."""
    return NavigatorParams(
        map=default_map_params(),
        planner=default_planner_params(),
        mode_speed=jnp.array([1.0, 1.5, 0.6], jnp.float32),
        mode_clearance=jnp.array([0.3, 0.2, 0.6], jnp.float32),
    )


def check(params: NavigatorParams, *, policy: Policy) -> None:
    """Refuse parameters with which the robot could never stop (host only).

    The first candidate seen, by a sentence that says nothing of where, is what is meant with
    probability 1 / (1 + α (1 − s) / (1 + κ s)) once a share s of the area has been looked at. A
    robot that waits for τ looks at most of the area first where that comes late.

    Args:
        params: concrete parameters.
        policy: which decides by them.

    Raises:
        ValueError: names the value, the limit and the remedy.
    """
    alpha, kappa = float(jnp.max(params.map.concentration)), float(jnp.min(params.map.clumping))
    tau = float(jnp.max(params.planner.stop_probability))
    gamma = float(jnp.max(params.planner.discount))
    for name, value in {"discount": gamma, "stop_probability": tau}.items():
        if not 0.0 < value < 1.0:
            raise ValueError(f"{name} is {value:g}, but must be above 0 and below 1")
    if alpha <= 0.0:
        raise ValueError(f"concentration is {alpha:g}, but must be positive")
    odds = 1.0 / tau - 1.0
    share = (alpha - odds) / (alpha + odds * kappa)
    if share > _MOST_LOOKED and not policy.takes_likeliest:
        raise ValueError(
            f"stop_probability is {tau:g}, but with concentration {alpha:g} the first candidate "
            f"seen reaches it after {100.0 * share:.0f} % of the area, and at most "
            f"{100.0 * _MOST_LOOKED:g} % can be asked of {policy.name}: lower stop_probability or "
            "concentration"
        )


class InferredTask(NamedTuple):
    """Marginals of the belief for planning: robot position, behavior, goal distribution."""

    fault: Array  # i32[] bits of Fault; 0 for a sound look and a task
    belief: ParticleBelief  # as far as the task speaks of it
    stands: Array  # bool[] the robot stands still: for a fault, or as it has been told or has ended
    robot: tuple[Array, Array]  # f32[] x and y, believed position, metres, map frame
    behavior: Behavior  # leaves [..., P]
    expected: Behavior  # expectation over particles
    is_relevant: Array  # bool[M, P] mentions that bear on the goal of the present command
    goals: Goals


def _is_last_clause(state: NavigatorState) -> Array:
    """Test whether the current command is the last one, bool[]."""
    return state.clause + 1 >= state.instruction.num_clauses


def _status(
    state: NavigatorState, task: InferredTask, choice: policy.Decision, config: NavigatorConfig
) -> Array:
    """Tell what becomes of the task, i32[] a Status: what it was where the robot stands still."""
    under_way = jnp.where(choice.is_approach, int(Status.APPROACHING), int(Status.SEARCHING))
    is_arrived = choice.is_stop & _is_last_clause(state)
    ended = jnp.where(choice.is_not_found, int(Status.NOT_FOUND), under_way)
    status = jnp.where(is_arrived, int(Status.ARRIVED), ended)
    status = jnp.where(choice.doubt.asks, int(Status.WHICH_ONE), status)
    is_blocked = state.way.num_closed > config.num_detours
    status = jnp.where(is_blocked & ~choice.is_stop, int(Status.BLOCKED), status)
    return jnp.where(task.stands, state.status, status)


def make_action(
    state: NavigatorState,
    task: InferredTask,
    choice: policy.Decision,
    sensor: SensorParams,
    *,
    params: NavigatorParams,
) -> Action:
    """Turn the choice into a step in the manner asked for: quickly, carefully.

    The state is the new one, of ``update_task_state``. Limits: where it stands, the waypoint is
    where the robot believes itself to be.
    """
    mode = jnp.argmax(task.expected.mode)
    speed, clearance = params.mode_speed[mode], params.mode_clearance[mode]
    waypoint = jnp.stack([choice.next_x, choice.next_y])
    stands = task.stands | (state.is_done & ~choice.is_stop)
    waypoint = jnp.where(stands, jnp.stack(task.robot), waypoint)
    travel = state.belief.terrain.travel
    here, there = task.robot, tuple(waypoint)
    next_x, next_y = travel.next_place(*here, *there)
    left, distance = travel.metres(*here, *there), travel.metres(*here, next_x, next_y)
    # A thing is gone up to, not into; anything else is a place to stand on.
    is_thing = (choice.kind == graph.OBJECT_NODE) & ~choice.turns
    spare = jnp.where(is_thing, policy.APPROACH * params.planner.reach, 0.0)
    length = jnp.clip(left - spare, 0.0, params.map.motion.step_length * speed)
    length = jnp.where(choice.is_stop, 0.0, jnp.minimum(length, distance))
    is_idle = state.instruction.num_clauses == 0
    step_x, step_y = next_x - here[0], next_y - here[1]
    step, constraint = jnp.stack([step_x, step_y]) / distance * length, task.behavior.constraint
    share = safe_fraction(task.belief, constraint, here, step, sensor, params.planner.unseen_risk)
    drift = mean_drift(state.belief)
    if drift is not None:
        step_x, step_y = rotated(step_x, step_y, -drift)
    status = jnp.where(is_idle, int(Status.IDLE), state.status)
    return Action(
        waypoint=waypoint,
        step=jnp.stack([step_x, step_y]) / distance * (length * share),
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
    """Remember what the next decision needs; a command carried out makes way for the next one."""
    is_last = _is_last_clause(state)
    # Of the objects that would do, the last command ended at the one gone up to.
    goals, travel = task.goals, state.belief.terrain.travel
    away = travel.metres(*task.robot, goals.object_x, goals.object_y)[:-1]
    will_do = goals.object_accepted[:-1] * params.planner.discount**away
    goal_slot = jnp.argmax(will_do).astype(jnp.int32)
    moves_on, talk = choice.is_stop & ~is_last, state.talk
    # What it goes up to is remembered for what may be said of it.
    away = jnp.hypot(goals.object_x - choice.waypoint_x, goals.object_y - choice.waypoint_y)
    is_goal = goals.is_object & (goals.object_accepted >= policy.MIN_GOAL_PROB)
    aimed = jnp.argmin(jnp.where(is_goal, away, jnp.inf)[:-1]).astype(jnp.int32)
    approached = jnp.where(choice.is_approach, aimed, talk.approached)
    reached = jnp.where(jnp.any(is_goal[:-1]), goal_slot, talk.approached)
    talk = replace(
        talk,
        approached=jnp.where(choice.is_stop, reached, approached),
        ruled_out=jnp.where(moves_on, 0, talk.ruled_out),
        chosen=jnp.where(moves_on, NONE, talk.chosen),
        closeness=jnp.where(moves_on, 1.0, talk.closeness),
        candidate=jnp.where(goals.is_object, goals.object_mass, 0.0)[:-1],
    )
    return replace(
        state,
        clause=state.clause + moves_on.astype(jnp.int32),
        previous_goal=jnp.where(choice.is_stop, goal_slot, state.previous_goal),
        status=_status(state, task, choice, config),
        talk=talk,
        way=replace(state.way, num_closed=jnp.where(moves_on, 0, state.way.num_closed)),
    )
