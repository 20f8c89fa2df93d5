"""One episode in one call: from a sentence and a world to a recording (the whole of section 3).

What ``jaxlangnav follow`` does on the command line, for notebooks and scripts. Many episodes at
once go through ``experiments.policies.run_policy``, a robot of one's own through ``Navigator``.
"""

import contextlib
import dataclasses
import functools
import itertools
import threading
from pathlib import Path

import jax
import numpy as np

from jaxlangnav.episode import recorder
from jaxlangnav.episode.recording import Recording
from jaxlangnav.experiments.policies import navigator_config, without_compass
from jaxlangnav.experiments.sizes import any_task
from jaxlangnav.grounding import GroundingModel, load_shipped, understand
from jaxlangnav.grounding.instruction import Instruction, Understanding
from jaxlangnav.inputs.program_cache import cache_dir, cached_jit
from jaxlangnav.messages import Status
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams, default_params
from jaxlangnav.navigator.api import Navigator
from jaxlangnav.planner.config import AnyPolicy, split_arrays
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.task.opening import (
    Prepared,
    count_types,
    detector_of,
    nothing_there,
    open_task,
    refuse_what_it_lacks,
    usual_steps,
)
from jaxlangnav.world.files import open_world
from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.state import NUM_SLOTS, Scenario
from jaxlangnav.world.templates import Template


@dataclasses.dataclass(frozen=True, kw_only=True)
class OpenedEpisode:
    """An episode that can be run: what was said, where, and by what robot."""

    text: str
    understood: Understanding
    prepared: Prepared
    params: NavigatorParams
    config: NavigatorConfig


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
    """Follow a sentence in a world never seen, until the robot says stop.

    Args:
        text: the sentence.
        world: a template (1H1C, 1H2C, 2H1C, 2H2C), a shipped world, or a file.
        sensing_range: how far the robot sees, metres; 3, or what the world's file says, if None.
        policy: "informed", "faithful", or a policy of somebody's own.
        seed: of the world, where it is drawn from a template, and of the noise.
        particles: P, hypotheses of the map kept at once.
        max_steps: decisions after which it ends as a time-out; ``usual_steps`` if None.
        params: the navigator's numbers; its defaults if None.
        model: trained models of language; the shipped ones if None.

    Returns:
        The episode, for ``viz`` or for a look at any array in it.

    Raises:
        ValueError: the sentence, the world or an option is refused; one line.
    """
    model = load_shipped() if model is None else model
    opened = open_episode(
        text, world, sensing_range, policy, seed, particles, model=model, params=params
    )
    return record_episode(opened, max_steps)


def open_episode(
    text: str,
    world: str | Path,
    sensing_range: float | None,
    policy: AnyPolicy,
    seed: int,
    particles: int,
    *,
    model: GroundingModel,
    params: NavigatorParams | None = None,
) -> OpenedEpisode:
    """Understand a sentence and open a world for it; arguments and errors as of ``follow``."""
    world = str(world)
    understood = understand(text, model, detector_of(world, model.type_names))
    understood.check_task()
    if sensing_range is not None and not sensing_range > 0.0:
        raise ValueError(f"sensing_range is {sensing_range:g}, but must be positive, in metres")
    refuse_what_it_lacks(world, understood)
    usual, config = usual_engine(world, policy, particles)
    params = usual if params is None else replace(params, policy=usual.policy)
    prepared = open_task(world, understood, sensing_range=sensing_range, seed=seed)
    motion = prepared.task.motion
    if prepared.is_drawn and not prepared.is_meant:
        counts = count_types(prepared.task.scenario, understood.type_names)
        raise ValueError(nothing_there(prepared.world, counts, ()))
    return OpenedEpisode(
        text=text,
        understood=understood,
        prepared=prepared,
        params=replace(params, map=replace(params.map, motion=motion)),
        config=without_compass(config, motion),
    )


@functools.cache
@cached_jit()
def navigator_params() -> NavigatorParams:
    """Build the default parameters: compiled, as one by one their operations take seconds."""
    return default_params()


def usual_engine(
    world: str, policy: AnyPolicy, particles: int
) -> tuple[NavigatorParams, NavigatorConfig]:
    """Choose the navigator's numbers and sizes by what it has to hold.

    In worlds drawn from their templates those of the paper's tables, in any other the numbers of
    ``Navigator.pretrained``; its sizes too where more things stand than the tables' hold.

    Args:
        world: a template, a shipped world or a file.
        policy: "informed", "faithful", or a policy of somebody's own.
        particles: P.

    Raises:
        ValueError: no such world or policy, or a bad file.
    """
    place, (static, arrays) = open_world(world), split_arrays(policy)
    if isinstance(place, Template):
        return replace(navigator_params(), policy=arrays), navigator_config(static, particles)
    anywhere = Navigator.pretrained(policy)
    if place.scenario.is_object.size <= NUM_SLOTS:
        return anywhere.params, navigator_config(static, particles)
    sizes = dataclasses.replace(anywhere.config.map, num_particles=particles)
    return anywhere.params, dataclasses.replace(anywhere.config, map=sizes)


def alone(understood: Understanding) -> Instruction:
    """Make a batch of one instruction, leaves [1, …] on the host."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[None], understood.instruction)


def rehearse(
    instructions: Instruction, empty: Scenario, *, params: NavigatorParams, config: NavigatorConfig
) -> None:
    """Load or compile the decision cycle in a thread, while other things are done.

    A step of an episode in an empty world asks for it: shapes are the same for every sentence,
    leaves [1, …], in every world with as many slots and walls. Where no programs are kept nothing
    is done, as two threads would compile the same.
    """
    if cache_dir() is None:
        return
    task = any_task(empty)

    def step() -> None:
        # What goes wrong here goes wrong again where it is asked for, and is told there.
        with contextlib.suppress(Exception):
            next(recorder.play(task, instructions, params=params, config=config))

    threading.Thread(target=step).start()


def record_episode(opened: OpenedEpisode, max_steps: int | None = None) -> Recording:
    """Run one episode, and judge it by what its command asks for; steps as of ``follow``."""
    task, understood = opened.prepared.task, opened.understood
    recording = recorder.record(
        task,
        alone(understood),
        params=opened.params,
        config=opened.config,
        max_steps=max_steps or usual_steps(task.scenario, task.sensor),
        text=opened.text,
        type_names=understood.type_names,
    )
    return judged(recording, opened.prepared)


def judged(recording: Recording, prepared: Prepared, *, has_person: bool = False) -> Recording:
    """Judge an episode by what its command asks for.

    To navigate is to stop within 1.5 m of the goal, which the episode has judged itself; to find
    is to stop with the goal in view. Where nothing fits, or several places do and nothing says
    which is meant, there is nothing to judge: no success. A simulated person who speaks
    (``has_person``) has one of several places in mind.
    """
    result, scene = recording.result, recording.scene
    in_view = float(scene.sensor.range_max) if prepared.is_find else 0.0
    radius = max(in_view, SUCCESS_RADIUS)
    is_judged = prepared.is_meant and (has_person or not prepared.unjudged)
    is_arrived = (result.ending == Status.ARRIVED) & is_judged
    is_success = np.asarray(is_arrived & (result.goal_distance <= radius))
    world = scene.scenario
    places = [tuple(world.start[:2]), *prepared.via, tuple(world.goal)]
    legs = (world.terrain.travel.metres(*a, *b) for a, b in itertools.pairwise(places))
    told = {"known_distance": float(sum(legs)), "unjudged": prepared.unjudged or scene.unjudged}
    scene = dataclasses.replace(scene, stop_radius=radius, is_judged=is_judged, **told)
    result = replace(result, is_success=is_success)
    return dataclasses.replace(recording, scene=scene, result=result)
