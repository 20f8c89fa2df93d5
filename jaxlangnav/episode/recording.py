"""Recording of an episode: simulated truth, observation, belief and decision of every step.

It feeds figures, narratives and live views; the navigator reads nothing of it.
Further axis letter: **T** steps of the episode.
"""

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import jax
import numpy as np

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.grounding.command_summary import CommandSummary
from jaxlangnav.inputs.object_types import name_of
from jaxlangnav.messages import NONE, Readings, SensorParams
from jaxlangnav.navigator.candidates import Candidate
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.planner.policy import PolicyDescription
from jaxlangnav.planner.termination import missing_types
from jaxlangnav.pytree import pytree
from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.state import Scenario, walls_of

Leaf: TypeAlias = Any  # a JAX array inside the compiled cycle, a NumPy array in a recording


@pytree
class Snapshot:
    """Record of one step: after sensing and deciding, before the motion.

    Positions are metres in the map frame. In a ``Recording`` every array has a leading axis T.
    """

    position: Leaf  # f32[2] true position
    heading: Leaf  # f32[] radians
    odometry: Leaf  # f32[2] dead reckoning from the start
    robot: Leaf  # f32[2] posterior mean position
    distance: Leaf  # f32[] metres truly travelled so far
    clause: Leaf  # i32[] index of the current command
    # What was sensed
    detection_type: Leaf  # i32[D] type index
    detection_range: Leaf  # f32[D] metres
    detection_bearing: Leaf  # f32[D] radians, robot frame
    is_detection: Leaf  # bool[D] valid entry
    # What is believed, after the step of the filter
    weight: Leaf  # f32[P] sums to 1
    reading: Leaf  # i32[P] interpretation of the instruction, by particle
    object_type: Leaf  # i32[O, P] NONE in empty slots
    object_x: Leaf  # f32[O, P] mean position
    object_y: Leaf  # f32[O, P]
    object_sd: Leaf  # f32[O, P] metres, standard deviation on each axis within the particle
    bystanders: Any  # a Bystanders, objects of types that the task does not mention; leaves [B]
    mention_type: Leaf  # i32[M, P] object type of each mention
    referent: Leaf  # i32[M, P] observed slot a mention refers to; NONE
    is_hypothesised: Leaf  # bool[M, P] the referent is not yet observed
    hypothesis_x: Leaf  # f32[M, P] position of the unobserved referent
    hypothesis_y: Leaf  # f32[M, P]
    miss: Leaf  # f32[G, G] probability that an object in the cell was missed; [y, x]
    effective_sample_size: Leaf  # f32[] of the P particles
    num_regrounded: Leaf  # i32[] particles whose groundings were resampled
    is_news: Leaf  # bool[] a new object or a new utterance
    fault: Leaf  # i32[] bits of messages.Fault: why the robot stands still
    overflow: Leaf  # i32[] detections in this step for which no object slot was free
    # Goals and behavior
    goal_x: Leaf  # f32[O + 1] goal position at each observed object; the robot last
    goal_y: Leaf  # f32[O + 1]
    goal_mass: Leaf  # f32[O + 1] probability that it is the goal
    goal_confirmed: Leaf  # f32[O + 1] … with everything mentioned observed
    is_goal: Leaf  # bool[O + 1] valid entry: an observed object; the robot if it may be the goal
    goal_region: Leaf  # i32[O + 1] likeliest relation of goal to object, index into REGIONS
    hypothesis_goal_x: Leaf  # f32[P] goal position at each particle's hypothesis
    hypothesis_goal_y: Leaf  # f32[P]
    hypothesis_goal_mass: Leaf  # f32[P] probability that it is the goal
    action: Leaf  # f32[2] probability of navigate, find
    mode: Leaf  # f32[3] probability of normal, quickly, carefully
    # What was decided, and why
    node_x: Leaf  # f32[A] position of each candidate waypoint
    node_y: Leaf  # f32[A]
    is_node: Leaf  # bool[A] valid entry
    node_kind: Leaf  # i32[A] planner.graph.FRONTIER, VISITED or OBJECT_NODE
    value: Leaf  # f32[A] value of each node; −∞ where closed
    goal_value: Leaf  # f32[A] part of it from goals
    information_value: Leaf  # f32[A] part of it from information gained on the path
    cost: Leaf  # f32[A] part of it lost to detours around keep-out zones
    waypoint: Leaf  # f32[2] the selected one
    waypoint_kind: Leaf  # i32[] its node type, as in ``node_kind``
    is_kept: Leaf  # bool[] the previous waypoint was kept
    is_stop: Leaf  # bool[] the present command has been carried out
    status: Leaf  # i32[] a messages.Status: task status
    is_done: Leaf  # bool[] the task has ended, with or without success
    stop_mass: Leaf  # f32[] goal probability within reach


@dataclasses.dataclass(frozen=True, kw_only=True)
class StaticScene:
    """Static part of a recording: what no step changes; leaves are NumPy arrays."""

    text: str  # the instruction
    type_names: tuple[str, ...]  # by type index
    policy: str  # its name
    portrayal: PolicyDescription  # how it decides, in words and columns
    scenario: Scenario
    sensor: SensorParams
    readings: Readings  # interpretations of the instruction
    planner: PlannerParams
    known_distance: float  # metres from the start to the goal, via the ends of earlier commands
    commands: tuple[CommandSummary, ...] = ()  # what each command asks for
    stop_radius: float = SUCCESS_RADIUS  # success radius around the goal, metres
    is_scored: bool = True  # success is defined: the sentence has one goal there
    unscored: str = "nothing there fits the sentence"  # why it is not

    @property
    def area(self) -> tuple[float, float, float, float]:
        """The operating area, x_min, x_max, y_min, y_max, metres."""
        x_min, x_max, y_min, y_max = (float(edge) for edge in self.scenario.area)
        return x_min, x_max, y_min, y_max

    @property
    def walls(self) -> np.ndarray:
        """The walls there, f32[W, 4], x, y of both ends, metres."""
        return walls_of(self.scenario)

    def type_name(self, object_type: int) -> str:
        """Name an object type; "thing" where the index is unknown."""
        return name_of(object_type, self.type_names) if object_type >= 0 else "thing"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Remark:
    """An utterance heard during the episode, and its outcome."""

    step: int  # index of the step before whose decision it was heard
    text: str
    kind: str = ""  # its speech act, a ``language.utterance.Kind``; "" where refused
    speaker: str = "you"  # or the simulated person's name
    ruled_out: tuple[Candidate, ...] = ()  # objects that it excludes
    notes: tuple[str, ...] = ()  # messages for people, a line each
    refusal: str = ""  # why it was refused, where it was
    scene: StaticScene | None = None  # static scene from then on; None: unchanged


@dataclasses.dataclass(frozen=True)
class StepView:
    """A step of a recording in context, as figures and narratives use it."""

    step: int
    scene: StaticScene  # as of this step
    frame: Snapshot
    before: Snapshot | None  # previous frame; None at the first step
    utterances: tuple[Remark, ...]  # heard just before its decision
    result: EpisodeResult


def replay(
    scene: StaticScene, steps: Iterable[tuple[Snapshot, EpisodeResult]], dialogue: Sequence[Remark]
) -> Iterator[StepView]:
    """Yield each step with the previous frame and the utterances heard before it.

    ``steps``: of ``recorder.play`` or a recording; ``dialogue`` may grow as the episode runs.
    """
    names = ("stop_radius", "known_distance", "is_scored", "unscored")
    unchanged = {name: getattr(scene, name) for name in names}
    before = None
    for step, (frame, result) in enumerate(steps):
        heard = tuple(utterance for utterance in dialogue if utterance.step == step)
        for utterance in heard:
            if utterance.scene is not None:
                scene = dataclasses.replace(utterance.scene, **unchanged)
        yield StepView(step, scene, frame, before, heard, result)
        before = frame


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recording:
    """A whole episode; leaves are NumPy arrays."""

    scene: StaticScene
    frames: Snapshot  # leaves [T, …]
    result: EpisodeResult
    utterances: tuple[Remark, ...] = ()  # in order
    candidates: tuple[Candidate, ...] = ()  # candidates of the question that it ended with
    pictures: tuple[Mapping[str, bytes], ...] = ()  # camera images of each step, JPEG by title
    end_reason: str = ""  # where no status says it: "blind: no picture for 5 s"

    @property
    def num_steps(self) -> int:
        """T, decision cycles."""
        return int(self.frames.distance.shape[0])

    @property
    def num_particles(self) -> int:
        """P, particles."""
        return int(self.frames.weight.shape[-1])

    @property
    def missing(self) -> list[str]:
        """Object types that the sentence mentions and that were never observed."""
        return missing_names(self.last_scene, self.at(-1))

    @functools.cached_property
    def steps(self) -> list[StepView]:
        """All steps in context."""
        steps = ((self.at(step), self.result) for step in range(self.num_steps))
        return list(replay(self.scene, steps, self.utterances))

    @property
    def last_scene(self) -> StaticScene:
        """The static scene after the last utterance."""
        return self.steps[-1].scene

    def at(self, step: int) -> Snapshot:
        """Return the frame of a step in [−T, T), leaves without the axis T."""
        return jax.tree.map(lambda leaf: leaf[step], self.frames)


def missing_names(scene: StaticScene, frame: Snapshot) -> list[str]:
    """Name the unobserved types that bear on the goal of the current command.

    In the order of the sentence: types of the goal and of its landmarks; of all mentions where the
    goal is none.
    """
    missing = missing_types(scene.readings, frame.object_type)
    clause = int(frame.clause)
    if clause < len(scene.commands) and scene.commands[clause].mention != NONE:
        command, types = scene.commands[clause], scene.readings.mention_type
        best = int(np.argmax(scene.readings.log_probability))
        needed = {int(types[best][mention]) for mention in (command.mention, *command.landmarks)}
        missing = [object_type for object_type in missing if object_type in needed]
    return [scene.type_name(object_type) for object_type in missing]


def stack_frames(scene: StaticScene, steps: Iterable[tuple[Snapshot, EpisodeResult]]) -> Recording:
    """Stack the steps of ``recorder.play``, at least one, into a recording."""
    frames, results = zip(*steps, strict=True)
    stacked: Snapshot = jax.tree.map(lambda *leaves: np.stack(leaves), *frames)
    return Recording(scene=scene, frames=stacked, result=results[-1])
