"""The navigator for people: grounder, parameters and sizes in one object.

Two functions over records are the whole engine, for any robot or simulator:

    navigator = jaxlangnav.Navigator.pretrained()
    state = navigator.start("go to the hydrant behind the cone", pose=(0.0, 0.0, 0.0))
    state, action, info = navigator.step(key, state, observation)

``step`` is compiled once, whatever is said; ``navigator.step`` the module function can be
``vmap``-ed over states.
"""

import dataclasses
import difflib
import logging
import time
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from jaxlangnav import navigator, sensing
from jaxlangnav.grounding import Context, GraphGrounder, Grounder, load_shipped
from jaxlangnav.grounding.instruction import Instruction, pack_instruction
from jaxlangnav.grounding.readings import Reading, pack
from jaxlangnav.kinds import name_of
from jaxlangnav.language.halting import Act, act_of, begins_with_halt
from jaxlangnav.messages import NONE, Action, Observation, SensorParams, default_sensor
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams, NavigatorState
from jaxlangnav.plain_text import cut
from jaxlangnav.planner.config import AnyPolicy, PlannerConfig
from jaxlangnav.planner.endings import missing_types
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.soundness import check_place
from jaxlangnav.terrain import OPEN, Terrain

DEFAULT_EXTENT = 15.0
"""Metres to each side of the robot that are its operating area unless it is told otherwise."""

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
        cls,
        policy: AnyPolicy = "informed",
        grounder: Grounder | None = None,
        *,
        labels: Sequence[str] | None = None,
        attributes: Sequence[str] = (),
        **numbers: float,
    ) -> Self:
        """Build a navigator from the weights that ship with the package.

        Args:
            policy: "informed", "faithful" to the paper, or a policy of one's own.
            grounder: what understands instructions; the trained graph by default.
            labels: what the robot's detector tells apart, in the order of its indices, for the
                trained graph; the lexicon's types by default.
            attributes: groups of ``kinds.ATTRIBUTES`` that the detector reports.
            **numbers: any single number of ``MapParams``, ``MotionParams`` or ``PlannerParams`` by
                its name, such as ``odometry_noise=0.05`` or ``step_length=0.5``; new values never
                recompile.

        Returns:
            The navigator, with default parameters and sizes, but without the search prior that was
            learned in the template worlds (``prior_share`` 0).

        Raises:
            ValueError: no such policy or an object that is none; no such number or one that cannot
                be; labels that cannot be, or labels for a grounder that has its own.
        """
        if grounder is not None and (labels is not None or attributes):
            raise ValueError("labels and attributes are of the trained graph: give no grounder too")
        if grounder is None:
            grounder = GraphGrounder(load_shipped(), labels, attributes)
        return cls(
            grounder=grounder,
            params=_with_numbers(_params_anywhere(), numbers),
            config=NavigatorConfig(planner=PlannerConfig(policy=policy)),
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
        *,
        terrain: Terrain = OPEN,
    ) -> NavigatorState:
        """Tell a robot that has seen nothing what to do.

        Args:
            text: the instruction.
            pose: x, y, heading, metres and radians, map frame.
            area: operating area x_min, x_max, y_min, y_max, metres, map frame; 15 m to each side
                of the robot by default.
            terrain: how far one sees and walks there; the open field by default.

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
            terrain=terrain,
        )

    def _command(self, text: str, *, is_under_way: bool) -> Instruction:
        """Understand what asks for something; what of it is not used is logged."""
        context = Context(is_under_way=is_under_way)
        grounded = self.grounder.ground(text, context)
        for note in grounded.notes:
            _log.warning("%s: %s", cut(text), note)
        instruction = grounded.instruction
        if int(instruction.num_clauses) == 0:
            raise ValueError(
                f"{cut(text)!r} informs but asks for nothing to be done: add a command"
            )
        return instruction

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
        """
        uniform = _uniform(observation)
        return _step(key, state, uniform, params=self.params, config=self.config)

    def observation(
        self,
        pose: Sequence[float],
        detections: Iterable[Sequence[Any]] = (),
        sensor: SensorParams | None = None,
    ) -> Observation:
        """Build an observation that names object types as this navigator does.

        Args:
            pose: x, y, heading, metres and radians, map frame.
            detections: (type, range, bearing) each, as ``Observation.of`` takes them.
            sensor: specification of the detector; ``default_sensor()`` if None.

        Returns:
            The observation.

        Raises:
            ValueError: what cannot be; one line.
        """
        return Observation.of(pose, detections, sensor, types=self.type_names)

    def warm_up(self, detections: int = 0) -> float:
        """Compile the decision cycle now, so that the first step of a task answers at once.

        Args:
            detections: as many as a look may hold; up to eight by default.

        Returns:
            Seconds that it took: most of a minute the first time, next to nothing once compiled.
        """
        began = time.perf_counter()
        nothing = pack_instruction(pack([(Reading((), ()), 0.0)]), [])
        place = jnp.zeros(3, jnp.float32)
        area = jnp.asarray(_around((0.0, 0.0, 0.0)), jnp.float32)
        state = navigator.start(
            nothing, place, area, config=self.config, num_types=len(self.type_names)
        )
        look = [(0, 1.0 + slot, 0.0) for slot in range(detections)]
        seen = self.observation((0.0, 0.0, 0.0), look, default_sensor(2.0 + detections))
        jax.block_until_ready(self.step(jax.random.key(0), state, seen))
        return time.perf_counter() - began

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

    def spoken(self, state: NavigatorState) -> list[str]:
        """Name the object types that the running task speaks of: what a detector should look for.

        Args:
            state: of any robot.

        Returns:
            Names of object types, in the order of the sentence; those of all its readings.
        """
        kinds = np.asarray(state.instruction.readings.mention_type).reshape(-1).tolist()
        return [name_of(kind, self._names) for kind in dict.fromkeys(kinds) if kind >= 0]

    def missing(self, state: NavigatorState) -> list[str]:
        """Name what the task speaks of and the robot has not seen, such as its goal's landmark.

        Args:
            state: after any step; of a robot that has not found its goal, it tells why.

        Returns:
            Names of things, in the order of the sentence; none where all has been seen.
        """
        types = np.asarray(state.belief.particles.object_type)
        missing = missing_types(state.instruction.readings, types)
        return [name_of(kind, self._names) for kind in missing]

    @property
    def _names(self) -> Sequence[str]:
        """Names of labels, and of things that a grounder's detector has no label for."""
        return getattr(self.grounder, "names", self.type_names)


def _around(pose: Sequence[float]) -> tuple[float, ...]:
    """Lay the operating area about a start pose."""
    x, y = (*map(float, pose), 0.0, 0.0)[:2]
    return (x - DEFAULT_EXTENT, x + DEFAULT_EXTENT, y - DEFAULT_EXTENT, y + DEFAULT_EXTENT)


def _uniform(observation: Observation) -> Observation:
    """Give an observation of the host the shapes and dtypes that have been compiled already."""
    leaves = jax.tree.leaves(observation)
    slots = np.shape(observation.detection_type)
    if any(isinstance(leaf, Tracer) for leaf in leaves) or len(slots) != 1:
        return observation
    spare = sensing.padded(slots[0]) - slots[0]

    def cast(leaf: Any, dtype: Any) -> np.ndarray:
        return np.asarray(leaf, dtype)

    def pad(leaf: Any, dtype: Any, filler: int) -> np.ndarray:
        return np.pad(cast(leaf, dtype), (0, spare), constant_values=filler)

    code = observation.detection_attribute

    return replace(
        observation,
        pose=cast(observation.pose, np.float32),
        detection_type=pad(observation.detection_type, np.int32, NONE),
        detection_range=pad(observation.detection_range, np.float32, 0),
        detection_bearing=pad(observation.detection_bearing, np.float32, 0),
        is_detection=pad(observation.is_detection, bool, 0),
        detection_attribute=None if code is None else pad(code, np.int32, 0),
        sensor=jax.tree.map(lambda leaf: cast(leaf, np.float32), observation.sensor),
    )


def _with_numbers(params: NavigatorParams, numbers: Mapping[str, float]) -> NavigatorParams:
    """Set single numbers by their names, wherever among the records they stand."""
    records = {"motion": params.map.motion, "map": params.map, "planner": params.planner}
    home = {
        field.name: place
        for place, record in records.items()
        for field in dataclasses.fields(record)
        if isinstance(value := getattr(record, field.name), Array) and value.ndim == 0
    }
    for name, value in numbers.items():
        if name not in home:
            near = difflib.get_close_matches(name, home, 1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(sorted(home))}"
            raise ValueError(f"{name[:40]} is no number of the navigator: {hint}")
        read = sensing.number(value, name)
        if read < 0.0:
            raise ValueError(f"{name} is {read:g}, but must not be negative")
        place = home[name]
        records[place] = replace(records[place], **{name: jnp.float32(read)})
    with_motion = replace(records["map"], motion=records["motion"])
    return replace(params, map=with_motion, planner=records["planner"])


def _params_anywhere() -> NavigatorParams:
    """Build the default numbers for places that are unlike the planner's training worlds."""
    params = navigator.default_params()
    planner = replace(params.planner, prior_share=jnp.float32(0.0))
    return replace(params, planner=planner)
