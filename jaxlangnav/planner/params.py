"""What a sweep may vary of the planner; traced."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.pytree import field, pytree


@pytree
class PlannerParams:
    """Numbers of the planner; traced."""

    discount: Array = field("γ per metre (eq. 12)")  # f32[]
    stop_probability: Array = field(  # f32[]
        "τ, goal probability within reach at which the robot stops"
    )
    reach: Array = field("metres from the goal that count as having arrived")  # f32[]
    frontier_miss: Array = field(  # f32[]
        "cells missed more likely than this share of the worst are unseen"
    )
    visit_spacing: Array = field("metres between visited nodes")  # f32[]
    rival_share: Array = field(  # f32[]
        "unseen rivals near things seen that a goal may have, relative to it"
    )
    rest_share: Array = field(  # f32[]
        "goal probability still unseen, relative to the best, that is let go"
    )
    prior_share: Array = field(  # f32[]
        "how far the order of search trusts the learned prior; 0: not at all"
    )
    ahead: Array = field(  # f32[]
        "κ, how far the order of search takes what is spoken of to lie ahead of the one spoken to"
    )
    give_up: Array = field(  # f32[]
        "probability that what is missing is there at all, below which the search "
        "ends; of ``informed``, 0: never"
    )
    absent: Array = field(  # f32[]
        "ν, probability that what is spoken of is nowhere: the more, the more a tour is to show "
        "all of the area, and the sooner a search that shows nothing ends; of ``informed``"
    )
    constraint_cost: Array = field(  # f32[]
        "metres of detour rather than a metre of way beside a thing to be kept away from"
    )
    question_cost: Array = field(  # f32[]
        "what a question costs, in probability of success; inf: never ask"
    )
    look_cost: Array = field(  # f32[]
        "what a metre of looking on costs where questions are allowed, in probability of success"
    )


def default_planner_params() -> PlannerParams:
    """Build the parameters used in all tables unless they say otherwise."""
    return PlannerParams(
        discount=jnp.float32(0.8),
        stop_probability=jnp.float32(0.7),
        reach=jnp.float32(1.2),
        frontier_miss=jnp.float32(0.5),
        visit_spacing=jnp.float32(1.0),
        rival_share=jnp.float32(0.1),
        rest_share=jnp.float32(0.25),
        prior_share=jnp.float32(0.8),
        ahead=jnp.float32(0.0),
        give_up=jnp.float32(0.15),
        absent=jnp.float32(0.0),
        constraint_cost=jnp.float32(100.0),
        question_cost=jnp.float32(jnp.inf),
        look_cost=jnp.float32(0.001),
    )
