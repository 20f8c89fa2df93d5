"""What the filter's step is given beyond the paper: components of the model (section 3.2; ours).

A component changes belief and look before the particles move (``admit``), after they have been
updated (``keep``), and after they have been resampled (``settle``). Without any the step is the
paper's. Existence and counts are factors of eq. 7b and 8 (``association``, ``counts``).
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp

from jaxlangnav.messages import Fault
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief, is_led, mean_drift, robot_position
from jaxlangnav.semantic_map.gating import Look, gate
from jaxlangnav.semantic_map.heading_bias import switch_bias_hypothesis
from jaxlangnav.semantic_map.motion import with_drift
from jaxlangnav.semantic_map.unreferenced_objects import part, promote, remember_bystanders

Change = Callable[[ParticleBelief, Look], tuple[ParticleBelief, Look]]


class Component(NamedTuple):
    """One addition to the paper's filter: what it does to a step; nothing where it is silent."""

    admit: Change = lambda belief, look: (belief, look)
    keep: Change = lambda belief, look: (belief, look)
    settle: Callable[[ParticleBelief], ParticleBelief] = lambda belief: belief


def _revive(belief: ParticleBelief, look: Look) -> tuple[ParticleBelief, Look]:
    """Make weights that are none equal, and say so."""
    log_weight = belief.log_weight
    is_alive = jnp.all(log_weight < jnp.inf) & jnp.any(log_weight > -jnp.inf)
    log_weight = jnp.where(is_alive, log_weight, -jnp.log(float(log_weight.shape[0])))
    fault = look.fault | jnp.where(is_alive, 0, int(Fault.WEIGHTS))
    return replace(belief, log_weight=log_weight), look._replace(fault=fault)


def _part(belief: ParticleBelief, look: Look) -> tuple[ParticleBelief, Look]:
    """Part what the particles hold from bystanders, in the map and in what is seen now."""
    known, spoken = belief.bystanders, look.spoken
    if spoken is None or known.x.shape[0] == 0 or not belief.sensor_model.is_located:
        return belief, look
    held = promote(belief.particles, known, spoken, belief.log_weight, belief.must_ground)
    ours, others = part(look.observation, spoken)
    belief = replace(belief, particles=held[0], bystanders=held[1])
    return belief, look._replace(observation=ours, others=others)


def _remember(belief: ParticleBelief, look: Look) -> tuple[ParticleBelief, Look]:
    """Remember bystanders that are seen, and count those that found no room."""
    if look.others is None:
        return belief, look
    weight, particles = jnp.exp(belief.log_weight), belief.particles
    here, spread = robot_position(belief), particles.covariance[-1, -1]
    if mean_drift(belief) is not None:
        weight = jnp.where(is_led(belief), weight, 0.0)
        weight = weight / jnp.maximum(jnp.sum(weight), 1e-30)
        apart = (particles.mean_x[-1] - here[0]) ** 2 + (particles.mean_y[-1] - here[1]) ** 2
        spread = spread + 0.5 * apart
    robot = *here, jnp.sum(weight * spread)
    seen = with_drift(belief, look.others)
    known, num_lost = remember_bystanders(belief.bystanders, seen, robot)
    return replace(belief, bystanders=known), look._replace(num_lost=num_lost)


COMPONENTS = (
    Component(admit=gate),
    Component(admit=_revive),
    Component(admit=_part, keep=_remember),
    Component(settle=switch_bias_hypothesis),
)
"""Gating, weights that died, unreferenced objects, and the sign of a steady heading bias."""
