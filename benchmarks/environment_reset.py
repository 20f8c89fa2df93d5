"""What an automatic reset costs a step of the environments: worlds drawn inside it, or ahead.

Three programs over the same lanes, each a scan of steps of a random agent: ``step`` alone,
``step_and_reset`` with a world drawn in every step of every lane, and with a pool of 1,024 worlds.
They take turns, so that a machine that slows down slows all of them; the median turn counts.

The target is an automatic reset at no more than half a step on top of the step.
"""

import pinning  # isort: skip
import statistics
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import record
from record import Measurement, entry

from jaxlangnav.environments import functional
from jaxlangnav.environments.pool import draw_pool

MANY, FEW = 200, 10
"""Steps of a turn: few where each of them takes a hundred times as long."""
TARGET = 1.5


def scanned(step: Callable[..., Any], num_steps: int) -> Callable[..., Any]:
    """Build the program of many steps in many lanes."""

    def advance(state: Any, key: Any) -> tuple[Any, Any]:
        keys = jax.random.split(key, state.steps.shape[0])
        actions = jax.random.uniform(key, (keys.shape[0], 3), minval=-1.0, maxval=1.0)
        observation, state, reward, _, _ = jax.vmap(step)(keys, state, actions)
        return state, reward + observation.sum(axis=1)

    def run(key: Any, state: Any) -> Any:
        return jax.lax.scan(advance, state, jax.random.split(key, num_steps))[1].sum()

    return jax.jit(run)


def entries(*, is_quick: bool) -> list[Measurement]:
    """Measure the three programs in turns.

    Args:
        is_quick: fewer lanes and turns.

    Returns:
        Entries of the bench's document.
    """
    num_lanes, num_turns = (64, 5) if is_quick else (512, 7)
    params = functional.default_params(world="2H1C")
    pool = draw_pool(jax.random.key(0), params.law)
    keys = jax.random.split(jax.random.key(1), num_lanes)
    _, state = jax.vmap(functional.reset, in_axes=(0, None, None))(keys, params, pool)
    steps = {"step": MANY, "drawn inside": FEW, "drawn ahead": MANY}
    programs = {
        "step": scanned(lambda *lane: functional.step(*lane, params), MANY),
        "drawn inside": scanned(lambda *lane: functional.step_and_reset(*lane, params), FEW),
        "drawn ahead": scanned(lambda *lane: functional.step_and_reset(*lane, params, pool), MANY),
    }
    times: dict[str, list[float]] = {name: [] for name in programs}
    for turn in range(num_turns + 1):
        for name, program in programs.items():
            begin = time.process_time()
            jnp.asarray(program(jax.random.key(turn), state)).block_until_ready()
            if turn:
                times[name].append(time.process_time() - begin)
    cost = {name: statistics.median(one) / (steps[name] * num_lanes) for name, one in times.items()}
    title = f"environment, {num_lanes} lanes"
    ratio = {name: one / cost["step"] for name, one in cost.items()}
    return [
        entry(f"{title}: a step", 1e6 * cost["step"], "µs CPU"),
        entry(
            f"{title}: automatic reset, worlds drawn inside, in steps", ratio["drawn inside"], ""
        ),
        entry(
            f"{title}: automatic reset, worlds drawn ahead, in steps",
            ratio["drawn ahead"],
            "",
            target=TARGET,
            is_limit=True,
        ),
    ]


if __name__ == "__main__":
    record.main(entries, __doc__, pinning.CORE)
