"""What a constraint forbids, and what it costs to come near it (section 3.4; ours).

A metre of way within the ``BERTH`` B of things k, forbidden with probability p_k, costs as many
metres more as it is deep in it:

    c Σ_k p_k max(0, 1 − d_k / B)²

``detours`` finds the cheapest ways; stops of tours are put outside (``keep_out``). Before what is
forbidden has been seen, steps are as short as it takes to see it in time (``safe_share``).
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

CLOSE = 2.0
"""Metres around an object that a constraint forbids."""
BERTH = CLOSE + 0.25
"""The same, and what its place may be out by."""
MOST_FORBIDDEN = 6
"""Forbidden objects that count, the nearest ones."""
NUM_TURNS = 12
"""Corners at which an object is gone round: their polygon just touches the berth."""
RADIUS = float(BERTH / np.cos(np.pi / NUM_TURNS))
"""Metres from an object to these corners."""
_LEAST = 0.05  # probability from which on an object counts as forbidden
_SHARES = np.array([1.0, 0.5, 0.25], np.float32)  # of a step


@pytree
class Forbidden:
    """What is to be kept away from; K = MOST_FORBIDDEN."""

    x: Array  # f32[K] metres, map frame
    y: Array  # f32[K]
    price: Array  # f32[K] c p, what a metre of way costs right beside it; 0 where there is none


def forbidden_objects(
    belief: ParticleBelief, constraint: Array, robot_x: Array, robot_y: Array, cost: Array
) -> Forbidden:
    """Find the observed objects that are forbidden; hypotheses are not.

    They are the nearest ones, where the particles that forbid them have them; ``constraint`` is
    f32[R, N + 1, P], the probability that a region of a slot is forbidden, and ``cost`` c.
    """
    particles = belief.particles
    num_objects = particles.object_type.shape[0]
    weight = jnp.max(constraint, axis=0)[:num_objects] * jnp.exp(belief.log_weight)[None, :]
    share = jnp.sum(weight, axis=1)  # [O]
    x, y = (
        jnp.sum(mean[:num_objects] * weight, axis=1) / jnp.maximum(share, 1e-9)
        for mean in (particles.mean_x, particles.mean_y)
    )
    share = jnp.where(share >= _LEAST, share, 0.0)
    squared = jnp.where(share > 0.0, (x - robot_x) ** 2 + (y - robot_y) ** 2, jnp.inf)
    spare = (0, max(MOST_FORBIDDEN - num_objects, 0))
    squared = jnp.pad(squared, spare, constant_values=jnp.inf)
    nearest = jax.lax.top_k(-squared, MOST_FORBIDDEN)[1]
    x, y, price = (jnp.pad(leaf, spare)[nearest] for leaf in (x, y, cost * share))
    return Forbidden(x=x, y=y, price=price)


def price_along(from_x: Array, from_y: Array, to_x: Array, to_y: Array, things: Forbidden) -> Array:
    """Integrate along straight ways what it costs to come near forbidden things.

        c Σ_k p_k ∫ max(0, 1 − d_k(s) / B)² ds

    f32[...] metres; the places, metres, map frame, broadcast to one shape. Limits: 0 outside all
    berths; 2 c p B / 3 from side to side through the midst of one.
    """
    span_x, span_y = to_x - from_x, to_y - from_y
    length = jnp.sqrt(span_x * span_x + span_y * span_y + 1e-12)
    unit_x, unit_y = span_x / length, span_y / length
    total = jnp.zeros_like(length)
    for x, y, price in zip(things.x, things.y, things.price, strict=True):
        offset_x, offset_y = x - from_x, y - from_y
        foot = offset_x * unit_x + offset_y * unit_y
        aside = offset_x * unit_y - offset_y * unit_x
        half = jnp.sqrt(jnp.maximum(BERTH**2 - aside * aside, 0.0))
        ends = (jnp.clip(end, -half, half) for end in (-foot, length - foot))
        before, until = (_antiderivative(end, aside) for end in ends)
        total = total + price * (until - before)
    return total


def _antiderivative(along: Array, aside: Array) -> Array:
    """Evaluate ∫ (1 − d / B)² ds of d² = s² + a², metres; s from the foot of the perpendicular."""
    least = jnp.maximum(jnp.abs(aside), 1e-4)
    distance = jnp.sqrt(along * along + least * least)
    of_distance = 0.5 * (along * distance + least * least * jnp.arcsinh(along / least))
    of_square = along**3 / 3.0 + least * least * along
    return along - 2.0 / BERTH * of_distance + of_square / BERTH**2


def price_of_stop(x: Array, y: Array, things: Forbidden) -> Array:
    """Compute what it costs to go into the berths as far as places f32[...], and out again.

    Limits: 0 outside all berths; as much as a way through at a thing itself.
    """
    total = jnp.zeros_like(x)
    for at_x, at_y, price in zip(things.x, things.y, things.price, strict=True):
        away = jnp.sqrt((x - at_x) ** 2 + (y - at_y) ** 2 + 1e-12)
        total = total + price * 2.0 * BERTH / 3.0 * jnp.maximum(1.0 - away / BERTH, 0.0) ** 3
    return total


def keep_out(
    x: Array, y: Array, things: Forbidden, range_max: Array, area: Array
) -> tuple[Array, Array]:
    """Move places out of the berths, where one sees the thing from outside.

    Limits: places outside stay, as all do where nothing is forbidden; out of the area f32[4]
    nothing is moved, but to the other side of the thing.
    """
    for at_x, at_y, price in zip(things.x, things.y, things.price, strict=True):
        off_x, off_y = x - at_x, y - at_y
        away = jnp.sqrt(off_x * off_x + off_y * off_y + 1e-12)
        is_inside = (away < BERTH) & (price > 0.0) & (range_max > RADIUS)
        out_x, out_y = RADIUS * off_x / away, RADIUS * off_y / away
        is_in = (at_x + out_x >= area[0]) & (at_x + out_x <= area[1])
        is_in &= (at_y + out_y >= area[2]) & (at_y + out_y <= area[3])
        side = jnp.where(is_in, 1.0, -1.0)
        x = jnp.where(is_inside, at_x + side * out_x, x)
        y = jnp.where(is_inside, at_y + side * out_y, y)
    return jnp.clip(x, area[0], area[1]), jnp.clip(y, area[2], area[3])


def safe_share(
    belief: ParticleBelief,
    constraint: Array,
    robot: tuple[Array, Array],
    step: Array,
    sensor: SensorParams,
    risk: Array,
) -> Array:
    """Choose the share of a step that leaves time to see what is forbidden, f32[].

    It is the longest of ``_SHARES`` that brings the robot within ``CLOSE`` of something forbidden
    which one more look would have shown with a probability of at most ``risk``, else the shortest.
    Where such a thing may stand the coverage tells: with probability s m(c) / Σ m in cell c, with s
    the share of maps in which it is forbidden and not yet seen, and m what all looks have missed.

    Limits: 1 where all that is forbidden has been seen; nothing is computed then.

    Args:
        belief: after the present look.
        constraint: f32[R, N + 1, P], as for ``forbidden_objects``.
        robot: f32[] x and y, believed position, metres, map frame.
        step: f32[2], metres; the robot looks where it goes.
        sensor: range, opening angle, probability of detection.
        risk: f32[].
    """
    particles, (robot_x, robot_y) = belief.particles, robot
    first = particles.object_type.shape[0]
    hidden = jnp.where(particles.is_hypothesised, jnp.max(constraint, axis=0)[first:-1], 0.0)
    hidden = jnp.sum(jnp.max(hidden, axis=0) * jnp.exp(belief.log_weight))
    eye = Eye(*robot, sensor.range_max, jnp.arctan2(step[1], step[0]), sensor.field_of_view)

    def shown(share: Array, log_miss: Array, x: Array, y: Array) -> Array:
        """Compute what one more look would show of what is close then and not now, f32[]."""
        x, y, miss = x[None], y[:, None], jnp.exp(log_miss)
        close = jnp.hypot(x - robot_x - share * step[0], y - robot_y - share * step[1])
        is_close = (close < CLOSE) & (close < jnp.hypot(x - robot_x, y - robot_y))
        seen = jnp.where(is_close & belief.terrain.view.sees(eye, x, y), miss, 0.0)
        return hidden * sensor.detection_probability * jnp.sum(seen) / jnp.sum(miss)

    each, shares = jax.vmap(shown, in_axes=(0, None, None, None)), jnp.asarray(_SHARES)
    given = shares, belief.coverage.log_miss, *cell_centres(belief.coverage)
    is_safe = skip_unless_any(hidden > _LEAST, lambda records: each(*records), given) <= risk
    return jnp.max(jnp.where(is_safe, _SHARES, _SHARES[-1]))
