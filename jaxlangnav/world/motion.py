"""Simulated motion and odometry (the odometry stream u of eq. 1 and 6).

A ``Body`` carries out the step that is asked for as well as it can. Where it truly ends differs
from its odometry by Gaussian noise in proportion to the way. A compass gives the heading, so that
is known.
"""

from typing import Protocol

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import Action, MotionParams
from jaxlangnav.pytree import pytree
from jaxlangnav.world.state import WorldState


class Body(Protocol):
    """How a pose changes with a command, and what odometry says of it: a record (``@pytree``).

    A body never goes further in a cycle than ``step_length`` times the action's speed: the belief
    takes what goes further for a jump.
    """

    def move(
        self, key: Array, state: WorldState, action: Action, motion: MotionParams
    ) -> WorldState:
        """Carry out one decision cycle's step; see ``motion.move`` for the holonomic one."""
        ...


@pytree
class Holonomic:
    """Goes anywhere from where it stands, and looks where it goes."""

    def move(
        self, key: Array, state: WorldState, action: Action, motion: MotionParams
    ) -> WorldState:
        """Carry out one decision cycle's step, see ``move``."""
        return move(key, state, action, motion)


HOLONOMIC = Holonomic()


def move(key: Array, state: WorldState, action: Action, motion: MotionParams) -> WorldState:
    """Carry out one decision cycle's step.

        x' = x + u + N(0, (ε |u|)²) per axis,   odometry' = odometry + u

    Limits: ε = 0 keeps odometry and truth together; a stop or a zero step changes nothing. A
    robot goes no further in a cycle than ``step_length`` times the action's speed.

    Args:
        key: random key.
        state: the robot.
        action: ``step`` f32[2] metres, map axes; ``is_stop`` keeps the robot where it is.
        motion: step length and odometry noise; traced.

    Returns:
        The robot after the step, heading along it.
    """
    step = jnp.where(action.is_stop, jnp.zeros_like(action.step), action.step)
    asked = jnp.hypot(step[0], step[1])
    limit = motion.step_length * action.speed
    is_long = asked > limit
    step = jnp.where(is_long, step * (limit / jnp.where(is_long, asked, 1.0)), step)
    way = jnp.minimum(asked, limit)
    is_moving = way > 0.0
    displacement = step + motion.odometry_noise * way * jax.random.normal(key, (2,))
    heading = jnp.where(is_moving, jnp.arctan2(step[1], step[0]), state.heading)
    return WorldState(
        position=state.position + displacement,
        heading=heading,
        odometry=jnp.stack([state.odometry[0] + step[0], state.odometry[1] + step[1], heading]),
        distance=state.distance + jnp.hypot(displacement[0], displacement[1]),
    )
