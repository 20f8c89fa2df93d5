"""What ``jaxlangnav reproduce`` can run: each experiment with its table, figure and words."""

import importlib.util
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxlangnav.cli.output import Output
from jaxlangnav.cli.reproduction import Settings, Study
from jaxlangnav.cli.runtime import progress_bar, waiting
from jaxlangnav.experiments import figure5, table2
from jaxlangnav.experiments.experiment import Experiment
from jaxlangnav.experiments.report import Section, Table
from jaxlangnav.plain_text import markdown_table

_SPLITS = 8
"""Random splits of Table 1, as in the paper; ``jaxlangnav evaluate`` takes any number."""
_LEADS = {
    "table2": "Success and distance in simulated worlds, by world and command (section 4.2). A run "
    "succeeds if the robot itself says stop within 1.5 m of the intended goal.",
    "fig5": "The farther the robot sees, the less it has to search, and the less the sentence "
    "matters: all curves that use it end at the known map's (section 4.2). The printed figure "
    "states no numbers; where Table 2 prints a row of the same world, command and range, it is "
    "drawn.",
}
_AMBIGUOUS = "“go to the hydrant” among several: nothing says which"
_CURVES = {
    "null": "“go to the hydrant”",
    "behind": "“… behind the cone”",
    "nearest": "“… nearest to the cone”",
}


def table1(settings: Settings, output: Output) -> Study:
    """Run the paper's protocol for understanding: Table 1.

    Args:
        settings: the seed of the splits is read.
        output: where the table is printed.

    Returns:
        The study.
    """
    from jaxlangnav.experiments.table1 import evaluate, render
    from jaxlangnav.files.whole import write_text

    begin = time.perf_counter()
    with progress_bar("splits", _SPLITS) as advance:
        document = evaluate(splits=_SPLITS, seed=settings.seed, on_progress=advance)
    drawn = render(document)
    output.say(drawn)
    headings = [str(column.header) for column in drawn.columns]
    columns = [[str(cell) for cell in column.cells] for column in drawn.columns]
    rows = [[*row] for row in zip(*columns, strict=True)]
    wall = time.perf_counter() - begin
    files: list[str] = []
    if settings.out is not None:
        text = f"# Table 1: ours beside the paper's\n\n{markdown_table(headings, rows)}"
        files.append(str(write_text(text, settings.out / "table1.md")))
    section = Section(
        title="Table 1: how often sentences are understood",
        lead="Whole sentences whose annotation or behavior is exactly right among those held out, "
        "mean and 95 % interval over random splits of 67 to 33 percent (section 4.1).",
        tables=[Table(headings=headings, rows=rows)],
        notes=[
            "The corpora differ: the paper's 39 instructions were never published, ours ship in "
            "the package. The commands of Table 2 are in neither.",
        ],
        made={
            "command": settings.command("table1"),
            "seed": str(settings.seed),
            "wall time": f"{wall:.0f} s",
            "files": _names(files),
        },
    )
    return Study(document={**document, "wall_s": wall, "files": files}, section=section)


def monte_carlo(name: str) -> Callable[[Settings, Output], Study]:
    """Build the runner of an experiment made of episodes.

    Args:
        name: "table2" or "fig5".

    Returns:
        A function that runs it for every row and policy.
    """

    def run(settings: Settings, output: Output) -> Study:
        experiment = experiment_of(name, settings)
        counted = {"episodes": settings.episodes, "policies": settings.policies}
        with progress_bar("episodes", experiment.total_work(**counted)) as advance:
            document = experiment.run(
                **counted,
                seed=settings.seed,
                out=settings.out,
                on_progress=advance,
                num_particles=settings.particles,
                params=settings.params,
                sensor=settings.sensor(),
                motion=settings.motion(),
            )
        if name == "fig5":
            document["falls"] = figure5.falls(document)
        output.say(experiment.render(document))
        wall, compiling = document["wall_s"], document["compile_s"]
        total = experiment.total_episodes(**counted)
        output.say(f"{total} episodes in {wall:.1f} s, {compiling:.1f} s of them compilation.")
        pictures = _draw(name, document, settings.out, output)
        document["files"] = [*document["files"], *(str(path) for path in pictures)]
        section = _section(name, experiment, document, pictures, settings)
        return Study(document=document, section=section)

    return run


def experiment_of(name: str, settings: Settings) -> Experiment:
    """Build the rows of an experiment made of episodes.

    Args:
        name: "table2" or "fig5".
        settings: which rows.

    Returns:
        The experiment.
    """
    if name == "fig5":
        return figure5.experiment(ranges=settings.ranges)
    return table2.experiment(extra=settings.extra, ranges=settings.ranges)


def timing(settings: Settings, output: Output) -> Study:
    """Measure where a decision cycle's time goes.

    Args:
        settings: the engine's numbers.
        output: where the shares are printed.

    Returns:
        The study.
    """
    from jaxlangnav.experiments.archive import write_manifest
    from jaxlangnav.speed.timing import cycle_parts

    with waiting("timing the parts of a cycle", output):
        document: dict[str, Any] = cycle_parts(params=settings.params)
    whole, parts = document["cycle_us"], document["parts_us"]
    for part, spent in sorted(parts.items(), key=lambda one: -one[1]):
        output.say(f"{part:<34} {spent:8.1f} µs {100 * spent / whole:5.1f} %")
    pictures: list[Path] = []
    if settings.out is not None:
        pictures = _draw("time", document, settings.out, output)
        written = write_manifest(document, settings.out / "time.json")
        document["files"] = [str(written), *(str(path) for path in pictures)]
    machine = document["machine"]
    section = Section(
        title="Where the time goes",
        lead="The parts of one decision cycle of one episode, each compiled alone and timed on the "
        "same beliefs in a batch; planner, motion and what else there is are what is left over.",
        pictures=[(path, "Bars of the parts of a cycle") for path in _vector(pictures)],
        notes=[
            f"{machine['device']}, {machine['threads']} threads, load {machine['load']} at the "
            f"start; JAX {machine['jax']}; policy {machine['policy']}. CPU time of all threads.",
        ],
        made={
            "command": settings.command("time"),
            "wall time": f"{document['wall_s']:.0f} s",
            "files": _names(document.get("files", [])),
        },
    )
    return Study(document=document, section=section)


def _section(
    name: str,
    experiment: Experiment,
    document: dict[str, Any],
    pictures: list[Path],
    settings: Settings,
) -> Section:
    """Write an experiment's part of the report."""
    from jaxlangnav.experiments.tables import HEADINGS, caption, deviation_lines, table_lines

    lines = table_lines(document)
    tables = [
        Table(
            headings=HEADINGS,
            rows=[texts for _, texts in lines],
            firsts=[is_first for is_first, _ in lines],
            fold="All numbers" if name == "fig5" else "",
        )
    ]
    headings, compared = deviation_lines(document)
    if compared:
        tables.append(Table(headings=headings, rows=compared))
    remark = [experiment.remark(document)] if experiment.remark else []
    return Section(
        title=experiment.title,
        lead=_LEADS[name],
        pictures=[(path, f"{experiment.title}: figure") for path in _vector(pictures)],
        tables=tables,
        notes=[*remark, *caption(document).splitlines()],
        made={
            "command": settings.command(name),
            "episodes": f"{document['episodes']} a row and policy, seed {document['seed']}, "
            f"{document['num_particles']} particles",
            "models": f"SHA-256 {document['models_sha256']}",
            "wall time": f"{document['wall_s']:.0f} s, {document['compile_s']:.0f} s of them "
            "compilation",
            "files": _names(document["files"]),
        },
    )


def _draw(name: str, document: dict[str, Any], out: Path | None, output: Output) -> list[Path]:
    """Draw the figures of an experiment, where there is a folder and something to draw with."""
    if out is None:
        return []
    if importlib.util.find_spec("matplotlib") is None:
        output.note('note: no figure without matplotlib: pip install "jaxlangnav[viz]"')
        return []
    from jaxlangnav.viz.measures import reliability_figure, time_figure
    from jaxlangnav.viz.rows import table_figure
    from jaxlangnav.viz.style import save
    from jaxlangnav.viz.sweep import range_figure

    if name == "time":
        return [*save(time_figure(document["parts_us"]), out / "time")]
    if name == "fig5":
        return [*save(range_figure(document), out / "figure5")]
    paths = [*save(table_figure(document), out / "table2")]
    panels = reliability_panels(document)
    if panels:
        figure = reliability_figure(
            panels,
            title="Calibration: “this object is the goal”",
            subtitle=f"Every step of {document['calibration_episodes']} episodes a row of Table 2; "
            "intervals allow for steps of one episode being alike.",
        )
        paths += save(figure, out / "calibration")
    return paths


def reliability_panels(document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Gather the reliability curves of a table's rows.

    Args:
        document: of ``experiments.table2``.

    Returns:
        For each policy that has a belief, the curve of each command over all worlds. Several
        hydrants and no relation stand apart: there no belief can know which is meant.
    """
    from jaxlangnav.experiments.reliability import curve, pooled

    parts: dict[str, dict[str, list[Any]]] = {}
    for row in document["rows"]:
        found = row.get("reliability")
        if found is not None and sum(found["planner"]["events"]) > 0:
            is_open = row["relation"] is None and not row["world"].startswith("1H")
            name = _AMBIGUOUS if is_open else _CURVES[row["relation"] or "null"]
            parts.setdefault(row["policy"], {}).setdefault(name, []).append(found["planner"])
    return {
        policy: {name: curve(pooled(listed)) for name, listed in curves.items()}
        for policy, curves in parts.items()
    }


def _vector(paths: list[Path]) -> list[Path]:
    """Keep the SVG files: sharp at any size."""
    return [path for path in paths if path.suffix == ".svg"]


def _names(paths: list[str]) -> str:
    """List files by name."""
    return ", ".join(Path(path).name for path in paths)


def _episode(name: str) -> Callable[[Settings, Output], Study]:
    """Build the runner of a figure of one episode."""

    def run(settings: Settings, output: Output) -> Study:
        from jaxlangnav.cli.illustrations import illustrate

        return illustrate(name, settings, output)

    return run


def _graph(settings: Settings, output: Output) -> Study:
    """Draw the factor graph."""
    from jaxlangnav.cli.illustrations import factor_graph

    return factor_graph(settings, output)


def _unknowns(settings: Settings, output: Output) -> Study:
    """Vary what the paper leaves open."""
    from jaxlangnav.cli.unknowns import unknowns

    return unknowns(settings, output)


STUDIES: dict[str, Callable[[Settings, Output], Study]] = {
    "table1": table1,
    "table2": monte_carlo("table2"),
    "fig1": _episode("fig1"),
    "fig3": _graph,
    "fig4": _episode("fig4"),
    "fig5": monte_carlo("fig5"),
    "unknowns": _unknowns,
    "time": timing,
}
"""Every experiment by its name on the command line."""
