"""A body on two wheels: it turns on the spot towards where it is to go, then drives (section 4.3).

A cycle is as long as one ``step_length`` at full speed. Turning takes its share of it, so a sharp
turn leaves less of the cycle for driving, and one sharper than ``turn_rate`` takes all of it.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import Action, MotionParams
from jaxlangnav.pytree import pytree
from jaxlangnav.world.motion import driven
from jaxlangnav.world.state import WorldState


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

        of odometry; where that leads see ``motion.driven``.
        Limits: ω → ∞ goes where a holonomic body goes; a stop or a zero step changes nothing.

        Args:
            key: random key.
            state: the robot.
            action: ``step`` f32[2] metres, map axes; ``is_stop`` keeps the robot where it is.
            motion: step length L, and what odometry is like.

        Returns:
            The robot after the step; odometry has the way without its noise.
        """
        step = jnp.where(action.is_stop, jnp.zeros_like(action.step), action.step)
        asked = jnp.hypot(step[0], step[1])
        wanted = jnp.arctan2(step[1], step[0]) - state.odometry[2]
        wanted = wanted - 2.0 * jnp.pi * jnp.round(wanted / (2.0 * jnp.pi))
        turn = jnp.where(asked > 0.0, jnp.clip(wanted, -self.turn_rate, self.turn_rate), 0.0)
        heading = state.odometry[2] + turn
        rest = 1.0 - jnp.abs(turn) / self.turn_rate
        way = jnp.minimum(asked, motion.step_length * action.speed * rest)
        step = way * jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        return driven(key, state, step, way, heading, motion)
