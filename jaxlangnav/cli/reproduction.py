"""The experiments behind ``jaxlangnav reproduce``: run, printed, drawn and put into the report.

``STUDIES`` is their registry, by name: from settings and an output to a document and its part of
the report.
"""

import functools
import json
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from jaxlangnav import __version__
from jaxlangnav.cli import illustrations
from jaxlangnav.cli.output import Document, Output, to_json
from jaxlangnav.cli.runtime import progress_bar, waiting
from jaxlangnav.cli.settings import apply
from jaxlangnav.cli.study import Settings, Study, draw_figures, told
from jaxlangnav.episode import MAX_STEPS
from jaxlangnav.experiments import paper, robustness, unknowns
from jaxlangnav.experiments.archive import manifest
from jaxlangnav.experiments.experiment import Experiment, Options
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.sizes import check_recording
from jaxlangnav.experiments.table import write_report
from jaxlangnav.grounding.weights import load_shipped
from jaxlangnav.messages import default_motion, default_sensor

_SPLITS = 8
"""Random splits of Table 1, as in the paper; ``jaxlangnav evaluate`` takes any number."""
_AMBIGUOUS = "“go to the hydrant” among several: nothing says which"
_CURVES = {
    "null": "“go to the hydrant”",
    "behind": "“… behind the cone”",
    "nearest": "“… nearest to the cone”",
}


def table1(settings: Settings, output: Output) -> Study:
    """Run the paper's protocol for understanding, Table 1; of the settings the seed is read."""
    from jaxlangnav.experiments.table1 import evaluate, table_1
    from jaxlangnav.files.whole import write_text

    begin = time.perf_counter()
    with progress_bar("splits", _SPLITS) as advance:
        document = evaluate(splits=_SPLITS, seed=settings.seed, on_progress=advance)
    laid = table_1(document)
    output.say(laid.text())
    document |= {"wall_s": time.perf_counter() - begin, "files": []}
    if settings.out is not None:
        text = f"# {laid.title}\n\n{laid.markdown()}"
        document["files"].append(str(write_text(text, settings.out / "table1.md")))
    return told(
        "table1",
        document,
        settings,
        title="Table 1: how often sentences are understood",
        lead="Whole sentences whose annotation or behavior is exactly right among those held out, "
        "mean and 95 % interval over random splits of 67 to 33 percent (section 4.1).",
        tables=[laid],
        notes=[
            "The corpora differ: the paper's 39 instructions were never published, ours ship in "
            "the package. The commands of Table 2 are in neither.",
        ],
        made={"seed": str(settings.seed)},
    )


def _episodes(name: str) -> Callable[[Settings, Output], Study]:
    """Build the runner of an experiment made of episodes."""

    def run(settings: Settings, output: Output) -> Study:
        experiment = GRIDS[name](settings)
        options = _options_of(name, settings)
        with progress_bar("episodes", experiment.total_work(options)) as advance:
            document = experiment.run(options, out=settings.out, on_progress=advance)
        output.say(experiment.render(document))
        wall, compiling = document["wall_s"], document["compile_s"]
        total = experiment.total_episodes(options)
        output.say(f"{total} episodes in {wall:.1f} s, {compiling:.1f} s of them compilation.")
        pictures = draw_figures(settings.out, output, _figures(experiment.name, document))
        document["files"] += [str(path) for path in pictures]
        return told(
            name,
            document,
            settings,
            title=experiment.title,
            lead=experiment.lead,
            pictures=[(path, f"{experiment.title}: figure") for path in pictures],
            tables=experiment.tables(document),
            notes=experiment.notes(document),
            made={
                "episodes": f"{document['episodes']} a row and arm, seed {document['seed']}, "
                f"{document['num_particles']} particles",
                "models": f"SHA-256 {document['models_sha256']}",
            },
        )

    return run


GRIDS: dict[str, Callable[[Settings], Experiment]] = {
    "table2": lambda settings: paper.table_2(extra=settings.extra, ranges=settings.ranges),
    "fig5": lambda settings: paper.figure_5(ranges=settings.ranges),
    "unknowns": lambda _: unknowns.UNKNOWNS,
    "robustness": lambda _: robustness.ROBUSTNESS,
}
"""The experiments made of episodes: from settings to rows."""


def _options_of(name: str, settings: Settings) -> Options:
    """Say what an experiment of episodes runs."""
    is_robust = name == "robustness"
    return Options(
        episodes=settings.episodes,
        policies=settings.policies,
        seed=settings.seed_unknowns if name == "unknowns" else settings.seed,
        num_particles=settings.particles,
        params=apply(robustness.numbers(), settings.values, "params")
        if is_robust
        else settings.params,
        sensor=apply(default_sensor(), settings.values, "sensor"),
        motion=apply(default_motion(), settings.values, "motion"),
    )


def timing(settings: Settings, output: Output) -> Study:
    """Measure where a decision cycle's time goes, under the engine's numbers of the settings."""
    from jaxlangnav.experiments.archive import write_manifest
    from jaxlangnav.experiments.timing import cycle_parts

    with waiting("timing the parts of a cycle", output):
        document: dict[str, Any] = cycle_parts(params=settings.params)
    whole, parts = document["cycle_us"], document["parts_us"]
    for part, spent in sorted(parts.items(), key=lambda one: -one[1]):
        output.say(f"{part:<34} {spent:8.1f} µs {100 * spent / whole:5.1f} %")
    pictures = draw_figures(settings.out, output, _figures("time", document))
    if settings.out is not None:
        written = write_manifest(document, settings.out / "time.json")
        document["files"] = [str(path) for path in (written, *pictures)]
    machine = document["machine"]
    return told(
        "time",
        document,
        settings,
        title="Where the time goes",
        lead="The parts of one decision cycle of one episode, each compiled alone and timed on the "
        "same beliefs in a batch; planner, motion and what else there are is what is left over.",
        pictures=[(path, "Bars of the parts of a cycle") for path in pictures],
        notes=[
            f"{machine['device']}, {machine['threads']} threads, load {machine['load']} at the "
            f"start; JAX {machine['jax']}; policy {machine['policy']}. CPU time of all threads.",
        ],
    )


def conversation(settings: Settings, output: Output) -> Study:
    """Run episodes in which a simulated person speaks; ``informed`` alone is told of it."""
    from jaxlangnav.experiments import conversation as rows_of
    from jaxlangnav.files.whole import write_text

    with progress_bar("episodes", settings.episodes * len(rows_of.ROWS)) as advance:
        document = rows_of.run_rows(
            episodes=settings.episodes,
            seed=settings.seed,
            particles=settings.particles,
            params=settings.params,
            out=settings.out,
            on_progress=advance,
        )
    table = rows_of.dialogue_table(document)
    output.say(table.text())
    if settings.out is not None:
        written = json.dumps(to_json(document), indent=2) + "\n"
        document["files"].append(str(write_text(written, settings.out / "conversation.json")))
    return told(
        "conversation",
        document,
        settings,
        title=rows_of.HEADING,
        lead="A simulated person who knows the goal corrects, answers and states.",
        tables=[table],
        notes=[rows_of.NOTE],
    )


def _figures(name: str, document: Mapping[str, Any]) -> dict[str, Callable[[], Any]]:
    """Name the figures of an experiment, and what draws them."""
    from jaxlangnav.viz.rows import reliability_figure, table_figure, time_figure
    from jaxlangnav.viz.sweep import range_figure, robustness_figure, unknowns_figure

    if name == "time":
        return {"time": lambda: time_figure(document["parts_us"])}
    if name == "robustness":
        return {"robustness": functools.partial(robustness_figure, document)}
    drawers = {"table2": table_figure, "figure5": range_figure, "unknowns": unknowns_figure}
    found: dict[str, Callable[[], Any]] = {name: functools.partial(drawers[name], document)}
    if panels := reliability_panels(document):
        found["calibration"] = functools.partial(
            reliability_figure,
            panels,
            title="Calibration: “this object is the goal”",
            subtitle=f"Every step of {document['calibration_episodes']} episodes a row of Table 2; "
            "intervals allow for steps of one episode being alike.",
        )
    return found


def reliability_panels(document: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Gather the reliability curves of a table's rows.

    Args:
        document: of ``paper.table_2``.

    Returns:
        For each policy that has a belief, the curve of each command over all worlds. Several
        hydrants and no relation stand apart: there no belief can know which is meant.
    """
    from jaxlangnav.experiments.judging import curve, pooled

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


STUDIES: dict[str, Callable[[Settings, Output], Study]] = {
    "table1": table1,
    "fig1": functools.partial(illustrations.illustrate, "fig1"),
    "fig3": illustrations.factor_graph,
    "fig4": functools.partial(illustrations.illustrate, "fig4"),
    **{name: _episodes(name) for name in ("table2", "fig5", "unknowns")},
    "time": timing,
    "conversation": conversation,
    "robustness": _episodes("robustness"),
}
"""Every experiment by its name on the command line, in the order of the report."""


def reported() -> list[str]:
    """List the experiments of the report: those of the paper, and what they cost."""
    return [name for name in STUDIES if name not in ("conversation", "robustness")]


def check_sizes(names: Sequence[str], settings: Settings) -> None:
    """Refuse, before the first of some experiments is run, what one of them could not do.

    Args:
        names: of the experiments.
        settings: what is run.

    Raises:
        ValueError: more than memory holds; says the size, the limit and what would fit.
    """
    for name in names:
        if name in GRIDS:
            GRIDS[name](settings).check(_options_of(name, settings))
        elif name in ("fig1", "fig4"):
            check_recording(navigator_config("faithful", settings.particles_drawn), MAX_STEPS)


def run_one(name: str, settings: Settings, output: Output) -> Study:
    """Run one experiment, print what it found and write its files.

    Args:
        name: a key of ``STUDIES``.
        settings: what is run, and where it is written.
        output: where people read.

    Returns:
        The document and its part of the report.

    Raises:
        ValueError: an option is outside its limits.
    """
    study = STUDIES[name](settings, output)
    for path in study.document.get("files", ()):
        output.say(f"Wrote {path}")
    return study


def run_all(settings: Settings, output: Output) -> Document:
    """Run all experiments, and write one page about them where a folder is given.

    Args:
        settings: what is run, and where it is written.
        output: where people read.

    Returns:
        Documents by name, and ``report``, the path of the page; None where nothing is written.

    Raises:
        ValueError: an option is outside its limits.
    """
    begin = time.perf_counter()
    found: dict[str, Study] = {}
    for place, name in enumerate(reported(), start=1):
        output.note(f"{name} ({place} of {len(reported())})")
        found[name] = run_one(name, settings, output)
    documents: dict[str, Any] = {name: study.document for name, study in found.items()}
    documents["report"] = None
    if settings.out is not None:
        made = _made_by(settings, time.perf_counter() - begin)
        sections = [study.section for study in found.values()]
        title = "Following commands in unknown places: ours beside the paper's"
        path = write_report(title, sections, settings.out / "report.html", made=made)
        documents["report"] = str(path)
        output.say(f"Wrote {path}")
    return documents


def _made_by(settings: Settings, seconds: float) -> dict[str, str]:
    """Say how a whole report was made; seconds on the wall, compilation included."""
    made = manifest({}, models=load_shipped())
    device, machine = made["device"], made["machine"]
    libraries = ", ".join(f"{name} {version}" for name, version in made["libraries"].items())
    return {
        "command": settings.command("all"),
        "versions": f"jaxlangnav {__version__}, Python {made['python']}, {libraries}",
        "models": f"as shipped, SHA-256 {made['models_sha256']}",
        "seed": f"{settings.seed}; {settings.seed_unknowns} in the study of the paper's unknowns",
        "episodes": f"{settings.episodes} a row and policy",
        "changed numbers": ", ".join(
            f"{'.'.join(place)} = {one}" for place, one in settings.values.items()
        ),
        "machine": f"{machine['system']} {machine['cpu']}, {machine['cores']} cores; "
        f"JAX on {device['count']} × {device['kind']}",
        "wall time": f"{seconds:.0f} s, compilation included",
        "the paper": "F. Duvallet, M. R. Walter, T. Howard, S. Hemachandra, J. Oh, S. Teller, "
        "N. Roy, A. Stentz: Inferring Maps and Behaviors from Natural Language Instructions. "
        "ISER 2014.",
    }
