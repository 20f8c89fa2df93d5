"""Batches of episodes: results depend on an episode's own key, never on its place (batch laws)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grounding_fixture import zeroed_model

from jaxlangnav import episode, navigator
from jaxlangnav.episode import EpisodeResult, Task, lanes, run
from jaxlangnav.episode.lanes import run_batch
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import MotionParams, SensorParams
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.world.scenario import draw_scenario, scenario_params

draw_worlds = jax.vmap(draw_scenario, in_axes=(0, None))
SENTENCES = ("go to the hydrant behind the cone", "go to the hydrant", "find the cone")
EPISODES, MAX_STEPS = 24, 40


def config(policy: str = "informed") -> NavigatorConfig:
    return NavigatorConfig(
        map=MapConfig(num_particles=32, num_objects=4, num_cells=24),
        planner=PlannerConfig(policy=policy, num_visited=8),
    )


@pytest.fixture(scope="module")
def instructions():
    grounded = [understand(text, load_shipped()).instruction for text in SENTENCES]
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *grounded)


@pytest.fixture(scope="module")
def tasks() -> Task:
    """Episodes that differ in world, sentence, range and noise, and so in length."""
    law = scenario_params(template="1H1C", relation="behind")
    number = np.arange(EPISODES)
    return Task(
        key=jax.random.split(jax.random.key(1), EPISODES),
        scenario=draw_worlds(jax.random.split(jax.random.key(7), EPISODES), law),
        instruction_index=jnp.asarray(number % len(SENTENCES), jnp.int32),
        sensor=SensorParams(
            range_max=jnp.asarray(np.choose(number % 4, [2.0, 3.0, 5.0, 20.0]), jnp.float32),
            field_of_view=jnp.full(EPISODES, 2 * jnp.pi, jnp.float32),
            detection_probability=jnp.full(EPISODES, 0.95, jnp.float32),
            noise=jnp.full(EPISODES, 0.1, jnp.float32),
            # What is not said, or is one number, holds for all.
            false_detections=jnp.float32(0.0),
        ),
        motion=MotionParams(
            step_length=jnp.full(EPISODES, 1.0, jnp.float32),
            odometry_noise=jnp.asarray(0.02 * (number % 2), jnp.float32),
        ),
    )


def in_worlds(tasks: Task, seed: int, template: str, relation: str, reach: float) -> Task:
    """Put the tasks into other worlds, with another range and without noise."""
    law = scenario_params(template=template, relation=relation)
    noise, reaches = (jnp.full(EPISODES, one, jnp.float32) for one in (0.0, reach))
    return replace(
        tasks,
        scenario=draw_worlds(jax.random.split(jax.random.key(seed), EPISODES), law),
        sensor=replace(tasks.sensor, noise=noise, range_max=reaches),
    )


def batch(tasks: Task, instructions, lanes: int, policy: str = "informed", **kwargs):
    given = {"params": navigator.default_params(), "config": config(policy), **kwargs}
    result = run_batch(tasks, instructions, num_lanes=lanes, max_steps=MAX_STEPS, **given)
    return jax.tree.map(np.asarray, result)


def assert_same(ours: EpisodeResult, theirs: EpisodeResult, share: float = 0.95) -> None:
    """Programs round differently: a draw in 24 may fall to the other side (as measured, none)."""
    same = np.isclose(ours.distance, theirs.distance, atol=1e-2) & (ours.steps == theirs.steps)
    same &= np.isclose(ours.final, theirs.final, atol=1e-2).all(-1)
    assert same.mean() >= share, same
    assert (ours.is_success == theirs.is_success)[same].all()
    # Where a draw has fallen otherwise the episode is another sample of the same law.
    assert abs(ours.is_success.mean() - theirs.is_success.mean()) <= 0.1


@pytest.fixture(scope="module")
def in_lanes(tasks, instructions) -> EpisodeResult:
    return batch(tasks, instructions, lanes=7)


def test_episodes_end_with_a_result(in_lanes: EpisodeResult) -> None:
    assert in_lanes.is_valid.all()
    assert (in_lanes.steps >= 1).all()
    assert (in_lanes.steps <= MAX_STEPS).all()
    assert len(set(in_lanes.steps.tolist())) > 5, "lengths should differ, or refilling is untested"
    assert (in_lanes.is_success <= in_lanes.is_stopped).all()
    assert (in_lanes.is_stopped | (in_lanes.steps == MAX_STEPS)).all()
    assert (in_lanes.is_success == (in_lanes.is_stopped & (in_lanes.goal_distance <= 1.5))).all()
    assert (in_lanes.degenerate == 0).all()
    assert (in_lanes.distance <= in_lanes.steps * 1.5 * 1.1 + 1e-3).all()
    assert np.isfinite(in_lanes.distance).all()
    # A hydrant behind the only cone: nearly always found.
    assert in_lanes.is_success[::3].mean() > 0.7


def test_any_numbers_are_data(in_lanes: EpisodeResult, tasks, instructions) -> None:
    """Sentences, worlds, ranges, noises and parameters do not compile again."""
    before = lanes._run_batch._cache_size()
    changed = navigator.default_params()
    changed = replace(
        changed,
        map=replace(changed.map, concentration=jnp.float32(0.1)),
        planner=replace(changed.planner, discount=jnp.float32(0.9)),
    )
    others = in_worlds(tasks, 8, "2H2C", "nearest", 4.0)
    grounded = understand("carefully move to the hydrant nearest to the cone", load_shipped())
    sentences = jax.tree.map(
        lambda leaf, first: leaf.at[0].set(first), instructions, grounded.instruction
    )
    assert (batch(others, sentences, lanes=7, params=changed).steps >= 1).all()
    assert lanes._run_batch._cache_size() == before


def test_order_of_tasks_does_not_matter(in_lanes: EpisodeResult, tasks, instructions) -> None:
    """The same program with tasks permuted: bitwise the same episodes."""
    order = np.random.default_rng(0).permutation(EPISODES)
    permuted = batch(
        jax.tree.map(lambda leaf: leaf[order] if leaf.ndim else leaf, tasks), instructions, lanes=7
    )
    for ours, theirs in zip(jax.tree.leaves(permuted), jax.tree.leaves(in_lanes), strict=True):
        np.testing.assert_array_equal(ours, theirs[order])


@pytest.mark.slow
@pytest.mark.parametrize("lanes", [1, 64])
def test_number_of_lanes_does_not_matter(lanes, in_lanes, tasks, instructions):
    assert_same(batch(tasks, instructions, lanes), in_lanes)


@pytest.mark.slow
def test_padding_tasks_are_not_run(in_lanes: EpisodeResult, tasks, instructions) -> None:
    some = batch(tasks, instructions, lanes=7, count=jnp.int32(10))
    assert_same(
        jax.tree.map(lambda leaf: leaf[:10], some), jax.tree.map(lambda leaf: leaf[:10], in_lanes)
    )
    assert (some.steps[10:] == 0).all()
    none = batch(tasks, instructions, lanes=7, count=jnp.int32(0))
    assert (none.steps == 0).all()


@pytest.mark.slow
def test_refilled_lanes_equal_a_vmapped_loop(in_lanes: EpisodeResult, tasks, instructions) -> None:
    """``vmap`` of ``run`` waits for its slowest lane and finds the same episodes."""
    given = {"params": navigator.default_params(), "config": config(), "max_steps": MAX_STEPS}
    results = jax.vmap(lambda task: run(task, instructions, **given))(tasks)
    assert_same(jax.tree.map(np.asarray, results), in_lanes)


def test_keys_decide(tasks, instructions, in_lanes: EpisodeResult) -> None:
    """Another key is another episode in the same world."""
    other = replace(tasks, key=jax.random.split(jax.random.key(99), EPISODES))
    result = batch(other, instructions, lanes=7)
    assert not np.allclose(result.distance, in_lanes.distance)
    assert episode.MAX_STEPS >= MAX_STEPS


def test_without_weights_behind_is_not_found(in_lanes: EpisodeResult, tasks, instructions) -> None:
    """The sentence reaches the robot through the trained model alone: zeroed, it says nothing."""
    del in_lanes  # compiles the program that this test runs again
    told = in_worlds(tasks, 9, "2H1C", "behind", 5.0)
    told = replace(told, instruction_index=jnp.zeros(EPISODES, jnp.int32))
    before = lanes._run_batch._cache_size()
    trained = batch(told, instructions, lanes=7)
    zeroed = understand(SENTENCES[0], zeroed_model()).instruction
    unlearned = jax.tree.map(lambda leaf, one: leaf.at[0].set(one), instructions, zeroed)
    without = batch(told, unlearned, lanes=7)
    assert lanes._run_batch._cache_size() == before
    assert trained.is_success.mean() > 0.8
    # Not even the half that a robot finds which merely stops at the first hydrant.
    assert without.is_success.mean() < 0.3
