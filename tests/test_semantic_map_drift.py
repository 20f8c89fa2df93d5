"""A heading that drifts: the belief of it against an integral over all drifts, and its limits."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import belief as beliefs
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map import motion

NUMBER = 4096
FIRST, SECOND = np.array([2.5, 0.5]), np.array([1.3, 0.9])
"""Offsets of one hydrant before and after a metre straight ahead, robot frame."""
ODOMETRY, NOISE = 0.05, 0.1


def begin(has_drift: bool, number: int = NUMBER):
    config = dataclasses.replace(by_hand.CONFIG, num_particles=number, has_drift=has_drift)
    return by_hand.begin(config=config)


def numbers(**drift: float):
    known = by_hand.params(odometry_noise=ODOMETRY, concentration=1e-7)
    told = {name: jnp.float32(value) for name, value in drift.items()}
    return replace(known, motion=replace(known.motion, **told))


@jax.jit
def look(key, belief, observation, params):
    """One look without words: the belief, and log p(look) in every particle."""
    uniform, noise = jax.random.split(key)
    number = belief.log_weight.shape[0]
    drawn = jax.random.normal(noise, (2, number)) if belief.particles.drift.shape[0] else None
    uniform = jax.random.uniform(uniform, (by_hand.D, number))
    belief, weighed = semantic_filter.observe(
        uniform, belief, observation, jnp.asarray(False), drawn, params=params
    )
    return belief, weighed.log_map


def seen_twice(belief, params):
    """See a hydrant, drive a metre, see it again: the belief, and log p of the second look."""
    sensor = by_hand.sensor(range_max=5.0, noise=NOISE)
    for key, x, offset in ((0, 0.0, FIRST), (1, 1.0, SECOND)):
        seen = by_hand.observation(np.array([x, 0.0, 0.0]), [(by_hand.HYDRANT, *offset)], sensor)
        belief, log_map = look(jax.random.key(key), belief, seen, params)
    return belief, np.asarray(log_map, float)


def integral(spread: float):
    """Integrate over the drift: log p of the second look, mean and deviation of the drift."""
    error = np.linspace(-6.0, 6.0, 20001) * spread

    def turned(offset, angle):
        cosine, sine = np.cos(angle), np.sin(angle)
        return np.stack(
            [cosine * offset[0] - sine * offset[1], sine * offset[0] + cosine * offset[1]]
        )

    missing = turned(SECOND, error) - FIRST[:, None] + turned(np.array([1.0, 0.0]), 0.5 * error)
    variance = 2.0 * NOISE**2 + ODOMETRY**2
    density = np.exp(-0.5 * (missing**2).sum(0) / variance) / (2 * np.pi * variance)
    prior = np.exp(-0.5 * (error / spread) ** 2)
    weight = prior * density
    total = weight.sum() / prior.sum()
    mean = (weight * error).sum() / weight.sum()
    return total, mean, np.sqrt((weight * (error - mean) ** 2).sum() / weight.sum())


@pytest.mark.parametrize("name", ["heading_noise", "heading_bias"])
def test_belief_in_the_drift_equals_an_integral(name: str) -> None:
    spread = 0.3
    total, mean, deviation = integral(spread)
    belief, log_map = seen_twice(begin(True), numbers(**{name: spread}))
    error, weight = np.asarray(belief.particles.drift[0], float), np.exp(log_map)
    found = np.mean(weight)
    assert abs(found - total) < 5.0 * weight.std() / np.sqrt(NUMBER)
    share = weight / weight.sum()
    estimate = (share * error).sum()
    size = 1.0 / (share**2).sum()
    assert size > 100.0
    assert abs(estimate - mean) < 5.0 * deviation / np.sqrt(size)
    # What is seen again tells much: the drift was known to 0.3 rad before.
    assert deviation < 0.15
    spread_now = np.sqrt((share * (error - estimate) ** 2).sum())
    assert abs(spread_now - deviation) < 5.0 * deviation / np.sqrt(2.0 * size)


def test_a_heading_that_does_not_drift_is_as_by_compass() -> None:
    for params in (numbers(), numbers(turn_noise=0.5)):
        drifting, log_drifting = seen_twice(begin(True), params)
        by_compass, log_by_compass = seen_twice(begin(False), params)
        np.testing.assert_array_equal(log_drifting, log_by_compass)
        jax.tree.map(
            np.testing.assert_array_equal,
            replace(drifting.particles, drift=by_compass.particles.drift),
            by_compass.particles,
        )


def test_turning_adds_noise_and_a_steady_drift_wanders_slowly() -> None:
    told = replace(by_hand.params().motion, turn_noise=jnp.float32(0.1))
    noise = jax.random.normal(jax.random.key(3), (2, NUMBER))
    steady = jax.random.normal(jax.random.key(4), (NUMBER,))
    drift = jnp.stack([jnp.zeros(NUMBER), steady])
    turn = motion.wrapped(jnp.float32(1.5 * np.pi))
    still = motion.drifted(drift, jnp.float32(0.0), turn, noise, motion=told)
    np.testing.assert_array_equal(still[1], steady)
    np.testing.assert_allclose(still[0], 0.1 * np.sqrt(0.5 * np.pi) * noise[0], rtol=1e-5)
    far = motion.drifted(drift, jnp.float32(motion.STEADY), turn, noise, motion=told)[1]
    five = 5.0 / np.sqrt(NUMBER)
    assert abs(float(far.std()) - 1.0) < five
    assert abs(float(jnp.mean(far * steady)) - np.exp(-1.0)) < five


def test_maps_are_laid_over_each_other_at_the_robot() -> None:
    belief, _ = seen_twice(begin(True, 64), numbers(heading_noise=0.1))
    laid, particles = beliefs.about_robot(belief), belief.particles
    robot = by_hand.CONFIG.num_objects
    x, y = beliefs.robot_position(belief)
    np.testing.assert_allclose(laid.particles.mean_x[robot], x, atol=1e-6)
    np.testing.assert_allclose(laid.particles.mean_y[robot], y, atol=1e-6)
    away = [
        np.hypot(one.mean_x[0] - one.mean_x[robot], one.mean_y[0] - one.mean_y[robot])
        for one in (particles, laid.particles)
    ]
    np.testing.assert_allclose(*away, atol=1e-5)
    # What is first seen now is at one place from the robot, but not in the map.
    cone = by_hand.observation(np.array([1.0, 0.0, 0.0]), [(by_hand.CONE, 3.0, 0.0)])
    belief, _ = look(jax.random.key(2), belief, cone, numbers(heading_noise=0.1))
    one, laid = belief.particles, beliefs.about_robot(belief).particles
    assert np.std(one.mean_y[1]) > 0.2
    assert np.std(laid.mean_y[1]) < 1e-5
    pose = beliefs.in_map(belief, belief.last_pose)
    np.testing.assert_allclose(pose[:2], [x, y], atol=1e-6)
    np.testing.assert_allclose(pose[2], beliefs.mean_drift(belief), atol=1e-6)
