"""Messages that are lost, doubled, and late, so that others overtake them: for trying a node."""

import heapq
import itertools
from typing import Generic, TypeVar

import numpy as np

Message = TypeVar("Message")
_LONGEST = 1.0
"""Seconds by which a message may be late."""


class UnrulyChannel(Generic[Message]):
    """Hands on messages as a bad network does."""

    def __init__(self, share: float, seed: int) -> None:
        """Begin with nothing under way.

        Args:
            share: of messages that are lost, and of those doubled, and of those late; each.
            seed: of what becomes of which.

        Raises:
            ValueError: no such share.
        """
        if not 0.0 <= share <= 0.3:
            raise ValueError(f"a share of {share:g} of messages cannot be lost: give 0 to 0.3")
        self._share = share
        self._random = np.random.default_rng(seed)
        self._count = itertools.count()
        self._under_way: list[tuple[float, int, Message]] = []

    def put(self, message: Message, now: float) -> None:
        """Send a message.

        Args:
            message: anything.
            now: seconds.
        """
        draw = self._random.uniform() / max(self._share, 1e-9)
        if draw < 1.0:
            return
        late = self._random.uniform(0.0, _LONGEST) if draw > 2.0 and draw < 3.0 else 0.0
        for delay in (0.0, 0.1) if draw < 2.0 else (late,):
            heapq.heappush(self._under_way, (now + delay, next(self._count), message))

    def take(self, now: float) -> list[Message]:
        """Receive what has come by now, in the order in which it comes."""
        come = []
        while self._under_way and self._under_way[0][0] <= now:
            come.append(heapq.heappop(self._under_way)[2])
        return come
