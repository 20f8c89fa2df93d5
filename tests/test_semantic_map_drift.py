"""A heading that drifts: the belief of it against an integral over all drifts, and its limits."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from test_semantic_map_words import ground_lanes

from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import belief as beliefs, heading_bias, motion
from jaxlangnav.semantic_map.motion import predict
from jaxlangnav.semantic_map.observe import observe

NUMBER = 4096
FIRST, SECOND = np.array([2.5, 0.5]), np.array([1.3, 0.9])
"""Offsets of one hydrant before and after a metre straight ahead, robot frame."""
ODOMETRY, NOISE = 0.05, 0.1


def begin(has_drift: bool, number: int = NUMBER):
    """Begin with a drift of either sign in every other particle, or with a compass."""
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
    drawn = jax.random.normal(noise, (number,)) if belief.particles.drift.shape[0] else None
    uniform = (jax.random.uniform(uniform, (by_hand.D, number)),) * 2
    belief = predict(belief, observation.pose, jnp.asarray(False), drawn, params=params)
    belief, weighed = observe(uniform, belief, observation, params=params)
    return belief, weighed.log_map


def seen_twice(belief, params):
    """See a hydrant, drive a metre, see it again: the belief, and log p of the second look."""
    sensor = by_hand.sensor(range_max=5.0, noise=NOISE)
    for key, x, offset in ((0, 0.0, FIRST), (1, 1.0, SECOND)):
        seen = by_hand.observation(np.array([x, 0.0, 0.0]), [(by_hand.HYDRANT, *offset)], sensor)
        belief, log_map = look(jax.random.key(key), belief, seen, params)
    return belief, np.asarray(log_map, float)


def integral(spread: float, is_steady: bool):
    """Integrate over the drift, or sum over two signs: p of the second look, mean, deviation."""
    error = np.array([-1.0, 1.0]) if is_steady else np.linspace(-6.0, 6.0, 20001)
    prior = np.ones(2) if is_steady else np.exp(-0.5 * error**2)
    error = error * spread

    def turned(offset, angle):
        (x, y), cosine, sine = offset, np.cos(angle), np.sin(angle)
        return np.stack([cosine * x - sine * y, sine * x + cosine * y])

    missing = turned(SECOND, error) - FIRST[:, None] + turned(np.array([1.0, 0.0]), 0.5 * error)
    variance = 2.0 * NOISE**2 + ODOMETRY**2
    density = np.exp(-0.5 * (missing**2).sum(0) / variance) / (2 * np.pi * variance)
    weight = prior * density
    total = weight.sum() / prior.sum()
    mean = (weight * error).sum() / weight.sum()
    return total, mean, np.sqrt((weight * (error - mean) ** 2).sum() / weight.sum())


@pytest.mark.parametrize("name", ["heading_noise", "heading_bias"])
def test_belief_in_the_drift_equals_an_integral(name: str) -> None:
    spread = 0.3
    total, mean, deviation = integral(spread, name == "heading_bias")
    belief, log_map = seen_twice(begin(True), numbers(**{name: spread}))
    error, weight = np.asarray(belief.particles.drift[0], float), np.exp(log_map)
    found = np.mean(weight)
    assert abs(found - total) < 5.0 * weight.std() / np.sqrt(NUMBER)
    share = weight / weight.sum()
    estimate = (share * error).sum()
    size = 1.0 / (share**2).sum()
    assert size > 100.0
    assert abs(estimate - mean) < 5.0 * deviation / np.sqrt(size) + 1e-4
    # What is seen again tells much: the drift was known to 0.3 rad before.
    assert deviation < 0.15
    spread_now = np.sqrt((share * (error - estimate) ** 2).sum())
    assert abs(spread_now - deviation) < 5.0 * deviation / np.sqrt(2.0 * size) + 1e-4


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


def test_turning_adds_noise_and_a_steady_drift_keeps_its_sign() -> None:
    told = replace(by_hand.params().motion, turn_noise=jnp.float32(0.1))
    noise = jax.random.normal(jax.random.key(3), (NUMBER,))
    drift = jnp.stack([jnp.zeros(NUMBER), jnp.where(noise > 0.0, 1.0, -1.0)])
    turn, still = jnp.float32(-0.5 * np.pi), jnp.float32(0.0)
    error, sign = motion.add_drift(drift, still, turn, noise, motion=told)
    np.testing.assert_allclose(error, 0.1 * np.sqrt(0.5 * np.pi) * noise, rtol=1e-5)
    # Without a steady drift there is no sign to tell apart.
    np.testing.assert_array_equal(sign, 0.0)
    told = replace(told, turn_noise=jnp.float32(0.0), heading_bias=jnp.float32(0.05))
    error, sign = motion.add_drift(drift, jnp.float32(40.0), still, noise, motion=told)
    np.testing.assert_allclose(error, 2.0 * drift[1], rtol=1e-5)
    np.testing.assert_array_equal(sign, drift[1])


def driven(metres: int, params):
    """Drive straight ahead as odometry has it, with nothing to be seen."""
    belief, sensor = begin(True, 64), by_hand.sensor(range_max=2.0)
    for x in range(metres + 1):
        seen = by_hand.observation(np.array([float(x), 0.0, 0.0]), [], sensor)
        belief, _ = look(jax.random.key(x), belief, seen, params)
    return belief


def test_robot_goes_by_one_drift_and_keeps_where_it_looked_by_either() -> None:
    belief = driven(8, numbers(heading_bias=0.1))
    x, y = beliefs.robot_position(belief)
    # An arc of eight metres that turns by 0.1 rad each.
    np.testing.assert_allclose([x, y], [np.sin(0.8) / 0.1, (1 - np.cos(0.8)) / 0.1], atol=0.01)
    np.testing.assert_allclose(beliefs.mean_drift(belief), 0.8, rtol=1e-5)
    ours, theirs = np.asarray(belief.coverage.log_miss), np.asarray(belief.alternate_miss)
    # The area lies as far to the left as to the right.
    np.testing.assert_allclose(theirs, ours[::-1], atol=1e-3)
    assert np.abs(ours - theirs).max() > 1.0
    # Where each particle has the robot, its own map has been looked at.
    here = jnp.zeros((1, 1, 64))
    assert (np.asarray(heading_bias.log_miss_at_offset(belief, here, here)) < -1.0).all()
    # Drifts without a steady part are gone by all at once.
    belief = driven(2, numbers(heading_noise=0.1))
    assert beliefs.is_active(belief).all()


def test_robot_goes_by_the_other_drift_once_it_is_far_likelier() -> None:
    belief = driven(8, numbers(heading_bias=0.1))
    led = np.asarray(beliefs.is_active(belief))

    def led_with(share: float):
        weight = np.where(led, share / led.sum(), (1.0 - share) / (~led).sum())
        weighed = replace(belief, log_weight=jnp.log(jnp.asarray(weight, jnp.float32)))
        return heading_bias.switch_bias_hypothesis(weighed)

    kept, left = led_with(0.3), led_with(0.1)
    assert float(kept.bias_sign) == 1.0
    assert float(left.bias_sign) == -1.0
    np.testing.assert_array_equal(left.coverage.log_miss, belief.alternate_miss)
    np.testing.assert_array_equal(left.alternate_miss, belief.coverage.log_miss)
    y = beliefs.robot_position(belief)[1]
    np.testing.assert_allclose(beliefs.robot_position(left)[1], -y, atol=0.01)


def test_maps_are_laid_over_each_other_at_the_robot() -> None:
    belief, _ = seen_twice(begin(True, 64), numbers(heading_noise=0.1))
    laid, particles = beliefs.align_on_robot(belief), belief.particles
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
    one, laid = belief.particles, beliefs.align_on_robot(belief).particles
    assert np.std(one.mean_y[1]) > 0.2
    assert np.std(laid.mean_y[1]) < 1e-5
    pose = beliefs.to_map_frame(belief, belief.last_pose)
    np.testing.assert_allclose(pose[:2], [x, y], atol=1e-6)
    np.testing.assert_allclose(pose[2], beliefs.mean_drift(belief), atol=1e-6)
    belief, _ = seen_twice(begin(False, 64), numbers())
    offset = np.asarray(beliefs.to_map_frame(belief, belief.last_pose) - belief.last_pose)
    assert np.hypot(*offset[:2]) > 0.04
    np.testing.assert_allclose(beliefs.robot_position(belief), [1.0 + offset[0], offset[1]])


def test_words_are_grounded_by_where_each_drift_has_looked() -> None:
    """By the drift that it goes by the robot has looked on the near side, by the other beyond."""
    near = np.where(np.arange(32)[None] < 16, -20.0, 0.0).astype(np.float32)
    far = np.where(np.arange(32)[None] < 24, 0.0, -20.0).astype(np.float32)
    maps = [np.broadcast_to(one, (32, 32)) for one in (near, far)]
    belief = begin(True, 64)
    lanes = [
        replace(belief, coverage=replace(belief.coverage, log_miss=ours), alternate_miss=theirs)
        for ours, theirs in (maps, maps[::-1])
    ]
    keys, everyone = jax.random.split(jax.random.key(2), 2), jnp.ones((2, 64), bool)
    given = keys, by_hand.stack(lanes), by_hand.repeat(by_hand.NULL, 2), everyone, by_hand.params()
    particles, found = ground_lanes(*given)
    led = np.asarray(beliefs.is_active(belief))
    x, log_weight = np.asarray(particles.hypothesis_x[:, 0]), np.asarray(found)
    for lane, is_near_seen in enumerate((led, ~led)):
        assert (x[lane, is_near_seen] >= 5.0).all()
        assert (x[lane, ~is_near_seen] <= 7.5).all()
        assert (x[lane, ~is_near_seen] < 5.0).any()
        share = np.where(is_near_seen, 0.5, 0.75)
        # The less there is left to look at, the less the words are to be believed: u of each.
        evidence = np.exp(log_weight[lane])
        np.testing.assert_allclose(evidence / share, evidence[0] / share[0], rtol=1e-3)
