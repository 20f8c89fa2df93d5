"""How far from this machine's limits: XLA's count of work over the peaks measured here.

The least time of a piece of work is the larger of its operations over the peak rate of operations
and its bytes over the peak bandwidth; what it really takes over that least time is its distance
from the limit (the roofline model of Williams, Waterman and Patterson, 2009). Peaks are those of
one core, reached by small kernels compiled by the same XLA. XLA counts the body of a loop once
and every operand of every fused kernel, whether it lies in a cache or not.
"""

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array
from record import Measurement, entry

from jaxlangnav.experiments.timing import Part, measure

_SIDE = 768
"""Rows of the matrices whose product is timed."""
_SIZES = (2**14, 2**16, 2**18, 2**20, 2**24)
"""Numbers in the arrays that are streamed; the last ones do not fit into a cache."""

_ROUNDS = 8
"""Times an array is streamed in one call, so that the call itself does not count."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Peaks:
    """What one core reaches."""

    operations: float
    """Floating-point operations a second, float32."""
    bandwidth: float
    """Bytes a second, read and written, in the cache that is fastest."""
    memory_bandwidth: float
    """Bytes a second from and to main memory."""

    def least_seconds(self, part: Part) -> float:
        """Compute the least time a part can take."""
        return max(part.operations / self.operations, part.memory / self.bandwidth)


def measure_peaks(repetitions: int = 5) -> Peaks:
    """Measure the peaks of one core by a matrix product and by streaming.

    Args:
        repetitions: how often; the best counts, as nothing can be faster than it may be.

    Returns:
        The peaks, per CPU second.
    """
    square = jnp.ones((_SIDE, _SIDE), jnp.float32)
    product = _best(jax.jit(lambda a: a @ a), square, 4, repetitions)
    rates = []
    for size in _SIZES:
        calls = max(1, 2**22 // size)
        seconds = _best(jax.jit(_stream), jnp.ones(size), calls, repetitions)
        rates.append(2.0 * 4.0 * size * _ROUNDS / seconds)
    return Peaks(
        operations=2.0 * _SIDE**3 / product,
        bandwidth=max(rates),
        memory_bandwidth=rates[-1],
    )


def _stream(values: Array) -> Array:
    """Read and write an array again and again."""
    return jax.lax.fori_loop(0, _ROUNDS, lambda _, own: own * 0.5 + 1.0, values)


def _best(work: Callable[[Array], Array], values: Array, calls: int, repetitions: int) -> float:
    """Time one call, CPU seconds, at its best."""
    jax.block_until_ready(work(values))
    costs = [
        measure(lambda: [work(values) for _ in range(calls)][-1], 1).cpu for _ in range(repetitions)
    ]
    return min(costs) / calls


def distances(parts: list[Part], peaks: Peaks) -> list[Measurement]:
    """Say how far each part is from the limit.

    Args:
        parts: of ``measure_parts``, the whole cycle first.
        peaks: of this machine.

    Returns:
        Entries: the peaks, the work of a cycle, and for each part its time over the least time.
    """
    whole = parts[0]
    entries = [
        entry("peak operations of a core", 1e-9 * peaks.operations, "Gflop/s"),
        entry("peak bandwidth of a core, cache", 1e-9 * peaks.bandwidth, "GB/s"),
        entry("peak bandwidth of a core, memory", 1e-9 * peaks.memory_bandwidth, "GB/s"),
        entry("operations of a cycle, XLA's count", 1e-6 * whole.operations, "Mflop"),
        entry("bytes of a cycle, XLA's count", 1e-6 * whole.memory, "MB"),
    ]
    for part in parts:
        least, taken = 1e6 * peaks.least_seconds(part), 1e6 * part.seconds
        name = f"{part.name} of one lane against its least time at these peaks"
        entries.append(entry(name, taken, "µs CPU", baseline=least, ratio=least / taken))
    return entries
