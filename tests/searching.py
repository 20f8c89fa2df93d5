"""How far ``Navigator`` walks to find a thing, in plain NumPy places that share no code with ours.

The robot stands at the middle of one side, or at the centre of a square. One line a row:

    python tests/searching.py --episodes 100 behind none --set absent=0.01
"""

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import outside

_AWAY = (1.5, 4.0), (6.0, 10.0)
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


def by_robot(random: np.random.Generator, side: float, turned: float | None = None) -> Things:
    """Draw a hydrant on a side of the robot, or a pair, and the like opposite; radians."""
    things: Things = []
    for turn in (0.0, 180.0):
        bearing = side + np.radians(turn + random.uniform(-35.0, 35.0))
        place = _polar(random.uniform(4.0, 10.0), bearing)
        aside = bearing + (turned or 0.0) + np.radians(random.uniform(-30.0, 30.0))
        beside = place + _polar(random.uniform(1.5, 3.5), aside)
        things += [("hydrant", place)] if turned is None else [("hydrant", beside), ("cone", place)]
    return things


def far_off(random: np.random.Generator, *, is_far: bool) -> Things:
    """Draw a hydrant near the robot and one far from it, in the order asked for."""
    places = [_polar(random.uniform(*away), random.uniform(-np.pi, np.pi)) for away in _AWAY]
    return [("hydrant", place) for place in places[:: -1 if is_far else 1]]


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

_AROUND = functools.partial(Row, area=(-14.0, 14.0, -14.0, 14.0))
_SIDES = {
    "right": (-0.5, "on your right"), "left": (0.5, "on your left"), "back": (1.0, "behind you"),
    "ahead": (0.0, "in front of you"),
}  # fmt: skip
"""In half turns from straight ahead."""
_BESIDE = {"behind": (0.0, "behind"), "front": (1.0, "in front of"), "left": (0.5, "left of"),
           "right": (-0.5, "right of"), "near": (0.5, "near")}  # fmt: skip
"""In half turns from straight behind the cone."""


def _by_robot(side: str, relation: str | None, *, is_cone: bool) -> Row:
    """A place in which a side of the robot tells things apart."""
    turn, where = np.pi * _SIDES[side][0], _SIDES[side][1]
    turned, of = (None, "") if relation is None else _BESIDE[relation]
    words = where if relation is None else f"{where} {of} the cone"
    return _AROUND(
        sentence=f"{PLAIN} {of} the cone {where}" if is_cone else f"{PLAIN} {words}",
        draw=functools.partial(by_robot, side=turn, turned=turned and np.pi * turned),
    )  # fmt: skip


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
    "second": Row(sentence="go to the second hydrant from the left", draw=in_a_row),
    "near": _AROUND(sentence=f"{PLAIN} near you", draw=functools.partial(far_off, is_far=False)),
    "far": _AROUND(sentence=f"{PLAIN} far from you", draw=functools.partial(far_off, is_far=True)),
} | {
    "_".join([side, relation or "robot", "cone"][: 2 + is_cone]): _by_robot(
        side, relation, is_cone=is_cone
    )
    for side in _SIDES
    for relation in (None, *_BESIDE)
    for is_cone in (False, True)[: 1 + (relation is not None)]
}  # fmt: skip


if __name__ == "__main__":
    outside.main(ROWS)
