"""Simulate and record one episode from a sentence and a world (all of section 3).

The function behind ``jaxlangnav follow``, for notebooks and scripts. Batches of episodes run by
``experiments.policies.run_policy``; a real robot uses ``Navigator``.
"""

import contextlib
import dataclasses
import functools
import itertools
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxlangnav.episode import EpisodeResult, recorder
from jaxlangnav.episode.recording import Recording, Snapshot, StaticScene, stack_frames
from jaxlangnav.experiments.policies import navigator_config, set_heading_bias
from jaxlangnav.grounding import GroundingModel, load_shipped, understand
from jaxlangnav.grounding.instruction import Instruction, Understanding
from jaxlangnav.inputs.program_cache import cache_dir, cached_jit
from jaxlangnav.messages import Status
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams, default_params
from jaxlangnav.navigator.api import Navigator
from jaxlangnav.planner.config import AnyPolicy, split_arrays
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.task import loading
from jaxlangnav.world.files import WorldSource, open_world
from jaxlangnav.world.simulator import SUCCESS_RADIUS, is_success
from jaxlangnav.world.state import NUM_SLOTS
from jaxlangnav.world.templates import Template


@dataclasses.dataclass(frozen=True, kw_only=True)
class PreparedEpisode:
    """An episode ready to run: grounded sentence, task, parameters and configuration."""

    understood: Understanding
    prepared: loading.PreparedTask
    params: NavigatorParams
    config: NavigatorConfig

    def scene(self) -> StaticScene:
        """Build the static part of its recording."""
        task, understood = self.prepared.task, self.understood
        names = {"text": understood.parse.instruction, "type_names": understood.type_names}
        inputs = task.scenario, task.sensor, understood.instruction
        return recorder.make_scene(*inputs, **names, params=self.params, config=self.config)

    def play(self, max_steps: int, speech: Any = None) -> Iterator[tuple[Snapshot, EpisodeResult]]:
        """Run it step by step, as ``recorder.play``."""
        inputs = self.prepared.task, batched(self.understood)
        sizes = {"params": self.params, "config": self.config, "max_steps": max_steps}
        return recorder.play(*inputs, **sizes, speech=speech)


def follow(
    text: str,
    *,
    world: str | Path = "1H1C",
    sensing_range: float | None = None,
    policy: AnyPolicy = "informed",
    seed: int = 0,
    particles: int = MapConfig().num_particles,
    max_steps: int | None = None,
    params: NavigatorParams | None = None,
    model: GroundingModel | None = None,
) -> Recording:
    """Simulate a robot that follows a sentence in an unknown world, until it stops.

    Args:
        text: the sentence.
        world: a template (1H1C, 1H2C, 2H1C, 2H2C), a shipped world, or a file.
        sensing_range: how far the robot sees, metres; 3, or what the world's file says, if None.
        policy: "informed", "faithful", or a custom policy.
        seed: of the world, where it is sampled from a template, and of the noise.
        particles: P, number of particles.
        max_steps: decisions after which it times out; ``step_limit`` if None.
        params: the navigator's parameters; its defaults if None.
        model: trained language models; the shipped ones if None.

    Returns:
        The recorded episode.

    Raises:
        ValueError: the sentence, the world or an option is refused; one line.
    """
    model = load_shipped() if model is None else model
    source = open_world(str(world))
    understood = understand(text, model, loading.detector_of(source, model.type_names))
    options = sensing_range, policy, seed, particles
    return record_episode(prepare_episode(understood, source, *options, params=params), max_steps)


def prepare_episode(
    understood: Understanding,
    source: WorldSource,
    sensing_range: float | None,
    policy: AnyPolicy,
    seed: int,
    particles: int,
    *,
    params: NavigatorParams | None = None,
) -> PreparedEpisode:
    """Prepare a world of ``open_world`` for a grounded sentence; the rest is as of ``follow``."""
    understood.check_task()
    defaults, config = params_and_config(source, policy, particles)
    params = defaults if params is None else replace(params, policy=defaults.policy)
    prepared = loading.load_task(source, understood, sensing_range=sensing_range, seed=seed)
    motion = prepared.task.motion
    if isinstance(source, Template) and not prepared.goal_exists:
        counts = loading.count_types(prepared.task.scenario, understood.type_names)
        raise ValueError(loading.mismatch_message(prepared.world, counts, ()))
    return PreparedEpisode(
        understood=understood,
        prepared=prepared,
        params=replace(params, map=replace(params.map, motion=motion)),
        config=set_heading_bias(config, motion),
    )


@functools.cache
@cached_jit()
def navigator_params() -> NavigatorParams:
    """Build the default parameters: compiled, as one by one their operations take seconds."""
    return default_params()


def params_and_config(
    source: WorldSource, policy: AnyPolicy, particles: int
) -> tuple[NavigatorParams, NavigatorConfig]:
    """Choose the navigator's default parameters and capacities for a world.

    In worlds sampled from templates those of the paper's tables, in any other the parameters of
    ``Navigator.pretrained``; its capacities too where a world has more objects than the tables'.

    Args:
        source: of ``open_world``.
        policy: "informed", "faithful", or a custom policy.
        particles: P.

    Raises:
        ValueError: no such policy.
    """
    static, arrays = split_arrays(policy)
    if isinstance(source, Template):
        return replace(navigator_params(), policy=arrays), navigator_config(static, particles)
    pretrained = Navigator.pretrained(policy)
    if source.scenario.is_object.size <= NUM_SLOTS:
        return pretrained.params, navigator_config(static, particles)
    map_config = dataclasses.replace(pretrained.config.map, num_particles=particles)
    return pretrained.params, dataclasses.replace(pretrained.config, map=map_config)


def batched(understood: Understanding) -> Instruction:
    """Build a batch of one instruction, leaves [1, …] on the host."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[None], understood.instruction)


def precompile_cycle(opened: PreparedEpisode) -> None:
    """Load or compile the decision cycle of an episode in a background thread.

    It runs one step. Without a program cache nothing is done, as two threads would compile the
    same.
    """
    if cache_dir() is None:
        return

    def step() -> None:
        # Any error occurs again in the foreground and is reported there.
        with contextlib.suppress(Exception):
            next(opened.play(1))

    threading.Thread(target=step).start()


def record_episode(opened: PreparedEpisode, max_steps: int | None = None) -> Recording:
    """Record one episode and evaluate its success; steps as of ``follow``."""
    task = opened.prepared.task
    max_steps = loading.step_limit(task) if max_steps is None else max_steps
    return score(stack_frames(opened.scene(), opened.play(max_steps)), opened.prepared)


def score(
    recording: Recording, prepared: loading.PreparedTask, *, has_person: bool = False
) -> Recording:
    """Evaluate the success of an episode by the command's action.

    To navigate is to stop within 1.5 m of the goal; to find is to stop where it is in view. Where
    no place fits, or several do and nothing says which is meant, success is undefined and set to
    False. A person who speaks (``has_person``) means one of several places.
    """
    result, scene, world = recording.result, recording.scene, recording.scene.scenario
    radius = max(float(scene.sensor.range_max) if prepared.is_find_task else 0.0, SUCCESS_RADIUS)
    is_scored = prepared.goal_exists and (has_person or not prepared.unscored)
    is_arrived = (result.ending == Status.ARRIVED) & is_scored
    waypoints = [tuple(world.start[:2]), *prepared.via, tuple(world.goal)]
    legs = (world.terrain.travel.metres(*a, *b) for a, b in itertools.pairwise(waypoints))
    fields = {"known_distance": float(sum(legs)), "unscored": prepared.unscored or scene.unscored}
    scene = dataclasses.replace(scene, stop_radius=radius, is_scored=is_scored, **fields)
    succeeds = is_success(result.final, world, is_arrived, radius)
    result = replace(result, is_success=np.asarray(succeeds))
    return dataclasses.replace(recording, scene=scene, result=result)
