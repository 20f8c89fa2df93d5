"""User-facing ``Navigator``: grounder, parameters and capacities behind start, step and hear.

    navigator = jaxlangnav.Navigator.pretrained()
    state = navigator.start("go to the hydrant behind the cone", pose=(0.0, 0.0, 0.0))
    state, action, info = navigator.step(key, state, observation)

``step`` is compiled once for all utterances; the module function ``navigator.step`` can be
``vmap``-ed over states.
"""

import dataclasses
import logging
import time
from collections.abc import Iterable, Sequence
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav import navigator
from jaxlangnav.dialogue import discourse_of
from jaxlangnav.grounding import Context, GraphGrounder, Grounded, Grounder, load_shipped
from jaxlangnav.grounding.annotated import come_here
from jaxlangnav.grounding.grounder import names_of
from jaxlangnav.grounding.instruction import pad_instruction
from jaxlangnav.grounding.readings import Capacity
from jaxlangnav.inputs.limits import bounded, whole_number
from jaxlangnav.inputs.object_types import is_anything, name_of
from jaxlangnav.inputs.observations import SLOTS, validate_area, validate_pose
from jaxlangnav.inputs.sanitize import quote, shorten
from jaxlangnav.language.halting import act_of
from jaxlangnav.messages import Action, Observation, SensorParams, Status, default_sensor
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams, NavigatorState
from jaxlangnav.navigator.candidates import Candidate, candidates, mentioned_types, unseen_types
from jaxlangnav.navigator.canonicalize import MAX_BITS, canonicalize, check_key, check_state
from jaxlangnav.navigator.deployment import deployment_config, deployment_params, set_params
from jaxlangnav.navigator.interpret import Listener, UtteranceOutcome, check_metric_goals
from jaxlangnav.planner.config import AnyPolicy, split_arrays
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.gating import check_start
from jaxlangnav.terrain import OPEN, RANGING, SensorModel, Terrain

DEFAULT_EXTENT = 15.0
"""Default operating area: metres to each side of the robot."""
_log = logging.getLogger(__name__)

_step = jax.jit(navigator.step, static_argnames="config")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Navigator:
    """Agent that follows instructions: its grounder, parameters and capacities."""

    grounder: Grounder
    params: NavigatorParams
    config: NavigatorConfig
    capacity: Capacity = dataclasses.field(default_factory=Capacity)
    """Capacities of the dialogue state."""

    @classmethod
    def pretrained(
        cls,
        policy: AnyPolicy = "informed",
        grounder: Grounder | None = None,
        *,
        labels: Sequence[str] | None = None,
        attributes: Sequence[str] = (),
        **numbers: float | str,
    ) -> Self:
        """Build a navigator from the weights that ship with the package.

        Args:
            policy: "informed", "faithful" to the paper, or a custom policy.
            grounder: grounds instructions; the trained graph by default.
            labels: object types of the robot's detector, in the order of its indices, for the
                trained graph; the lexicon's types by default.
            attributes: groups of ``ATTRIBUTES`` that the detector reports.
            **numbers: any scalar of ``MapParams``, ``MotionParams`` or ``PlannerParams`` by its
                name, such as ``odometry_noise=0.05`` or ``step_length="50 cm"``, within the
                limits of the command line; new values never recompile. A drifting heading
                (``heading_noise`` and the like) needs a compiled program of its own.

        Returns:
            The navigator, with parameters and capacities for real environments: without the search
            prior learned in the template worlds (``prior_share`` 0), with room for unreferenced
            objects, and with uncertain numbers and existence of objects.

        Raises:
            ValueError: no such policy or parameter; an invalid policy, value or label; labels for
                a grounder that has its own.
        """
        if grounder is not None and (labels is not None or attributes):
            raise ValueError("labels and attributes are of the trained graph: give no grounder too")
        if grounder is None:
            grounder = GraphGrounder(load_shipped(), labels, attributes)
        static, arrays = split_arrays(policy)
        params = replace(set_params(numbers, params=deployment_params()), policy=arrays)
        config = deployment_config(static, params=params)
        return cls(grounder=grounder, params=params, config=config)

    def __post_init__(self) -> None:
        """Raise a ValueError for no grounder, inconsistent sizes, or if nothing could ever stop."""
        if not isinstance(self.grounder, Grounder):
            remedy = "type_names and ground(text, context), as a Grounder has"
            raise ValueError(f"grounder is {quote(self.grounder)}, but must have {remedy}")
        navigator.check(self.params, policy=self.config.planner.chosen)
        num_objects, num_mentions = self.config.map.num_objects, self.capacity.num_mentions
        for name, size in {"num_objects": num_objects, "num_mentions": num_mentions}.items():
            if size > MAX_BITS:
                limit = f"at most {MAX_BITS} are told apart in a conversation"
                raise ValueError(f"{name} is {quote(size)}, but {limit}")

    @property
    def type_names(self) -> tuple[str, ...]:
        """Names of the object types, by the type index of a detection."""
        return self.grounder.type_names

    def start(
        self,
        text: str,
        pose: Sequence[float] = (0.0, 0.0, 0.0),
        area: Sequence[float] | None = None,
        *,
        terrain: Terrain = OPEN,
        sensor_model: SensorModel = RANGING,
    ) -> NavigatorState:
        """Build the initial state of a robot with an instruction and no observations.

        Args:
            text: the instruction.
            pose: x, y, heading, metres and radians, map frame.
            area: operating area x_min, x_max, y_min, y_max, metres, map frame; 15 m to each side
                of the robot by default.
            terrain: lines of sight and travel distances there; the open field by default.
            sensor_model: observation model; range and bearing by default.

        Raises:
            ValueError: the instruction is not understood or has no command, or pose or area is
                invalid.
        """
        if (act := act_of(text)) is not None:
            raise ValueError(
                f"{text[:40]!r} is to {act}, but a robot that has no task yet has nothing to "
                f"{act}: give a command, as in 'go to the hydrant'"
            )
        grounded = self.grounder.ground(text, Context(is_under_way=False))
        if int(grounded.instruction.num_clauses) == 0:
            reason = "informs but asks for nothing to be done: add a command"
            raise ValueError(f"{shorten(text)!r} {reason}")
        for note in grounded.notes:
            _log.warning("%s: %s", shorten(text), note)
        return self._start(grounded, pose, area, terrain, sensor_model)

    def wait(
        self, pose: Sequence[float] = (0.0, 0.0, 0.0), area: Sequence[float] | None = None
    ) -> NavigatorState:
        """Build the initial state of an idle robot, without instruction and observations.

        Pose and area are those of ``start``; a ValueError if they are invalid.
        """
        no_command = replace(come_here(), num_clauses=jnp.int32(0))
        grounded = Grounded(instruction=no_command, annotations=())
        return replace(self._start(grounded, pose, area), status=jnp.int32(Status.IDLE))

    def _start(
        self,
        grounded: Grounded,
        pose: Sequence[float],
        area: Sequence[float] | None,
        terrain: Terrain = OPEN,
        sensor_model: SensorModel = RANGING,
    ) -> NavigatorState:
        """Build the initial state of a grounded instruction, padded to the dialogue's capacity."""
        start = validate_pose(pose).tolist()
        default = np.add(np.repeat(start[:2], 2), DEFAULT_EXTENT * np.array([-1, 1, -1, 1]))
        bounds = default.tolist() if area is None else validate_area(area).tolist()
        check_start(start, bounds)
        check_metric_goals(grounded.spoken, start, bounds)
        instruction = pad_instruction(grounded.instruction, self.capacity)
        state = navigator.start(
            instruction,
            jnp.asarray(start, jnp.float32),
            jnp.asarray(bounds, jnp.float32),
            config=self.config,
            num_types=len(self.type_names),
            terrain=terrain,
            sensor_model=sensor_model,
            words=discourse_of(instruction, grounded.spoken),
        )
        return self._checked(state)

    def _checked(self, state: NavigatorState) -> NavigatorState:
        """Raise a ValueError unless it is a state of a navigator with these labels and policy."""
        return check_state(state, self.type_names, self.config.planner.chosen.name)

    def step(
        self, key: Array, state: NavigatorState, observation: Observation
    ) -> tuple[NavigatorState, Action, NavigatorInfo]:
        """Run one compiled decision cycle: from an observation to an action.

        No observation of up to eight detections recompiles: those on the host are padded as by
        ``Observation.of``, and Python's numbers are cast.

        Args:
            key: random key, consumed.
            state: after the last cycle.
            observation: pose and detections now. An impossible one is rejected: the robot stands
                still, and ``Fault(int(info.fault))`` gives the reason.

        Returns:
            The new state, the action, and diagnostics.

        Raises:
            ValueError: no key, state or observation, or one of invalid shapes.
        """
        check_key(key)
        state, observation = self._checked(state), canonicalize(observation)
        return _step(key, state, observation, params=self.params, config=self.config)

    def observation(
        self,
        pose: Sequence[float],
        detections: Iterable[Sequence[Any]] = (),
        sensor: SensorParams | None = None,
    ) -> Observation:
        """Build an observation with object types by this navigator's names.

        Args:
            pose: x, y, heading, metres and radians, map frame.
            detections: (type, range, bearing) each, or with attributes (type, range, bearing,
                {"colour": "red"}), as for ``Observation.of``.
            sensor: specification of the detector; ``default_sensor()`` if None.

        Raises:
            ValueError: an invalid value; one line.
        """
        return Observation.of(pose, detections, sensor, types=self.type_names)

    def warm_up(self, detections: int = 0) -> float:
        """Compile all programs of a task now, so that its first utterances and steps are fast.

        Args:
            detections: maximum number in an observation; eight by default.

        Returns:
            Duration in seconds: most of a minute the first time, next to nothing once compiled.
        """
        count = whole_number(detections, "detections")
        bounded(count, 0, SLOTS[-1], "detections", "give as many as a look may hold")
        began, state = time.perf_counter(), self.wait()
        Listener(self.grounder).warm_up(state)
        bool(state.is_resting)
        if isinstance(self.grounder, GraphGrounder):  # a custom grounder may be slow or costly
            self.grounder.ground("go forward one metre", Context(is_under_way=False))
        rows = [(0, 1.0 + slot, 0.0) for slot in range(count)]
        observation = self.observation((0.0, 0.0, 0.0), rows, default_sensor(2.0 + count))
        jax.block_until_ready(self.step(jax.random.key(0), state, observation))
        return time.perf_counter() - began

    def hear(self, state: NavigatorState, text: str) -> NavigatorState:
        """Process an utterance; see ``take``, which also returns its interpretation.

        Notes on it, such as unused words, are logged as warnings.
        """
        state, outcome = self.take(state, text)
        for note in outcome.notes:
            _log.warning("%s: %s", shorten(text), note)
        return state

    def take(self, state: NavigatorState, text: str) -> tuple[NavigatorState, UtteranceOutcome]:
        """Process an utterance: update the task and the dialogue state by its speech act.

        A command replaces the task, an addition ("then …") follows it. A statement describes the
        map and changes no task; nor does a constraint, which holds until the robot is told to go to
        that very object. A correction excludes the object being approached ("the other one"), or
        says what is meant; "come back" returns to where the conversation began; a question
        (``Status.WHICH_ONE``) is answered by "the left one", "the second", "the one by the cone".
        Statements are kept as long as there is room, and utterances may refer back: "it", "the one
        on the left", "the other hydrant".

        Halting, resuming and cancelling work without any model and in any state. A halted robot
        resumes when told to, or given a command, a correction or an answer, but not for a
        statement, an addition or a constraint. After cancelling it is idle, without a task. An
        utterance that begins by halting or cancelling ("Stop! There is a child …", "never mind,
        come back") does so, too, and the rest is processed as the next utterance. As a refusal must
        not undo the halt, nothing is raised then: the reason is logged as a warning.

        After ``warm_up`` no utterance compiles anything.

        Args:
            state: under way, halted, idle or ended.
            text: the utterance.

        Returns:
            The state, to be followed by the next observation, and the interpretation.

        Raises:
            ValueError: the utterance is not understood, or has no referent, as "the other one"
                where nothing has been approached: the state is then unchanged.
        """
        return Listener(self.grounder).take(self._checked(state), text)

    def candidates(self, state: NavigatorState) -> list[Candidate]:
        """List the observed objects that may be the goal, the candidates of a question."""
        return candidates(self._checked(state), names_of(self.grounder))

    def spoken(self, state: NavigatorState) -> list[str]:
        """Name the object types that the task mentions, for which a detector should look.

        Those of all but very improbable interpretations, in the order of the sentence; all types
        if it mentions "the thing".
        """
        types = mentioned_types(self._checked(state))
        if any(map(is_anything, types)):
            return list(self.type_names)
        return [name_of(index, names_of(self.grounder)) for index in types]

    def missing(self, state: NavigatorState) -> list[str]:
        """Name the object types that the task mentions and the robot has not observed.

        In the order of the sentence.
        """
        types = unseen_types(self._checked(state))
        return [name_of(index, names_of(self.grounder)) for index in types]
