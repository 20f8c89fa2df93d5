"""A recorded episode, of ``recorder``: what a picture, a story or a live view needs of every step.

The truth is recorded beside the belief, for people only: nothing here is read by the navigator.
Further axis letter: **T** steps of the episode.
"""

import dataclasses
import functools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import jax
import numpy as np

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.grounding.asked import CommandSummary
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
class Frame:
    """One step: the robot as it has sensed and decided, before it moves.

    Positions are metres in the map frame. In a ``Recording`` every array has a leading axis T.
    """

    position: Leaf  # f32[2] true position
    heading: Leaf  # f32[] radians
    odometry: Leaf  # f32[2] dead reckoning from the start
    robot: Leaf  # f32[2] believed position, mean over particles
    distance: Leaf  # f32[] metres truly travelled so far
    clause: Leaf  # i32[] the command being carried out
    # What was sensed
    detection_type: Leaf  # i32[D]
    detection_range: Leaf  # f32[D] metres
    detection_bearing: Leaf  # f32[D] radians, robot frame
    is_detection: Leaf  # bool[D]
    # What is believed, after the step of the filter
    weight: Leaf  # f32[P] sums to 1
    reading: Leaf  # i32[P] the reading each particle believes
    object_type: Leaf  # i32[O, P] NONE in empty slots
    object_x: Leaf  # f32[O, P]
    object_y: Leaf  # f32[O, P]
    object_sd: Leaf  # f32[O, P] metres, standard deviation on each axis within the particle
    mention_type: Leaf  # i32[M, P] type of what each mention speaks of
    referent: Leaf  # i32[M, P] observed slot a mention refers to; NONE
    is_hypothesised: Leaf  # bool[M, P] the mention is only a hypothesis yet
    hypothesis_x: Leaf  # f32[M, P]
    hypothesis_y: Leaf  # f32[M, P]
    miss: Leaf  # f32[G, G] probability that an object there would have been missed; [y, x]
    effective_sample_size: Leaf  # f32[]
    is_resampled: Leaf  # bool[]
    num_regrounded: Leaf  # i32[] particles whose words were grounded anew
    is_news: Leaf  # bool[] an object was seen for the first time, or words came in
    fault: Leaf  # i32[] bits of messages.Fault: why the robot stands still
    overflow: Leaf  # i32[]
    # Goals and behavior
    goal_x: Leaf  # f32[O + 1] goal place at each observed object; the robot last
    goal_y: Leaf  # f32[O + 1]
    goal_mass: Leaf  # f32[O + 1] probability that it is the goal
    goal_confirmed: Leaf  # f32[O + 1] … with everything mentioned observed
    is_goal: Leaf  # bool[O + 1]
    goal_region: Leaf  # i32[O + 1] index into messages.REGIONS: what is asked for there
    hypothesis_goal_x: Leaf  # f32[P]
    hypothesis_goal_y: Leaf  # f32[P]
    hypothesis_goal_mass: Leaf  # f32[P]
    action: Leaf  # f32[2] probability of navigate, find
    mode: Leaf  # f32[3] probability of normal, quickly, carefully
    # What was decided, and why
    node_x: Leaf  # f32[A]
    node_y: Leaf  # f32[A]
    is_node: Leaf  # bool[A]
    node_kind: Leaf  # i32[A] planner.graph.FRONTIER, VISITED or OBJECT
    value: Leaf  # f32[A] −∞ where closed
    goal_value: Leaf  # f32[A]
    information_value: Leaf  # f32[A]
    cost: Leaf  # f32[A]
    waypoint: Leaf  # f32[2]
    waypoint_kind: Leaf  # i32[]
    is_kept: Leaf  # bool[] the former waypoint was kept
    is_stop: Leaf  # bool[] the present command has been carried out
    status: Leaf  # i32[] a messages.Status: what the robot says of its task
    is_done: Leaf  # bool[] the task has ended: it is carried out, or cannot be
    stop_mass: Leaf  # f32[] goal probability within reach


@dataclasses.dataclass(frozen=True, kw_only=True)
class StaticScene:
    """What stays the same over an episode; leaves are NumPy arrays."""

    text: str
    type_names: tuple[str, ...]
    policy: str
    portrayal: PolicyDescription
    scenario: Scenario
    sensor: SensorParams
    readings: Readings
    planner: PlannerParams
    num_clauses: int
    known_distance: float  # metres from the start to the goal, by where earlier commands end
    asks: tuple[CommandSummary, ...] = ()  # what each command asks for
    stop_radius: float = SUCCESS_RADIUS  # metres from the goal, within which it may stop
    is_judged: bool = True  # something there fits the sentence, so that success can be told
    unjudged: str = "nothing there fits the sentence"  # why not, where it cannot be told

    @property
    def straight_distance(self) -> float:
        """Metres straight from the start to where it may stop: the least that any robot walks."""
        return max(0.0, self.known_distance - self.stop_radius)

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
    """An utterance that the robot heard under way, and what came of it."""

    step: int  # heard before this decision
    text: str
    kind: str = ""  # what it was taken for, a ``language.utterance.Kind``; "" where refused
    speaker: str = "you"  # or the simulated person's name
    ruled_out: tuple[Candidate, ...] = ()  # things that it says are not meant
    notes: tuple[str, ...] = ()  # what else people should know, a line each
    refusal: str = ""  # why the robot kept to its task, where it did
    scene: StaticScene | None = None  # what is understood from then on; None: as before


@dataclasses.dataclass(frozen=True)
class Moment:
    """A step as pictures and the story take it."""

    step: int
    scene: StaticScene  # with what was understood by then
    frame: Frame
    before: Frame | None  # the step before it; None at first
    said: tuple[Remark, ...]  # heard just before its decision
    result: EpisodeResult


def moments(
    scene: StaticScene, steps: Iterable[tuple[Frame, EpisodeResult]], said: Sequence[Remark]
) -> Iterator[Moment]:
    """Set each step of an episode beside what was said and seen before it.

    ``steps``: as they happen, from ``recorder.play``, or as they were recorded; ``said``:
    utterances, a list that may grow as the episode runs.
    """
    names = ("stop_radius", "known_distance", "is_judged", "unjudged")
    own = {name: getattr(scene, name) for name in names}
    before = None
    for step, (frame, result) in enumerate(steps):
        now = tuple(one for one in said if one.step == step)
        for one in now:
            if one.scene is not None:
                scene = dataclasses.replace(one.scene, **own)
        yield Moment(step, scene, frame, before, now, result)
        before = frame


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recording:
    """A whole episode; leaves are NumPy arrays."""

    scene: StaticScene
    frames: Frame  # leaves [T, …]
    result: EpisodeResult
    said: tuple[Remark, ...] = ()  # under way, in order
    candidates: tuple[Candidate, ...] = ()  # what may be meant, where it ended with a question
    pictures: tuple[Mapping[str, bytes], ...] = ()  # of each step, JPEG by title; () without
    ended: str = ""  # how, in words, where no status tells it: "blind: no picture for 5 s"

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
        """Types that the sentence speaks of and no look has shown by the end."""
        return missing_names(self.last_scene, self.at(-1))

    @functools.cached_property
    def moments(self) -> list[Moment]:
        """All steps, each with what is needed to tell it."""
        steps = ((self.at(step), self.result) for step in range(self.num_steps))
        return list(moments(self.scene, steps, self.said))

    @property
    def last_scene(self) -> StaticScene:
        """The scene with what was understood in the end."""
        return self.moments[-1].scene

    def at(self, step: int) -> Frame:
        """Take the step in [−T, T) out, leaves without the axis T."""
        return jax.tree.map(lambda leaf: leaf[step], self.frames)


def missing_names(scene: StaticScene, frame: Frame) -> list[str]:
    """Name types that bear on the goal of the present command and no look has shown by a step.

    In the order of the sentence: of the goal and of what it is placed against; of all that the
    sentence speaks of where the goal is not one of these.
    """
    missing = missing_types(scene.readings, frame.object_type)
    clause = int(frame.clause)
    if clause < len(scene.asks) and scene.asks[clause].mention != NONE:
        one, kinds = scene.asks[clause], scene.readings.mention_type
        best = int(np.argmax(scene.readings.log_probability))
        wanted = {int(kinds[best][mention]) for mention in (one.mention, *one.against)}
        missing = [kind for kind in missing if kind in wanted]
    return [scene.type_name(kind) for kind in missing]


def stack_frames(scene: StaticScene, frames: list[Frame], result: EpisodeResult) -> Recording:
    """Stack the steps of an episode, at least one; ``result`` is of the last."""
    stacked: Frame = jax.tree.map(lambda *leaves: np.stack(leaves), *frames)
    return Recording(scene=scene, frames=stacked, result=result)
