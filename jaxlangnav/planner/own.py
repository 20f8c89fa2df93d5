"""A policy of one's own: what it is shown, and what it answers (section 3.4, eq. 10).

``PlannerConfig(policy=f)`` takes any function from a ``Situation`` to a ``Valuation`` that JAX can
trace. The planner does the rest as for the paper's policy: the most valuable open waypoint is taken
and kept until it is reached or something new is seen, and the robot stops where ``stop_mass``
reaches τ, if something seen that may be the goal is within reach (or in view,
for "find") at all.
"""

from collections.abc import Callable
from typing import TypeAlias

from jax import Array

from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.graph import Nodes
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.pytree import pytree
from jaxlangnav.semantic_map.belief import ParticleBelief


@pytree
class Situation:
    """What a policy decides upon; metres, map frame."""

    belief: ParticleBelief  # weighted maps, what each hypothesises, what has been looked at
    nodes: Nodes  # leaves [A], waypoints to value: frontiers, visited places, observed objects
    goals: Goals  # where the goal may be, with probabilities
    distance: Array  # f32[A] metres from the robot to each node
    robot_x: Array  # f32[] believed position
    robot_y: Array  # f32[]
    range_max: Array  # f32[] sensing range
    is_find: Array  # f32[] probability that "find" is asked for: stop once it is in view
    params: PlannerParams


@pytree
class Valuation:
    """What a policy makes of it; the value of a node is the sum of its parts less its cost."""

    goal_value: Array  # f32[A] what a node is worth for being near the goal
    information_value: Array  # f32[A] what it is worth for what the way would reveal
    stop_mass: Array  # f32[] probability that the goal is within reach; the robot stops from τ on


Policy: TypeAlias = Callable[[Situation], Valuation]
"""A policy for ONE robot; the engine batches it. A new function is compiled anew."""
