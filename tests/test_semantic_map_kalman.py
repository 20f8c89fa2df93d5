"""The Gaussian part of the filter against a dense Kalman filter (section 3.2)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from oracles.kalman import Kalman

from jaxlangnav.messages import NONE
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import association, motion, observe
from jaxlangnav.semantic_map.particle import START_VARIANCE, SemanticMap, empty

OBJECTS = [(0, 3.0, 3.0), (0, 7.0, -3.0), (1, 3.0, -3.0), (1, 7.0, 3.0), (2, 5.0, 0.0)]
"""Metres apart, so that which detection is which object is beyond doubt."""
CALLS, WORLDS = 4, 16
EPS = float(np.finfo(np.float32).eps)


def drive(seed: int, noise: float, odometry_noise: float):
    """Drive 32 random steps in WORLDS; what is observed in every lane, and its Kalman filter."""
    random = np.random.default_rng(seed)
    specification = by_hand.sensor(range_max=5.0, probability=0.9, noise=noise)
    kalmans, lanes = [], []
    for _ in range(WORLDS):
        truth, odometry = np.zeros(2), np.zeros(2)
        kalman, looks = Kalman(odometry, START_VARIANCE), []
        for _ in range(CALLS * by_hand.STEPS):
            heading = random.uniform(-np.pi, np.pi)
            target = random.uniform([1.0, -4.0], [9.0, 4.0])
            step = (target - odometry) * min(1.0, 1.0 / np.linalg.norm(target - odometry))
            # What the filter reads is float32: the oracle gets the very same numbers.
            now = np.float32(odometry + step).astype(float)
            step, odometry = now - odometry, now
            spread = odometry_noise * np.linalg.norm(step)
            truth = truth + step + random.normal(0.0, 1.0, 2) * spread
            kalman.move(step, spread**2)
            seen = []
            for index, (name, x, y) in enumerate(OBJECTS):
                offset = np.array([x, y]) - truth + random.normal(0.0, 1.0, 2) * noise
                if np.linalg.norm(offset) < 5.0 and random.uniform() < 0.9:
                    seen.append((name, *offset))
                    kalman.detect(index, offset, noise)
            pose = np.array([*odometry, heading])
            looks.append(by_hand.observation(pose, seen, specification))
        kalmans.append(kalman)
        lanes.append(by_hand.stack(looks))
    times = by_hand.SEEDS // WORLDS
    return by_hand.stack(lanes * times), kalmans * times


@pytest.mark.parametrize(
    ("noise", "odometry_noise"), [(0.1, 0.02), (0.1, 0.3), (0.3, 0.0), (0.03, 0.1)]
)
def test_equals_dense_kalman_filter(noise: float, odometry_noise: float) -> None:
    observations, kalmans = drive(7, noise, odometry_noise)
    beliefs = by_hand.repeat(by_hand.begin(), by_hand.SEEDS)
    sentences = by_hand.repeat(by_hand.NULL, by_hand.SEEDS)
    # Further objects are ruled out, or a particle in a thousand rightly grounds an outlier in one.
    numbers = by_hand.params(odometry_noise=odometry_noise, concentration=1e-7)
    for call in range(CALLS):
        part = slice(call * by_hand.STEPS, (call + 1) * by_hand.STEPS)
        beliefs, _ = by_hand.run_many(
            jax.random.split(jax.random.key(call), by_hand.SEEDS),
            beliefs,
            sentences,
            jax.tree.map(lambda leaf, part=part: leaf[:, part], observations),
            numbers,
        )
    particles = jax.tree.map(np.asarray, beliefs.particles)
    for lane, kalman in enumerate(kalmans):
        slots = [*range(len(kalman.names)), by_hand.CONFIG.num_objects]
        types = [OBJECTS[name][0] for name in kalman.names]
        assert (particles.object_type[lane, : len(types)] == np.array(types)[:, None]).all()
        covariance = particles.covariance[lane, ..., 0].astype(float)[np.ix_(slots, slots)]
        mean = np.stack([particles.mean_x[lane], particles.mean_y[lane]], -1)[slots]
        error = np.abs(covariance - kalman.covariance).max() / np.abs(kalman.covariance).max()
        shift = np.abs(mean - kalman.mean[:, None, :]).max()
        # An update rounds a variance by half a unit in the last place, and there are at most five
        # a step; a mean of ten metres is rounded likewise, and its gain is below one.
        updates = 5 * CALLS * by_hand.STEPS
        assert error < updates * EPS, (lane, error)
        assert shift < 10.0 * updates * EPS, (lane, shift)


def seen_at(x: float, y: float) -> association.Detections:
    """One detection of type 1, hardly of a new thing."""
    return association.Detections(*(jnp.array([one]) for one in (1, x, y, -200.0, True)))


def test_hypotheses_move_with_what_they_hang_on() -> None:
    """A cone turns out to lie half a metre further: what is "behind the cone" does so, too."""
    one = empty(2, 3, jnp.float32(0.0), jnp.float32(0.0))
    one = replace(
        one,
        object_type=jnp.array([1, 2]),
        covariance=jnp.diag(jnp.array([1e4, 1.0, 0.0])),
        mean_x=jnp.array([4.0, 7.0, 0.0]),
        mean_y=jnp.array([1.0, -2.0, 0.0]),
        # By the chain of anchors on the cone, on the ground, and on what was not seen again.
        root=jnp.array([0, NONE, 1]),
        hypothesis_x=jnp.array([6.0, 5.0, 9.0]),
        hypothesis_y=jnp.array([1.5, 3.0, -2.0]),
    )
    sensor = by_hand.sensor(noise=0.01)
    grounded = association.associate(one, seen_at(4.5, 0.8), jnp.array([0.5]), sensor)
    after = observe.condition(one, grounded, sensor)
    np.testing.assert_allclose(after.mean_x, [4.5, 7.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(after.hypothesis_x, [6.5, 5.0, 9.0], atol=1e-4)
    np.testing.assert_allclose(after.hypothesis_y, [1.3, 3.0, -2.0], atol=1e-4)


def test_a_detection_is_expected_with_what_robot_and_object_have_in_common() -> None:
    """log N(z; x_o − x_r, σ_o² + σ_r² − 2 σ_or + R): a doubt that both share is none."""
    one = empty(1, 1, jnp.float32(0.0), jnp.float32(0.0))
    one = replace(
        one,
        object_type=jnp.array([1]),
        covariance=jnp.array([[1.0, 0.6], [0.6, 0.5]]),
        mean_x=jnp.array([4.0, 1.0]),
        mean_y=jnp.array([1.0, 0.0]),
    )
    sensor = by_hand.sensor(noise=0.2)
    grounded = association.associate(one, seen_at(3.4, 0.8), jnp.array([0.5]), sensor)
    spread = 1.0 + 0.5 - 2 * 0.6 + 0.04
    expected = -(0.4**2 + 0.2**2) / (2 * spread) - np.log(2 * np.pi * spread)
    np.testing.assert_allclose(grounded.log_weight, expected, rtol=1e-5)


LONG, LAPS = 600, 8
"""Steps of the long drive, and how often it goes round."""


@jax.jit
def follow(steps: jax.Array, offsets: jax.Array, is_seen: jax.Array, spread, noise) -> SemanticMap:
    """Move and look T times: steps [T, 2], offsets [T, L, 2], is_seen [T, L]."""
    number = offsets.shape[1]

    def body(one: SemanticMap, look: tuple) -> tuple[SemanticMap, None]:
        step, offset, seen = look
        variance = spread**2 * jnp.sum(step * step)
        one = motion.move(one, step[0], step[1], variance)
        detections = association.Detections(
            object_type=jnp.arange(number),
            offset_x=offset[:, 0],
            offset_y=offset[:, 1],
            log_new=jnp.full(number, -200.0),
            is_detection=seen,
        )
        uniform, sensor = jnp.full(number, 0.5), replace(by_hand.sensor(), noise=noise)
        grounded = association.associate(one, detections, uniform, sensor)
        return observe.condition(one, grounded, sensor), None

    start = empty(number, 1, jnp.float32(0.0), jnp.float32(0.0))
    return jax.lax.scan(body, start, (steps, offsets, is_seen))[0]


@pytest.mark.parametrize(
    ("noise", "odometry_noise"), [(0.01, 0.3), (0.01, 0.0), (0.01, 0.002), (0.3, 0.3)]
)
def test_long_drives_do_not_drift(noise: float, odometry_noise: float) -> None:
    """600 steps in float32, half at a standstill: still the dense filter, symmetric, positive."""
    random = np.random.default_rng(1)
    places = 6.0 * random.normal(size=(8, 2))
    turn = 2.0 * np.pi * LAPS * np.arange(LONG) / LONG
    steps = np.float32(0.6 * np.stack([np.cos(turn), np.sin(turn)], -1))
    steps[LONG // 4 : 3 * LONG // 4] = 0.0
    kalman, truth = Kalman(np.zeros(2), START_VARIANCE), np.zeros(2)
    offsets, is_seen = np.zeros((LONG, 8, 2), np.float32), np.zeros((LONG, 8), bool)
    largest = START_VARIANCE
    for index, step in enumerate(steps.astype(float)):
        spread = odometry_noise * np.linalg.norm(step)
        truth = truth + step + spread * random.normal(size=2)
        kalman.move(step, spread**2)
        largest = max(largest, kalman.covariance.max())
        offsets[index] = places - truth + noise * random.normal(size=places.shape)
        is_seen[index] = np.linalg.norm(places - truth, axis=1) < 7.0
        for name in np.flatnonzero(is_seen[index]):
            kalman.detect(int(name), offsets[index, name].astype(float), noise)
    one = follow(steps, offsets, is_seen, jnp.float32(odometry_noise), jnp.float32(noise))
    order = [int(name) for name in one.object_type if name >= 0]
    rows = [*(kalman.names.index(name) for name in order), len(kalman.names)]
    filled = [*range(len(order)), 8]
    assert len(order) == len(kalman.names) > 4
    covariance = np.asarray(one.covariance)
    np.testing.assert_array_equal(covariance, covariance.T)
    ours, dense = covariance[np.ix_(filled, filled)], kalman.covariance[np.ix_(rows, rows)]
    # Thousands of roundings of the largest variance there was, in every direction alike: a random
    # walk, of which five standard deviations are allowed for.
    allowed = 5.0 * np.sqrt(is_seen.sum()) * EPS * largest
    assert np.abs(ours - dense).max() < allowed
    assert np.linalg.eigvalsh(ours.astype(float)).min() > 0.0
    mean = np.stack([one.mean_x, one.mean_y], -1)[filled]
    # Means of ten metres are rounded as often, and a wrong gain meets innovations of 5 sd.
    reach = 20.0 + 5.0 * largest / noise
    assert np.abs(mean - kalman.mean[rows]).max() < 5.0 * np.sqrt(is_seen.sum()) * EPS * reach
