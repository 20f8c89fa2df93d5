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
_DOUBT = 0.01  # number of things before one of a rank, expected at most
_SHORT = 1.08  # metres before a goal at which a robot halts


@dataclasses.dataclass(frozen=True)
class Row(outside.Scenario):
    """One sentence, and places of one kind."""

    draw: Callable[[np.random.Generator], Things] = _PAIR
    area: tuple[float, float, float, float] = (0.0, 14.0, -9.0, 9.0)
    steps: int = 200
    side: float | None = None  # radians, of the robot: where goal or landmark is said to be
    relation: str | None = None  # of goal and cone
    is_cone: bool = False  # it is the cone that is on that side

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
_SIDES = {"right": (-0.5, "on your right"), "left": (0.5, "on your left"),
          "back": (1.0, "behind you"), "ahead": (0.0, "in front of you")}  # fmt: skip
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
        side=turn, relation=relation, is_cone=is_cone,
    )  # fmt: skip


def _of_side(side: float, sentence: str) -> Row:
    """A place of so many metres a side."""
    return Row(
        sentence=sentence, draw=functools.partial(pair, near=0.25 * side, far=0.6 * side),
        area=(0.0, side, -0.5 * side, 0.5 * side), reach=3.0 if side < 20.0 else 5.0,
        steps=int(80 + 12 * side),
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
    "_".join([side, of or "robot", "cone"][: 2 + is_cone]): _by_robot(side, of, is_cone=is_cone)
    for side in _SIDES
    for of in (None, *_BESIDE)
    for is_cone in (False, True)[: 1 + (of is not None)]
} | {
    f"{name}_{side}": _of_side(float(side), sentence)
    for side in (8, 14, 25, 40, 60)
    for name, sentence in (("behind", outside.SENTENCE), ("none", PLAIN))
}  # fmt: skip


def handed(row: Row, place: outside.Place, seed: int) -> float:
    """Measure the way, metres, of a search that is handed the relations' density as its map.

    It always makes for the place that shows most of what is left of it a metre, on cells of a
    metre, and goes up to the goal once it has seen that and the thing that tells it: the second.
    A rank asks too that hardly another, at the rate of those seen, can stand before the goal.
    """
    random, (cells, joint) = np.random.default_rng([seed, 41]), _joint(row)
    is_near = np.hypot(*(cells[:, None] - cells[None]).T) <= row.reach
    at, metres, unseen, where = np.zeros(2), 0.0, np.ones(len(cells)), joint.sum(0)
    lacking = {"goal", "cone"} if len(joint) > 1 or row.draw is in_a_row else {"goal"}
    while metres < row.steps:
        unseen[np.hypot(*(cells - at).T) <= row.reach] *= row.misses
        for name, thing in zip(("goal", "cone"), place.at, strict=False):
            is_seen = np.hypot(*(thing - at)) <= row.reach and random.uniform() >= row.misses
            if is_seen and name in lacking:
                cell = np.argmin(np.hypot(*(cells - thing).T))
                lacking = lacking - {name}
                where = joint[:, cell] if name == "goal" else joint[cell % len(joint)]
        if row.draw is in_a_row and not lacking:
            where = (cells[:, 1] > place.at[0][1]).astype(float)
            is_sure = len(place.at) * where @ unseen <= _DOUBT * (1.0 - unseen).sum()
        if not lacking and (row.draw is not in_a_row or is_sure):
            return metres + max(float(np.hypot(*(place.at[0] - at))) - _SHORT, 0.0)
        spans = np.hypot(*(cells - at).T)
        aim = cells[np.argmax(is_near @ (where * unseen) / (0.5 + spans))] - at
        step = min(1.0, np.hypot(*aim)) * aim / max(np.hypot(*aim), 1e-9)
        at, metres = at + step, metres + float(np.hypot(*step))
    return metres


def _weigh(relation: str | None, span: np.ndarray, turn: np.ndarray | float) -> np.ndarray:
    """Weigh spans [..., 2] from a landmark as a relation to it does, or a side of the robot."""
    away, bearing = np.hypot(*np.moveaxis(span, -1, 0)), np.arctan2(span[..., 1], span[..., 0])
    if relation is None:
        return np.exp(4.0 * np.cos(bearing - turn))
    aside = bearing - turn - np.pi * _BESIDE[relation][0]
    directed = 0.0 if relation == "near" else 12.0 * np.cos(aside)
    far = np.log(np.maximum(away, 0.1) / (2.2 if relation == "near" else 2.4)) / 0.35
    return np.exp(directed - 0.5 * far**2) / np.maximum(away, 0.1) ** 2


@functools.lru_cache
def _joint(row: Row) -> tuple[np.ndarray, np.ndarray]:
    """Weigh where cone and goal are by what is said: [C, 2] cells of a metre, [C or 1, C]."""
    x, y = np.meshgrid(*(np.arange(*row.area[k : k + 2]) + 0.5 for k in (0, 2)))
    cells = np.stack([x.ravel(), y.ravel()], -1)
    here = np.ones(len(cells)) if row.side is None else _weigh(None, cells, row.side)
    if row.relation is None:
        return cells, here[None]
    turn = np.arctan2(cells[:, 1], cells[:, 0])[:, None]
    beside = _weigh(row.relation, cells[None] - cells[:, None], turn)
    beside /= beside.sum(1, keepdims=True)
    return cells, beside * (here[:, None] if row.is_cone else here[None])


def as_told(row: Row) -> Row:
    """Build the row whose places are drawn by the density that ``handed`` has as its map."""

    def draw(random: np.random.Generator) -> Things:
        cells, joint = _joint(row)
        cone, goal = divmod(random.choice(joint.size, p=joint.ravel() / joint.sum()), len(cells))
        at = cells[[goal, cone]] + random.uniform(-0.5, 0.5, (2, 2))
        return list(zip(("hydrant", "cone")[: 1 + (len(joint) > 1)], at, strict=False))

    return dataclasses.replace(row, draw=draw)


ROWS |= {f"{name}_told": as_told(row) for name, row in ROWS.items() if row.side is not None}


def compare(row: Row, outcome: outside.Outcome, seed: int) -> str:
    """Hold the way against that of a search that is handed where goals are; "" without one."""
    if row.is_empty:
        return ""
    rides = [outside.Ride(row, seed + k, ("hydrant", "cone")) for k in range(len(outcome.metres))]
    best = np.mean([handed(row, one.place, one.seed) for one in rides])
    return f"  handed the density {best:.1f} m, {outcome.metres.mean() / best:.2f} of it"


if __name__ == "__main__":
    outside.main(ROWS, compare)
