"""Worlds of a template drawn ahead, out of which every episode takes one by lot."""

import functools

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.limits import refuse_below
from jaxlangnav.world.scenario import ScenarioLaw, draw_scenario
from jaxlangnav.world.state import Scenario

NUM_WORLDS = 1024
"""Worlds of a pool unless told otherwise: 150 kB, and an average's σ/√N is 3 % of σ."""
_SLICE = 64  # worlds drawn together; all at once would hold every place tried


@functools.partial(jax.jit, static_argnames="num_worlds")
def draw_pool(
    key: Array, worlds: ScenarioLaw | Scenario, *, num_worlds: int = NUM_WORLDS
) -> Scenario:
    """Draw the worlds of a pool, a leading axis N ≥ 1 on every leaf; another N recompiles.

    Limits: one world makes every episode the same place; a world that does not meet the law is
    replaced by one of the pool that does (if there is one). A pool stays what it is.
    """
    refuse_below(1, num_worlds=num_worlds)
    if isinstance(worlds, Scenario):
        return worlds
    keys = jax.random.split(key, num_worlds)
    drawn = jax.lax.map(lambda one: draw_scenario(one, worlds), keys, batch_size=_SLICE)
    best = jnp.argsort(~drawn.is_valid, stable=True)
    number = jnp.maximum(jnp.sum(drawn.is_valid), 1)
    return jax.tree.map(lambda leaf: leaf[best[jnp.arange(num_worlds) % number]], drawn)


def next_world(key: Array, worlds: ScenarioLaw | Scenario) -> Scenario:
    """Draw a world, or take one of the N worlds of a pool by lot."""
    if isinstance(worlds, ScenarioLaw):
        return draw_scenario(key, worlds)
    # One draw where randint takes four; 2³² is so large that its remainder favours nobody.
    index = jax.random.bits(key) % jnp.uint32(worlds.goal_index.shape[0])
    return jax.tree.map(lambda leaf: leaf[index], worlds)
