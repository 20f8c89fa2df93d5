"""The Gaussian part of the filter against a dense Kalman filter (section 3.2)."""

import jax
import numpy as np
import pytest
import readings as by_hand
from oracles.kalman import Kalman

from jaxlangnav.semantic_map.particle import START_VARIANCE

OBJECTS = [(0, 3.0, 3.0), (0, 7.0, -3.0), (1, 3.0, -3.0), (1, 7.0, 3.0), (2, 5.0, 0.0)]
"""Metres apart, so that which detection is which object is beyond doubt."""
CALLS = 4


def drive(seed: int, noise: float, odometry_noise: float):
    """Drive 32 random steps; return what is observed, and the Kalman filters of every lane."""
    random = np.random.default_rng(seed)
    specification = by_hand.sensor(range_max=5.0, probability=0.9, noise=noise)
    kalmans, lanes = [], []
    for _ in range(by_hand.SEEDS):
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
                    seen.append((index, name, offset))
            look = by_hand.observation(
                np.array([*odometry, heading]),
                [(name, *offset) for _, name, offset in seen],
                specification,
            )
            for index, _, offset in seen:
                kalman.detect(index, offset, noise)
            looks.append(look)
        kalmans.append(kalman)
        lanes.append(by_hand.stack(looks))
    return by_hand.stack(lanes), kalmans


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
        print(lane, error, shift)
