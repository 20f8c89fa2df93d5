"""A recording is the episode: the same steps, the same end, and nothing the belief did not hold."""

from collections.abc import Callable

import chex
import jax
import numpy as np
import pytest
from recording_fixture import make_recording
from test_episode_batch import MAX_STEPS, SENTENCES, config, in_lanes, instructions, tasks

from jaxlangnav.episode import Task, recorder
from jaxlangnav.episode.recording import Recording, stack_frames
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.tasks import Cell, make_tasks
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import default_sensor
from jaxlangnav.navigator import default_params
from jaxlangnav.task.follow import batched

__all__ = ["in_lanes", "instructions", "tasks"]
TEXT, RANGES = SENTENCES[0], (2.0, 3.0, 5.0, 20.0, 3.0, 5.0)


def first(tasks: Task, number: int = 0) -> Task:
    return jax.tree.map(lambda leaf: leaf[number] if leaf.ndim else leaf, tasks)


@pytest.fixture(scope="module")
def record() -> Callable[..., Recording]:
    """Record by the program that ``follow`` runs, and other tests have compiled."""
    told, numbers = batched(understand(TEXT, load_shipped())), default_params()
    given = {"params": numbers, "config": navigator_config("informed")}

    def of(seed: int, max_steps: int = MAX_STEPS) -> Recording:
        sensor = default_sensor(RANGES[seed % len(RANGES)])
        task = first(make_tasks(Cell(world="1H1C", relation="behind", sensor=sensor, seed=seed), 1))
        scene = recorder.make_scene(task.scenario, task.sensor, first(told), text=TEXT, **given)
        return stack_frames(scene, recorder.play(task, told, max_steps=max_steps, **given))

    return of


@pytest.fixture(scope="module")
def recordings(record) -> list[Recording]:
    return [record(seed) for seed in range(len(RANGES))]


@pytest.mark.slow
def test_the_same_key_gives_the_same_episode_as_in_a_batch(tasks, instructions, in_lanes):
    # Two compiled programs round differently; one that resamples otherwise takes another way
    # (findings: up to 15 % of episodes). All but one of six must agree to the millimetre.
    numbers, agree = range(0, 18, len(SENTENCES)), 0
    given = {"params": default_params(), "config": config(), "max_steps": MAX_STEPS}
    for number in numbers:
        *_, (_, one) = recorder.play(first(tasks, number), instructions, **given)
        other = first(in_lanes, number)
        agree += bool(
            one.steps == other.steps
            and one.is_success == other.is_success
            and np.allclose([one.distance, *one.final], [other.distance, *other.final], atol=1e-3)
        )
    assert agree >= len(numbers) - 1


def test_a_recording_repeats_bit_by_bit(recordings, record):
    chex.assert_trees_all_equal(recordings[0].frames, record(0).frames)


def test_the_cycle_compiles_once(recordings, record):
    """Another episode of the same sizes is data: nothing compiles again."""
    before = recorder._advance.__wrapped__._cache_size()
    record(len(recordings))
    assert recorder._advance.__wrapped__._cache_size() == before


def test_it_ends_with_the_stop_the_way_adds_up_and_weights_are_a_distribution(recordings):
    for one in recordings:
        assert one.num_steps == int(one.result.steps)
        assert not one.frames.is_done[:-1].any()
        assert bool(one.frames.is_done[-1]) == bool(one.result.is_stopped)
        legs = np.diff(one.frames.position, axis=0)
        walked = np.hypot(legs[:, 0], legs[:, 1]).sum()
        assert np.allclose(walked, one.frames.distance[-1], atol=1e-3)
        assert np.allclose(one.frames.position[0], one.scene.scenario.start[:2])
        assert np.allclose(one.frames.weight.sum(axis=1), 1.0, atol=1e-4)


def test_leaves_are_numpy_with_a_leading_axis(recordings):
    one = recordings[0]
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(one.frames))
    chex.assert_tree_shape_prefix(one.frames, (one.num_steps,))
    assert one.num_particles == 64


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
    assert checked >= len(RANGES)


def test_a_time_out_is_recorded_to_the_last_step(record):
    one = record(0, max_steps=2)
    assert one.num_steps == 2
    assert not one.result.is_stopped
    assert not one.result.is_success


def test_no_steps_are_refused(record):
    with pytest.raises(ValueError, match="max_steps is 0"):
        record(0, max_steps=0)


def test_types_have_names():
    scene = make_recording(2).scene
    assert scene.type_name(1) == "cone"
    assert scene.type_name(-1) == "thing"
    assert scene.type_name(99) == "thing"
