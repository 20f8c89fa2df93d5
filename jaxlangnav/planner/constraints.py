"""Soft keep-out zones around forbidden objects, and their path cost (section 3.4; ours).

A metre of path within the radius B (``ZONE_RADIUS``) of objects k, forbidden with probability p_k,
has the additional cost, in metres,

    c Σ_k p_k max(0, 1 − d_k / B)²

``detours`` finds the cheapest paths; stops of tours are moved outside (``keep_out``). Before a
forbidden object has been observed, steps are short enough to see it in time (``safe_fraction``).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.numerics.batching import skip_unless_any
from jaxlangnav.pytree import pytree
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.coverage import cell_centres
from jaxlangnav.terrain import Eye
from jaxlangnav.terrain.view import Position

KEEP_AWAY = 2.0
"""Metres to keep from a forbidden object."""
ZONE_RADIUS = KEEP_AWAY + 0.25
"""The same plus a margin for the error of the object's position: B."""
MAX_ZONES = 6
"""Maximum number of forbidden objects that are considered, the nearest ones."""
NUM_CORNERS = 12
"""Corners of the polygon around an object, which circumscribes its keep-out zone."""
CORNER_RADIUS = float(ZONE_RADIUS / np.cos(np.pi / NUM_CORNERS))
"""Metres from an object to these corners."""
_MIN_PROB = 0.05  # probability above which an object counts as forbidden
_FRACTIONS = np.array([1.0, 0.5, 0.25], np.float32)  # of a step


@pytree
class Zones:
    """Keep-out zones; K = MAX_ZONES."""

    x: Array  # f32[K] metres, map frame
    y: Array  # f32[K]
    cost: Array  # f32[K] c p, cost of a metre of path at the object; 0 in empty entries


def keep_out_zones(
    belief: ParticleBelief, forbidden: Array, robot_x: Array, robot_y: Array, cost: Array
) -> Zones:
    """Build the keep-out zones of the nearest observed forbidden objects; hypotheses are ignored.

    Positions are means over the particles that forbid them; ``forbidden`` is f32[R, N + 1, P],
    the probability that a region of a slot is forbidden, and ``cost`` c.
    """
    particles = belief.particles
    num_objects = particles.object_type.shape[0]
    weight = jnp.max(forbidden, axis=0)[:num_objects] * jnp.exp(belief.log_weight)[None, :]
    prob = jnp.sum(weight, axis=1)  # [O]
    x, y = (
        jnp.sum(mean[:num_objects] * weight, axis=1) / jnp.maximum(prob, 1e-9)
        for mean in (particles.mean_x, particles.mean_y)
    )
    prob = jnp.where(prob >= _MIN_PROB, prob, 0.0)
    squared = jnp.where(prob > 0.0, (x - robot_x) ** 2 + (y - robot_y) ** 2, jnp.inf)
    padding = (0, max(MAX_ZONES - num_objects, 0))
    squared = jnp.pad(squared, padding, constant_values=jnp.inf)
    nearest = jax.lax.top_k(-squared, MAX_ZONES)[1]
    x, y, zone_cost = (jnp.pad(leaf, padding)[nearest] for leaf in (x, y, cost * prob))
    return Zones(x=x, y=y, cost=zone_cost)


def cost_along(from_x: Array, from_y: Array, to_x: Array, to_y: Array, zones: Zones) -> Array:
    """Integrate the keep-out cost along straight segments.

        c Σ_k p_k ∫ max(0, 1 − d_k(s) / B)² ds

    f32[...] metres; the positions, metres, map frame, broadcast to one shape. Limits: 0 outside
    all zones; 2 c p B / 3 across the diameter of one.
    """
    segment_x, segment_y = to_x - from_x, to_y - from_y
    length = jnp.sqrt(segment_x * segment_x + segment_y * segment_y + 1e-12)
    unit_x, unit_y = segment_x / length, segment_y / length
    total = jnp.zeros_like(length)
    for x, y, cost in zip(zones.x, zones.y, zones.cost, strict=True):
        offset_x, offset_y = x - from_x, y - from_y
        foot = offset_x * unit_x + offset_y * unit_y
        lateral = offset_x * unit_y - offset_y * unit_x
        half = jnp.sqrt(jnp.maximum(ZONE_RADIUS**2 - lateral * lateral, 0.0))
        ends = (jnp.clip(end, -half, half) for end in (-foot, length - foot))
        start_value, end_value = (_antiderivative(end, lateral) for end in ends)
        total = total + cost * (end_value - start_value)
    return total


def _antiderivative(along: Array, lateral: Array) -> Array:
    """Evaluate ∫ (1 − d / B)² ds of d² = s² + a², metres; s from the foot of the perpendicular."""
    offset = jnp.maximum(jnp.abs(lateral), 1e-4)
    distance = jnp.sqrt(along * along + offset * offset)
    distance_term = 0.5 * (along * distance + offset * offset * jnp.arcsinh(along / offset))
    square_term = along**3 / 3.0 + offset * offset * along
    return along - 2.0 / ZONE_RADIUS * distance_term + square_term / ZONE_RADIUS**2


def cost_at(x: Array, y: Array, zones: Zones) -> Array:
    """Compute the cost of entering the zones up to positions f32[...], and of leaving again.

    Limits: 0 outside all zones; at the object itself, the cost of the whole diameter.
    """
    total = jnp.zeros_like(x)
    for at_x, at_y, cost in zip(zones.x, zones.y, zones.cost, strict=True):
        away = jnp.sqrt((x - at_x) ** 2 + (y - at_y) ** 2 + 1e-12) / ZONE_RADIUS
        total = total + cost * 2.0 * ZONE_RADIUS / 3.0 * jnp.maximum(1.0 - away, 0.0) ** 3
    return total


def keep_out(x: Array, y: Array, zones: Zones, range_max: Array, area: Array) -> Position:
    """Move positions out of the keep-out zones, if the object can be seen from outside.

    Limits: positions outside stay, as all do without forbidden objects; a position that would
    leave the area f32[4] is moved to the other side of the object.
    """
    for at_x, at_y, cost in zip(zones.x, zones.y, zones.cost, strict=True):
        offset_x, offset_y = x - at_x, y - at_y
        distance = jnp.sqrt(offset_x * offset_x + offset_y * offset_y + 1e-12)
        is_inside = (distance < ZONE_RADIUS) & (cost > 0.0) & (range_max > CORNER_RADIUS)
        out_x, out_y = CORNER_RADIUS * offset_x / distance, CORNER_RADIUS * offset_y / distance
        is_in_area = (at_x + out_x >= area[0]) & (at_x + out_x <= area[1])
        is_in_area &= (at_y + out_y >= area[2]) & (at_y + out_y <= area[3])
        side = jnp.where(is_in_area, 1.0, -1.0)
        x = jnp.where(is_inside, at_x + side * out_x, x)
        y = jnp.where(is_inside, at_y + side * out_y, y)
    return jnp.clip(x, area[0], area[1]), jnp.clip(y, area[2], area[3])


def safe_fraction(
    belief: ParticleBelief,
    forbidden: Array,
    robot: Position,
    step: Array,
    sensor: SensorParams,
    risk: Array,
) -> Array:
    """Choose the fraction of a step that is safe with respect to unseen forbidden objects, f32[].

    It is the largest of ``_FRACTIONS`` that brings the robot within ``KEEP_AWAY`` of a forbidden
    object that one more observation would have revealed with probability at most ``risk``, else the
    smallest. Such an object is in cell c with probability s m(c) / Σ m, with s the probability of
    maps in which it is forbidden and unseen, and m the miss probability of the coverage map.

    Limits: 1 if all forbidden objects have been observed; nothing is computed then.

    Args:
        belief: after the current observation.
        forbidden: f32[R, N + 1, P], as for ``keep_out_zones``.
        robot: f32[] x and y, believed position, metres, map frame.
        step: f32[2], metres; the robot faces its direction of motion.
        sensor: range, opening angle, probability of detection.
        risk: f32[].
    """
    particles, (robot_x, robot_y) = belief.particles, robot
    first, prob = particles.object_type.shape[0], jnp.max(forbidden, axis=0)
    p_unseen = jnp.where(particles.is_hypothesised, prob[first:-1], 0.0)
    p_unseen = jnp.sum(jnp.max(p_unseen, axis=0) * jnp.exp(belief.log_weight))
    eye = Eye(*robot, sensor.range_max, jnp.arctan2(step[1], step[0]), sensor.field_of_view)

    def exposed(fraction: Array, log_miss: Array, x: Array, y: Array) -> Array:
        """Compute the probability that one more observation reveals a newly close object, f32[]."""
        x, y, miss = x[None], y[:, None], jnp.exp(log_miss)
        away = jnp.hypot(x - robot_x - fraction * step[0], y - robot_y - fraction * step[1])
        is_close = (away < KEEP_AWAY) & (away < jnp.hypot(x - robot_x, y - robot_y))
        visible = jnp.where(is_close & belief.terrain.view.sees(eye, x, y), miss, 0.0)
        return p_unseen * sensor.detection_probability * jnp.sum(visible) / jnp.sum(miss)

    risks, fractions = jax.vmap(exposed, in_axes=(0, None, None, None)), jnp.asarray(_FRACTIONS)
    args = fractions, belief.coverage.log_miss, *cell_centres(belief.coverage)
    none = jnp.zeros_like(fractions)
    exposure = skip_unless_any(p_unseen > _MIN_PROB, lambda args: risks(*args), args, none)
    return jnp.max(jnp.where(exposure <= risk, _FRACTIONS, _FRACTIONS[-1]))
