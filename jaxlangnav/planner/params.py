"""Parameters of the planner; traced, so that a sweep may vary them without recompiling."""

import math

from jax import Array

from jaxlangnav.pytree import field, pytree


@pytree
class PlannerParams:
    """Parameters of the planner, scalars f32[]; traced. The defaults are those of the results."""

    discount: Array = field("γ per metre (eq. 12)", default=0.8)
    stop_probability: Array = field(
        "τ, goal probability within reach at which the robot stops", default=0.7
    )
    reach: Array = field("metres from the goal at which the robot has arrived", default=1.2)
    frontier_miss: Array = field(
        "fraction of the largest miss probability above which a cell is unexplored", default=0.5
    )
    visit_spacing: Array = field("metres between visited nodes", default=1.0)
    rival_share: Array = field(
        "maximum mass of unseen rivals near observed objects, relative to the goal's", default=0.1
    )
    rest_share: Array = field(
        "goal mass still unseen, relative to the best, that is neglected", default=0.25
    )
    prior_share: Array = field(
        "weight of the learned prior in the order of search; 0: none", default=0.95
    )
    ahead: Array = field(
        "κ, concentration of the prior that mentioned objects lie ahead of the robot", default=0.0
    )
    give_up: Array = field(
        "probability that a missing object exists, below which the search "
        "ends; of ``informed``, 0: never",
        default=0.15,
    )
    absent: Array = field(
        "ν, probability that a mentioned object does not exist: the larger, the more a tour covers "
        "the whole area, and the sooner an unsuccessful search ends; of ``informed``",
        default=0.0,
    )
    constraint_cost: Array = field(
        "cost of a metre of path at a forbidden object, in metres of detour", default=100.0
    )
    unseen_risk: Array = field(
        "probability that one more observation would reveal a forbidden object within two metres "
        "of the next position, above which the step is shortened",
        default=2e-5,
    )
    question_cost: Array = field(
        "cost of a question, in probability of success; inf: never ask", default=math.inf
    )
    look_cost: Array = field(
        "cost of a metre of search where questions are allowed, in probability of success",
        default=0.001,
    )
