"""Additions to the paper's filter step, before the motion and after the update (section 3.2; ours).

Existence and counts are factors of eq. 7b and 8 (``association``, ``counts``).
"""

import jax.numpy as jnp

from jaxlangnav.messages import Fault
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief, is_active, mean_drift, robot_position
from jaxlangnav.semantic_map.gating import GatedStep
from jaxlangnav.semantic_map.motion import correct_heading
from jaxlangnav.semantic_map.unreferenced_objects import add_bystanders, exchange, split_by_type


def reset_weights(belief: ParticleBelief, gated: GatedStep) -> tuple[ParticleBelief, GatedStep]:
    """Reset weights to uniform where all are zero or one is not finite, and flag the fault."""
    log_weight = belief.log_weight
    is_valid = jnp.all(log_weight < jnp.inf) & jnp.any(log_weight > -jnp.inf)
    log_weight = jnp.where(is_valid, log_weight, -jnp.log(float(log_weight.shape[0])))
    fault = gated.fault | jnp.where(is_valid, 0, int(Fault.WEIGHTS))
    return replace(belief, log_weight=log_weight), gated._replace(fault=fault)


def split_objects(belief: ParticleBelief, gated: GatedStep) -> tuple[ParticleBelief, GatedStep]:
    """Split unreferenced objects (bystanders) from the particles' own, in map and detections."""
    listed, types, log_weight = belief.bystanders, gated.mentioned, belief.log_weight
    if types is None or listed.x.shape[0] == 0 or not belief.sensor_model.is_located:
        return belief, gated
    particles, listed = exchange(belief.particles, listed, types, log_weight, belief.must_ground)
    observation, others = split_by_type(gated.observation, types)
    belief = replace(belief, particles=particles, bystanders=listed)
    return belief, gated._replace(observation=observation, others=others)


def add_unreferenced(belief: ParticleBelief, gated: GatedStep) -> tuple[ParticleBelief, GatedStep]:
    """Add the detected unreferenced objects to their list; count those that do not fit."""
    if gated.others is None:
        return belief, gated
    weight, particles = jnp.exp(belief.log_weight), belief.particles
    mean, variance = robot_position(belief), particles.covariance[-1, -1]
    if mean_drift(belief) is not None:
        weight = jnp.where(is_active(belief), weight, 0.0)
        weight = weight / jnp.maximum(jnp.sum(weight), 1e-30)
        squared = (particles.mean_x[-1] - mean[0]) ** 2 + (particles.mean_y[-1] - mean[1]) ** 2
        variance = variance + 0.5 * squared
    robot = *mean, jnp.sum(weight * variance)
    corrected = correct_heading(belief, gated.others)
    updated, num_dropped = add_bystanders(belief.bystanders, corrected, robot)
    return replace(belief, bystanders=updated), gated._replace(num_dropped=num_dropped)
