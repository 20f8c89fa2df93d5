"""Rows of Table 2 and Figure 5: specifications, published values, bounds, deviations (4.2)."""

import dataclasses
import math
from collections.abc import Sequence

from jaxlangnav.experiments.table import Row
from jaxlangnav.experiments.tasks import SENTENCES, Cell
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.world.templates import TABLE_2, TableRow, known_map_distance, parse_template

PAPER_RUNS = 100  # simulations per published value: "approximately 100" (section 4.2)
MAX_Z = 2.0  # standard errors within which two values agree


@dataclasses.dataclass(frozen=True, kw_only=True)
class RowSpec:
    """Key of a row: world, range and relation."""

    world: str
    range: float
    relation: str  # a key of ``SENTENCES``

    @classmethod
    def of(cls, row: TableRow) -> "RowSpec":
        """Build the key of a published row."""
        return cls(world=row.world, range=row.range, relation=row.relation)

    def heading(self) -> Row:
        """Return the entries that identify the row; relation None for a command without one."""
        relation = None if self.relation == "null" else self.relation
        return {"world": self.world, "range": self.range, "relation": relation}

    def setting(self, *, seed: int, sensor: SensorParams | None = None) -> Cell:
        """Build the setting of its episodes; commands are numbered in the order of ``SENTENCES``.

        ``sensor``: sensor model, except its range; the default one if None.
        """
        default = default_sensor(self.range)
        return Cell(
            world=self.world,
            relation=self.relation,
            instruction_index=list(SENTENCES).index(self.relation),
            sensor=default if sensor is None else replace(sensor, range_max=default.range_max),
            seed=seed,
            labels={"world": self.world, "range": self.range, "relation": self.relation},
        )


TABLE2_ROWS = tuple(RowSpec.of(row) for row in TABLE_2)  # the rows of Table 2, in the paper's order


def published_rows(table: Sequence[TableRow]) -> list[Row]:
    """Convert published rows to records, rates in percent, distances in metres."""
    return [{**row._asdict(), **RowSpec.of(row).heading(), "policy": "paper"} for row in table]


def bound_rows(specs: Sequence[RowSpec]) -> list[Row]:
    """Compute bounds on the performance of any policy in each row (section 4.2).

    ``known``: mean straight-line distance, metres; ``success``: the highest rate, percent, below
    100 where the sentence fits several objects.
    """
    rows = []
    for spec in specs:
        template = parse_template(spec.world)
        success_rate = 1.0 / template.num_hydrants if spec.relation == "null" else 1.0
        mean, _ = known_map_distance(template, spec.relation)
        rows.append(spec.heading() | {"known": mean, "success": 100.0 * success_rate})
    return rows


def describe_noise(
    sensor: SensorParams | None = None, motion: MotionParams | None = None
) -> dict[str, float]:
    """Summarise sensor and motion noise, the default one if None: metres, radians, fractions."""
    sensor, motion = sensor or default_sensor(), motion or default_motion()
    noise = {
        "detection_probability": sensor.detection_probability,
        "detection_noise": sensor.noise,
        "field_of_view": sensor.field_of_view,
        "odometry_noise": motion.odometry_noise,
        "step_length": motion.step_length,
    }
    return {name: round(float(value), 6) for name, value in noise.items()}


def row_key(row: Row) -> tuple[str, float, str | None]:
    """Return the key of a row, independent of the policy."""
    return row["world"], row["range"], row["relation"]


def deviations(row: Row, paper: Row) -> dict[str, float]:
    """Compute z-scores of a row against the published one, with the standard errors of both.

    A rate of 0 or 100 % counts as half a run away from it, so that its error is not zero.
    """
    dist_error = math.hypot(distance_error(row), paper["distance_sd"] / math.sqrt(PAPER_RUNS))
    success_error = math.hypot(
        rate_error(row["success_rate"], row["episodes"]),
        rate_error(paper["success_rate"], PAPER_RUNS),
    )
    return {
        "distance": (row["distance_mean"] - paper["distance_mean"]) / max(dist_error, 1e-9),
        "success": (row["success_rate"] - paper["success_rate"]) / success_error,
    }


def distance_error(row: Row) -> float:
    """Compute the standard error of a row's mean distance, metres."""
    return row["distance_sd"] / math.sqrt(max(1, row["episodes"]))


def rate_error(percent: float, runs: int) -> float:
    """Compute the standard error of a rate, percent; 0 and 100 % count as half a run away."""
    rate = min(max(percent / 100.0, 0.5 / max(1, runs)), 1.0 - 0.5 / max(1, runs))
    return 100.0 * math.sqrt(rate * (1.0 - rate) / max(1, runs))
