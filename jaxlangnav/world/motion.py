"""Simulated motion and odometry (the odometry stream u of eq. 1 and 6).

A ``Body`` carries out the step that is asked for as well as it can. Where it truly ends differs
from its odometry by Gaussian noise in proportion to the way. A compass gives the heading unless
``MotionParams`` lets it drift: odometry then has a heading of its own, and goes by that.
"""

from typing import Protocol

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import Action, MotionParams, Status
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.terrain import Terrain
from jaxlangnav.terrain.view import Stretch, wrapped
from jaxlangnav.world.state import WorldState


def plain_action(waypoint: Array, step: Array, is_stop: Array) -> Action:
    """Build the action of an agent without a pace of its own: it has arrived, or searches."""
    return Action(
        waypoint=waypoint,
        step=step,
        is_stop=is_stop,
        status=jnp.where(is_stop, int(Status.ARRIVED), int(Status.SEARCHING)),
        speed=jnp.float32(1.0),
        clearance=jnp.float32(0.0),
    )


class Body(Protocol):
    """How a pose changes with a command, and what odometry says of it: a record (``@pytree``).

    A body never goes further in a cycle than ``step_length`` times the action's speed: the belief
    takes what goes further for a jump.
    """

    def move(
        self, key: Array, state: WorldState, action: Action, motion: MotionParams
    ) -> WorldState:
        """Carry out one decision cycle's step; see ``carry_out`` for the holonomic one."""
        ...


def carry_out(key: Array, state: WorldState, action: Action, motion: MotionParams) -> WorldState:
    """Carry out one decision cycle's step.

        x' = x + R(e) u + N(0, (ε |u|)²) per axis,   odometry' = odometry + u

    with e by how much the true heading exceeds odometry's (see ``_driven``).
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
    asked = jnp.hypot(step[0], step[1])
    limit = motion.step_length * action.speed
    is_long = asked > limit
    step = jnp.where(is_long, step * (limit / jnp.where(is_long, asked, 1.0)), step)
    way = jnp.minimum(asked, limit)
    heading = jnp.where(way > 0.0, jnp.arctan2(step[1], step[0]), state.odometry[2])
    return _driven(key, state, step, way, heading, motion)


@pytree
class Holonomic:
    """Goes anywhere from where it stands, and looks where it goes: see ``carry_out``."""

    move = staticmethod(carry_out)


HOLONOMIC = Holonomic()


def _driven(
    key: Array, state: WorldState, step: Array, way: Array, heading: Array, motion: MotionParams
) -> WorldState:
    """Turn and drive as odometry has it, and end where noise and drift of the heading lead."""
    # e' = e + b s + N(0, σ² s + τ² |φ|),   x' = x + R((e + e') / 2) u + N(0, (ε s)²) per axis
    # with φ the turn.
    noise = jax.random.normal(key, (3,))
    turn = jnp.abs(wrapped(heading - state.odometry[2]))
    spread = jnp.sqrt(motion.heading_noise**2 * way + motion.turn_noise**2 * turn)
    drift = motion.heading_bias * way + spread * noise[2]
    error = state.heading - state.odometry[2]
    halfway = error + 0.5 * drift
    cosine, sine = jnp.cos(halfway), jnp.sin(halfway)
    along = jnp.stack([cosine * step[0] - sine * step[1], sine * step[0] + cosine * step[1]])
    displacement = along + motion.odometry_noise * way * noise[:2]
    return WorldState(
        position=state.position + displacement,
        heading=heading + error + drift,
        odometry=jnp.stack([state.odometry[0] + step[0], state.odometry[1] + step[1], heading]),
        distance=state.distance + jnp.hypot(displacement[0], displacement[1]),
    )


BODY_RADIUS = 0.25
"""Metres from a wall at which the middle of a robot is halted by it."""


def halted(before: WorldState, after: WorldState, terrain: Terrain) -> WorldState:
    """Halt a robot at the first wall in its way; its wheels stand there, too.

    Limits: where no wall is in the way nothing changes.
    """
    way = Stretch(*before.position, *after.position)
    share = terrain.view.clear_share(way, BODY_RADIUS)
    if share is None:
        return after
    odometry = before.odometry + share * (after.odometry - before.odometry)
    return replace(
        after,
        position=before.position + share * (after.position - before.position),
        odometry=odometry.at[2].set(after.odometry[2]),
        distance=before.distance + share * (after.distance - before.distance),
    )


@pytree
class Unicycle:
    """Turns, then drives straight ahead; never sideways."""

    turn_rate: Array  # f32[] radians turned in one decision cycle at most, > 0

    def move(
        self, key: Array, state: WorldState, action: Action, motion: MotionParams
    ) -> WorldState:
        """Carry out one decision cycle's step.

            θ' = θ + clip(∠u − θ, ±ω),   s = min(|u|, L v (1 − |θ' − θ| / ω))
            u' = s (cos θ', sin θ')

        of odometry; where that leads see ``_driven``. Arguments as of ``carry_out``.
        Limits: ω → ∞ goes where a holonomic body goes; a stop or a zero step changes nothing.
        """
        step = jnp.where(action.is_stop, jnp.zeros_like(action.step), action.step)
        asked = jnp.hypot(step[0], step[1])
        wanted = wrapped(jnp.arctan2(step[1], step[0]) - state.odometry[2])
        turn = jnp.where(asked > 0.0, jnp.clip(wanted, -self.turn_rate, self.turn_rate), 0.0)
        heading = state.odometry[2] + turn
        rest = 1.0 - jnp.abs(turn) / self.turn_rate
        way = jnp.minimum(asked, motion.step_length * action.speed * rest)
        step = way * jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        return _driven(key, state, step, way, heading, motion)
