"""Simulated motion and odometry (the odometry stream u of eq. 1 and 6).

A ``Body`` executes the commanded step as far as its kinematics allow. Its true displacement differs
from odometry by Gaussian noise proportional to the distance. A compass gives the heading unless
``MotionParams`` has drift: then odometry integrates its own heading.
"""

from typing import Protocol

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import Action, MotionParams, Status
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.terrain import Terrain
from jaxlangnav.terrain.view import Segment, rotate, wrapped
from jaxlangnav.world.state import WorldState


def move_or_stop(waypoint: Array, step: Array, is_stop: Array) -> Action:
    """Build the action of an agent at full speed: it has arrived, or searches."""
    return Action(
        waypoint=waypoint,
        step=step,
        is_stop=is_stop,
        status=jnp.where(is_stop, int(Status.ARRIVED), int(Status.SEARCHING)),
        speed=jnp.float32(1.0),
        clearance=jnp.float32(0.0),
    )


class Body(Protocol):
    """Motion model of a robot: pose and odometry after a command; a record (``@pytree``).

    A body never moves further in a cycle than ``step_length`` times the action's speed: the filter
    treats longer moves as jumps.
    """

    def move(
        self, key: Array, state: WorldState, action: Action, motion: MotionParams
    ) -> WorldState:
        """Execute one decision cycle's step; see ``Holonomic.move``."""
        ...


@pytree
class Holonomic:
    """Holonomic body that moves in any direction and faces it."""

    def move(
        self, key: Array, state: WorldState, action: Action, motion: MotionParams
    ) -> WorldState:
        """Execute one decision cycle's step.

            x' = x + R(e) u + N(0, (ε |u|)²) per axis,   odometry' = odometry + u

        with e the error of odometry's heading, true minus odometry (see ``_propagate``).
        Limits: no noise keeps odometry and truth together; a stop or a zero step changes nothing. A
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
        demand = jnp.hypot(step[0], step[1])
        limit = motion.step_length * action.speed
        is_long = demand > limit
        step = jnp.where(is_long, step * (limit / jnp.where(is_long, demand, 1.0)), step)
        length = jnp.minimum(demand, limit)
        heading = jnp.where(length > 0.0, jnp.arctan2(step[1], step[0]), state.odometry[2])
        return _propagate(key, state, step, length, heading, motion)


HOLONOMIC = Holonomic()


def _propagate(
    key: Array, state: WorldState, step: Array, length: Array, heading: Array, motion: MotionParams
) -> WorldState:
    """Propagate odometry by a step, and the true pose with noise and heading drift."""
    # e' = e + b s + N(0, σ² s + τ² |φ|),   x' = x + R((e + e') / 2) u + N(0, (ε s)²) per axis
    # with φ the turn.
    noise = jax.random.normal(key, (3,))
    turn = jnp.abs(wrapped(heading - state.odometry[2]))
    std = jnp.sqrt(motion.heading_noise**2 * length + motion.turn_noise**2 * turn)
    heading_noise = motion.heading_bias * length + std * noise[2]
    error = state.heading - state.odometry[2]
    mean_error = error + 0.5 * heading_noise
    rotated = jnp.stack(rotate(step[0], step[1], mean_error))
    displacement = rotated + motion.odometry_noise * length * noise[:2]
    return WorldState(
        position=state.position + displacement,
        heading=heading + error + heading_noise,
        odometry=jnp.stack([state.odometry[0] + step[0], state.odometry[1] + step[1], heading]),
        distance=state.distance + jnp.hypot(displacement[0], displacement[1]),
    )


BODY_RADIUS = 0.25
"""Radius of the robot, metres, at which a wall stops it."""


def stop_at_wall(before: WorldState, after: WorldState, terrain: Terrain) -> WorldState:
    """Stop a robot at the first wall on its path; its odometry stops there, too.

    Limits: without a wall on the path nothing changes.
    """
    fraction = terrain.view.free_fraction(Segment(*before.position, *after.position), BODY_RADIUS)
    if fraction is None:
        return after
    odometry = before.odometry + fraction * (after.odometry - before.odometry)
    return replace(
        after,
        position=before.position + fraction * (after.position - before.position),
        odometry=odometry.at[2].set(after.odometry[2]),
        distance=before.distance + fraction * (after.distance - before.distance),
    )


@pytree
class Unicycle:
    """Unicycle body that turns, then drives straight ahead."""

    turn_rate: Array  # f32[] maximum turn in one decision cycle, radians, > 0

    def move(
        self, key: Array, state: WorldState, action: Action, motion: MotionParams
    ) -> WorldState:
        """Execute one decision cycle's step.

            θ' = θ + clip(∠u − θ, ±ω),   s = min(|u|, L v (1 − |θ' − θ| / ω))
            u' = s (cos θ', sin θ')

        of odometry; for the true pose see ``_propagate``. Arguments as of ``Holonomic.move``.
        Limits: ω → ∞ equals a holonomic body; a stop or a zero step changes nothing.
        """
        step = jnp.where(action.is_stop, jnp.zeros_like(action.step), action.step)
        demand = jnp.hypot(step[0], step[1])
        target = wrapped(jnp.arctan2(step[1], step[0]) - state.odometry[2])
        turn = jnp.where(demand > 0.0, jnp.clip(target, -self.turn_rate, self.turn_rate), 0.0)
        heading = state.odometry[2] + turn
        remaining = 1.0 - jnp.abs(turn) / self.turn_rate
        length = jnp.minimum(demand, motion.step_length * action.speed * remaining)
        step = length * jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        return _propagate(key, state, step, length, heading, motion)
