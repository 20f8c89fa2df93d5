"""Places unlike the paper's: does the robot still arrive, and does it know what it does not know?

``jaxlangnav reproduce robustness``. Nothing of Table 2's law holds in these scenarios
(``SCENARIOS`` says what does). The navigator has the sizes and numbers of ``Navigator.pretrained``:
those of a robot in a place that nobody has prepared. Beside success and ways stand how episodes
end, whether "this is the goal" is as probable as it says, and what the belief was told of its
sensors against what was true.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxlangnav.agent import Navigator
from jaxlangnav.experiments.experiment import Experiment, Options
from jaxlangnav.experiments.grid import Arm, Played, Row
from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.experiments.policies import POLICY_NAMES, check_policies
from jaxlangnav.experiments.scenarios import SAID, SCENARIOS, PlaceSpec
from jaxlangnav.experiments.table import Table
from jaxlangnav.messages import Status
from jaxlangnav.navigator import NavigatorParams
from jaxlangnav.planner.config import POLICIES

_MAX_STEPS = 400
"""Decision cycles until a time-out: an area of 60 × 60 m takes more than the paper's worlds."""
ECE_TARGET = 0.05
"""Of "this is the goal", where the belief was told the truth of its sensors and by the sentence."""
_FOREIGN = "arc"
"""The baseline that knows the law of Table 2's worlds, which these are not of."""
SUITE_HEADINGS = (
    "Scenario",
    "Policy",
    "Success % (95 %)",
    "target",
    "Distance m (σ)",
    "Known m",
    "Stopped elsewhere",
    "Not found",
    "Asks",
    "Other ends",
    "Time-outs",
    "ECE (chance)",
    "Overflow",
)
_TERMINAL = (0, 1, 2, 3, 4, 6, 7, 10, 11)
"""Columns that a terminal has room for."""


def numbers() -> NavigatorParams:
    """Build the navigator's numbers in places as they are."""
    return Navigator.pretrained().params


class Robustness(Experiment):
    """All scenarios as rows; its arms have the sizes of ``Navigator.pretrained``."""

    def arms(self, options: Options) -> list[Arm]:
        """Build the policies, but for the one that knows the law of other worlds."""
        names = [one for one in check_policies(options.policies) if one != _FOREIGN]
        if not names:
            rest = ", ".join(one for one in POLICY_NAMES if one != _FOREIGN)
            raise ValueError(
                f'policy is "{_FOREIGN}", but it sweeps by the law of Table 2\'s worlds, which '
                f"these are not: choose from {rest}"
            )
        return [_arm(name, options) for name in names]

    def rows(self, played: Played, first: Played, judged: Sequence[Row]) -> list[Row]:
        """Add how episodes ended, and which targets are met."""
        rows = super().rows(played, first, judged)
        for place, (row, spec) in enumerate(zip(rows, self.specs, strict=True)):
            results, _ = played.of_setting(place)
            row |= _endings(results)
            if isinstance(spec, PlaceSpec):
                row |= _judged_by(spec, row)
        return rows

    def printed(self) -> list[Row]:
        """List nothing: the paper has none of these."""
        return []

    def found(self, rows: Sequence[Row], options: Options) -> dict[str, Any]:
        """Add what each scenario is, and how many targets are met."""
        del options
        return {"scenarios": [one.described() for one in SCENARIOS], "missed": _missed(rows)}

    def tables(self, document: Mapping[str, Any]) -> list[Table]:
        """Lay out the results, and what each scenario is."""
        return [_robustness_table(document), _scenarios_table(document)]

    def notes(self, document: Mapping[str, Any]) -> list[str]:
        """Say what was missed and what was run."""
        return [*_describe_missed(document), *_caption(document)]

    def markdown(self, document: Mapping[str, Any]) -> str:
        """Write the tables and what is beneath them in Markdown."""
        tables = "\n".join(one.markdown() for one in self.tables(document))
        return f"# {self.title}\n\n{tables}\n" + "\n".join(self.notes(document)) + "\n"

    def render(self, document: Mapping[str, Any]) -> Any:
        """Draw the results for the terminal."""
        wide = _robustness_table(document)
        return Table(
            headings=[wide.headings[at] for at in _TERMINAL],
            rows=[[row[at] for at in _TERMINAL] for row in wide.rows],
            title=self.title,
            caption="\n".join(_describe_missed(document)),
            firsts=wide.firsts,
        ).text()


def _arm(policy: str, options: Options) -> Arm:
    """Build the arm of a policy; all policies may take as long as they like, within reason."""
    told = {"policy": policy}
    if policy not in POLICIES:
        return Arm(policy=policy, told=told, max_steps=_MAX_STEPS)
    usual = Navigator.pretrained(policy)
    sizes = dataclasses.replace(usual.config.map, num_particles=options.num_particles)
    return Arm(
        policy=policy,
        told=told,
        config=dataclasses.replace(usual.config, map=sizes),
        params=usual.params if options.params is None else options.params,
        max_steps=_MAX_STEPS,
        is_judged=True,
    )


def _endings(results: Any) -> Row:
    """Count how episodes ended; those in invalid places are left out."""
    valid = np.asarray(results.is_valid)
    ending, success = np.asarray(results.ending)[valid], np.asarray(results.is_success)[valid]
    stopped = np.asarray(results.is_stopped)[valid]
    named = (Status.ARRIVED, Status.NOT_FOUND, Status.WHICH_ONE)
    return {
        "elsewhere": int((stopped & (ending == Status.ARRIVED) & ~success).sum()),
        "asks": int((stopped & (ending == Status.WHICH_ONE)).sum()),
        "other_ends": int((stopped & ~np.isin(ending, [int(one) for one in named])).sum()),
        "overflow_episodes": int((np.asarray(results.overflow)[valid] > 0).sum()),
    }


def _judged_by(spec: PlaceSpec, row: Row) -> Row:
    """Judge a row by what is right in its scenario; only ``informed`` has targets."""
    mine: Row = {"is_told": spec.is_told, "target": None, "is_met": None, "is_calibrated": None}
    if spec.ending == "not_found":
        right, number = row["not_found"], row["episodes"]
        low, high = wilson_interval(right, number)
        rate = 100.0 * right / max(1, number)
        mine |= {"success_rate": rate, "success_ci": [100.0 * low, 100.0 * high]}
    row = row | mine
    if row["policy"] != "informed":
        return mine
    if spec.target is not None:
        is_short = spec.longest is None or row["distance_mean"] <= spec.longest
        is_met = row["success_rate"] >= spec.target and is_short
        mine |= {"target": spec.target, "longest": spec.longest, "is_met": is_met}
    if spec.is_told and row["ece"] is not None:
        mine["is_calibrated"] = row["ece"] <= ECE_TARGET
    return mine


def _missed(rows: Sequence[Row]) -> list[Row]:
    """List the targets that are missed."""
    found: list[Row] = []
    for row in rows:
        name = {"scenario": row["scenario"]}
        if row.get("is_met") is False:
            way = {"distance": row["distance_mean"], "longest": row.get("longest")}
            mine = {"what": "success", "is": row["success_rate"], "target": row["target"]}
            found.append(name | mine | way)
        if row.get("is_calibrated") is False:
            found.append(name | {"what": "ece", "is": row["ece"], "target": ECE_TARGET})
    return found


def _describe_missed(document: Mapping[str, Any]) -> list[str]:
    """Say which targets of ``informed`` are missed, a line for successes and one for ECE."""
    if "informed" not in document["policies"]:
        return []
    lines = []
    for what, form in (("success", ".1f"), ("ece", ".3f")):
        listed = [
            f"{one['scenario']} ({one['is']:{form}}, target {one['target']:g}{_way(one)})"
            for one in document["missed"]
            if one["what"] == what
        ]
        lines.append(f"Targets of informed missed, {what}: {'; '.join(listed) or 'none'}.")
    return lines


def _way(one: Row) -> str:
    """Say the way, where it has a target."""
    return f"; {one['distance']:.1f} m, at most {one['longest']:g}" if one.get("longest") else ""


def _caption(document: Mapping[str, Any]) -> list[str]:
    """Say under what conditions the rows were measured."""
    invalid = sum(row["invalid_worlds"] for row in document["rows"])
    return [
        f"{document['episodes']} episodes a row, a fresh place each, seed {document['seed']}, "
        f"{document['num_particles']} particles, at most {_MAX_STEPS} decisions; every policy has "
        "the same places and noise.",
        "ECE of “this is the goal” over every step; in brackets what a perfect belief would show "
        "by chance in so few episodes. Targets are of informed; ECE has one only where the belief "
        "was told the truth, of its sensors and by the sentence.",
        f"Places in which something found no room, left out: {invalid}.",
    ]


def _robustness_table(document: Mapping[str, Any]) -> Table:
    """Lay out the rows by scenario, then by policy."""
    order = list(dict.fromkeys(row["scenario"] for row in document["rows"]))
    rows = sorted(document["rows"], key=lambda row: order.index(row["scenario"]))
    before = ["", *(row["scenario"] for row in rows[:-1])]
    firsts = [row["scenario"] != above for row, above in zip(rows, before, strict=True)]
    return Table(headings=SUITE_HEADINGS, rows=[_cells(row) for row in rows], firsts=firsts)


def _cells(row: Row) -> list[str]:
    """Write one row's cells, in the order of ``SUITE_HEADINGS``."""
    low, high = row["success_ci"]
    target = "" if row["target"] is None else f"≥ {row['target']:g}"
    if row.get("longest"):
        target += f", ≤ {row['longest']:g} m"
    score = ""
    if row["ece"] is not None:
        score = f"{row['ece']:.3f} ({row['ece_floor']:.3f})"
    return [
        row["scenario"],
        row["policy"],
        f"{row['success_rate']:.1f} ({low:.1f}-{high:.1f})",
        target,
        f"{row['distance_mean']:.1f} ({row['distance_sd']:.1f})",
        f"{row['known_distance_mean']:.1f}",
        f"{row['elsewhere']}",
        f"{row['not_found']}",
        f"{row['asks']}",
        f"{row['other_ends']}",
        f"{row['timeouts']}",
        score,
        f"{row['overflow_episodes']}",
    ]


def _scenarios_table(document: Mapping[str, Any]) -> Table:
    """Lay out what each scenario is, what is true of its sensors and what the belief is told."""
    return Table(
        headings=[
            "Scenario",
            "What it is",
            "Said",
            "Sensors in truth",
            "Belief is told otherwise",
            "Numbers of things told",
        ],
        rows=[
            [
                one["scenario"],
                one["what"],
                one["said"],
                one["truth"],
                one["told"] or "no",
                one["numbers"],
            ]
            for one in document["scenarios"]
        ],
        fold="What each scenario is",
    )


ROBUSTNESS = Robustness(
    name="robustness",
    title="Robustness: places unlike the paper's",
    lead="Crowds, bystanders, false detections, wrong labels, misses, false sentences, areas of 8 "
    "to 60 m: none of it is of the law of Table 2's worlds. A run succeeds if the robot itself "
    "says stop within 1.5 m of the goal; where there is none, if it says that it is not found.",
    specs=SCENARIOS,
    sentences=SAID,
)
"""The public suite."""
