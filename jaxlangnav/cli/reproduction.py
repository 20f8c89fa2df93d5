"""The experiments behind ``jaxlangnav reproduce``: run, printed, drawn and put into the report.

``STUDIES`` is their registry: one record each, by name, from the settings of the command line.
"""

import dataclasses
import functools
import importlib.util
import json
import time
from collections.abc import Callable, Sequence
from typing import Any

from jaxlangnav import __version__
from jaxlangnav.cli.output import Document, Output, to_json
from jaxlangnav.cli.runtime import progress_bar, waiting
from jaxlangnav.cli.settings import apply
from jaxlangnav.cli.study import FACTOR_GRAPH, FIGURE_1, FIGURE_4, Settings, Study
from jaxlangnav.episode import MAX_STEPS
from jaxlangnav.experiments import conversation as spoken, paper, robustness, unknowns
from jaxlangnav.experiments.archive import manifest, write_manifest
from jaxlangnav.experiments.experiment import Experiment, Options
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.sizes import check_recording
from jaxlangnav.experiments.table import Section, write_report
from jaxlangnav.experiments.table1 import evaluate, table_1
from jaxlangnav.experiments.timing import cycle_parts
from jaxlangnav.files.whole import write_text
from jaxlangnav.grounding.weights import load_shipped

_SPLITS = 8
"""Random splits of Table 1, as in the paper; ``jaxlangnav evaluate`` takes any number."""
_AMBIGUOUS = "“go to the hydrant” among several: nothing says which"
_CURVES = {
    "null": "“go to the hydrant”",
    "behind": "“… behind the cone”",
    "nearest": "“… nearest to the cone”",
}


GRIDS: dict[str, Callable[[Settings], Experiment]] = {
    "table2": lambda settings: paper.table_2(extra=settings.extra, ranges=settings.ranges),
    "fig5": lambda settings: paper.figure_5(ranges=settings.ranges),
    "unknowns": lambda _: unknowns.UNKNOWNS,
    "robustness": lambda _: robustness.ROBUSTNESS,
}
"""The experiments made of episodes: from settings to rows."""


def _table1(settings: Settings, output: Output) -> dict[str, Any]:
    """Run the paper's protocol for understanding; of the settings the seed is read."""
    begin = time.perf_counter()
    with progress_bar("splits", _SPLITS) as advance:
        document = evaluate(splits=_SPLITS, seed=settings.options.seed, on_progress=advance)
    laid = table_1(document)
    output.say(laid.text())
    document |= {"wall_s": time.perf_counter() - begin, "files": []}
    if settings.out is not None:
        text = f"# {laid.title}\n\n{laid.markdown()}"
        document["files"].append(str(write_text(text, settings.out / "table1.md")))
    return document


def _episodes(name: str, settings: Settings) -> Study:
    """Build the study of an experiment made of episodes: every row and arm."""
    experiment, options = GRIDS[name](settings), _options_of(name, settings)

    def run(settings: Settings, output: Output) -> dict[str, Any]:
        with progress_bar("episodes", experiment.total_work(options)) as advance:
            document = experiment.run(options, out=settings.out, on_progress=advance)
        output.say(experiment.render(document))
        wall, compiling = document["wall_s"], document["compile_s"]
        total = experiment.total_episodes(options)
        output.say(f"{total} episodes in {wall:.1f} s, {compiling:.1f} s of them compilation.")
        return document

    return Study(
        title=experiment.title,
        lead=experiment.lead,
        run=run,
        tables=experiment.tables,
        notes=experiment.notes,
        figures=functools.partial(_figures, experiment.name),
        made=lambda document: {
            "episodes": f"{document['episodes']} a row and arm, seed {document['seed']}, "
            f"{document['num_particles']} particles",
            "models": f"SHA-256 {document['models_sha256']}",
        },
    )


def _options_of(name: str, settings: Settings) -> Options:
    """Say what an experiment of episodes runs."""
    changed: dict[str, Any] = {}
    if name == "unknowns":
        changed["seed"] = settings.seed_unknowns
    if name == "robustness":
        changed["params"] = apply(robustness.numbers(), settings.values, "params")
    return dataclasses.replace(settings.options, **changed)


def _timing(settings: Settings, output: Output) -> dict[str, Any]:
    """Measure where a decision cycle's time goes, under the engine's numbers of the settings."""
    with waiting("timing the parts of a cycle", output):
        document: dict[str, Any] = cycle_parts(params=settings.params)
    whole, parts = document["cycle_us"], document["parts_us"]
    for part, spent in sorted(parts.items(), key=lambda one: -one[1]):
        output.say(f"{part:<34} {spent:8.1f} µs {100 * spent / whole:5.1f} %")
    if settings.out is not None:
        document["files"] = [str(write_manifest(document, settings.out / "time.json"))]
    return document


def _conversation(settings: Settings, output: Output) -> dict[str, Any]:
    """Run episodes in which a simulated person speaks; ``informed`` alone is told of it."""
    given = settings.options
    with progress_bar("episodes", given.episodes * len(spoken.ROWS)) as advance:
        document = spoken.run_rows(
            episodes=given.episodes,
            seed=given.seed,
            particles=given.num_particles,
            params=settings.params,
            out=settings.out,
            on_progress=advance,
        )
    output.say(spoken.dialogue_table(document).text())
    if settings.out is not None:
        written = json.dumps(to_json(document), indent=2) + "\n"
        document["files"].append(str(write_text(written, settings.out / "conversation.json")))
    return document


def _figures(name: str, document: Document) -> dict[str, Callable[[], Any]]:
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


def reliability_panels(document: Document) -> dict[str, dict[str, Any]]:
    """Gather the reliability curves of Table 2's rows: by policy and command, over all worlds.

    Several hydrants and no relation stand apart: there no belief can know which is meant.
    """
    from jaxlangnav.experiments.judging import curve, pooled

    parts: dict[str, dict[str, list[Any]]] = {}
    for row in document["rows"]:
        found = row.get("reliability")
        if found is not None and any(found["planner"]["events"]):
            is_open = row["relation"] is None and not row["world"].startswith("1H")
            name = _AMBIGUOUS if is_open else _CURVES[row["relation"] or "null"]
            parts.setdefault(row["policy"], {}).setdefault(name, []).append(found["planner"])
    return {
        policy: {name: curve(pooled(listed)) for name, listed in curves.items()}
        for policy, curves in parts.items()
    }


STUDIES: dict[str, Study | Callable[[Settings], Study]] = {
    "table1": Study(
        title="Table 1: how often sentences are understood",
        lead="Whole sentences whose annotation or behavior is exactly right among those held "
        "out, mean and 95 % interval over random splits of 67 to 33 percent (section 4.1).",
        run=_table1,
        tables=lambda document: [table_1(document)],
        notes=lambda _: [
            "The corpora differ: the paper's 39 instructions were never published, ours ship "
            "in the package. The commands of Table 2 are in neither.",
        ],
        made=lambda document: {"seed": str(document["seed"])},
    ),
    "fig1": FIGURE_1,
    "fig3": FACTOR_GRAPH,
    "fig4": FIGURE_4,
    **{name: functools.partial(_episodes, name) for name in ("table2", "fig5", "unknowns")},
    "time": Study(
        title="Where the time goes",
        lead="The parts of one decision cycle of one episode, each compiled alone and timed on "
        "the same beliefs in a batch; planner, motion and what else there are is left over.",
        run=_timing,
        notes=lambda document: [
            "{device}, {threads} threads, load {load} at the start; JAX {jax}; policy {policy}. "
            "CPU time of all threads.".format_map(document["machine"])
        ],
        figures=functools.partial(_figures, "time"),
    ),
    "conversation": Study(
        title=spoken.HEADING,
        lead="A simulated person who knows the goal corrects, answers and states.",
        run=_conversation,
        tables=lambda document: [spoken.dialogue_table(document)],
        notes=lambda _: [spoken.NOTE],
    ),
    "robustness": functools.partial(_episodes, "robustness"),
}
"""Every experiment by its name on the command line, in the order of the report; those made of
episodes are built from the settings."""


def reported() -> list[str]:
    """List the experiments of the report: those of the paper, and what they cost."""
    return [name for name in STUDIES if name not in ("conversation", "robustness")]


def check_sizes(names: Sequence[str], settings: Settings) -> None:
    """Refuse, before the first of some experiments is run, what memory cannot hold."""
    for name in names:
        if name in GRIDS:
            GRIDS[name](settings).check(_options_of(name, settings))
        elif name in ("fig1", "fig4"):
            check_recording(navigator_config("faithful", settings.particles_drawn), MAX_STEPS)


def run_one(name: str, settings: Settings, output: Output) -> tuple[dict[str, Any], Section]:
    """Run one of ``STUDIES``, print what it found, write its files and draw its figures.

    Returns:
        The document and its part of the report.
    """
    study = STUDIES[name]
    study = study if isinstance(study, Study) else study(settings)
    document, out = study.run(settings, output), settings.out
    if out is not None and (figures := study.figures(document)):
        if importlib.util.find_spec("matplotlib") is None:
            output.note('note: no figure without matplotlib: pip install "jaxlangnav[viz]"')
        else:
            from jaxlangnav.viz.style import save

            drawn = [path for file, draw in figures.items() for path in save(draw(), out / file)]
            document["files"] += map(str, drawn)
    for path in document["files"]:
        output.say(f"Wrote {path}")
    return document, study.section(name, document, settings)


def run_all(settings: Settings, output: Output) -> Document:
    """Run all experiments, and write one page about them, ``report``, where a folder is given."""
    begin = time.perf_counter()
    found: dict[str, tuple[dict[str, Any], Section]] = {}
    for place, name in enumerate(reported(), start=1):
        output.note(f"{name} ({place} of {len(reported())})")
        found[name] = run_one(name, settings, output)
    documents: dict[str, Any] = {name: document for name, (document, _) in found.items()}
    documents["report"] = None
    if settings.out is not None:
        made = _made_by(settings, time.perf_counter() - begin)
        sections = [section for _, section in found.values()]
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
        "seed": f"{settings.options.seed}; {settings.seed_unknowns} in the study of the paper's "
        "unknowns",
        "episodes": f"{settings.options.episodes} a row and policy",
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
