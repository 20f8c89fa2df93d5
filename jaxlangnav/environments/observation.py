"""What an agent is given: its command and what the robot senses, as one vector (section 4.2)."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.experiments.sentences import SENTENCES
from jaxlangnav.messages import Observation
from jaxlangnav.world.sensor import NUM_DETECTIONS
from jaxlangnav.world.state import CONE, HYDRANT

BOUND = 100.0
"""Entries of an observation are clipped to plus and minus this."""
OBSERVATION_SIZE = 12 + 5 * NUM_DETECTIONS


def to_vector(seen: Observation, *, area: Array, relation: Array) -> Array:
    """Lay out what the agent is given.

    Args:
        seen: what the robot senses.
        area: f32[4], edges of the operating area, which are known to all; metres.
        relation: i32[], index of the command.

    Returns:
        f32[52]: x, y, cosine and sine of the heading (odometry); the area's edges (4); the sensing
        range; one-hot of the command (3); and for each of eight detections, nearest first,
        whether there is one, metres ahead, metres to the left, is hydrant, is cone.
    """
    x, y, heading = seen.pose[0], seen.pose[1], seen.pose[2]
    told = (jnp.arange(len(SENTENCES)) == relation).astype(jnp.float32)
    is_there = seen.is_detection.astype(jnp.float32)
    detections = jnp.stack(
        [
            is_there,
            is_there * seen.detection_range * jnp.cos(seen.detection_bearing),
            is_there * seen.detection_range * jnp.sin(seen.detection_bearing),
            (seen.detection_type == HYDRANT).astype(jnp.float32),
            (seen.detection_type == CONE).astype(jnp.float32),
        ],
        axis=1,
    )
    own = jnp.stack([x, y, jnp.cos(heading), jnp.sin(heading)])
    parts = [own, area, seen.sensor.range_max[None], told, detections.reshape(-1)]
    return jnp.clip(jnp.concatenate(parts), -BOUND, BOUND)
