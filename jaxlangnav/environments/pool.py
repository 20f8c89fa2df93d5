"""A pool of pre-sampled template worlds, from which each episode takes a random one."""

import functools

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.world.scenario import ScenarioParams, draw_scenario
from jaxlangnav.world.state import Scenario

NUM_WORLDS = 1024  # default size of a pool: 150 kB, and σ/√N of an average is 3 % of σ
_BATCH_SIZE = 64  # worlds sampled together, which bounds the memory of rejection sampling


@functools.partial(jax.jit, static_argnames="num_worlds")
def draw_pool(
    key: Array, source: ScenarioParams | Scenario, *, num_worlds: int = NUM_WORLDS
) -> Scenario:
    """Sample a pool of worlds, a leading axis N ≥ 1 on every leaf; another N recompiles.

    Invalid samples (rejection sampling failed) are replaced by valid ones of the pool, if there
    are any. A single world or a pool is returned unchanged.
    """
    check_minimum(1, num_worlds=num_worlds)
    if isinstance(source, Scenario):
        return source
    keys = jax.random.split(key, num_worlds)
    samples = jax.lax.map(lambda k: draw_scenario(k, source), keys, batch_size=_BATCH_SIZE)
    order = jnp.argsort(~samples.is_valid, stable=True)
    num_valid = jnp.maximum(jnp.sum(samples.is_valid), 1)
    return jax.tree.map(lambda leaf: leaf[order[jnp.arange(num_worlds) % num_valid]], samples)


def sample_world(key: Array, source: ScenarioParams | Scenario) -> Scenario:
    """Sample a world, or pick one of the N worlds of a pool uniformly."""
    if isinstance(source, ScenarioParams):
        return draw_scenario(key, source)
    # Cheaper than randint; the modulo bias of 32 bits is negligible.
    index = jax.random.bits(key) % jnp.uint32(source.goal_index.shape[0])
    return jax.tree.map(lambda leaf: leaf[index], source)
