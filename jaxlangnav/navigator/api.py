"""User-facing ``Navigator``: grounder, parameters and capacities behind start, step and hear.

    navigator = jaxlangnav.Navigator.pretrained()
    state = navigator.start("go to the hydrant behind the cone", pose=(0.0, 0.0, 0.0))
    state, action, info = navigator.step(key, state, observation)

``step`` is compiled once, whatever is said; ``navigator.step`` the module function can be
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
from jaxlangnav.dialogue import first_words
from jaxlangnav.grounding import Context, GraphGrounder, Grounded, Grounder, load_shipped
from jaxlangnav.grounding.annotated import come_here
from jaxlangnav.grounding.grounder import names_of
from jaxlangnav.grounding.readings import Capacity, widen
from jaxlangnav.inputs.limits import bounded
from jaxlangnav.inputs.object_types import is_anything, name_of
from jaxlangnav.inputs.observations import SLOTS, area_numbers, pose_numbers
from jaxlangnav.inputs.sanitize import quote, shorten
from jaxlangnav.language.halting import act_of
from jaxlangnav.messages import Action, Observation, SensorParams, Status, default_sensor
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams, NavigatorState
from jaxlangnav.navigator.candidates import Candidate, candidates, mentioned_types, unseen_types
from jaxlangnav.navigator.canonicalize import MAX_BITS, canonicalize, check_state
from jaxlangnav.navigator.deployment import deployment_config, deployment_params, set_params
from jaxlangnav.navigator.interpret import Listener, UtteranceOutcome, check_measures
from jaxlangnav.planner.config import AnyPolicy, split_arrays
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.gating import check_place
from jaxlangnav.terrain import OPEN, POSITIONS, SensorModel, Terrain

DEFAULT_EXTENT = 15.0
"""Default operating area: metres to each side of the robot."""
_log = logging.getLogger(__name__)

_step = jax.jit(navigator.step, static_argnames="config")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Navigator:
    """Grounder, parameters and sizes of an agent that follows instructions."""

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
            policy: "informed", "faithful" to the paper, or a policy of one's own.
            grounder: what understands instructions; the trained graph by default.
            labels: what the robot's detector tells apart, in the order of its indices, for the
                trained graph; the lexicon's types by default.
            attributes: groups of ``ATTRIBUTES`` that the detector reports.
            **numbers: any single number of ``MapParams``, ``MotionParams`` or ``PlannerParams`` by
                its name, such as ``odometry_noise=0.05`` or ``step_length="50 cm"``, within the
                limits of the command line; new values never recompile. A heading that drifts
                (``heading_noise`` and the like) is believed so by a program of its own.

        Returns:
            The navigator, with parameters and sizes for places as they are: without the search
            prior that was learned in the template worlds (``prior_share`` 0), with room for
            bystanders, and in doubt about how many things there are and whether they exist.

        Raises:
            ValueError: no such policy or an object that is none; no such number or one that cannot
                be; labels that cannot be, or labels for a grounder that has its own.
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
        """Raise a ValueError for parameters that prevent any stop, and for inconsistent sizes."""
        navigator.check(self.params, policy=self.config.planner.chosen)
        num_objects, num_mentions = self.config.map.num_objects, self.capacity.num_mentions
        for name, size in {"num_objects": num_objects, "num_mentions": num_mentions}.items():
            if size > MAX_BITS:
                most = f"at most {MAX_BITS} are told apart in a conversation"
                raise ValueError(f"{name} is {quote(size)}, but {most}")

    @property
    def type_names(self) -> tuple[str, ...]:
        """Object types; a detection names its type by the index into them."""
        return self.grounder.type_names

    def start(
        self,
        text: str,
        pose: Sequence[float] = (0.0, 0.0, 0.0),
        area: Sequence[float] | None = None,
        *,
        terrain: Terrain = OPEN,
        sensor_model: SensorModel = POSITIONS,
    ) -> NavigatorState:
        """Tell a robot that has seen nothing what to do.

        Args:
            text: the instruction.
            pose: x, y, heading, metres and radians, map frame.
            area: operating area x_min, x_max, y_min, y_max, metres, map frame; 15 m to each side
                of the robot by default.
            terrain: how far one sees and walks there; the open field by default.
            sensor_model: how the detector reports; by range and bearing by default.

        Raises:
            ValueError: the instruction is not understood or asks for nothing, or pose or area
                cannot be.
        """
        if (act := act_of(text)) is not None:
            raise ValueError(
                f"{text[:40]!r} is to {act}, but a robot that has no task yet has nothing to "
                f"{act}: give a command, as in 'go to the hydrant'"
            )
        grounded = self.grounder.ground(text, Context(is_under_way=False))
        if int(grounded.instruction.num_clauses) == 0:
            why = "informs but asks for nothing to be done: add a command"
            raise ValueError(f"{shorten(text)!r} {why}")
        for note in grounded.notes:
            _log.warning("%s: %s", shorten(text), note)
        return self._start(grounded, pose, area, terrain, sensor_model)

    def wait(
        self, pose: Sequence[float] = (0.0, 0.0, 0.0), area: Sequence[float] | None = None
    ) -> NavigatorState:
        """Place a robot that has seen nothing and been told nothing: it is idle until it hears.

        Pose and area are those of ``start``; a ValueError where they cannot be.
        """
        silent = replace(come_here(), num_clauses=jnp.int32(0))
        grounded = Grounded(instruction=silent, annotations=())
        return replace(self._start(grounded, pose, area), status=jnp.int32(Status.IDLE))

    def _start(
        self,
        grounded: Grounded,
        pose: Sequence[float],
        area: Sequence[float] | None,
        terrain: Terrain = OPEN,
        sensor_model: SensorModel = POSITIONS,
    ) -> NavigatorState:
        """Begin with what has been understood, in arrays that hold a conversation."""
        place = pose_numbers(pose).tolist()
        around = np.add(np.repeat(place[:2], 2), DEFAULT_EXTENT * np.array([-1, 1, -1, 1]))
        bounds = around.tolist() if area is None else area_numbers(area).tolist()
        check_place(place, bounds)
        check_measures(grounded.spoken, place, bounds)
        told = grounded.instruction
        instruction = replace(told, readings=widen(told.readings, self.capacity))
        state = navigator.start(
            instruction,
            jnp.asarray(place, jnp.float32),
            jnp.asarray(bounds, jnp.float32),
            config=self.config,
            num_types=len(self.type_names),
            terrain=terrain,
            sensor_model=sensor_model,
            words=first_words(instruction, grounded.spoken),
        )
        return self._checked(state)

    def _checked(self, state: NavigatorState) -> NavigatorState:
        """Refuse what is no state, and a state of a navigator with other labels or policy."""
        return check_state(state, self.type_names, self.config.planner.chosen.name)

    def step(
        self, key: Array, state: NavigatorState, observation: Observation
    ) -> tuple[NavigatorState, Action, NavigatorInfo]:
        """Run one decision cycle, compiled: from an observation to an action.

        However it is given, no observation of up to eight detections compiles anything anew: those
        on the host are padded as ``Observation.of`` pads them, and Python's numbers are cast.

        Args:
            key: random key, consumed.
            state: after the last cycle.
            observation: pose and detections now. One that cannot be is left out: the robot stands
                still, and ``Fault(int(info.fault))`` says why.

        Returns:
            The new state, what the robot is to do, and why.

        Raises:
            ValueError: a state or an observation that is none or of shapes that cannot be.
        """
        state, look = self._checked(state), canonicalize(observation)
        return _step(key, state, look, params=self.params, config=self.config)

    def observation(
        self,
        pose: Sequence[float],
        detections: Iterable[Sequence[Any]] = (),
        sensor: SensorParams | None = None,
    ) -> Observation:
        """Build an observation that names object types as this navigator does.

        Args:
            pose: x, y, heading, metres and radians, map frame.
            detections: (type, range, bearing) each, or with how it looks (type, range, bearing,
                {"colour": "red"}), as ``Observation.of`` takes them.
            sensor: specification of the detector; ``default_sensor()`` if None.

        Raises:
            ValueError: what cannot be; one line.
        """
        return Observation.of(pose, detections, sensor, types=self.type_names)

    def warm_up(self, detections: int = 0) -> float:
        """Compile all that runs for a task now, so that its first words and steps answer at once.

        Args:
            detections: as many as a look may hold; up to eight by default.

        Returns:
            Seconds that it took: most of a minute the first time, next to nothing once compiled.
        """
        count = bounded(detections, 0, SLOTS[-1], "detections", "give as many as a look may hold")
        if count != int(count):
            raise ValueError(f"detections is {count:g}, but must be a whole number")
        began, state = time.perf_counter(), self.wait()
        Listener(self.grounder).warm_up(state)
        bool(state.is_resting)
        if isinstance(self.grounder, GraphGrounder):  # one's own may be slow, or cost something
            self.grounder.ground("go forward one metre", Context(is_under_way=False))
        row = [(0, 1.0 + slot, 0.0) for slot in range(int(count))]
        look = self.observation((0.0, 0.0, 0.0), row, default_sensor(2.0 + count))
        jax.block_until_ready(self.step(jax.random.key(0), state, look))
        return time.perf_counter() - began

    def hear(self, state: NavigatorState, text: str) -> NavigatorState:
        """Take in an utterance; see ``take``, which also tells what it was taken for.

        What people should know of it besides, such as words that are not used, is logged.
        """
        state, heard = self.take(state, text)
        for note in heard.notes:
            _log.warning("%s: %s", shorten(text), note)
        return state

    def take(self, state: NavigatorState, text: str) -> tuple[NavigatorState, UtteranceOutcome]:
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
        no task any more. What begins with words to halt or to cancel ("Stop! There is a child …",
        "never mind, come back") does so, too, and what follows is taken in as if it were said
        next. As the robot must not lose its halt to a refusal, nothing is raised then: why the
        rest was left out is logged as a warning.

        After ``warm_up`` nothing is compiled for it, whatever is said.

        Args:
            state: of a robot under way, halted, idle or at its end.
            text: what the person said.

        Returns:
            The state, to be followed by the next observation, and what the words were taken for.

        Raises:
            ValueError: the words are not understood, or refer to what is not there, as "the other
                one" where nothing has been approached: the robot then keeps to its state.
        """
        return Listener(self.grounder).take(self._checked(state), text)

    def candidates(self, state: NavigatorState) -> list[Candidate]:
        """List the things seen that may be meant, the nearest first: what a question is about."""
        return candidates(self._checked(state), names_of(self.grounder))

    def spoken(self, state: NavigatorState) -> list[str]:
        """Name the object types that the running task speaks of: what a detector should look for.

        They are those of all its readings but the least likely, in the order of the sentence; all
        that there are where it speaks of "the thing".
        """
        kinds = mentioned_types(self._checked(state))
        if any(map(is_anything, kinds)):
            return list(self.type_names)
        return [name_of(kind, names_of(self.grounder)) for kind in kinds]

    def missing(self, state: NavigatorState) -> list[str]:
        """Name what the task speaks of and the robot has not seen, such as its goal's landmark.

        The names are in the order of the sentence; none where all has been seen.
        """
        missing = unseen_types(self._checked(state))
        return [name_of(kind, names_of(self.grounder)) for kind in missing]
