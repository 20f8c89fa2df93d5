"""Generate docs/results.md from a folder of results: python scripts/results_page.py results COMMIT.

The folder is what ``jaxlangnav reproduce all --out results`` has written; COMMIT says of which
state of the code. What stands in the page from ``HANDWRITTEN_MARK`` on is written by hand and kept.
"""

import json
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import ages

from jaxlangnav.experiments.paper import describe_success_drops
from jaxlangnav.experiments.table import Table
from jaxlangnav.experiments.unknowns import UNKNOWNS

ROOT = ages.ROOT
PAGE = ROOT / "docs" / "results.md"
HANDWRITTEN_MARK = "<!-- What follows is written by hand; scripts/results_page.py keeps it. -->"
PICTURES = ("table2", "calibration", "figure5", "unknowns")
SHOWN = ("informed", "faithful", "known")
"""Policies of the short table of Figure 5."""
IN_TABLE_2, COLUMNS = ("informed", "faithful", "frontier"), 10
"""Policies and columns of Table 2 that the page shows of ``table2.md``."""


def read(folder: Path, name: str) -> dict[str, Any]:
    """Read the document of an experiment."""
    return json.loads((folder / f"{name}.json").read_text("utf-8"))


def range_table(document: dict[str, Any]) -> str:
    """Format success and distance by range, for the policies of ``SHOWN``."""
    cells_by_key: dict[tuple[str, float], dict[str, str]] = {}
    for row in document["rows"]:
        text = f"{row['success_rate']:.0f} % · {row['distance_mean']:.1f} m"
        cells_by_key.setdefault((row["relation"], row["range"]), {})[row["policy"]] = text
    rows = [
        [relation, f"{sensing_range:g}", *(cells.get(name, "") for name in SHOWN)]
        for (relation, sensing_range), cells in cells_by_key.items()
    ]
    return Table(headings=["command", "range m", *SHOWN], rows=rows).markdown().rstrip()


def shorten(table2: str) -> str:
    """Select the first columns of Table 2, for the policies that the page shows."""
    rows = [
        line.split("|")[1 : COLUMNS + 1]
        for line in re.findall(r"(?m)^\|.*\|$", table2.partition("\n\n")[0])
    ]
    shown = [*rows[:2], *(row for row in rows[2:] if row[3].strip() in IN_TABLE_2)]
    return "\n".join(f"|{'|'.join(row)}|" for row in shown)


def time_line(document: dict[str, Any]) -> str:
    """Format the run time of the parts of a decision cycle."""
    total = document["cycle_us"]
    parts = sorted(document["parts_us"].items(), key=lambda part: -part[1])
    fractions = ", ".join(f"{name} {100 * micros / total:.0f} %" for name, micros in parts)
    return f"{total:.0f} µs of CPU: {fractions}."


def unknowns_section(document: dict[str, Any]) -> str:
    """Format the section on the paper's unreported parameters."""
    rows = len(document["paper"])
    lines = "\n".join(f"- {line}" for line in UNKNOWNS.notes(document)[:rows])
    return f"""## What would explain the paper's figures

`jaxlangnav reproduce unknowns` runs the rows of Table 2 for `faithful` with one thing at a time set
otherwise that the paper does not print: field of view, frontier spacing, γ, particles, thresholds,
expected objects, detection, time-out, direction of the goal. `unknowns.md` has all figures.

![Success and distance of every variation beside the paper's](unknowns.png)

{lines}"""


def page(folder: Path, commit: str, handwritten: str) -> str:
    """Format the page of a commit's results; ``handwritten``: its handwritten part."""
    table2, figure5 = read(folder, "table2"), read(folder, "figure5")
    unknowns = read(folder, "unknowns")
    body = (folder / "table2.md").read_text("utf-8").split("\n", 2)[2].strip()
    figure4 = (folder / "figure4.md").read_text("utf-8").strip().split("\n\n")[-1]
    setup = read(folder, "table2_manifest")
    return f"""# Results

`jaxlangnav reproduce all --out results` writes this page up to "Where the time goes" and
`report.html`, which sets all tables and figures beside the paper's numbers. What follows is such a
run of commit {commit}: {table2["episodes"]} episodes a row of Table 2,
{figure5["rows"][0]["episodes"]} of Figure 5 (seed {table2["seed"]}), {unknowns["episodes"]}
of the paper's unknowns (seed {unknowns["seed"]}),
models SHA-256 `{table2["models_sha256"][:12]}…`, JAX {setup["libraries"]["jax"]},
{setup["device"]["kind"]}, {setup["machine"]["cores"]} cores. Table 2 took {table2["wall_s"]:.0f} s,
{table2["compile_s"]:.0f} s of them compilation; Figure 5 took {figure5["wall_s"]:.0f} s.

## Table 2

![Success and distance of all policies beside the paper's](table2.png)

{shorten(body)}

A fresh world an episode, 64 particles; all policies have the same worlds and noise. "Known" has the
map and drives to the goal itself; others may stop within reach of it (1.2 m). `table2.md` has more.

{unknowns_section(unknowns)}

## Calibration

![How often "this object is the goal" came true, by the probability given to it](calibration.png)

Over every step of {table2["calibration_episodes"]} episodes a row; intervals are clustered by
episodes. With two hydrants and no relation nothing says which is meant: every hydrant seen fits
the command, and half are not the one that was drawn at random.

## Figure 5

![Distance and success against the sensing range](figure5.png)

{range_table(figure5)}

`known` drives to the goal itself, so others may end below it. All policies stand in the figure.
{describe_success_drops(figure5)} The printed figure
states no numbers; where Table 2 prints a row of the same world, command and range, it is drawn.

## Figures 1 and 4

`jaxlangnav reproduce fig1` and `fig4` run the scenes of the paper's illustrations, the shipped
worlds `figure1` and `figure4`. In Figure 4 two cones are in view at the start. Where the unseen
hydrant is believed to be, left or right of where the robot faced at first (`faithful`, seed 0,
256 particles):

{figure4}

## Where the time goes

One decision cycle of one episode in a batch (`jaxlangnav reproduce time`):
{time_line(read(folder, "time"))}

{handwritten}"""


def write(folder: Path, commit: str) -> None:
    """Write the page, copy its pictures and record the engine that made them."""
    text = PAGE.read_text("utf-8")
    PAGE.write_text(page(folder, commit, text[text.index(HANDWRITTEN_MARK) :]), "utf-8")
    for name in PICTURES:
        shutil.copy(folder / f"{name}.png", ROOT / "docs" / f"{name}.png")
    ages.record(PAGE)


if __name__ == "__main__":
    write(Path(sys.argv[1]), sys.argv[2])
