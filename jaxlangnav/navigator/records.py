"""What a decision cycle is given and keeps: numbers, sizes and state."""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxlangnav.conversation import Conversation
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import Behavior, Status
from jaxlangnav.planner import graph
from jaxlangnav.planner.blocked import Way
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.params import PlannerParams, default_planner_params
from jaxlangnav.planner.policy import Policy
from jaxlangnav.pytree import field, pytree
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapConfig, MapParams, default_map_params

_MOST_LOOKED = 0.75
"""Share of the area beyond which a robot that waits to be sure as good as never stops."""


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
    signature: Array | None = None  # u32[2] checksums of the labels and of the policy's name; None:
    # not checked

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
        policy: which decides by them. One that takes the likeliest thing in the end may be told
            that there are as many of a type as there are.

    Raises:
        ValueError: names the value, the limit and the remedy.
    """
    alpha, kappa = float(jnp.max(params.map.concentration)), float(jnp.min(params.map.clumping))
    tau = float(jnp.max(params.planner.stop_probability))
    gamma = float(jnp.max(params.planner.discount))
    if not 0.0 < gamma < 1.0:
        raise ValueError(f"discount is {gamma:g}, but must be above 0 and below 1")
    if not 0.0 < tau < 1.0:
        raise ValueError(f"stop_probability is {tau:g}, but must be above 0 and below 1")
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


class Outlook(NamedTuple):
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
