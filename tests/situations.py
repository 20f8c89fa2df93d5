"""Situations by hand: what a policy is shown, as the navigator shows it."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.messages import default_sensor
from jaxlangnav.planner import policy
from jaxlangnav.planner.blocked import init_progress
from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.graph import Nodes
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.planner.policy import Situation
from jaxlangnav.semantic_map.params import default_map_params

RANGE = 3.0
CHOOSE = jax.jit(policy.choose, static_argnames="policy")
"""Compiled once for all files that let a policy decide by hand."""


def nodes_at(x, y, kind) -> Nodes:
    return Nodes(
        x=jnp.asarray(x, jnp.float32),
        y=jnp.asarray(y, jnp.float32),
        is_node=jnp.ones(len(x), bool),
        kind=jnp.asarray(kind, jnp.int32),
    )


def goals_with(x, y, mass, *, confirmed=None, hypothesis=(0.0, 0.0, 0.0)) -> Goals:
    """Things that have been seen; a hypothesis is (mass, x, y)."""
    x, y, mass = (jnp.asarray(one, jnp.float32) for one in (x, y, mass))
    hidden, *place = (jnp.full(1, one, jnp.float32) for one in hypothesis)
    return Goals(
        object_x=x,
        object_y=y,
        object_mass=mass,
        object_accepted=mass,
        object_confirmed=mass if confirmed is None else jnp.asarray(confirmed, jnp.float32),
        is_object=jnp.ones(x.shape, bool),
        hypothesis_x=place[0],
        hypothesis_y=place[1],
        hypothesis_mass=hidden,
    )


def seen_goal(share, x: float = 0.0, y: float = 0.0, hypothesis=(0.0, 0.0, 0.0)) -> Goals:
    return goals_with([x], [y], [share], hypothesis=hypothesis)


def forbid(belief, share: float):
    """Forbid the first observed object in a share of the particles: f32[R, N + 1, P]."""
    slots, number = belief.particles.mean_x.shape
    forbidden = np.zeros((7, slots, number), np.float32)
    forbidden[6, 0, : round(share * number)] = 1.0
    return jnp.asarray(forbidden)


def situation(
    belief, nodes: Nodes, goals: Goals, robot=(0.0, 0.0), *, is_news=False, is_find=0.0,
    is_still=False, forbidden: float = 0.0,
) -> Situation:  # fmt: skip
    x, y = jnp.float32(robot[0]), jnp.float32(robot[1])
    return Situation(
        belief=belief,
        nodes=nodes,
        goals=goals,
        forbidden_prob=forbid(belief, forbidden),
        is_relevant=jnp.ones_like(belief.particles.is_mentioned),
        robot_x=x,
        robot_y=y,
        sensor=default_sensor(RANGE),
        progress=init_progress(jnp.zeros(3)),
        may_ask=jnp.asarray(True),
        has_chosen=jnp.asarray(False),
        is_find=jnp.float32(is_find),
        is_news=jnp.asarray(is_news),
        is_still=jnp.asarray(is_still),
        params=PlannerParams(),
        map_params=default_map_params(),
        num_blocks=1,
    )
