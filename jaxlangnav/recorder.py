"""Running an episode step by step, to be looked at as it happens or kept (section 4).

A Python loop over one compiled cycle, ``episode.advance``: ``play`` yields each step, ``record``
keeps them all as NumPy arrays.
"""

from collections.abc import Iterator
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav import episode
from jaxlangnav.episode import MAX_STEPS, EpisodeResult, EpisodeState, Task
from jaxlangnav.grounding.asked import asked
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.kept import kept
from jaxlangnav.kinds import label_of
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.messages import NONE, Observation, Readings, SensorParams, Status
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams, NavigatorState
from jaxlangnav.pytree import replace
from jaxlangnav.recording import Frame, Recording, StaticScene, stack_frames
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.world.simulator import known_distance
from jaxlangnav.world.state import Scenario, WorldState


class Ear(Protocol):
    """What a robot hears while an episode runs."""

    def begin(self, progress: EpisodeState) -> EpisodeState:
        """Prepare the state, before the first step, for what may be said."""
        ...

    def hear(self, step: int, progress: EpisodeState) -> EpisodeState:
        """Take in what is said before the decision of a step."""
        ...

    def expects(self, progress: EpisodeState) -> bool:
        """Tell whether more may be said to a robot that stands still until it hears something."""
        ...


def scene_of(
    scenario: Scenario,
    sensor: SensorParams,
    instruction: Instruction,
    *,
    text: str,
    params: NavigatorParams,
    config: NavigatorConfig,
    type_names: tuple[str, ...] | None = None,
) -> StaticScene:
    """Gather what stays the same, whoever moves the robot.

    Args:
        scenario: the truth.
        sensor: what the belief is told of the detector.
        instruction: the sentence, grounded.
        text: the sentence, for people.
        params: the navigator's numbers.
        config: sizes and policy.
        type_names: of the detector's labels; the lexicon's types by default.

    Returns:
        The scene.
    """
    instruction, scenario, sensor, planner = jax.device_get(
        (instruction, scenario, sensor, params.planner)
    )
    return StaticScene(
        text=text,
        type_names=load_lexicon().type_names if type_names is None else type_names,
        policy=config.planner.chosen.name,
        portrayal=config.planner.chosen.portrayal,
        scenario=scenario,
        sensor=sensor,
        readings=instruction.readings,
        planner=planner,
        num_clauses=int(instruction.num_clauses),
        known_distance=float(known_distance(scenario)),
        asks=tuple(asked(instruction)),
    )


def play(
    task: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    ear: Ear | None = None,
) -> Iterator[tuple[Frame, EpisodeResult]]:
    """Run an episode step by step, early exit included.

    Args:
        task: one episode; the same key gives the same episode as ``episode.run``.
        instructions: leaves [I, …]; the task names one of them.
        params: the navigator's numbers.
        config: sizes and policy.
        max_steps: cycles until a time-out, at least 1.
        ear: what is said under way; the episode goes on as long as it expects more.

    Yields:
        Each step, and how the episode would be judged if it ended with it.

    Raises:
        ValueError: ``max_steps`` is less than 1.
    """
    if max_steps < 1:
        raise ValueError(f"max_steps is {max_steps}, but must be at least 1")
    progress = _begin(task, instructions, config=config)
    if ear is not None:
        progress = ear.begin(progress)
    for step in range(max_steps):
        if ear is not None:
            progress = ear.hear(step, progress)
        progress, frame, result = _advance(progress, params=params, config=config)
        shown, judged = jax.device_get((frame, result))
        if bool(progress.navigator.is_halted):
            halted = np.int32(Status.HALTED)
            shown, judged = replace(shown, status=halted), replace(judged, ending=halted)
        yield shown, judged
        if bool(progress.navigator.is_resting) and (ear is None or not ear.expects(progress)):
            return


def record(
    task: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    text: str = "",
    type_names: tuple[str, ...] | None = None,
) -> Recording:
    """Run an episode and keep what pictures need.

    Args:
        task: one episode.
        instructions: leaves [I, …]; the task names one of them.
        params: the navigator's numbers.
        config: sizes and policy.
        max_steps: cycles until a time-out, at least 1.
        text: the sentence, for people.
        type_names: of the detector's labels; the lexicon's types by default.

    Returns:
        The recording.
    """
    index = int(task.instruction_index)
    instruction = jax.tree.map(lambda leaf: leaf[index], jax.device_get(instructions))
    given = {"text": text, "type_names": type_names}
    scene = scene_of(task.scenario, task.sensor, instruction, params=params, config=config, **given)
    steps = list(play(task, instructions, params=params, config=config, max_steps=max_steps))
    return stack_frames(scene, [frame for frame, _ in steps], steps[-1][1])


@kept(static_argnames=("config",))
def _begin(task: Task, instructions: Instruction, *, config: NavigatorConfig) -> EpisodeState:
    """Compile ``episode.begin``: eager, its many small operations would take seconds."""
    return episode.begin(task, instructions, config=config)


@kept(static_argnames=("config",))
def _advance(
    progress: EpisodeState, *, params: NavigatorParams, config: NavigatorConfig
) -> tuple[EpisodeState, Frame, EpisodeResult]:
    """Run one cycle and gather what it looked like."""
    after, info, observation = episode.cycle(progress, params=params, config=config)
    frame = frame_of(progress.world, progress.navigator, after.navigator, info, observation)
    return after, frame, episode.finish(after)


def frame_of(
    world: WorldState,
    before: NavigatorState,
    after: NavigatorState,
    info: NavigatorInfo,
    observation: Observation,
) -> Frame:
    """Gather one step.

    Args:
        world: before the motion.
        before: the navigator's state before its decision.
        after: and after it.
        info: of the decision.
        observation: that it was decided by.

    Returns:
        The frame: the world before the motion, the belief after the step.
    """
    belief = after.belief
    return Frame(
        position=world.position,
        heading=world.heading,
        odometry=world.odometry[:2],
        robot=info.robot,
        distance=world.distance,
        clause=before.clause,
        detection_type=observation.detection_type,
        detection_range=observation.detection_range,
        detection_bearing=observation.detection_bearing,
        is_detection=observation.is_detection,
        effective_sample_size=info.filter.effective_sample_size,
        is_resampled=info.filter.is_resampled,
        num_regrounded=info.filter.num_regrounded,
        is_news=info.filter.is_news,
        fault=info.fault,
        overflow=info.filter.overflow,
        goal_region=_goal_region(info),
        action=info.behavior.action,
        mode=info.behavior.mode,
        status=after.status,
        is_done=after.is_done,
        **_belief_fields(belief, before.instruction.readings),
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
    variance = jnp.diagonal(particles.covariance, axis1=0, axis2=1).T  # [O + 1, P]
    mention_type = readings.mention_type[particles.reading].T  # [M, P]
    return {
        "weight": jnp.exp(belief.log_weight),
        "reading": particles.reading,
        "object_type": label_of(particles.object_type),
        "object_x": particles.mean_x[:num_objects],
        "object_y": particles.mean_y[:num_objects],
        "object_sd": jnp.sqrt(jnp.maximum(variance[:num_objects], 0.0)),
        "mention_type": jnp.where(particles.is_mentioned, label_of(mention_type), NONE),
        "referent": particles.referent,
        "is_hypothesised": particles.is_hypothesised,
        "hypothesis_x": particles.hypothesis_x,
        "hypothesis_y": particles.hypothesis_y,
        "miss": jnp.exp(belief.coverage.log_miss),
    }


def _decision_fields(info: NavigatorInfo) -> dict[str, Array]:
    """Gather the goals, the nodes and the choice."""
    goals, choice = info.goals, info.choice
    nodes = choice.nodes
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
