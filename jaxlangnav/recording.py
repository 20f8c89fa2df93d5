"""Recording an episode: what a picture, a story or a live view needs of every step (section 4).

An episode runs in a Python loop over one compiled cycle, ``episode.advance``, so that each step
can be looked at as it happens (``play``) or kept as NumPy arrays (``record``). The truth is
recorded beside the belief, for people only: nothing here is read by the navigator.

Further axis letter: **T** steps of the episode.
"""

import dataclasses
import functools
from collections.abc import Iterator
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav import episode
from jaxlangnav.episode import MAX_STEPS, EpisodeResult, Progress, Task
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.messages import NONE, Readings, SensorParams
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.pytree import pytree
from jaxlangnav.semantic_map.filter import ParticleBelief
from jaxlangnav.world.known import known_distance
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.state import Scenario

Leaf: TypeAlias = Any
"""A JAX array inside the compiled cycle, a NumPy array in a recording."""


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
    is_degenerate: Leaf  # bool[]
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
    is_done: Leaf  # bool[] … and it was the last one
    stop_mass: Leaf  # f32[] goal probability within reach


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scene:
    """What stays the same over an episode; leaves are NumPy arrays."""

    text: str
    type_names: tuple[str, ...]
    policy: str
    scenario: Scenario
    sensor: SensorParams
    readings: Readings
    planner: PlannerParams
    num_clauses: int
    known_distance: float  # metres, straight from the start to the goal

    @property
    def area(self) -> tuple[float, float, float, float]:
        """The operating area, x_min, x_max, y_min, y_max, metres."""
        x_min, x_max, y_min, y_max = (float(edge) for edge in self.scenario.area)
        return x_min, x_max, y_min, y_max

    def type_name(self, object_type: int) -> str:
        """Name an object type; "thing" where the index is unknown."""
        known = 0 <= object_type < len(self.type_names)
        return self.type_names[object_type] if known else "thing"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Recording:
    """A whole episode; leaves are NumPy arrays."""

    scene: Scene
    frames: Frame  # leaves [T, …]
    result: EpisodeResult

    @property
    def num_steps(self) -> int:
        """T, decision cycles."""
        return int(self.frames.distance.shape[0])

    @property
    def num_particles(self) -> int:
        """P, particles."""
        return int(self.frames.weight.shape[-1])

    def at(self, step: int) -> Frame:
        """Take one step out, leaves without the axis T.

        Args:
            step: in [−T, T).

        Returns:
            The frame.
        """
        return jax.tree.map(lambda leaf: leaf[step], self.frames)


def set_scene(
    task: Task,
    instructions: Instruction,
    *,
    text: str,
    params: NavigatorParams,
    config: NavigatorConfig,
) -> Scene:
    """Gather what stays the same over an episode.

    Args:
        task: one episode.
        instructions: leaves [I, …]; the task names one of them.
        text: the sentence, for people.
        params: the navigator's numbers.
        config: sizes and policy.

    Returns:
        The scene.
    """
    index = int(task.instruction_index)
    readings, num_clauses = jax.device_get((instructions.readings, instructions.num_clauses))
    scenario, sensor, planner = jax.device_get((task.scenario, task.sensor, params.planner))
    return Scene(
        text=text,
        type_names=load_lexicon().type_names,
        policy=config.planner.policy_name,
        scenario=scenario,
        sensor=sensor,
        readings=jax.tree.map(lambda leaf: leaf[index], readings),
        planner=planner,
        num_clauses=int(num_clauses[index]),
        known_distance=float(known_distance(task.scenario)),
    )


def play(
    task: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
) -> Iterator[tuple[Frame, EpisodeResult]]:
    """Run an episode step by step, early exit included.

    Args:
        task: one episode; the same key gives the same episode as ``episode.run``.
        instructions: leaves [I, …]; the task names one of them.
        params: the navigator's numbers.
        config: sizes and policy.
        max_steps: cycles until a time-out, at least 1.

    Yields:
        Each step, and how the episode would be judged if it ended with it.

    Raises:
        ValueError: ``max_steps`` is less than 1.
    """
    if max_steps < 1:
        raise ValueError(f"max_steps is {max_steps}, but must be at least 1")
    progress = _begin(task, instructions, config=config)
    for _ in range(max_steps):
        progress, frame, result = _advance(progress, params=params, config=config)
        shown, judged = jax.device_get((frame, result))
        yield shown, judged
        if shown.is_done:
            return


def record(
    task: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    text: str = "",
) -> Recording:
    """Run an episode and keep what pictures need.

    Args:
        task: one episode.
        instructions: leaves [I, …]; the task names one of them.
        params: the navigator's numbers.
        config: sizes and policy.
        max_steps: cycles until a time-out, at least 1.
        text: the sentence, for people.

    Returns:
        The recording.
    """
    scene = set_scene(task, instructions, text=text, params=params, config=config)
    steps = list(play(task, instructions, params=params, config=config, max_steps=max_steps))
    return gather(scene, [frame for frame, _ in steps], steps[-1][1])


def gather(scene: Scene, frames: list[Frame], result: EpisodeResult) -> Recording:
    """Stack the steps of an episode.

    Args:
        scene: what stays the same.
        frames: the steps from ``play``, at least one.
        result: of the last step.

    Returns:
        The recording.
    """
    stacked: Frame = jax.tree.map(lambda *leaves: np.stack(leaves), *frames)
    return Recording(scene=scene, frames=stacked, result=result)


@functools.partial(jax.jit, static_argnames=("config",))
def _begin(task: Task, instructions: Instruction, *, config: NavigatorConfig) -> Progress:
    """Compile ``episode.begin``: eager, its many small operations would take seconds."""
    return episode.begin(task, instructions, config=config)


@functools.partial(jax.jit, static_argnames=("config",))
def _advance(
    progress: Progress, *, params: NavigatorParams, config: NavigatorConfig
) -> tuple[Progress, Frame, EpisodeResult]:
    """Run one cycle and gather what it looked like."""
    after, info = episode.advance(progress, params=params, config=config)
    return after, _frame(progress, after, info), episode.finish(after)


def _frame(before: Progress, after: Progress, info: NavigatorInfo) -> Frame:
    """Gather one step: the world before the motion, the belief after the step."""
    task, belief = before.task, after.navigator.belief
    # The observation that ``advance`` has drawn, drawn again from the same key (XLA merges them).
    sense_key = jax.random.split(jax.random.fold_in(task.key, before.steps), 3)[0]
    observation = sense(sense_key, before.world, task.scenario, task.sensor)
    return Frame(
        position=before.world.position,
        heading=before.world.heading,
        odometry=before.world.odometry[:2],
        robot=info.robot,
        distance=before.world.distance,
        clause=before.navigator.clause,
        detection_type=observation.detection_type,
        detection_range=observation.detection_range,
        detection_bearing=observation.detection_bearing,
        is_detection=observation.is_detection,
        effective_sample_size=info.filter.effective_sample_size,
        is_resampled=info.filter.is_resampled,
        num_regrounded=info.filter.num_regrounded,
        is_news=info.filter.is_news,
        is_degenerate=info.filter.is_degenerate,
        overflow=info.filter.overflow,
        goal_region=_goal_region(info),
        action=info.behavior.action,
        mode=info.behavior.mode,
        is_done=after.navigator.is_done,
        **_belief_fields(belief, before.navigator.instruction.readings),
        **_decision_fields(info),
    )


def _goal_region(info: NavigatorInfo) -> Array:
    """Find the likeliest goal region of each observed object and of the robot, i32[O + 1]."""
    num_objects = info.goals.object_x.shape[0] - 1
    region = jnp.argmax(info.behavior.goal, axis=0).astype(jnp.int32)  # [N + 1]
    return jnp.append(region[:num_objects], region[-1])


def _belief_fields(belief: ParticleBelief, readings: Readings) -> dict[str, Array]:
    """Gather what the particles hold."""
    particles = belief.particles
    num_objects = particles.object_type.shape[0]
    mention_type = readings.mention_type[particles.reading].T  # [M, P]
    return {
        "weight": jnp.exp(belief.log_weight),
        "reading": particles.reading,
        "object_type": particles.object_type,
        "object_x": particles.mean_x[:num_objects],
        "object_y": particles.mean_y[:num_objects],
        "mention_type": jnp.where(particles.is_mentioned, mention_type, NONE),
        "referent": particles.referent,
        "is_hypothesised": particles.is_hypothesised,
        "hypothesis_x": particles.hypothesis_x,
        "hypothesis_y": particles.hypothesis_y,
        "miss": jnp.exp(belief.coverage.log_miss),
    }


def _decision_fields(info: NavigatorInfo) -> dict[str, Array]:
    """Gather the goals, the nodes and the choice."""
    goals, nodes, choice = info.goals, info.nodes, info.choice
    return {
        "goal_x": goals.object_x,
        "goal_y": goals.object_y,
        "goal_mass": goals.object_mass,
        "goal_confirmed": goals.object_confirmed,
        "is_goal": goals.is_object,
        "hypothesis_goal_x": goals.hypothesis_x,
        "hypothesis_goal_y": goals.hypothesis_y,
        "hypothesis_goal_mass": goals.hypothesis_mass,
        "node_x": nodes.x,
        "node_y": nodes.y,
        "is_node": nodes.is_node,
        "node_kind": nodes.kind,
        "value": choice.value,
        "goal_value": choice.goal_value,
        "information_value": choice.information_value,
        "cost": choice.cost,
        "waypoint": jnp.stack([choice.waypoint_x, choice.waypoint_y]),
        "waypoint_kind": choice.kind,
        "is_kept": choice.is_kept,
        "is_stop": choice.is_stop,
        "stop_mass": choice.stop_mass,
    }
