"""Running an episode step by step, to be looked at as it happens or kept (section 4).

A Python loop over one compiled cycle, ``episode.advance``: ``play`` yields each step, ``record``
keeps them all as NumPy arrays.
"""

import dataclasses
from collections import ChainMap
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav import episode
from jaxlangnav.episode import MAX_STEPS, EpisodeResult, EpisodeState, Task
from jaxlangnav.episode.recording import Frame, Recording, StaticScene, stack_frames
from jaxlangnav.grounding.asked import summarize_commands
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.limits import refuse_below
from jaxlangnav.inputs.object_types import label_of
from jaxlangnav.inputs.program_cache import cached_jit
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.messages import NONE, Observation, SensorParams, Status
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams, NavigatorState
from jaxlangnav.pytree import replace
from jaxlangnav.world.simulator import known_distance
from jaxlangnav.world.state import Scenario, WorldState


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

    ``scenario``: the truth; ``sensor``: what the belief is told of the detector; ``instruction``:
    the sentence, grounded, and ``text``, for people; ``type_names``: of the detector's labels, the
    lexicon's types by default.
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
        asks=tuple(summarize_commands(instruction)),
    )


def play(
    task: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    ear: Any = None,
) -> Iterator[tuple[Frame, EpisodeResult]]:
    """Run an episode step by step: each step, and how it would be judged if it ended with it.

    The same ``task.key`` gives the same episode as ``episode.run``. The episode goes on for
    ``max_steps`` cycles (at least 1) or until it ends, or as long as its ``ear`` expects more to be
    said (``task.talk.Earshot``: it begins with a state, hears before each step).

    Raises:
        ValueError: ``max_steps`` is less than 1.
    """
    refuse_below(1, max_steps=max_steps)
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
    """Run an episode as ``play`` does and keep it; text and names as ``scene_of``."""
    index = int(task.instruction_index)
    instruction = jax.tree.map(lambda leaf: leaf[index], jax.device_get(instructions))
    given = {"text": text, "type_names": type_names}
    scene = scene_of(task.scenario, task.sensor, instruction, params=params, config=config, **given)
    steps = list(play(task, instructions, params=params, config=config, max_steps=max_steps))
    return stack_frames(scene, [frame for frame, _ in steps], steps[-1][1])


@cached_jit(static_argnames=("config",))
def _begin(task: Task, instructions: Instruction, *, config: NavigatorConfig) -> EpisodeState:
    """Compile ``episode.begin``: eager, its many small operations would take seconds."""
    return episode.begin(task, instructions, config=config)


@cached_jit(static_argnames=("config",))
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
    """Gather one step: the world before the motion, the belief after the step."""
    belief, goals, choice = after.belief, info.goals, info.choice
    particles, nodes = belief.particles, choice.nodes
    num_objects = particles.object_type.shape[0]
    variance = jnp.diagonal(particles.covariance, axis1=0, axis2=1).T  # [O + 1, P]
    mention_type = before.instruction.readings.mention_type[particles.reading].T  # [M, P]
    region = jnp.argmax(info.behavior.goal, axis=0).astype(jnp.int32)  # [N + 1]
    own = {
        "odometry": world.odometry[:2],
        "clause": before.clause,
        "weight": jnp.exp(belief.log_weight),
        "object_type": label_of(particles.object_type),
        "object_x": particles.mean_x[:num_objects],
        "object_y": particles.mean_y[:num_objects],
        "object_sd": jnp.sqrt(jnp.maximum(variance[:num_objects], 0.0)),
        "mention_type": jnp.where(particles.is_mentioned, label_of(mention_type), NONE),
        "is_hypothesised": particles.is_hypothesised,
        "miss": jnp.exp(belief.coverage.log_miss),
        "is_goal": goals.is_object,
        "goal_region": jnp.append(region[: goals.object_x.shape[0] - 1], region[-1]),
        **{
            f"goal_{name}": vars(goals)[f"object_{name}"]
            for name in ("x", "y", "mass", "confirmed")
        },
        **{
            f"hypothesis_goal_{name}": vars(goals)[f"hypothesis_{name}"]
            for name in ("x", "y", "mass")
        },
        **{f"node_{name}": vars(nodes)[name] for name in ("x", "y", "kind")},
        "is_node": nodes.is_node,
        "waypoint": jnp.stack([choice.waypoint_x, choice.waypoint_y]),
        "waypoint_kind": choice.kind,
        "is_done": after.is_done,
    }
    # What else a frame holds has the same name in one of these, the first of them that has it.
    records = (info, choice, info.filter, info.behavior, observation, particles, after, world)
    found = ChainMap(own, *map(vars, records))
    return Frame(**{field.name: found[field.name] for field in dataclasses.fields(Frame)})
