"""What the paper leaves open, one thing at a time: which of it explains its figures (section 4.2)?

The paper prints no field of view, no frontier spacing, no γ, no number of particles, no threshold
of stopping and no geometry. ``faithful`` runs the rows of Table 2 once as in all our tables and
once with each of these set otherwise, in the same worlds with the same noise, and every figure is
held against the printed one in standard errors of both. A variation *explains* a row where both its
success and its distance then lie within two standard errors. Seven rows and two dozen variations
are many looks: one that explains a single row and spoils the others explains little, so the rows
that each variation brings near are counted too.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.episode import MAX_STEPS, EpisodeResult, Task
from jaxlangnav.experiments.experiment import Experiment, Options
from jaxlangnav.experiments.grid import Arm, Played, Row, policy_arm
from jaxlangnav.experiments.metrics import compare
from jaxlangnav.experiments.rows import AGREEMENT, PRINTED, deviations, distance_error, rate_error
from jaxlangnav.experiments.table import Table
from jaxlangnav.navigator import default_params
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.pytree import replace
from jaxlangnav.studies import unknowns_tables
from jaxlangnav.world.placement import OBJECT_BEARING_MAX

_POLICY = "faithful"
OURS = "as in all our tables"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Variation:
    """One thing that the paper leaves open, set to one value."""

    unknown: str
    value: str
    """For people."""
    sensor: Mapping[str, float] = dataclasses.field(default_factory=dict)
    map: Mapping[str, float] = dataclasses.field(default_factory=dict)
    planner: Mapping[str, float] = dataclasses.field(default_factory=dict)
    particle_factor: float = 1.0
    num_blocks: int = PlannerConfig().num_blocks
    """Blocks of the area a side, each with one frontier node at most."""
    max_steps: int = MAX_STEPS
    is_turned: bool = False
    """Whether each world is turned about the start by an angle of its own."""

    def arm(self, options: Options) -> Arm:
        """Build the arm that runs it.

        Args:
            options: of the run; ``params`` and ``num_particles`` where they are not what varies.

        Returns:
            The arm.
        """
        params = default_params() if options.params is None else options.params
        params = replace(
            params,
            map=replace(params.map, **_as_arrays(self.map)),
            planner=replace(params.planner, **_as_arrays(self.planner)),
        )
        arm = policy_arm(
            _POLICY,
            num_particles=max(2, round(self.particle_factor * options.num_particles)),
            params=params,
            motion=options.motion,
            told={"policy": _POLICY, "unknown": self.unknown, "value": self.value},
        )
        assert arm.config is not None
        planner = dataclasses.replace(arm.config.planner, num_blocks=self.num_blocks)
        config = dataclasses.replace(arm.config, planner=planner)
        worlds = functools.partial(_turned, seed=options.seed) if self.is_turned else None
        return dataclasses.replace(
            arm, config=config, sensor=self.sensor, max_steps=self.max_steps, worlds=worlds
        )


def _degrees(angle: float) -> dict[str, float]:
    """Open the field of view by an angle in degrees."""
    return {"field_of_view": float(np.radians(angle))}


VARIATIONS = (
    Variation(unknown=OURS, value=""),
    Variation(unknown="field of view", value="180°", sensor=_degrees(180.0)),
    Variation(unknown="field of view", value="90°", sensor=_degrees(90.0)),
    Variation(unknown="field of view", value="60°", sensor=_degrees(60.0)),
    Variation(unknown="frontier spacing", value="doubled", num_blocks=3),
    Variation(unknown="frontier spacing", value="halved", num_blocks=12),
    Variation(unknown="discount γ", value="0.5", planner={"discount": 0.5}),
    Variation(unknown="discount γ", value="0.95", planner={"discount": 0.95}),
    Variation(unknown="discount γ", value="0.99", planner={"discount": 0.99}),
    Variation(unknown="particles", value="÷ 4", particle_factor=0.25),
    Variation(unknown="particles", value="× 4", particle_factor=4.0),
    Variation(unknown="stop threshold τ", value="0.3", planner={"stop_probability": 0.3}),
    Variation(unknown="stop threshold τ", value="0.5", planner={"stop_probability": 0.5}),
    Variation(unknown="further objects α", value="0.02", map={"concentration": 0.02}),
    Variation(unknown="further objects α", value="0.1", map={"concentration": 0.1}),
    Variation(unknown="reach", value="0.8 m", planner={"reach": 0.8}),
    Variation(unknown="reach", value="1.45 m", planner={"reach": 1.45}),
    Variation(unknown="detection", value="50 %", sensor={"detection_probability": 0.5}),
    Variation(unknown="time-out", value="480 steps", max_steps=4 * MAX_STEPS),
    Variation(unknown="direction of the goal", value="any", is_turned=True),
)
"""What is varied; the first one is what all our tables run. Two values of one unknown are two
points of a line: what lies between them is for ``jaxlangnav sweep``."""


def _turned(tasks: Task, seed: int) -> Task:
    """Turn each world about the start by an angle of its own, uniform over the circle."""
    # Places relative to each other and to whoever looks from the start stay: what was behind a cone
    # still is. The operating area becomes the square [-D, D]² around the start. A world of which
    # something then stands outside the area counts as invalid.
    scenario = tasks.scenario
    number = tasks.instruction_index.shape[0]
    angle = jax.random.uniform(
        jax.random.fold_in(jax.random.key(seed), 1), (number,), maxval=2.0 * jnp.pi
    )
    cosine, sine = jnp.cos(angle)[:, None], jnp.sin(angle)[:, None]

    def turn(x: Array, y: Array) -> tuple[Array, Array]:
        return cosine * x - sine * y, sine * x + cosine * y

    x, y = turn(scenario.object_x, scenario.object_y)
    goal_x, goal_y = turn(scenario.goal[:, :1], scenario.goal[:, 1:])
    depth = scenario.area[:, 1:2]
    is_inside = (jnp.maximum(jnp.abs(x), jnp.abs(y)) <= depth) | ~scenario.is_object
    return replace(
        tasks,
        scenario=replace(
            scenario,
            object_x=x,
            object_y=y,
            goal=jnp.concatenate([goal_x, goal_y], axis=1),
            area=jnp.concatenate([-depth, depth, -depth, depth], axis=1),
            is_valid=scenario.is_valid & jnp.all(is_inside, axis=1),
        ),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Unknowns(Experiment):
    """The rows of Table 2 for every variation; the first is what the others are compared with."""

    variations: Sequence[Variation] = VARIATIONS

    def arms(self, options: Options) -> list[Arm]:
        """Build an arm for each variation."""
        return [one.arm(options) for one in self.variations]

    def rows(self, played: Played, first: Played, judged: Sequence[Row]) -> list[Row]:
        """Hold each row against the printed one, and against the first variation's.

        Args:
            played: the episodes of a variation.
            first: those of the first one.
            judged: not used, as no belief is judged here.

        Returns:
            One per row of Table 2.
        """
        del judged
        rows = []
        for place, (row, paper) in enumerate(zip(played.rows(), self.printed(), strict=True)):
            row |= self.specs[place].heading()
            (mine, _), (base, _) = played.of_setting(place), first.of_setting(place)
            rows.append(row | _against_paper(row, paper) | _against_first(mine, base))
        return rows

    def found(self, rows: Sequence[Row], options: Options) -> dict[str, Any]:
        """Say how near each variation comes to the paper, and what explains each row.

        Args:
            rows: of all variations.
            options: of the run.

        Returns:
            ``policy``, ``ours`` (what holds where it is not varied), ``variations`` (how near each
            comes over all rows), ``explained`` (by row).
        """
        return {
            "policy": _POLICY,
            "ours": _settings(options),
            "variations": [_fit(one, rows) for one in self.variations],
            "explained": [_explained(index, rows) for index in range(len(PRINTED))],
        }

    def tables(self, document: Mapping[str, Any]) -> list[Table]:
        """Lay out variations by rows, and all figures."""
        matrix = unknowns_tables.matrix(document, mark="*")
        return [matrix, unknowns_tables.long_table(document)]

    def notes(self, document: Mapping[str, Any]) -> list[str]:
        """Say what explains each row, and under what it was measured."""
        explained = unknowns_tables.explained_lines(document)
        return [*explained, *unknowns_tables.conditions(document).splitlines()]

    def markdown(self, document: Mapping[str, Any]) -> str:
        """Write the whole study in Markdown."""
        return unknowns_tables.unknowns_markdown(document)

    def render(self, document: Mapping[str, Any]) -> Any:
        """Draw the variations for the terminal, with rich."""
        return unknowns_tables.draw_unknowns(document)


def _against_paper(row: Row, paper: Row) -> Row:
    """Hold a row against the printed one."""
    far = deviations(row, paper)
    return {
        "success_se": rate_error(row["success_rate"], row["episodes"]),
        "distance_se": distance_error(row),
        "paper_success_rate": paper["success_rate"],
        "paper_distance_mean": paper["distance_mean"],
        "z_success": far["success"],
        "z_distance": far["distance"],
        "is_success_near": abs(far["success"]) <= AGREEMENT,
        "is_distance_near": abs(far["distance"]) <= AGREEMENT,
        "is_near": max(abs(z) for z in far.values()) <= AGREEMENT,
    }


def _against_first(mine: EpisodeResult, base: EpisodeResult) -> Row:
    """Compare a variation with the first one, episode by episode."""
    both = np.asarray(mine.is_valid) & np.asarray(base.is_valid)
    if not both.any():
        return {"paired": None}
    pair = compare(
        np.asarray(base.is_success)[both],
        np.asarray(mine.is_success)[both],
        np.asarray(base.distance)[both],
        np.asarray(mine.distance)[both],
    )
    return {"paired": dataclasses.asdict(pair) | {"distance_ci": [*pair.distance_ci]}}


def _fit(one: Variation, rows: Sequence[Row]) -> dict[str, Any]:
    """Say how near a variation comes to the paper over all rows."""
    mine = [row for row in rows if (row["unknown"], row["value"]) == (one.unknown, one.value)]
    z = np.array([[row["z_success"], row["z_distance"]] for row in mine])
    return {
        "unknown": one.unknown,
        "value": one.value,
        "rows_near": int(sum(row["is_near"] for row in mine)),
        "rms_z": float(np.sqrt((z**2).mean())),
    }


def _explained(index: int, rows: Sequence[Row]) -> dict[str, Any]:
    """List the variations that bring a row of Table 2 within two standard errors of the paper."""
    mine = rows[index :: len(PRINTED)]
    first, *others = mine
    named = {
        key: [_variation_name(row) for row in others if row[f"is_{key}"]]
        for key in ("near", "success_near", "distance_near")
    }
    nearest = min(mine, key=lambda row: max(abs(row["z_success"]), abs(row["z_distance"])))
    return PRINTED[index].heading() | {
        "is_near": first["is_near"],
        "is_success_near": first["is_success_near"],
        "is_distance_near": first["is_distance_near"],
        "both": named["near"],
        "success": named["success_near"],
        "distance": named["distance_near"],
        "nearest": _variation_name(nearest),
        "nearest_z": [nearest["z_success"], nearest["z_distance"]],
    }


def _settings(options: Options) -> dict[str, float]:
    """Say what holds where it is not varied."""
    params = default_params() if options.params is None else options.params
    traced = {
        "discount": params.planner.discount,
        "stop_probability": params.planner.stop_probability,
        "reach": params.planner.reach,
        "concentration": params.map.concentration,
    }
    return {name: round(float(value), 6) for name, value in traced.items()} | {
        "num_blocks": PlannerConfig().num_blocks,
        "max_steps": MAX_STEPS,
        "bearing_max": OBJECT_BEARING_MAX,
    }


def _variation_name(row: Mapping[str, Any]) -> str:
    """Name a variation: "field of view 90°"."""
    return f"{row['unknown']} {row['value']}".strip()


def _as_arrays(chosen: Mapping[str, float]) -> dict[str, Array]:
    """Turn numbers into the traced scalars of Params."""
    return {name: jnp.float32(value) for name, value in chosen.items()}


UNKNOWNS = Unknowns(
    name="unknowns", title=unknowns_tables.TITLE, lead=unknowns_tables.LEAD, specs=PRINTED
)
"""All variations."""
