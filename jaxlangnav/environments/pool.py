"""Worlds drawn ahead: what an automatic reset takes, so that it costs no more than a step.

Drawing a world tries hundreds of places, and takes 260 times as long as a step in a batch of 512
lanes (``benchmarks/environment_reset.py``). Under ``vmap`` a reset inside a step is worked out for
every lane, ended or not, so an environment that begins anew by itself would pay that every step.
It takes a world out of a pool instead, at a sixth of a step.

What that means for the law of worlds: each world of a pool follows the law of the environment,
and each episode takes one of the N by lot, independently of all others. So every single episode
has the law of a fresh world, but two of them share their world with probability 1/N, and an
average over any number of episodes keeps the spread of an average over N worlds (σ/√N). Noise of
sensing and odometry is drawn anew each time. An agent that could learn N worlds by heart wants a
larger pool, or a new one from time to time; a table wants ``reset``, which draws fresh worlds.
"""

import functools

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.world.scenario import ScenarioLaw, draw_scenario
from jaxlangnav.world.state import Scenario

NUM_WORLDS = 1024
"""Worlds of a pool unless told otherwise: 150 kB, and an average's σ/√N is 3 % of σ."""
_SLICE = 64
"""Worlds drawn together; all at once would hold every place tried."""


@functools.partial(jax.jit, static_argnames="num_worlds")
def draw_pool(key: Array, law: ScenarioLaw, *, num_worlds: int = NUM_WORLDS) -> Scenario:
    """Draw the worlds of a pool.

    Limits: one world makes every episode the same place; a world that does not meet the law is
    replaced by one of the pool that does (if there is one).

    Args:
        key: random key.
        law: of the worlds; traced.
        num_worlds: N; a change recompiles.

    Returns:
        The worlds, a leading axis N on every leaf.

    Raises:
        ValueError: fewer than one world.
    """
    if num_worlds < 1:
        raise ValueError(f"num_worlds is {num_worlds}, but must be at least 1")
    keys = jax.random.split(key, num_worlds)
    drawn = jax.lax.map(lambda one: draw_scenario(one, law), keys, batch_size=_SLICE)
    best = jnp.argsort(~drawn.is_valid, stable=True)
    number = jnp.maximum(jnp.sum(drawn.is_valid), 1)
    return jax.tree.map(lambda leaf: leaf[best[jnp.arange(num_worlds) % number]], drawn)


def pick_world(key: Array, pool: Scenario) -> Scenario:
    """Take one world out of a pool by lot.

    Args:
        key: random key.
        pool: N worlds.

    Returns:
        One of them.
    """
    # One draw where randint takes four; 2³² is so large that its remainder favours nobody.
    index = jax.random.bits(key) % jnp.uint32(pool.goal_index.shape[0])
    return jax.tree.map(lambda leaf: leaf[index], pool)
