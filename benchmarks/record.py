"""Benchmark results: entries, their table, and the command line of the scripts."""

import argparse
import json
from collections.abc import Callable
from typing import Any

from rich.console import Console

from jaxlangnav.episode import MAX_STEPS
from jaxlangnav.experiments.table import Table
from jaxlangnav.experiments.timing import describe_machine

Measurement = dict[str, Any]


def entry(
    name: str,
    value: float,
    unit: str,
    *,
    baseline: float | None = None,
    ratio: float | None = None,
    target: float | None = None,
    is_limit: bool = False,
) -> Measurement:
    """Build an entry.

    Args:
        name: what was measured.
        value: ours.
        unit: of value and baseline.
        baseline: theirs, in the same run.
        ratio: how many times better ours is.
        target: of the ratio, or of the value where there is no ratio.
        is_limit: the value is to stay below the target.

    Returns:
        The entry; ``holds`` says whether the target is reached, None without one.
    """
    measured = value if ratio is None else ratio
    holds = None if target is None else bool(measured <= target if is_limit else measured >= target)
    return {
        "name": name,
        "value": value,
        "unit": unit,
        "baseline": baseline,
        "ratio": ratio,
        "target": target,
        "holds": holds,
    }


def against(ours: float, theirs: float, target: float) -> Measurement:
    """Compare a cost with a baseline's, by their ratio."""
    ratio = theirs / ours
    return {"baseline": theirs, "ratio": ratio, "target": target, "holds": ratio >= target}


def render(document: dict[str, Any]) -> Any:
    """Build a table of the results.

    Args:
        document: of ``run_bench``.

    Returns:
        A rich table.
    """
    machine = document["machine"]
    caption = (
        f"{machine['device']}, {machine['threads']} threads, load {machine['load']} at the start; "
        f"JAX {machine['jax']}; policy {machine['policy']}, at most {MAX_STEPS} cycles an episode; "
        f"at most {machine['chunk']} episodes a call, in {machine['lanes']} lanes."
    )
    rows = [
        [
            item["name"],
            f"{item['value']:.3g} {item['unit']}".strip(),
            *(_number(item[name]) for name in ("baseline", "ratio", "target")),
            {True: "yes", False: "no", None: ""}[item["holds"]],
        ]
        for item in document["entries"]
    ]
    headings = ["Measured", "Ours", "Baseline", "Ratio", "Target", "Holds"]
    return Table(headings=headings, rows=rows, title="Speed", caption=caption).text()


def _number(value: float | None) -> str:
    """Format a number, or "" for None."""
    return "" if value is None else f"{value:.3g}"


def main(entries: Callable[..., list[Measurement]], about: str | None, core: int | None) -> None:
    """Run one benchmark as a script.

    Args:
        entries: measures; takes ``is_quick``.
        about: the module's docstring.
        core: on which everything is pinned; None where that cannot be.
    """
    parser = argparse.ArgumentParser(description=(about or "").split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="smaller sizes, fewer repetitions")
    parser.add_argument("--json", action="store_true", help="one JSON document: machine, entries")
    options = parser.parse_args()
    machine = describe_machine() | {"core": core}
    document = {"machine": machine, "entries": entries(is_quick=options.quick)}
    if options.json:
        print(json.dumps(document, indent=2, ensure_ascii=False))
    else:
        Console(width=140).print(render(document))
