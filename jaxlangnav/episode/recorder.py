"""Step-by-step simulation of an episode, for display and recording (section 4).

A Python loop over one compiled cycle, ``episode.advance``: ``play`` yields each step,
``recording.stack_frames`` stacks them as NumPy arrays.
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
from jaxlangnav.episode.recording import Snapshot, StaticScene
from jaxlangnav.grounding.command_summary import summarize_commands
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.inputs.object_types import label_of
from jaxlangnav.inputs.program_cache import cached_jit
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.messages import NONE, Observation, SensorParams, Status
from jaxlangnav.navigator import NavigatorConfig, NavigatorInfo, NavigatorParams, NavigatorState
from jaxlangnav.pytree import replace
from jaxlangnav.world.simulator import known_distance
from jaxlangnav.world.state import Scenario, WorldState

# Not compiled, its many small operations would take seconds.
_begin = cached_jit(static_argnames=("config",))(episode.begin)


def make_scene(
    scenario: Scenario,
    sensor: SensorParams,
    instruction: Instruction,
    *,
    text: str,
    params: NavigatorParams,
    config: NavigatorConfig,
    type_names: tuple[str, ...] | None = None,
) -> StaticScene:
    """Build the static part of a recording, for a simulated or a real robot.

    ``scenario``: the truth; ``sensor``: sensor model of the belief; ``instruction``: the grounded
    sentence, ``text`` its wording; ``type_names``: of the detector's labels, the lexicon's types by
    default.
    """
    records = (instruction, scenario, sensor, params.planner)
    instruction, scenario, sensor, planner = jax.device_get(records)
    return StaticScene(
        text=text,
        type_names=load_lexicon().type_names if type_names is None else type_names,
        policy=config.planner.chosen.name,
        portrayal=config.planner.chosen.portrayal,
        scenario=scenario,
        sensor=sensor,
        readings=instruction.readings,
        planner=planner,
        known_distance=float(known_distance(scenario)),
        commands=tuple(summarize_commands(instruction)),
    )


def play(
    task: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams,
    config: NavigatorConfig,
    max_steps: int = MAX_STEPS,
    speech: Any = None,
) -> Iterator[tuple[Snapshot, EpisodeResult]]:
    """Run an episode step by step; yield each step and the episode's result if it ended there.

    The same ``task.key`` gives the same episode as ``episode.run``. The episode runs for
    ``max_steps`` cycles (at least 1), or until it ends and ``speech`` (a ``task.talk.Dialogue``,
    polled before each step) expects no further utterance.

    Raises:
        ValueError: ``max_steps`` is less than 1.
    """
    check_minimum(1, max_steps=max_steps)
    state = _begin(task, instructions, config=config)
    if speech is not None:
        state = speech.begin(state)
    for step in range(max_steps):
        if speech is not None:
            state = speech.hear(step, state)
        state, device_frame, device_result = _advance(state, params=params, config=config)
        frame, result = jax.device_get((device_frame, device_result))
        if bool(state.navigator.is_halted):
            halted = np.int32(Status.HALTED)
            frame, result = replace(frame, status=halted), replace(result, ending=halted)
        yield frame, result
        if bool(state.navigator.is_resting) and (speech is None or not speech.expects(state)):
            return


@cached_jit(static_argnames=("config",))
def _advance(
    state: EpisodeState, *, params: NavigatorParams, config: NavigatorConfig
) -> tuple[EpisodeState, Snapshot, EpisodeResult]:
    """Run one cycle; return the next state, the frame and the result if it ended here."""
    next_state, info, observation = episode.advance(state, params=params, config=config)
    frame = make_frame(state.world, state.navigator, next_state.navigator, info, observation)
    return next_state, frame, episode.finish(next_state)


def make_frame(
    world: WorldState,
    previous: NavigatorState,
    after: NavigatorState,
    info: NavigatorInfo,
    observation: Observation,
) -> Snapshot:
    """Build the record of one step: the world before the motion, the belief after the update."""
    belief, goals, decision = after.belief, info.goals, info.choice
    particles, nodes = belief.particles, decision.nodes
    num_slots = particles.object_type.shape[0]
    variance = jnp.diagonal(particles.covariance, axis1=0, axis2=1).T  # [O + 1, P]
    mention_type = previous.instruction.readings.mention_type[particles.reading].T  # [M, P]
    region = jnp.argmax(info.behavior.goal, axis=0).astype(jnp.int32)  # [N + 1]
    derived = {
        "odometry": world.odometry[:2],
        "clause": previous.clause,
        "weight": jnp.exp(belief.log_weight),
        "object_type": label_of(particles.object_type),
        "object_x": particles.mean_x[:num_slots],
        "object_y": particles.mean_y[:num_slots],
        "object_sd": jnp.sqrt(jnp.maximum(variance[:num_slots], 0.0)),
        "mention_type": jnp.where(particles.is_mentioned, label_of(mention_type), NONE),
        "is_hypothesised": particles.is_hypothesised,
        "miss": jnp.exp(belief.coverage.log_miss),
        "is_goal": goals.is_object,
        "goal_region": jnp.append(region[: goals.object_x.shape[0] - 1], region[-1]),
        "goal_x": goals.object_x,
        "goal_y": goals.object_y,
        "goal_mass": goals.object_mass,
        "goal_confirmed": goals.object_confirmed,
        "hypothesis_goal_x": goals.hypothesis_x,
        "hypothesis_goal_y": goals.hypothesis_y,
        "hypothesis_goal_mass": goals.hypothesis_mass,
        **{f"node_{name}": vars(nodes)[name] for name in ("x", "y", "kind")},
        "is_node": nodes.is_node,
        "waypoint": jnp.stack([decision.waypoint_x, decision.waypoint_y]),
        "waypoint_kind": decision.kind,
        "is_done": after.is_done,
    }
    # The other fields are copied from the first of these records with a field of that name.
    records = (info, decision, info.filter, info.behavior, observation, particles, belief, after)
    fields = ChainMap(derived, *map(vars, records), vars(world))
    return Snapshot(**{f.name: fields[f.name] for f in dataclasses.fields(Snapshot)})
