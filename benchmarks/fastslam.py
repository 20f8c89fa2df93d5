"""Benchmark of the filter step against FastSLAM 1.0 as a NumPy loop and against dynamax.

    python benchmarks/fastslam.py [--quick] [--json]

1,000 particles, eight landmarks in view in every step, association known (every landmark is of a
type of its own). CPU seconds on one core, compilation apart, the median of several repetitions;
the error is that of robot and landmarks at the end of the drive, the median over seeds.
"""

import pinning  # noqa: I001 - before JAX and NumPy start their threads

import statistics
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import record
from record import Measurement, against, entry
import slam_scenario
from jax import Array
from slam_scenario import LANDMARKS, ODOMETRY_NOISE, SENSOR_NOISE, STEP, Drive

from jaxlangnav.experiments.timing import measure
from jaxlangnav.experiments.tasks import SENTENCES, ground_sentences
from jaxlangnav.messages import MotionParams, Observation, Readings, SensorParams, default_sensor
from jaxlangnav.numerics import categorical
from jaxlangnav.numerics.batching import take
from jaxlangnav.numerics.categorical import effective_sample_size, systematic
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import association, motion, observe, particle
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.params import MapConfig, default_map_params
from jaxlangnav.semantic_map.particle import SemanticMap

NUM_PARTICLES = 1000
NUM_LANDMARKS = len(LANDMARKS)
ERROR_RATIO = 0.99
"""Target of error ratios: differences below 1 % count as equal."""
_LOG_NEW = -60.0
"""Log density of a new object: so low that it is chosen only if nothing else is possible."""

Estimate = tuple[np.ndarray, np.ndarray]
"""Mean position of the robot f64[2] and of the landmarks f64[L, 2], metres."""


def core_step(
    carry: tuple[SemanticMap, Array], inputs: tuple[Array, Array, Array]
) -> tuple[tuple[SemanticMap, Array], None]:
    """Run one Rao-Blackwellized filter step: predict, associate, update, weigh, resample."""
    particles, log_weight = carry
    key, odometry, offsets = inputs
    associate_key, resample_key = jax.random.split(key)
    num_particles = log_weight.shape[0]
    sensor = default_sensor(noise=SENSOR_NOISE)
    variance = jnp.float32((ODOMETRY_NOISE * STEP) ** 2)
    particles = motion.move(particles, odometry[0], odometry[1], variance)
    detections = association.Detections(
        object_type=jnp.arange(NUM_LANDMARKS),
        offset_x=offsets[:, 0],
        offset_y=offsets[:, 1],
        log_new=jnp.full(NUM_LANDMARKS, _LOG_NEW),
        is_detection=jnp.ones(NUM_LANDMARKS, bool),
    )
    uniform = jax.random.uniform(associate_key, (NUM_LANDMARKS, num_particles))
    grounded = association.associate(particles, detections, uniform, sensor)
    particles = observe.condition(particles, grounded, sensor)
    weight, _, _ = categorical.log_normalize(log_weight + grounded.log_weight)
    is_resampled = effective_sample_size(weight) < 0.5 * num_particles
    ancestors = systematic(weight, jax.random.uniform(resample_key))
    ancestors = jnp.where(is_resampled, ancestors, jnp.arange(num_particles))
    particles = take(particles, ancestors)
    log_weights = jnp.log(jnp.maximum(weight, 1e-30))
    return (particles, jnp.where(is_resampled, -jnp.log(float(num_particles)), log_weights)), None


@jax.jit
def run_core(odometry: Array, offsets: Array, key: Array) -> tuple[SemanticMap, Array]:
    """Run the Gaussian core over a drive.

    Args:
        odometry: f32[T, 2], metres.
        offsets: f32[T, L, 2], metres.
        key: random key.

    Returns:
        Particles, leaves [..., P], and their log-weights f32[P].
    """
    empty = particle.empty(NUM_LANDMARKS, 1, jnp.float32(0.0), jnp.float32(0.0))
    particles = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf[..., None], (*leaf.shape, NUM_PARTICLES)), empty
    )
    log_weight = jnp.full(NUM_PARTICLES, -jnp.log(float(NUM_PARTICLES)))
    inputs = (jax.random.split(key, len(odometry)), odometry, offsets)
    return jax.lax.scan(core_step, (particles, log_weight), inputs)[0]


@jax.jit
def run_whole(
    odometry: Array, offsets: Array, key: Array, readings: Readings
) -> tuple[SemanticMap, Array]:
    """Run the complete semantic filter over a drive, with coverage, negative information and words.

    Args:
        odometry: f32[T, 2], metres.
        offsets: f32[T, L, 2], metres.
        key: random key.
        readings: of what the robot was told.

    Returns:
        Particles, leaves [..., P], and their log-weights f32[P].
    """
    sensor = SensorParams(
        range_max=jnp.float32(30.0),
        field_of_view=jnp.float32(2.0 * np.pi),
        detection_probability=jnp.float32(0.999),
        noise=jnp.float32(SENSOR_NOISE),
    )
    robot = MotionParams(step_length=jnp.float32(STEP), odometry_noise=jnp.float32(ODOMETRY_NOISE))
    params = replace(default_map_params(), motion=robot)
    config = MapConfig(num_particles=NUM_PARTICLES, num_objects=NUM_LANDMARKS)
    area = jnp.array([-20.0, 20.0, -20.0, 20.0])

    def step(belief, inputs):
        step_key, position, offset = inputs
        observation = Observation(
            pose=jnp.append(position, 0.0),
            detection_type=jnp.arange(NUM_LANDMARKS),
            detection_range=jnp.hypot(offset[:, 0], offset[:, 1]),
            detection_bearing=jnp.arctan2(offset[:, 1], offset[:, 0]),
            is_detection=jnp.ones(NUM_LANDMARKS, bool),
            sensor=sensor,
        )
        return semantic_filter.step(step_key, belief, readings, observation, params=params)[0], None

    num_mentions = readings.mention_type.shape[-1]
    belief = semantic_filter.start(jnp.zeros(3), area, num_mentions, config=config)
    inputs = (jax.random.split(key, len(odometry)), jnp.cumsum(odometry, axis=0), offsets)
    belief, _ = jax.lax.scan(step, belief, inputs)
    return belief.particles, belief.log_weight


def estimate(filtered: tuple[SemanticMap, Array]) -> Estimate:
    """Compute the weighted mean over particles; landmarks in the order of their types."""
    particles, log_weight = filtered
    weight = np.exp(np.asarray(log_weight, np.float64))
    mean = np.stack([particles.mean_x @ weight, particles.mean_y @ weight], axis=-1)
    types = np.asarray(particles.object_type[:, 0])
    return mean[-1], mean[[int(np.argmax(types == i)) for i in range(NUM_LANDMARKS)]]


def arrays(drive: Drive, seed: int) -> tuple[Array, Array, Array]:
    """Convert a drive to device arrays."""
    return (
        jnp.asarray(drive.odometry, jnp.float32),
        jnp.asarray(drive.offsets, jnp.float32),
        jax.random.key(seed),
    )


def ours(run: Callable[..., Any], drives: list[Drive], repetitions: int) -> tuple[float, float]:
    """Measure one of our filters: µs CPU per particle and step, and median error in metres."""
    inputs = [arrays(drive, seed) for seed, drive in enumerate(drives)]
    errors = [
        slam_scenario.error(*estimate(run(*args)), drive)
        for args, drive in zip(inputs, drives, strict=True)
    ]
    cost = measure(lambda: run(*inputs[0]), repetitions).cpu
    return 1e6 * cost / len(drives[0].truth) / NUM_PARTICLES, statistics.median(errors)


def looping(drives: list[Drive]) -> tuple[float, float]:
    """Measure FastSLAM 1.0 as a loop; results as ``ours``."""
    import fastslam_loop

    costs, errors = [], []
    for seed, drive in enumerate(drives):
        begin = time.process_time()
        estimates = fastslam_loop.run(drive, NUM_PARTICLES, seed)
        costs.append(time.process_time() - begin)
        errors.append(slam_scenario.error(*estimates, drive))
    cost = statistics.median(costs)
    return 1e6 * cost / len(drives[0].truth) / NUM_PARTICLES, statistics.median(errors)


def dynamax(drives: list[Drive], repetitions: int) -> tuple[float, float]:
    """Measure dynamax's filter; results as ``ours``."""
    import dynamax_filter

    costs, errors = [], []
    for seed, drive in enumerate(drives):
        run = dynamax_filter.prepare(drive, NUM_PARTICLES, seed)
        errors.append(slam_scenario.error(*dynamax_filter.estimate(run()), drive))
        costs.append(measure(run, repetitions).cpu)
    cost = statistics.median(costs)
    return 1e6 * cost / len(drives[0].truth) / NUM_PARTICLES, statistics.median(errors)


def entries(*, is_quick: bool) -> list[Measurement]:
    """Run all measurements.

    Args:
        is_quick: a shorter drive, fewer seeds and repetitions.

    Returns:
        Entries of the bench's document.
    """
    num_steps, seeds = (8, 1) if is_quick else (30, 3)
    repetitions = 3 if is_quick else 9
    drives = [slam_scenario.drive(num_steps, seed) for seed in range(seeds)]
    core, core_error = ours(run_core, drives, repetitions)
    readings_batch = ground_sentences([SENTENCES["null"]]).instructions.readings
    readings = jax.tree.map(lambda leaf: leaf[0], readings_batch)
    full, full_error = ours(lambda *a: run_whole(*a, readings=readings), drives, repetitions)
    loop, loop_error = looping(drives)
    rival, dynamax_error = dynamax(drives, repetitions)
    unit = "µs CPU per particle and step"
    return [
        entry("filter step against FastSLAM 1.0 as a NumPy loop", core, unit)
        | against(core, loop, 300.0),
        entry("filter step against dynamax's rbpfilter", core, unit) | against(core, rival, 100.0),
        entry("whole filter, words and absences too, against FastSLAM 1.0", full, unit)
        | against(full, loop, 300.0),
        entry("error of the filter step against FastSLAM 1.0", core_error, "m")
        | against(core_error, loop_error, ERROR_RATIO),
        entry("error of the filter step against dynamax's rbpfilter", core_error, "m")
        | against(core_error, dynamax_error, ERROR_RATIO),
        entry("error of the whole filter against FastSLAM 1.0", full_error, "m")
        | against(full_error, loop_error, ERROR_RATIO),
    ]


if __name__ == "__main__":
    record.main(entries, __doc__, pinning.CORE)
