"""A recording is the episode: the same steps, the same end, and nothing the belief did not hold."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from recording_fixture import make_recording

from jaxlangnav import episode, recorder
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import default_motion, default_sensor
from jaxlangnav.navigator import NavigatorConfig, default_params
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.recording import Frame, Recording
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.world.scenario import sample_scenario

TEXT = "go to the hydrant behind the cone"
CONFIG = NavigatorConfig(map=MapConfig(num_particles=32), planner=PlannerConfig(policy="faithful"))
SEEDS = (0, 1, 2, 3, 4, 5)


@pytest.fixture(scope="module")
def instructions():
    understood = understand(TEXT, load_shipped())
    return jax.tree.map(lambda leaf: leaf[None], understood.instruction)


def task_of(seed: int) -> episode.Task:
    key = jax.random.fold_in(jax.random.key(7), seed)
    draw = jax.jit(lambda one: sample_scenario(one, template="1H1C", relation="behind"))
    return episode.Task(
        key=jax.random.fold_in(key, 1),
        scenario=draw(jax.random.fold_in(key, 0)),
        instruction_index=jnp.int32(0),
        sensor=default_sensor(),
        motion=default_motion(),
    )


@pytest.fixture(scope="module")
def recordings(instructions) -> list[Recording]:
    return [
        recorder.record(
            task_of(seed), instructions, params=default_params(), config=CONFIG, text=TEXT
        )
        for seed in SEEDS
    ]


def test_the_same_key_gives_the_same_episode_as_run(recordings, instructions):
    # Two compiled programs round differently; one that resamples otherwise takes another way
    # (findings: up to 15 % of episodes). All but one of six must agree to the millimetre.
    agree = 0
    for seed, one in zip(SEEDS, recordings, strict=True):
        other = jax.device_get(
            episode.run(task_of(seed), instructions, params=default_params(), config=CONFIG)
        )
        agree += bool(
            one.result.steps == other.steps
            and one.result.is_success == other.is_success
            and np.allclose(one.result.distance, other.distance, atol=1e-3)
            and np.allclose(one.result.final, other.final, atol=1e-3)
        )
    assert agree >= len(SEEDS) - 1


def test_a_recording_repeats_bit_by_bit(recordings, instructions):
    again = recorder.record(
        task_of(SEEDS[0]), instructions, params=default_params(), config=CONFIG, text=TEXT
    )
    for field in dataclasses.fields(Frame):
        mine = getattr(recordings[0].frames, field.name)
        assert np.array_equal(mine, getattr(again.frames, field.name)), field.name


def test_the_cycle_compiles_once(recordings, instructions):
    """Another episode of the same sizes is data: nothing compiles again."""
    assert len(recordings) == len(SEEDS)
    before = recorder._advance.__wrapped__._cache_size()
    recorder.record(
        task_of(max(SEEDS) + 1), instructions, params=default_params(), config=CONFIG, text=TEXT
    )
    assert recorder._advance.__wrapped__._cache_size() == before


def test_it_ends_with_the_stop_and_not_before(recordings):
    for one in recordings:
        assert one.num_steps == int(one.result.steps)
        assert not one.frames.is_done[:-1].any()
        assert bool(one.frames.is_done[-1]) == bool(one.result.is_stopped)


def test_the_way_adds_up(recordings):
    for one in recordings:
        legs = np.diff(one.frames.position, axis=0)
        walked = np.hypot(legs[:, 0], legs[:, 1]).sum()
        assert np.allclose(walked, one.frames.distance[-1], atol=1e-3)
        assert np.allclose(one.frames.position[0], one.scene.scenario.start[:2])


def test_leaves_are_numpy_with_a_leading_axis(recordings):
    one = recordings[0]
    for field in dataclasses.fields(Frame):
        leaf = getattr(one.frames, field.name)
        assert isinstance(leaf, np.ndarray), field.name
        assert leaf.shape[0] == one.num_steps, field.name
    assert one.num_particles == 32


def test_weights_are_a_distribution(recordings):
    for one in recordings:
        assert np.allclose(one.frames.weight.sum(axis=1), 1.0, atol=1e-4)


def test_recorded_detections_are_those_the_belief_was_given(recordings):
    # Where something is discovered, a detection of its type points to where the belief has it:
    # within 6 standard deviations of the sensor's noise (0.1 m an axis) and the robot's own.
    checked = 0
    for one in recordings:
        for step in range(one.num_steps):
            frame = one.at(step)
            before = one.at(step - 1).object_type if step else np.full_like(frame.object_type, -1)
            is_new = (frame.object_type >= 0).all(axis=1) & (before < 0).all(axis=1)
            for slot in np.flatnonzero(is_new):
                turn = frame.heading + frame.detection_bearing
                x = frame.robot[0] + frame.detection_range * np.cos(turn)
                y = frame.robot[1] + frame.detection_range * np.sin(turn)
                off = np.hypot(x - frame.object_x[slot].mean(), y - frame.object_y[slot].mean())
                same = frame.is_detection & (frame.detection_type == frame.object_type[slot, 0])
                assert off[same].min() < 0.85
                checked += 1
    assert checked >= len(SEEDS)


def test_a_time_out_is_recorded_to_the_last_step(instructions):
    one = recorder.record(
        task_of(0), instructions, params=default_params(), config=CONFIG, max_steps=2
    )
    assert one.num_steps == 2
    assert not one.result.is_stopped
    assert not one.result.is_success


def test_no_steps_are_refused(instructions):
    with pytest.raises(ValueError, match="max_steps is 0"):
        recorder.record(
            task_of(0), instructions, params=default_params(), config=CONFIG, max_steps=0
        )


def test_one_step_can_be_taken_out():
    one = make_recording(5, 7)
    assert one.at(2).weight.shape == (7,)
    assert np.array_equal(one.at(-1).position, one.frames.position[4])


def test_types_have_names():
    scene = make_recording(2).scene
    assert scene.type_name(1) == "cone"
    assert scene.type_name(-1) == "thing"
    assert scene.type_name(99) == "thing"
