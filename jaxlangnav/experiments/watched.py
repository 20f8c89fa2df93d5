"""What a simulated person is shown of the robot: where belief and truth meet, for ``world.person``.

The robot says what it goes up to, what it takes for possible where it asks, and where these are.
"""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import NONE, Status
from jaxlangnav.navigator import NavigatorState
from jaxlangnav.world.person import RobotView
from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.state import Scenario

LEAST_SHARE = 0.01
"""Goal probability below which a thing is no candidate of a question."""


def has_seen_goal(seen: RobotView, state: NavigatorState, scenario: Scenario) -> Array:
    """Tell whether the robot takes a thing for being where the goal truly is, bool[].

    Args:
        seen: of the robot.
        state: of the same robot.
        scenario: the truth.

    Returns:
        Whether most of the weight has an observed thing within the success radius of the goal.
    """
    weight = jnp.exp(state.belief.log_weight)[None]
    is_held = jnp.sum(weight * (state.belief.particles.object_type != NONE), axis=1) > 0.5
    away = jnp.hypot(seen.x - scenario.goal[0], seen.y - scenario.goal[1])
    return jnp.any(is_held & (away <= SUCCESS_RADIUS))


def seen_of(state: NavigatorState, step: Array) -> RobotView:
    """Gather what the robot says of itself.

    A robot at an end without a goal goes up to nothing, whatever it went up to before.

    Args:
        state: after the last cycle.
        step: i32[], the decision to come.

    Returns:
        What a person is shown.
    """
    particles = state.belief.particles
    num_slots = particles.object_type.shape[0]
    weight = jnp.exp(state.belief.log_weight)[None] * (particles.object_type != NONE)
    total = jnp.maximum(jnp.sum(weight, axis=1), 1e-9)

    def mean(values: Array) -> Array:
        return jnp.sum(weight * values[:num_slots], axis=1) / total

    is_at = (state.status == Status.APPROACHING) | (state.status == Status.ARRIVED)
    return RobotView(
        step=step,
        aimed=jnp.where(is_at, state.talk.approached, NONE),
        is_asking=state.status == Status.WHICH_ONE,
        is_candidate=state.talk.candidate >= LEAST_SHARE,
        x=mean(particles.mean_x),
        y=mean(particles.mean_y),
    )
