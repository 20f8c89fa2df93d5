"""The navigator for people: grounder, parameters and sizes in one object.

Two functions over records are the whole engine, for any robot or simulator:

    navigator = jaxlangnav.Navigator.pretrained()
    state = navigator.start("go to the hydrant behind the cone", pose=(0.0, 0.0, 0.0))
    state, action, info = navigator.step(key, state, observation)

``step`` is compiled once, whatever is said; ``navigator.step`` the module function can be
``vmap``-ed over states.
"""

import dataclasses
import logging
from collections.abc import Sequence
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav import navigator
from jaxlangnav.grounding import Context, GraphGrounder, Grounder, load_shipped
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.language.halting import Act, act_of, begins_with_halt
from jaxlangnav.messages import Action, Observation
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams, NavigatorState
from jaxlangnav.plain_text import cut
from jaxlangnav.planner.endings import missing_types
from jaxlangnav.planner.own import Policy
from jaxlangnav.planner.params import PlannerConfig
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.semantic_map.soundness import check_place

DEFAULT_EXTENT = 15.0
"""Metres to each side of the robot that are its operating area unless it is told otherwise."""
OBJECTS, BYSTANDERS = 12, 64
"""Things that a sentence may mean, and others, that are remembered: for places as they are."""
CLUMPING, MISLEADING = 1.0, 0.01
"""How many things there are is not known, and a sentence is rather taken to speak of another of
them than to be false: in 14 × 18 m with two further pairs 197 of 200 arrive (180 with the numbers
of the tables), and a false sentence costs 37.5 m (34.9)."""

_log = logging.getLogger(__name__)
_step = jax.jit(navigator.step, static_argnames="config")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Navigator:
    """Grounder, parameters and sizes of an agent that follows instructions."""

    grounder: Grounder
    params: NavigatorParams
    config: NavigatorConfig

    @classmethod
    def pretrained(
        cls, policy: str | Policy = "informed", grounder: Grounder | None = None
    ) -> Self:
        """Build a navigator from the weights that ship with the package.

        Args:
            policy: "informed", "faithful" to the paper, or a policy of one's own.
            grounder: what understands instructions; the trained graph by default.

        Returns:
            The navigator, with parameters and sizes for places as they are: without the search
            prior that was learned in the template worlds (``prior_share`` 0), with room for
            bystanders, and in doubt about how many things there are and whether they exist.

        Raises:
            ValueError: no such policy.
        """
        return cls(
            grounder=GraphGrounder(load_shipped()) if grounder is None else grounder,
            params=_params_anywhere(),
            config=NavigatorConfig(
                map=MapConfig(num_objects=OBJECTS, num_bystanders=BYSTANDERS, has_doubts=True),
                planner=PlannerConfig(policy=policy),
            ),
        )

    def __post_init__(self) -> None:
        """Refuse parameters with which the robot could never stop."""
        navigator.check(self.params)

    @property
    def type_names(self) -> tuple[str, ...]:
        """Object types; a detection names its type by the index into them."""
        return self.grounder.type_names

    def start(
        self,
        text: str,
        pose: Sequence[float] = (0.0, 0.0, 0.0),
        area: Sequence[float] | None = None,
    ) -> NavigatorState:
        """Tell a robot that has seen nothing what to do.

        Args:
            text: the instruction.
            pose: x, y, heading, metres and radians, map frame.
            area: operating area x_min, x_max, y_min, y_max, metres, map frame; 15 m to each side
                of the robot by default.

        Returns:
            The state before the first observation.

        Raises:
            ValueError: the instruction is not understood or asks for nothing, or pose or area
                cannot be.
        """
        act = act_of(text)
        if act is not None:
            raise ValueError(
                f"{text[:40]!r} is to {act}, but a robot that has no task yet has nothing to "
                f"{act}: give a command, as in 'go to the hydrant'"
            )
        bounds = _around(pose) if area is None else area
        check_place(pose, bounds)
        return navigator.start(
            self._command(text, is_under_way=False),
            jnp.asarray(pose, jnp.float32),
            jnp.asarray(bounds, jnp.float32),
            config=self.config,
            num_types=len(self.type_names),
        )

    def _command(self, text: str, *, is_under_way: bool) -> Instruction:
        """Understand what asks for something."""
        context = Context(is_under_way=is_under_way)
        instruction = self.grounder.ground(text, context).instruction
        if int(instruction.num_clauses) == 0:
            raise ValueError(
                f"{cut(text)!r} informs but asks for nothing to be done: add a command"
            )
        return instruction

    def step(
        self, key: Array, state: NavigatorState, observation: Observation
    ) -> tuple[NavigatorState, Action, NavigatorInfo]:
        """Run one decision cycle, compiled: from an observation to an action.

        Args:
            key: random key, consumed.
            state: after the last cycle.
            observation: pose and detections now. One that cannot be is left out: the robot stands
                still, and ``Fault(int(info.fault))`` says why.

        Returns:
            The new state, what the robot is to do, and why.
        """
        return _step(key, state, observation, params=self.params, config=self.config)

    def hear(self, state: NavigatorState, text: str) -> NavigatorState:
        """Take in another command, or words to halt, to go on or to cancel.

        Of a command the map is kept and the words are grounded anew; a robot that has been halted
        goes on with it. Words to halt work by themselves, before any model and whatever the state
        is; until it is told to go on, or given a command, the robot stands still. Cancelled it is
        idle: it has no task any more.

        What begins with a sentence to halt ("Stop! There is a child …") halts the robot, too, where
        the whole is no command that it understands. As the robot must not lose its halt to a
        refusal, nothing is raised then: why the rest was left out is logged as a warning.

        Args:
            state: of a robot under way, halted or at its goal.
            text: what the person said.

        Returns:
            The state, to be followed by the next observation.

        Raises:
            ValueError: the instruction is not understood, or asks for nothing to be done: the
                robot then keeps to the state that it has.
        """
        act = act_of(text)
        if act is not None:
            return navigator.obey(state, act)
        try:
            instruction = self._command(text, is_under_way=True)
        except ValueError as refusal:
            if not begins_with_halt(text):
                raise
            _log.warning("halted; the rest of what was said is left out: %s", refusal)
            return navigator.obey(state, Act.HALT)
        return navigator.hear(state, instruction, state.belief.last_pose)

    def missing(self, state: NavigatorState) -> list[str]:
        """Name what the task speaks of and the robot has not seen, such as its goal's landmark.

        Args:
            state: after any step; of a robot that has not found its goal, it tells why.

        Returns:
            Names of object types, in the order of the sentence; none where all has been seen.
        """
        types = np.asarray(state.belief.particles.object_type)
        missing = missing_types(state.instruction.readings, types)
        return [self.type_names[kind] for kind in missing]


def _around(pose: Sequence[float]) -> tuple[float, ...]:
    """Lay the operating area about a start pose."""
    x, y = (*map(float, pose), 0.0, 0.0)[:2]
    return (x - DEFAULT_EXTENT, x + DEFAULT_EXTENT, y - DEFAULT_EXTENT, y + DEFAULT_EXTENT)


def _params_anywhere() -> NavigatorParams:
    """Build the default numbers for places that are unlike the planner's training worlds."""
    params = navigator.default_params()
    believed = replace(
        params.map, clumping=jnp.float32(CLUMPING), misleading=jnp.float32(MISLEADING)
    )
    planner = replace(params.planner, prior_share=jnp.float32(0.0))
    return replace(params, map=believed, planner=planner)
