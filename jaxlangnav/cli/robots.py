"""``jaxlangnav reproduce table3``: robots with bodies, in physics (section 4.3)."""

import json
from pathlib import Path
from typing import Any

from jaxlangnav.cli.output import Output, to_json
from jaxlangnav.cli.runtime import progress_bar
from jaxlangnav.files.whole import write_text
from jaxlangnav.plain_text import markdown_table
from jaxlangnav.robots.libraries import check_libraries

_TITLE = "Table 3 in simulation: ours beside the paper's"
_CAPTION = (
    "Physics-in-the-loop simulation with rendered-camera perception; the paper drove real robots. "
    "Success: said to have arrived, within 1.5 m of the intended goal; 95 % interval. "
    "Distance truly travelled, mean (sd)."
)


def table3(
    *, trials: int, seed: int, policy: str, out: Path | None, output: Output
) -> dict[str, Any]:
    """Run Table 3, print it, and write it where a folder is given.

    Args:
        trials: of each row.
        seed: root seed.
        policy: of the navigator.
        out: folder; trials that it holds already are not run again.
        output: where the table is printed.

    Returns:
        The document.

    Raises:
        ValueError: a library or the system's EGL is missing; says what to install.
    """
    check_libraries()
    from rich.table import Table

    from jaxlangnav.robots.trials import (
        TABLE3,
        TRIAL_HEADINGS,
        TrialPlan,
        reproduce_table3,
        table_rows,
    )

    plan = TrialPlan(trials=trials, seed=seed, policy=policy, out=out)
    total = len(TABLE3) * (trials + 1)
    output.note(f"{total} runs of two robots, two at a time")
    with progress_bar("runs", total) as advance:
        document = reproduce_table3(plan, on_progress=advance)
    rows = table_rows(document)
    drawn = Table(*TRIAL_HEADINGS, title=_TITLE, caption=_CAPTION)
    for row in rows:
        drawn.add_row(*row)
    output.say(drawn)
    _tell(document, total, output)
    document["files"] = []
    if out is not None:
        text = f"# {_TITLE}\n\n{_CAPTION}\n\n{markdown_table(list(TRIAL_HEADINGS), rows)}"
        written = [
            write_text(text, out / "table3.md"),
            write_text(json.dumps(to_json(document), indent=2) + "\n", out / "table3.json"),
        ]
        document["files"] = [str(path) for path in written]
        for path in written:
            output.say(f"Wrote {path}")
    return document


def _tell(document: dict[str, Any], total: int, output: Output) -> None:
    """Say which of all runs failed, and how many did not."""
    for row in document["rows"]:
        for one in row["failures"]:
            name = f"{row['robot']} {row['world']} {row['range']:g} m {row['relation'] or 'null'}"
            output.say(f"{name}, trial {one['trial']}: {one['ending']}: {one['why']}")
    low, high = (100 * one for one in document["success_interval"])
    output.say(
        f"Over all: {100 * document['success']:.1f} % [{low:.1f}, {high:.1f}]; "
        f"{total - document['resumed']} runs in {document['wall_s']:.0f} s, "
        f"{document['resumed']} kept from before."
    )
