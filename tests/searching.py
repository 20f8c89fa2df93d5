"""How far ``Navigator`` walks to find a thing, in plain NumPy places that share no code with ours.

The robot stands at the middle of one side, or at the centre of a square. One line a row:

    python tests/searching.py --episodes 100 behind none --set absent=0.01
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import outside

Things = list[tuple[str, np.ndarray]]
"""Name and place of each thing, metres; the goal first."""


def _polar(metres: float, bearing: float) -> np.ndarray:
    return metres * np.array([np.cos(bearing), np.sin(bearing)])


def pair(random: np.random.Generator, near: float, far: float, turned: float = 0.0) -> Things:
    """Draw a cone so far away, and a hydrant 1.5 to 3.5 m from it, behind it but for a turn."""
    bearing = random.uniform(-1.22, 1.22)
    cone = _polar(random.uniform(near, far), bearing)
    aside = turned + np.radians(random.uniform(-30.0, 30.0))
    return [("hydrant", cone + _polar(random.uniform(1.5, 3.5), bearing + aside)), ("cone", cone)]


def by_robot(random: np.random.Generator) -> Things:
    """Draw a hydrant on the robot's right and another one on its left."""
    return [
        ("hydrant", _polar(random.uniform(4.0, 12.0), np.radians(random.uniform(55, 125)) * turn))
        for turn in (-1.0, 1.0)
    ]


def in_a_row(random: np.random.Generator) -> Things:
    """Draw three hydrants ahead, the second from the left first."""
    bearings = np.radians(np.array([0.0, 45.0, -45.0]) + random.uniform(-10.0, 10.0, 3))
    return [("hydrant", _polar(random.uniform(4.0, 11.0), bearing)) for bearing in bearings]


_PAIR = functools.partial(pair, near=3.0, far=11.0)
_TURNED = functools.partial(_PAIR, turned=np.pi)


@dataclasses.dataclass(frozen=True)
class Row(outside.Scenario):
    """One sentence, and places of one kind."""

    draw: Callable[[np.random.Generator], Things] = _PAIR
    area: tuple[float, float, float, float] = (0.0, 14.0, -9.0, 9.0)
    steps: int = 200

    def furnish(self, random: np.random.Generator, types: tuple[str, ...]) -> outside.Place:
        """Draw a place: all within the area, nothing crowded, and one hydrant behind a cone."""
        low, high = np.array(self.area[::2]) + 0.5, np.array(self.area[1::2]) - 0.5
        while True:
            things = self.draw(random)
            for _ in range(self.extra_pairs):
                things += [(name, random.uniform(low, high)) for name in ("hydrant", "cone")]
            at = np.array([place for _, place in things]).reshape(-1, 2)
            gaps = np.hypot(*(at[:, None] - at[None]).transpose(2, 0, 1)) + 9.0 * np.eye(len(at))
            is_placed = bool((gaps >= 0.9).all() and ((at >= low) & (at <= high)).all())
            if is_placed and not (self.extra_pairs and self._is_ambiguous(things)):
                return outside.Place(np.array([types.index(name) for name, _ in things], int), at)

    def _is_ambiguous(self, things: Things) -> bool:
        at = {name: [one for kind, one in things if kind == name] for name in ("hydrant", "cone")}
        return sum(outside.is_behind(one, two) for one in at["hydrant"] for two in at["cone"]) != 1


PLAIN = "go to the hydrant"
_LARGE = functools.partial(
    Row, draw=functools.partial(pair, near=16.0, far=19.0), area=(0.0, 40.0, -20.0, 20.0),
    reach=5.0, steps=500,
)  # fmt: skip


def _of_side(side: float, sentence: str) -> Row:
    """A place of so many metres a side."""
    return Row(
        sentence=sentence,
        draw=functools.partial(pair, near=0.25 * side, far=0.6 * side),
        area=(0.0, side, -0.5 * side, 0.5 * side),
        reach=3.0 if side < 20.0 else 5.0,
        steps=int(80 + 12 * side),
    )


ROWS = {
    "behind": Row(),
    "none": Row(sentence=PLAIN),
    "pairs": Row(extra_pairs=2),
    "front": Row(sentence="go to the hydrant in front of the cone", draw=_TURNED),
    "false": Row(sentence="go to the hydrant left of the cone"),
    "large_behind": _LARGE(),
    "large_none": _LARGE(sentence=PLAIN),
    "empty": Row(draw=lambda _: [], is_empty=True),
    "no_landmark": Row(draw=lambda random: _PAIR(random)[:1]),
    "right": Row(sentence=f"{PLAIN} on your right", draw=by_robot, area=(-14, 14, -14, 14)),
    "second": Row(sentence="go to the second hydrant from the left", draw=in_a_row),
} | {
    f"{name}_{side}": _of_side(float(side), sentence)
    for side in (8, 14, 25, 40, 60)
    for name, sentence in (("behind", outside.SENTENCE), ("none", PLAIN))
}  # fmt: skip


if __name__ == "__main__":
    outside.main(ROWS)
