"""Benchmark each optimization of ``numerics.batching`` against plain code.

    python benchmarks/batching.py [--quick] [--json]

The sizes are those of a cycle: 64 particles in 32 lanes, nine coordinates, records of a particle.
A trick with both ratios near 1 no longer pays: write its callers plainly and delete it.
"""

import pinning  # noqa: I001 - before JAX and NumPy start their threads

import functools
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import record
from record import Measurement, entry

from jaxlangnav.experiments.timing import measure
from jaxlangnav.numerics import batching, gaussian
from jaxlangnav.semantic_map import particle

LANES, PARTICLES, OBJECTS = 32, 64, 8
CALLS = 50
"""Calls in one measurement."""
Program = Callable[[Any], Any]
Case = tuple[Program, Program, Any]
"""Optimized program, plain program, and their input."""


def batch_axes_last() -> Case:
    """Eight updates of small Gaussians, particles last, or batched by ``vmap``."""
    count, size = LANES * PARTICLES, OBJECTS + 1
    root = np.random.default_rng(0).normal(size=(count, size, size)).astype(np.float32)
    covariance = root @ root.transpose(0, 2, 1) + np.eye(size, dtype=np.float32)
    moments = gaussian.Moments(
        jnp.asarray(covariance.transpose(1, 2, 0)),
        jnp.zeros((size, count)),
        jnp.zeros((size, count)),
    )
    edges = [(index, OBJECTS) for index in range(OBJECTS)]

    def update(moments: gaussian.Moments) -> gaussian.Moments:
        shape = (OBJECTS, *moments.mean_x.shape[1:])
        offset, is_used = jnp.ones(shape), jnp.ones(shape, bool)
        return gaussian.condition_offsets(
            moments, edges, is_used, offset, offset, jnp.full(shape, 0.01)
        )

    return update, jax.vmap(update, in_axes=-1, out_axes=-1), moments


def rows() -> Case:
    """One row of twenty leaves in a loop over four, each added up."""
    rng = np.random.default_rng(1)
    leaves = [jnp.asarray(rng.normal(size=(4, 3, 256)), jnp.float32) for _ in range(20)]

    def looped(row: Callable[[Any, Any], Any]) -> Program:
        def run(leaves: Any) -> Any:
            return jax.lax.fori_loop(
                0, 4, lambda index, total: total + sum(row(leaves, index)), jnp.zeros((3, 256))
            )

        return run

    return (
        looped(batching.select_row),
        looped(lambda leaves, index: [leaf[index] for leaf in leaves]),
        leaves,
    )


def short_tables() -> Case:
    """One of nine candidates for each particle, of four tables."""
    rng = np.random.default_rng(2)
    count = LANES * PARTICLES
    tables = jnp.asarray(rng.normal(size=(4, OBJECTS + 1, count)), jnp.float32)
    index = jnp.asarray(rng.integers(OBJECTS + 1, size=count), jnp.int32)

    def selected(inputs: Any) -> Any:
        return [batching.lookup(table, inputs[1]) for table in inputs[0]]

    def gathered(inputs: Any) -> Any:
        return [jnp.take_along_axis(table, inputs[1][None], axis=0)[0] for table in inputs[0]]

    return selected, gathered, (tables, index)


def worked_out_once() -> Case:
    """A chain of cheap steps that ten joined arrays read."""

    def read(keep: Program) -> Program:
        def run(x: Any) -> Any:
            for index in range(40):
                x = jnp.where(x > index, x - 0.5, x + index)
            x = keep(x)
            return [jnp.concatenate([x * factor, x[:1]]) for factor in range(2, 12)]

        return run

    values = jnp.linspace(0.0, 1.0, LANES * PARTICLES)
    return read(batching.materialize), read(lambda same: same), values


def one_table() -> Case:
    """Resample the particles of all lanes."""
    empty = particle.empty(OBJECTS, 6, jnp.float32(0.0), jnp.float32(0.0))
    shape = (LANES, PARTICLES)
    many = jax.tree.map(
        lambda leaf: jnp.broadcast_to(leaf[None, ..., None], (LANES, *leaf.shape, PARTICLES)) + 0,
        empty,
    )
    ancestors = jnp.asarray(np.sort(np.random.default_rng(3).integers(PARTICLES, size=shape)))

    def plainly(particles: Any, ancestors: Any) -> Any:
        return jax.tree.map(lambda leaf: leaf[..., ancestors], particles)

    def of_lanes(take: Callable[[Any, Any], Any]) -> Program:
        return lambda args: jax.vmap(take)(*args)

    return of_lanes(batching.take), of_lanes(plainly), (many, ancestors)


def one_draw() -> Case:
    """Numbers for four keys of each lane."""
    keys = jax.random.split(jax.random.key(4), (LANES, 4))

    def shared(keys: Any) -> Any:
        return jax.vmap(lambda lane: batching.uniforms(lane, 5 * PARTICLES))(keys)

    def separate(keys: Any) -> Any:
        return jax.vmap(lambda lane: [jax.random.uniform(key, (5 * PARTICLES,)) for key in lane])(
            keys
        )

    return shared, separate, keys


TRICKS = (batch_axes_last, rows, short_tables, worked_out_once, one_table, one_draw)


def compile_program(program: Program, inputs: Any) -> tuple[Program, float]:
    """Compile a program, and measure the CPU seconds it takes."""
    begin = time.process_time()
    compiled = jax.jit(program).lower(inputs).compile()
    seconds = time.process_time() - begin
    jax.block_until_ready(compiled(inputs))
    return compiled, seconds


def call_repeatedly(program: Program, inputs: Any) -> list[Any]:
    """Call a program ``CALLS`` times."""
    return [program(inputs) for _ in range(CALLS)]


def entries(*, is_quick: bool = False) -> list[Measurement]:
    """Measure every case, optimized and plain alternately."""
    repetitions, table = 5 if is_quick else 25, []
    for trick in TRICKS:
        *programs, inputs = trick()
        compiled = [compile_program(program, inputs) for program in programs]
        samples: list[list[float]] = [[], []]
        for _ in range(repetitions):
            for cpu_times, (program, _) in zip(samples, compiled, strict=True):
                cost = measure(functools.partial(call_repeatedly, program, inputs), 1)
                cpu_times.append(cost.cpu / CALLS)
        ours, plain = (1e6 * float(np.median(cpu_times)) for cpu_times in samples)
        name = trick.__name__.replace("_", " ")
        table.append(entry(name, ours, "µs CPU", baseline=plain, ratio=plain / ours))
        (_, ours), (_, plain) = compiled
        table.append(entry(f"{name}, compiled", ours, "s CPU", baseline=plain, ratio=plain / ours))
    return table


if __name__ == "__main__":
    record.main(entries, __doc__, pinning.CORE)
