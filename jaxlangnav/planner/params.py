"""What a sweep may vary of the planner; traced."""

import math

from jax import Array

from jaxlangnav.pytree import field, pytree


@pytree
class PlannerParams:
    """Numbers of the planner; traced, all of them scalars f32[]."""

    discount: Array = field("γ per metre (eq. 12)", default=0.8)
    stop_probability: Array = field(
        "τ, goal probability within reach at which the robot stops", default=0.7
    )
    reach: Array = field("metres from the goal that count as having arrived", default=1.2)
    frontier_miss: Array = field(
        "cells missed more likely than this share of the worst are unseen", default=0.5
    )
    visit_spacing: Array = field("metres between visited nodes", default=1.0)
    rival_share: Array = field(
        "unseen rivals near things seen that a goal may have, relative to it", default=0.1
    )
    rest_share: Array = field(
        "goal probability still unseen, relative to the best, that is let go", default=0.25
    )
    prior_share: Array = field(
        "how far the order of search trusts the learned prior; 0: not at all", default=0.8
    )
    ahead: Array = field(
        "κ, how far the order of search takes what is spoken of to lie ahead of the one spoken to",
        default=0.0,
    )
    give_up: Array = field(
        "probability that what is missing is there at all, below which the search "
        "ends; of ``informed``, 0: never",
        default=0.15,
    )
    absent: Array = field(
        "ν, probability that what is spoken of is nowhere: the more, the more a tour is to show "
        "all of the area, and the sooner a search that shows nothing ends; of ``informed``",
        default=0.0,
    )
    constraint_cost: Array = field(
        "metres of detour rather than a metre of way beside a thing to be kept away from",
        default=100.0,
    )
    unseen_risk: Array = field(
        "probability that one more look would show a thing to be kept away from within two metres "
        "of the next place, above which the step to it is shorter",
        default=2e-5,
    )
    question_cost: Array = field(
        "what a question costs, in probability of success; inf: never ask", default=math.inf
    )
    look_cost: Array = field(
        "what a metre of looking on costs where questions are allowed, in probability of success",
        default=0.001,
    )


def default_planner_params() -> PlannerParams:
    """Build the parameters used in all tables unless they say otherwise."""
    return PlannerParams()
