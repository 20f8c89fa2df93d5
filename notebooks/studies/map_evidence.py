"""How probable what was seen is by the map alone, as a differentiable function of the sensor.

    log p(z) = Σ_t log p(z_t | z_<t) + D log p_d − K α (1 − u)

with D detections, K types of object and u the share of the area unexplored; the words' part is
``episode_evidence``. The filter runs without words. It is differentiated forwards, with common
random numbers; which detection is which object, and the resampling, are discrete draws that are
held (with well-separated objects nothing depends on them).
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE, Observation, Readings, SensorParams
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapParams


def log_map(
    key: Array,
    belief: ParticleBelief,
    observations: Observation,
    *,
    params: MapParams,
    sensor: SensorParams,
    num_types: int,
) -> Array:
    """Compute log p(z): how probable detections and absences are, by the map alone.

    Differentiable forwards (``jax.jvp``, ``jax.jacfwd``) in sensor and odometry.

    Args:
        key: random key; the same for values that are compared.
        belief: before the first observation.
        observations: leaves [T, …]; their sensor is not read.
        params: of the map.
        sensor: the specification that is held against the observations.
        num_types: K, types of object that may be in the area.

    Returns:
        f32[], nats; a density in the detections' places.
    """
    silent = _no_words(belief)

    def body(carry: ParticleBelief, step: tuple[Array, Observation]) -> tuple[ParticleBelief, None]:
        step_key, observation = step
        observation = replace(observation, sensor=sensor)
        return semantic_filter.step(step_key, carry, silent, observation, params=params)[0], None

    keys = jax.random.split(key, observations.pose.shape[0])
    after, _ = jax.lax.scan(body, belief, (keys, observations))
    hits = jnp.sum(observations.is_detection).astype(jnp.float32)
    seen = 1.0 - jnp.mean(jnp.exp(after.coverage.log_miss))
    log_hits = hits * jnp.log(jnp.minimum(sensor.detection_probability, 0.999))
    return (
        after.log_evidence
        - belief.log_evidence
        + log_hits
        - num_types * params.concentration * seen
    )


def _no_words(belief: ParticleBelief) -> Readings:
    """Build readings that mention nothing, for a belief's capacity."""
    mentions = belief.particles.referent.shape[0]
    none = jnp.full((1, 1), NONE, jnp.int32)
    return Readings(
        mention_type=jnp.full((1, mentions), NONE, jnp.int32),
        figure=none,
        relation=none,
        landmark=none,
        rank=jnp.zeros((1, 1), jnp.int32),
        log_probability=jnp.zeros(1, jnp.float32),
    )
