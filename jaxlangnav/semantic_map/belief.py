"""What the robot believes: weighted particles and what they share (section 3.2)."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.coverage import Coverage
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.unreferenced_objects import Bystanders
from jaxlangnav.terrain import SensorModel, Terrain
from jaxlangnav.terrain.view import rotated


@pytree
class ParticleBelief:
    """Weighted particles and what they share; the particle axis is last in every particle."""

    particles: SemanticMap  # leaves [..., P]
    log_weight: Array  # f32[P] normalised
    coverage: Coverage  # where the robot has looked, by the drift that it goes by
    alternate_miss: Array  # f32[G, G] … by a steady drift of the other sign; f32[0, 0]: a compass
    bias_sign: Array  # f32[] sign of the steady drift that the robot goes by
    terrain: Terrain  # how far one sees and walks there, as the robot takes it to be
    sensor_model: SensorModel  # how its detector reports
    bystanders: Bystanders  # things of types that the task does not speak of; B may be 0
    last_pose: Array  # f32[3] dead-reckoned pose at the last observation that was believed
    reported_pose: Array  # f32[3] … that was reported, believed or not
    is_placed: Array  # bool[] area and start pose are as they were given, and can be
    num_types: Array  # i32[] object types that a detection may name
    viewer: Array  # f32[3] x, y, heading when the last instruction was heard, map frame
    must_ground: Array  # bool[] words have come in that no particle has grounded yet
    log_evidence: Array  # f32[] log predictive probability of all detections and absences so
    # far, relative to a constant per detection; what new groundings of the words add is left out


def is_active(belief: ParticleBelief) -> Array:
    """Tell which particles drift as the robot goes by, bool[P]: all where nothing is steady."""
    return belief.particles.drift[1] * belief.bias_sign >= 0.0


def mean_robot_pose(belief: ParticleBelief, is_chosen: Array) -> tuple[Array, Array, Array]:
    """Compute where some particles, bool[P], have the robot on average; meaningless of none.

    f32[] each: x and y, metres, map frame, and radians that the true heading exceeds odometry's by.
    """
    weight = jnp.where(is_chosen, jnp.exp(belief.log_weight), 0.0)
    weight, held = weight / jnp.maximum(jnp.sum(weight), 1e-30), belief.particles
    places = held.mean_x[-1], held.mean_y[-1], held.drift[0]
    x, y, drift = (jnp.sum(weight * one) for one in places)
    return x, y, drift


def robot_position(belief: ParticleBelief) -> tuple[Array, Array]:
    """Compute the mean position of the robot over the particles, f32[] x and y, metres.

    Of particles of either steady drift, over those of the one that the robot goes by.
    """
    if belief.particles.drift.shape[0]:
        return mean_robot_pose(belief, is_active(belief))[:2]
    weight, particles = jnp.exp(belief.log_weight), belief.particles
    robot = particles.object_type.shape[0]
    return jnp.sum(weight * particles.mean_x[robot]), jnp.sum(weight * particles.mean_y[robot])


def mean_drift(belief: ParticleBelief) -> Array | None:
    """Compute by how much the true heading exceeds odometry's, f32[] radians; None: a compass."""
    if belief.particles.drift.shape[0] == 0:
        return None
    return mean_robot_pose(belief, is_active(belief))[2]


def to_map_frame(belief: ParticleBelief, pose: Array) -> Array:
    """Take a dead-reckoned pose f32[3] to the map frame; as it was where a compass guides."""
    drift = mean_drift(belief)
    if drift is None:
        return pose
    offset = pose - belief.last_pose
    x, y = rotated(offset[0], offset[1], drift)
    robot_x, robot_y = robot_position(belief)
    return jnp.stack([robot_x + x, robot_y + y, pose[2] + drift])


def align_on_robot(belief: ParticleBelief) -> ParticleBelief:
    """Move and turn the particles' maps so that the robot has one pose in all of them.

    Drifted apart, what they agree on, which is where things are from the robot, is in none of
    their averages. With a compass the belief stays as it was.
    """
    drift, particles = mean_drift(belief), belief.particles
    if drift is None:
        return belief
    here = robot_position(belief)
    origin = particles.mean_x[-1:], particles.mean_y[-1:]
    turn = drift - particles.drift[:1]

    def moved(x: Array, y: Array) -> tuple[Array, Array]:
        x, y = rotated(x - origin[0], y - origin[1], turn)
        return here[0] + x, here[1] + y

    mean_x, mean_y = moved(particles.mean_x, particles.mean_y)
    hypothesis_x, hypothesis_y = moved(particles.hypothesis_x, particles.hypothesis_y)
    drift = particles.drift.at[0].set(drift)
    particles = replace(particles, mean_x=mean_x, mean_y=mean_y, drift=drift)
    particles = replace(particles, hypothesis_x=hypothesis_x, hypothesis_y=hypothesis_y)
    return replace(belief, particles=particles)
