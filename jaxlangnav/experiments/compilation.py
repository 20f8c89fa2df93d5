"""How long JAX has compiled: compilation is reported apart from the work itself."""

import time
from types import TracebackType
from typing import Self

import jax.monitoring

_COMPILE_EVENTS = "/jax/core/compile/"


class CompileClock:
    """Context manager: seconds in which at least one thread traced, lowered or compiled.

    Nested and parallel compilations count once: ``seconds`` is the length of the union of their
    intervals, so it never exceeds the time that passed.
    """

    def __enter__(self) -> Self:
        """Start the clock: ask JAX to report."""
        self.seconds = 0.0
        self._intervals: list[tuple[float, float]] = []
        jax.monitoring.register_event_duration_secs_listener(self._listen)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop the clock."""
        jax.monitoring.unregister_event_duration_listener(self._listen)
        self.seconds = union_length(self._intervals)

    def _listen(self, event: str, duration_secs: float, **kwargs: str | int) -> None:
        """Note when a trace, a lowering or a compilation began and ended."""
        del kwargs
        if event.startswith(_COMPILE_EVENTS):
            now = time.perf_counter()
            self._intervals.append((now - duration_secs, now))


def union_length(intervals: list[tuple[float, float]]) -> float:
    """Measure the union of intervals.

    Args:
        intervals: begin and end of each, in any order.

    Returns:
        Its length; overlaps count once.
    """
    total, reached = 0.0, float("-inf")
    for begin, end in sorted(intervals):
        total += max(0.0, end - max(begin, reached))
        reached = max(reached, end)
    return total
