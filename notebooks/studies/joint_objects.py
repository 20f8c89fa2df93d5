"""What the joint Gaussian over robot and objects is worth (section 3.2, eq. 5c).

One drive, two maps. The joint form keeps the covariance of robot and objects, so that seeing one
object again corrects the robot and, through it, all others. The independent form keeps what every
object and the robot are known to by themselves and drops their covariances after each update.
Both see the same worlds, odometry and detections, and are held against the true places by the
negative log-likelihood: being wrong and being sure of it costs most.

Objects differ in type, so nothing but the form of the Gaussian is compared. The robot drives twice
round a circle that is wider than its sight, so that it comes back to what it has seen.
"""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import NONE, Action, MotionParams, SensorParams, Status, default_sensor
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map import association, motion, particle, update
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.world import simulator
from jaxlangnav.world.motion import carry_out
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.state import Scenario, WorldState

NUM_OBJECTS = 8
RADIUS = 6.0
"""Metres, of the circle that is driven."""
LAPS = 2
STEPS = 76
"""One metre each: twice round."""
_LOG_NEW = -20.0  # an object of a type that has been seen is that object
_Z95 = 1.959964


@pytree
class FormScores:
    """How well the true places are known, for joint and independent; leaves may lead with E."""

    nll: Array  # f32[2, T] nats per seen object: joint, independent; NaN before the first object
    squared_error: Array  # f32[2, T] square metres, mean over the seen objects
    num_seen: Array  # i32[T]


@dataclasses.dataclass(frozen=True, kw_only=True)
class FormComparison:
    """Independent minus joint over paired drives."""

    scores: FormScores
    """Leaves [E, …] as NumPy arrays."""
    nll_difference: float
    """Nats per object at the end of the drive, mean."""
    nll_ci: tuple[float, float]
    """95 %."""
    rmse: tuple[float, float]
    """Metres at the end: joint, independent."""


def drop_covariances(one: SemanticMap) -> SemanticMap:
    """Keep the marginals of robot and objects and forget how they hang together.

    Args:
        one: one particle.

    Returns:
        The same means and variances, Σ diagonal.
    """
    return replace(one, covariance=jnp.diag(jnp.diagonal(one.covariance)))


def log_places(one: SemanticMap, x: Array, y: Array, is_there: Array) -> Array:
    """Evaluate the Gaussian of the objects, the robot marginalised out, at true places.

    Args:
        one: one particle.
        x: f32[O] true places by slot, metres, map frame.
        y: f32[O].
        is_there: bool[O] slots that count.

    Returns:
        f32[], log-density.
    """
    num_objects = one.object_type.shape[0]
    both = is_there[:, None] & is_there[None, :]
    covariance = jnp.where(both, one.covariance[:-1, :-1], jnp.eye(num_objects))
    off_x = jnp.where(is_there, x - one.mean_x[:num_objects], 0.0)
    off_y = jnp.where(is_there, y - one.mean_y[:num_objects], 0.0)
    root = jnp.linalg.cholesky(covariance)
    off = jax.scipy.linalg.solve_triangular(root, jnp.stack([off_x, off_y], axis=1), lower=True)
    squared, log_determinant = jnp.sum(off * off), 2.0 * jnp.sum(jnp.log(jnp.diagonal(root)))
    return -0.5 * squared - log_determinant - jnp.sum(is_there) * math.log(2.0 * math.pi)


def _world(key: Array) -> Scenario:
    """Scatter objects of eight types about the circle."""
    distance_key, angle_key = jax.random.split(key)
    distance = RADIUS + jax.random.uniform(distance_key, (NUM_OBJECTS,), minval=-2.0, maxval=2.0)
    turn = jax.random.uniform(angle_key, (NUM_OBJECTS,), maxval=2.0 * jnp.pi)
    extent = RADIUS + 4.0
    return Scenario(
        object_type=jnp.arange(NUM_OBJECTS, dtype=jnp.int32),
        object_x=distance * jnp.cos(turn),
        object_y=distance * jnp.sin(turn),
        is_object=jnp.ones(NUM_OBJECTS, bool),
        goal=jnp.zeros(2),
        goal_index=jnp.int32(NONE),
        start=jnp.array([RADIUS, 0.0, 0.5 * math.pi], jnp.float32),
        area=jnp.array([-extent, extent, -extent, extent], jnp.float32),
        is_valid=jnp.asarray(True),
    )


def _command(step: Array) -> Action:
    """Ask for the next chord of the circle, as odometry has it: the robot does not steer."""
    length = 2.0 * math.pi * RADIUS * LAPS / STEPS
    turn = (step + 0.5) * length / RADIUS + 0.5 * math.pi
    chord = jnp.stack([jnp.cos(turn), jnp.sin(turn)]) * length
    one = jnp.float32(1.0)
    return Action(
        waypoint=chord,
        step=chord,
        is_stop=jnp.asarray(False),
        status=jnp.int32(Status.SEARCHING),
        speed=one,
        clearance=0.0 * one,
    )


def _update(
    one: SemanticMap, detections: association.Detections, draws: Array, sensor: SensorParams
) -> SemanticMap:
    """Condition a map on detections."""
    grounded = association.associate(one, detections, draws, sensor)
    return update.condition(one, grounded, sensor)


def _score(one: SemanticMap, scenario: Scenario) -> tuple[Array, Array, Array]:
    """Score one map: NLL per object, squared error, and how many objects it has."""
    is_there = one.is_observed
    slot = jnp.maximum(one.object_type, 0)  # types are the world's slots
    x, y = scenario.object_x[slot], scenario.object_y[slot]
    number = jnp.sum(is_there)
    size = jnp.maximum(number, 1)
    squared = (one.mean_x[:-1] - x) ** 2 + (one.mean_y[:-1] - y) ** 2
    error = jnp.sum(jnp.where(is_there, squared, 0.0)) / size
    nll = -log_places(one, x, y, is_there) / size
    return jnp.where(number > 0, nll, jnp.nan), error, number


def drive_joint(key: Array, sensor: SensorParams, odometry: MotionParams) -> FormScores:
    """Drive once and keep both maps.

    Args:
        key: random key of world and noise.
        sensor: the detector.
        odometry: its noise; the maps assume the same.

    Returns:
        Scores after every step.
    """
    world_key, drive_key = jax.random.split(key)
    scenario = _world(world_key)
    empty = particle.empty(NUM_OBJECTS, 1, scenario.start[0], scenario.start[1])

    def body(
        carry: tuple[WorldState, SemanticMap, SemanticMap], step: Array
    ) -> tuple[tuple[WorldState, SemanticMap, SemanticMap], tuple[Array, Array, Array]]:
        state, joint, independent = carry
        move_key, sense_key, draw_key = jax.random.split(jax.random.fold_in(drive_key, step), 3)
        command = _command(step)
        after = carry_out(move_key, state, command, odometry)
        way = jnp.hypot(command.step[0], command.step[1])
        observation = sense(sense_key, after, scenario, sensor)
        bearing = after.heading + observation.detection_bearing
        detections = association.Detections(
            object_type=observation.detection_type,
            offset_x=observation.detection_range * jnp.cos(bearing),
            offset_y=observation.detection_range * jnp.sin(bearing),
            log_new=jnp.full(observation.detection_type.shape, _LOG_NEW),
            is_detection=observation.is_detection,
        )
        draws = jax.random.uniform(draw_key, observation.detection_type.shape)
        variance = (odometry.odometry_noise * way) ** 2
        maps = [
            _update(motion.move(one, command.step[0], command.step[1], variance), detections,
                    draws, sensor)
            for one in (joint, independent)
        ]  # fmt: skip
        joint, independent = maps[0], drop_covariances(maps[1])
        first, second = _score(joint, scenario), _score(independent, scenario)
        nll, error = jnp.stack([first[0], second[0]]), jnp.stack([first[1], second[1]])
        return (after, joint, independent), (nll, error, first[2])

    carry = (simulator.reset(scenario), empty, empty)
    _, (nll, error, number) = jax.lax.scan(body, carry, jnp.arange(STEPS))
    return FormScores(nll=nll.T, squared_error=error.T, num_seen=number)


def compare_forms(
    *,
    episodes: int,
    seed: int,
    odometry_noise: float = 0.1,
    sensor: SensorParams | None = None,
) -> FormComparison:
    """Compare the joint with the independent form over the same drives.

    Args:
        episodes: E, drives.
        seed: root seed of worlds and noise.
        odometry_noise: standard deviation per axis as a share of the way.
        sensor: the detector; the default's range and noise if None.

    Returns:
        The comparison at the end of the drives, and the scores after every step.

    Raises:
        ValueError: fewer than two drives, or noise that is not positive.
    """
    if episodes < 2:
        raise ValueError(f"episodes is {episodes}, but an interval needs at least 2")
    if odometry_noise <= 0.0:
        raise ValueError(f"odometry_noise is {odometry_noise:g}, but must be positive")
    keys = jax.random.split(jax.random.key(seed), episodes)
    # One metre a step and a little: the chord must not be cut short.
    odometry = MotionParams(
        step_length=jnp.float32(2.0), odometry_noise=jnp.float32(odometry_noise)
    )
    run = jax.jit(jax.vmap(drive_joint, in_axes=(0, None, None)))
    scores = jax.tree.map(
        np.asarray, run(keys, default_sensor() if sensor is None else sensor, odometry)
    )
    last = np.asarray(scores.nll)[:, :, -1]
    difference = last[:, 1] - last[:, 0]
    half = _Z95 * float(difference.std(ddof=1)) / math.sqrt(episodes)
    mean = float(difference.mean())
    joint, independent = np.sqrt(np.asarray(scores.squared_error)[:, :, -1].mean(axis=0))
    return FormComparison(
        scores=scores,
        nll_difference=mean,
        nll_ci=(mean - half, mean + half),
        rmse=(float(joint), float(independent)),
    )
