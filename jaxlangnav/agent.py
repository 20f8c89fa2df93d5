"""The navigator for people: grounder, parameters and sizes in one object.

Two functions over records are the whole engine, for any robot or simulator:

    navigator = jaxlangnav.Navigator.pretrained()
    state = navigator.start("go to the hydrant behind the cone", pose=(0.0, 0.0, 0.0))
    state, action, info = navigator.step(key, state, observation)

``step`` is compiled once, whatever is said; ``navigator.step`` the module function can be
``vmap``-ed over states.
"""

import dataclasses
from collections.abc import Sequence
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav import navigator
from jaxlangnav.conversation import words_of
from jaxlangnav.grounding import Context, GraphGrounder, Grounded, Grounder, load_shipped
from jaxlangnav.grounding.annotated import returning
from jaxlangnav.grounding.behavior import MAX_SLOTS
from jaxlangnav.grounding.readings import Capacity, widen
from jaxlangnav.language.halting import act_of
from jaxlangnav.listening import Candidate, Heard, Listener
from jaxlangnav.messages import NONE, Action, Observation, Status
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams, NavigatorState
from jaxlangnav.plain_text import cut
from jaxlangnav.planner.endings import missing_types
from jaxlangnav.planner.own import Policy
from jaxlangnav.planner.params import PlannerConfig
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.soundness import check_place

DEFAULT_EXTENT = 15.0
"""Metres to each side of the robot that are its operating area unless it is told otherwise."""

_step = jax.jit(navigator.step, static_argnames="config")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Navigator:
    """Grounder, parameters and sizes of an agent that follows instructions."""

    grounder: Grounder
    params: NavigatorParams
    config: NavigatorConfig
    capacity: Capacity = dataclasses.field(default_factory=Capacity)
    """How much of a conversation is kept."""

    @classmethod
    def pretrained(
        cls, policy: str | Policy = "informed", grounder: Grounder | None = None
    ) -> Self:
        """Build a navigator from the weights that ship with the package.

        Args:
            policy: "informed", "faithful" to the paper, or a policy of one's own.
            grounder: what understands instructions; the trained graph by default.

        Returns:
            The navigator, with default parameters and sizes, but without the search prior that was
            learned in the template worlds (``prior_share`` 0).

        Raises:
            ValueError: no such policy.
        """
        return cls(
            grounder=GraphGrounder(load_shipped()) if grounder is None else grounder,
            params=_params_anywhere(),
            config=NavigatorConfig(planner=PlannerConfig(policy=policy)),
        )

    def __post_init__(self) -> None:
        """Refuse parameters with which the robot could never stop, and sizes that do not fit."""
        navigator.check(self.params)
        size = self.config.map.num_objects + self.capacity.num_mentions + 1
        if size > MAX_SLOTS:
            raise ValueError(
                f"num_objects and num_mentions sum to {size - 1}, but at most {MAX_SLOTS - 1} are "
                "held: lower one of them"
            )

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
        grounded = self.grounder.ground(text, Context(is_under_way=False))
        if int(grounded.instruction.num_clauses) == 0:
            raise ValueError(
                f"{cut(text)!r} informs but asks for nothing to be done: add a command"
            )
        return self._start(grounded, pose, area)

    def wait(
        self, pose: Sequence[float] = (0.0, 0.0, 0.0), area: Sequence[float] | None = None
    ) -> NavigatorState:
        """Place a robot that has seen nothing and been told nothing: it is idle until it hears.

        Args:
            pose: see ``start``.
            area: see ``start``.

        Returns:
            The state before the first observation.

        Raises:
            ValueError: pose or area cannot be.
        """
        nothing = returning()
        silent = replace(nothing, num_clauses=jnp.zeros_like(nothing.num_clauses))
        grounded = Grounded(instruction=silent, annotations=())
        return replace(self._start(grounded, pose, area), status=jnp.int32(Status.IDLE))

    def _start(
        self, grounded: Grounded, pose: Sequence[float], area: Sequence[float] | None
    ) -> NavigatorState:
        """Begin with what has been understood, in arrays that hold a conversation."""
        bounds = _around(pose) if area is None else area
        check_place(pose, bounds)
        told = grounded.instruction
        instruction = replace(told, readings=widen(told.readings, self.capacity))
        return navigator.start(
            instruction,
            jnp.asarray(pose, jnp.float32),
            jnp.asarray(bounds, jnp.float32),
            config=self.config,
            num_types=len(self.type_names),
            words=words_of(instruction, grounded.spoken),
        )

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
        """Take in an utterance; see ``take``, which also tells what it was taken for."""
        return self.take(state, text)[0]

    def take(self, state: NavigatorState, text: str) -> tuple[NavigatorState, Heard]:
        """Take in an utterance: a conversation is a stream of them.

        A command takes the place of the task, an addition ("then …") comes after it. A statement
        says something of the map and changes no task; so does what to keep away from, which holds
        until the robot is told to go to the very thing. A correction rules out what is being
        approached ("the other one"), or says what is meant; "come back" returns to where the
        conversation began; a question (``Status.WHICH_ONE``) is answered by "the left one", "the
        second", "the one by the cone". What was said of the map is never forgotten while there is
        room for it, and words reach back: "it", "the one on the left", "the other hydrant".

        Words to halt, to go on or to cancel work by themselves, before any model and whatever the
        state is. A halted robot goes on when it is told to, or given a command, a correction or an
        answer, and not for a statement, an addition or a constraint. Cancelled it is idle: it has
        no task any more. What begins with a sentence to halt ("Stop! There is a child …") halts
        the robot, too, where the whole is no command that it understands. As the robot must not
        lose its halt to a refusal, nothing is raised then: why the rest was left out is logged as
        a warning.

        Nothing is compiled for it, whatever is said.

        Args:
            state: of a robot under way, halted, idle or at its end.
            text: what the person said.

        Returns:
            The state, to be followed by the next observation, and what the words were taken for.

        Raises:
            ValueError: the words are not understood, or refer to what is not there, as "the other
                one" where nothing has been approached: the robot then keeps to its state.
        """
        return self._listener.take(state, text)

    def candidates(self, state: NavigatorState) -> list[Candidate]:
        """List the things that may be meant, the nearest first: what a question is about.

        Args:
            state: after any step.

        Returns:
            Things seen that may be the goal, with where they are believed to be.
        """
        return self._listener.candidates(state)

    @property
    def _listener(self) -> Listener:
        return Listener(self.grounder)

    def missing(self, state: NavigatorState) -> list[str]:
        """Name what the task speaks of and the robot has not seen, such as its goal's landmark.

        Args:
            state: after any step; of a robot that has not found its goal, it tells why.

        Returns:
            Names of object types, in the order of the sentence; none where all has been seen.
        """
        types = np.asarray(state.belief.particles.object_type)
        readings, is_asked = state.instruction.readings, state.talk.words.is_asked
        spoken = np.where(np.asarray(is_asked), np.asarray(readings.mention_type), NONE)
        missing = missing_types(replace(readings, mention_type=spoken), types)
        return [self.type_names[kind] for kind in missing]


def _around(pose: Sequence[float]) -> tuple[float, ...]:
    """Lay the operating area about a start pose."""
    x, y = (*map(float, pose), 0.0, 0.0)[:2]
    return (x - DEFAULT_EXTENT, x + DEFAULT_EXTENT, y - DEFAULT_EXTENT, y + DEFAULT_EXTENT)


def _params_anywhere() -> NavigatorParams:
    """Build the default numbers for places that are unlike the planner's training worlds."""
    params = navigator.default_params()
    planner = replace(params.planner, prior_share=jnp.float32(0.0))
    return replace(params, planner=planner)
