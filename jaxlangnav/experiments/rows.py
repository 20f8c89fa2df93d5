"""Rows of Table 2 and Figure 5: ours, the printed ones, and limits that hold for both (4.2)."""

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np

from jaxlangnav.experiments.table import Row
from jaxlangnav.experiments.tasks import SENTENCES, Cell
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.world.scenario import AREA_SIGMAS
from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.templates import TABLE_2, TableRow, known_range, parse_template

PAPER_RUNS = 100  # simulations behind a printed figure: "approximately 100" (section 4.2)
AGREEMENT = 2.0  # standard errors within which two figures agree


@dataclasses.dataclass(frozen=True, kw_only=True)
class RowSpec:
    """Which row it is."""

    world: str
    range: float
    relation: str  # a key of ``SENTENCES``

    @classmethod
    def of(cls, printed: TableRow) -> "RowSpec":
        """Take from a printed row which one it is."""
        return cls(world=printed.world, range=printed.range, relation=printed.relation)

    def heading(self) -> Row:
        """Say which row it is in a document; a command without a relation has None."""
        relation = None if self.relation == "null" else self.relation
        return {"world": self.world, "range": self.range, "relation": relation}

    def setting(
        self, *, seed: int, environments: int = 0, sensor: SensorParams | None = None
    ) -> Cell:
        """Build the setting of its episodes; commands are numbered in the order of ``SENTENCES``.

        ``environments``: worlds of a template taken in turn; 0 for a fresh one per episode.
        ``sensor``: the detector, but for its range; the default one if None.
        """
        usual = default_sensor(self.range)
        return Cell(
            world=self.world,
            relation=self.relation,
            instruction_index=list(SENTENCES).index(self.relation),
            sensor=usual if sensor is None else replace(sensor, range_max=usual.range_max),
            seed=seed,
            environments=environments,
            labels={"world": self.world, "range": self.range, "relation": self.relation},
        )


PRINTED = tuple(RowSpec.of(one) for one in TABLE_2)  # the rows of Table 2, in the paper's order


def printed_rows(printed: Sequence[TableRow]) -> list[Row]:
    """List rows as the paper prints them, rates in percent, distances in metres."""
    return [
        RowSpec.of(row).heading()
        | {
            "policy": "paper",
            "success_rate": row.success_ours,
            "distance_mean": row.distance_ours,
            "distance_sd": row.distance_ours_sd,
            "known_success_rate": row.success_known,
            "known_distance_mean": row.distance_known,
            "known_distance_sd": row.distance_known_sd,
        }
        for row in printed
    ]


def bound_rows(specs: Sequence[RowSpec]) -> list[Row]:
    """Compute the limits of every row: metres, and ``success`` in percent."""
    return [one.heading() | limits(one.world, one.relation, one.range) for one in specs]


def describe_noise(
    sensor: SensorParams | None = None, motion: MotionParams | None = None
) -> dict[str, float]:
    """Say the noise that rows run under, the default one if None: metres, radians, shares."""
    sensor, motion = sensor or default_sensor(), motion or default_motion()
    said = {
        "detection_probability": sensor.detection_probability,
        "detection_noise": sensor.noise,
        "field_of_view": sensor.field_of_view,
        "odometry_noise": motion.odometry_noise,
        "step_length": motion.step_length,
    }
    return {name: round(float(value), 6) for name, value in said.items()}


def row_key(row: Row) -> tuple[str, float, str | None]:
    """Identify a row of a table, whatever the policy."""
    return row["world"], row["range"], row["relation"]


def deviations(row: Row, paper: Row) -> dict[str, float]:
    """Measure how far a row lies above the printed one, in standard errors of both.

    A rate of 0 or 100 % counts as half a run away from it, or it would have no error at all.
    """
    way_error = math.hypot(distance_error(row), paper["distance_sd"] / math.sqrt(PAPER_RUNS))
    success_error = math.hypot(
        rate_error(row["success_rate"], row["episodes"]),
        rate_error(paper["success_rate"], PAPER_RUNS),
    )
    return {
        "distance": (row["distance_mean"] - paper["distance_mean"]) / max(way_error, 1e-9),
        "success": (row["success_rate"] - paper["success_rate"]) / success_error,
    }


def distance_error(row: Row) -> float:
    """Compute the standard error of a row's mean distance, metres."""
    return row["distance_sd"] / math.sqrt(max(1, row["episodes"]))


def rate_error(percent: float, runs: int) -> float:
    """Compute the standard error of a rate, percent; 0 and 100 % count as half a run away."""
    rate = min(max(percent / 100.0, 0.5 / max(1, runs)), 1.0 - 0.5 / max(1, runs))
    return 100.0 * math.sqrt(rate * (1.0 - rate) / max(1, runs))


# Limits no robot can beat in these worlds, by computation (section 4.2).
#
# - The known map: the straight way to the goal.
# - Search without a hint. Call D the way of a robot that sees R metres all round, misses nothing
#   and starts at the origin, until it is within s = 1.5 m of a goal that stands at range r from
#   there.
#
#   *Sight comes first.* Where the goal comes into view after L metres it is min(r, R) away, so D ≥
#   L + min(r, R) − s. Until then the robot has been told nothing: its path is what it would walk
#   wherever the goal is, and the goal is seen by L exactly if it lies in the union S(L) of all
#   looks along that path.
#
#   *What a path can have seen.* One metre of it adds at most 2R square metres to S. A place at
#   range ρ > R is in no look before the robot is at range ρ − R, which takes ρ − R metres; so for
#   every ρ
#
#       |S(L) ∩ {range ≥ ρ}| ≤ |first look ∩ {range ≥ ρ}| + 2R · max(0, L − max(0, ρ − R))
#
#   *The likeliest such set.* Of all sets that keep these bounds none holds the goal more probably
#   than the one that takes rings about the start in the order of their density, of each as much as
#   the bounds of all smaller ρ leave: they are bounds on nested sets, for which the greedy choice
#   is the best. With F(L) its probability, and k goals of which any will do, however they stand to
#   one another,
#
#       E[D] ≥ ∫ max(0, 1 − k F(max(0, x − max(0, R − s)))) dx
#
#   Both sums are taken so that they err downwards: rings count from their inner edge, and every
#   step of x with the probability at its end.
#
# They hold where the sentence gives no relation: a relation makes the landmark a hint. With one,
# what is proved is the straight way, 1.5 m short of the goal: the same sums for the first sight of
# figure or landmark, whichever comes first, gave no more in the rows of Table 2.

_SECTOR = math.pi / 2.0  # radians: hydrants stand within ±45° of the start's heading
_RINGS, _STEPS, _ANGLES = 200, 800, 720
"""Rings about the start, steps of the way, and directions in which a ring is held to the area."""


def _likeliest_share(
    edges: np.ndarray, area: np.ndarray, mass: np.ndarray, sensing_range: float, way: np.ndarray
) -> np.ndarray:
    """Bound the probability that a goal has come into view, whatever the path."""
    # Limits: the mass of the first look for no way at all; 1 for a long one.
    inner = edges[:-1]
    first = np.where(inner < sensing_range, area, 0.0)
    since = np.maximum(0.0, way[:, None] - np.maximum(0.0, inner - sensing_range))
    room = np.cumsum(first[::-1])[::-1] + 2.0 * sensing_range * since
    found = np.zeros(way.shape)
    for ring in np.argsort(-mass / np.maximum(area, 1e-12), kind="stable"):
        taken = np.minimum(area[ring], room[:, : ring + 1].min(axis=1))
        room[:, : ring + 1] -= taken[:, None]
        found += mass[ring] * taken / max(area[ring], 1e-12)
    return np.minimum(found, 1.0)


def _search_bound(
    edges: np.ndarray, area: np.ndarray, mass: np.ndarray, sensing_range: float, num_goals: int
) -> float:
    """Bound the mean way of a search that ends within 1.5 m of a goal."""
    #     E[D] ≥ ∫ max(0, 1 − k F(max(0, x − max(0, R − s)))) dx
    # Limits: the mean straight way less 1.5 m for a large R and one goal.
    longest = edges[-1] + float(area.sum()) / (2.0 * sensing_range)
    ends = np.linspace(0.0, longest, _STEPS + 1)[1:]
    way = np.maximum(0.0, ends - max(0.0, sensing_range - SUCCESS_RADIUS))
    found = _likeliest_share(edges, area, mass, sensing_range, way)
    # What is in view from the start is not reached before it has been walked to.
    within = mass @ (edges[:-1, None] <= ends + SUCCESS_RADIUS)
    missed = np.maximum(0.0, 1.0 - num_goals * np.minimum(found, within))
    return float(np.sum(missed) * ends[0])


@functools.cache
def _uniform_search_bound(
    depth: float, width: float, sensing_range: float, num_goals: int = 1
) -> float:
    """Bound the mean way to a goal that may be anywhere alike in the operating area."""
    # Limits: near A / 4R for a small R.
    edges = np.linspace(0.0, math.hypot(depth, 0.5 * width), _RINGS + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    angle = (np.arange(_ANGLES) + 0.5) / _ANGLES * math.pi - 0.5 * math.pi
    x, y = middle[:, None] * np.cos(angle), middle[:, None] * np.abs(np.sin(angle))
    is_in = (x <= depth) & (y <= 0.5 * width)
    area = 0.5 * math.pi * is_in.mean(axis=1) * np.diff(edges**2)
    return _search_bound(edges, area, area / area.sum(), sensing_range, num_goals)


@functools.cache
def _law_search_bound(mean: float, sd: float, sensing_range: float, num_goals: int = 1) -> float:
    """Bound the mean way to a goal drawn by the worlds' law: range N(mean, sd), bearing ±45°."""
    # Limits: mean − 1.5 m for a large R and one goal.
    edges = np.linspace(max(0.0, mean - 5.0 * sd), mean + 5.0 * sd, _RINGS + 1)
    below = np.array([0.5 * math.erfc((mean - edge) / (sd * math.sqrt(2.0))) for edge in edges])
    mass = np.diff(below) / (below[-1] - below[0])
    area = 0.5 * _SECTOR * np.diff(edges**2)
    return _search_bound(edges, area, mass, sensing_range, num_goals)


def limits(template: str, relation: str, sensing_range: float) -> dict[str, float | None]:
    """Gather the limits of one row of a table, such as "2H1C", "behind", 3 m.

    ``known``: mean straight way, metres; ``search_uniform``, ``search_law``: least mean distance of
    a search without a hint, None where the sentence gives one; ``success``: the highest success
    rate in percent, below 100 where the sentence fits several objects.
    """
    record = parse_template(template)
    mean, sd = known_range(record, relation)
    if relation != "null":
        return {"known": mean, "search_uniform": None, "search_law": None, "success": 100.0}
    number = record.num_hydrants
    depth = mean + AREA_SIGMAS * sd  # how far the operating area reaches ahead; √2 D wide
    area = depth, math.sqrt(2.0) * depth
    return {
        "known": mean,
        "search_uniform": _uniform_search_bound(*area, sensing_range, number),
        "search_law": _law_search_bound(mean, sd, sensing_range, number),
        "success": 100.0 / number,
    }
