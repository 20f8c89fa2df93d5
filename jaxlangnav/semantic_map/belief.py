"""The belief: weighted particles and the state that they share (section 3.2)."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.coverage import Coverage
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.unreferenced_objects import Bystanders
from jaxlangnav.terrain import SensorModel, Terrain
from jaxlangnav.terrain.view import rotate


@pytree
class ParticleBelief:
    """Weighted particles and shared state; the particle axis is last in every particle."""

    particles: SemanticMap  # leaves [..., P]
    log_weight: Array  # f32[P] normalised
    coverage: Coverage  # coverage map under the active sign of the heading bias
    alternate_miss: Array  # f32[G, G] … under the other sign; f32[0, 0]: with a compass
    bias_sign: Array  # f32[] active sign of the heading bias
    terrain: Terrain  # lines of sight and travel distances, as assumed by the robot
    sensor_model: SensorModel  # observation model of its detector
    bystanders: Bystanders  # objects of types that the task does not mention; B may be 0
    last_pose: Array  # f32[3] dead-reckoned pose at the last accepted observation
    reported_pose: Array  # f32[3] … at the last observation, accepted or not
    is_placed: Array  # bool[] the given area and start pose were valid
    num_types: Array  # i32[] number of object types that the detector distinguishes
    viewer: Array  # f32[3] x, y, heading when the last instruction was heard, map frame
    must_ground: Array  # bool[] an utterance came in that no particle has grounded yet
    log_evidence: Array  # f32[] log predictive probability of all detections and misses so far,
    # relative to a constant per detection; without the evidence of new groundings


def is_active(belief: ParticleBelief) -> Array:
    """Mark the particles with the active sign of the heading bias, bool[P]; all without a bias."""
    return belief.particles.drift[1] * belief.bias_sign >= 0.0


def mean_robot_pose(belief: ParticleBelief, is_selected: Array) -> tuple[Array, Array, Array]:
    """Compute the mean robot pose over some particles, bool[P]; undefined for none.

    f32[] each: x and y, metres, map frame, and error of the odometry's heading, radians.
    """
    weight = jnp.where(is_selected, jnp.exp(belief.log_weight), 0.0)
    weight, particles = weight / jnp.maximum(jnp.sum(weight), 1e-30), belief.particles
    values = particles.mean_x[-1], particles.mean_y[-1], particles.drift[0]
    x, y, drift = (jnp.sum(weight * v) for v in values)
    return x, y, drift


def robot_position(belief: ParticleBelief) -> tuple[Array, Array]:
    """Compute the mean position of the robot over the particles, f32[] x and y, metres.

    With a heading bias, over the particles with its active sign.
    """
    if belief.particles.drift.shape[0]:
        return mean_robot_pose(belief, is_active(belief))[:2]
    weight, particles = jnp.exp(belief.log_weight), belief.particles
    return jnp.sum(weight * particles.mean_x[-1]), jnp.sum(weight * particles.mean_y[-1])


def mean_drift(belief: ParticleBelief) -> Array | None:
    """Compute the mean error of the odometry's heading, f32[] radians; None: with a compass."""
    if belief.particles.drift.shape[0] == 0:
        return None
    return mean_robot_pose(belief, is_active(belief))[2]


def to_map_frame(belief: ParticleBelief, pose: Array) -> Array:
    """Transform a dead-reckoned pose f32[3] to the map frame: its offset from the last one."""
    drift = mean_drift(belief)
    drift = jnp.float32(0.0) if drift is None else drift
    offset = pose - belief.last_pose
    x, y = rotate(offset[0], offset[1], drift)
    robot_x, robot_y = robot_position(belief)
    return jnp.stack([robot_x + x, robot_y + y, pose[2] + drift])


def align_on_robot(belief: ParticleBelief) -> ParticleBelief:
    """Align the particles' maps by rigid transforms to a common robot pose.

    After drift, particles agree on positions relative to the robot only, which averages in the map
    frame would lose. With a compass the belief is unchanged.
    """
    drift, particles = mean_drift(belief), belief.particles
    if drift is None:
        return belief
    robot = robot_position(belief)
    origin = particles.mean_x[-1:], particles.mean_y[-1:]
    rotation = drift - particles.drift[:1]

    def transform(x: Array, y: Array) -> tuple[Array, Array]:
        x, y = rotate(x - origin[0], y - origin[1], rotation)
        return robot[0] + x, robot[1] + y

    mean_x, mean_y = transform(particles.mean_x, particles.mean_y)
    hypothesis_x, hypothesis_y = transform(particles.hypothesis_x, particles.hypothesis_y)
    drift = particles.drift.at[0].set(drift)
    particles = replace(particles, mean_x=mean_x, mean_y=mean_y, drift=drift)
    particles = replace(particles, hypothesis_x=hypothesis_x, hypothesis_y=hypothesis_y)
    return replace(belief, particles=particles)
