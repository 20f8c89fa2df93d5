"""Run the experiments of ``jaxlangnav reproduce``: print, draw and write the report.

``GRIDS`` and ``STUDIES`` are their registry, by the names on the command line.
"""

import dataclasses
import importlib.util
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec

from jaxlangnav import __version__
from jaxlangnav.cli import runtime
from jaxlangnav.cli.output import Document, Output, document_text
from jaxlangnav.cli.settings import apply
from jaxlangnav.cli.study import FACTOR_GRAPH, FIGURE_1, FIGURE_4, Settings, Study, StudyResult
from jaxlangnav.episode import MAX_STEPS
from jaxlangnav.experiments import conversation as spoken, paper, robustness, unknowns
from jaxlangnav.experiments.archive import manifest, pytree_hash, read_part, write_manifest
from jaxlangnav.experiments.experiment import Experiment, Options
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.reliability import pool_bins, reliability_curve
from jaxlangnav.experiments.sizes import check_recording
from jaxlangnav.experiments.table import Report, Section, Table, report_html
from jaxlangnav.experiments.table1 import evaluate, table_1
from jaxlangnav.experiments.timing import cycle_parts
from jaxlangnav.grounding.weights import load_shipped
from jaxlangnav.inputs.atomic_files import write_text
from jaxlangnav.navigator.api import Navigator

_NUM_SPLITS = 8  # random splits of Table 1, as in the paper
_TITLE3 = "Table 3 in simulation: ours beside the paper's"
_CAPTION3 = (
    "Physics-in-the-loop simulation with rendered-camera perception; the paper drove real robots. "
    "Success: said to have arrived, within 1.5 m of the intended goal; 95 % interval. "
    "Distance truly travelled, mean (sd)."
)
_PAPER = (
    "F. Duvallet, M. R. Walter, T. Howard, S. Hemachandra, J. Oh, S. Teller, N. Roy, A. Stentz: "
    "Inferring Maps and Behaviors from Natural Language Instructions. ISER 2014."
)
_AMBIGUOUS_CURVE = "“go to the hydrant” among several: nothing says which"
_CURVE_NAMES = {
    "null": "“go to the hydrant”",
    "behind": "“… behind the cone”",
    "nearest": "“… nearest to the cone”",
}
GRIDS = ("table2", "fig5", "unknowns", "robustness")  # experiments over episodes


def _experiment(name: str, settings: Settings) -> tuple[Experiment, Options]:
    """Build an experiment of ``GRIDS`` and its options."""
    options, ranges = settings.options, settings.ranges
    if name == "table2":
        return paper.table_2(extra=settings.args.extra, ranges=ranges), options
    if name == "fig5":
        return paper.figure_5(ranges=ranges), options
    if name == "unknowns":
        return unknowns.UNKNOWNS, dataclasses.replace(options, seed=settings.sensitivity_seed)
    params = apply(Navigator.pretrained().params, settings.values, "params")
    return robustness.ROBUSTNESS, dataclasses.replace(options, params=params)


def _run_table1(settings: Settings, output: Output) -> StudyResult:
    """Run the paper's evaluation of language understanding (Table 1)."""
    with runtime.progress_bar("splits", _NUM_SPLITS) as advance:
        document = evaluate(splits=_NUM_SPLITS, seed=settings.options.seed, on_progress=advance)
    table = table_1(document)
    output.print(table.text())
    text = f"# {table.title}\n\n{table.markdown()}"
    return document, lambda out: [write_text(text, out / "table1.md")]


def _episode_study(name: str, settings: Settings) -> Study:
    """Build the study of one experiment of ``GRIDS``, all rows and policies."""
    experiment, options = _experiment(name, settings)

    def run(settings: Settings, output: Output) -> StudyResult:
        total = experiment.total_episodes(options)
        with runtime.progress_bar("episodes", total) as advance:
            document = experiment.run(options, out=settings.args.out, on_progress=advance)
        output.print(experiment.render(document))
        wall, compiling = document["wall_s"], document["compile_s"]
        output.print(f"{total} episodes in {wall:.1f} s, {compiling:.1f} s of them compilation.")
        return document, lambda out: _draw(experiment.name, document, out, output)

    return Study(
        **{field.name: getattr(experiment, field.name) for field in dataclasses.fields(Report)},
        run=run,
    )


def _run_timing(settings: Settings, output: Output) -> StudyResult:
    """Measure the run time of each part of a decision cycle with the settings' parameters."""
    with runtime.spinner("timing the parts of a cycle"):
        document: dict[str, Any] = cycle_parts(params=settings.params)
    total, parts = document["cycle_us"], document["parts_us"]
    for part, micros in sorted(parts.items(), key=lambda item: -item[1]):
        output.print(f"{part:<34} {micros:8.1f} µs {100 * micros / total:5.1f} %")
    return document, lambda out: [
        write_manifest(document, out / "time.json"),
        *_draw("time", document, out, output),
    ]


def _run_conversation(settings: Settings, output: Output) -> StudyResult:
    """Run episodes with a simulated speaker, policy ``informed`` only."""
    options = settings.options
    with runtime.progress_bar("episodes", options.episodes * len(spoken.ROWS)) as advance:
        document = spoken.run_rows(options, on_progress=advance)
    output.print(spoken.CONVERSATION.render(document))

    return document, lambda out: [
        write_text(spoken.CONVERSATION.markdown(document), out / "conversation.md"),
        write_text(document_text(document), out / "conversation.json"),
    ]


def _run_table3(settings: Settings, output: Output) -> StudyResult:
    """Run the physics simulations of Table 3; trials found in the folder are not repeated."""
    from jaxlangnav.robots.trials import TABLE3, TRIAL_COLUMNS, TrialPlan, reproduce_table3

    args, policies = settings.args, settings.options.policies
    policy = policies[0] if len(policies) == 1 else "informed"
    plan = TrialPlan(trials=args.trials or 10, seed=args.seed or 0, policy=policy, out=args.out)
    total = len(TABLE3) * (plan.trials + 1)
    output.note(f"{total} runs of two robots, two at a time")
    with runtime.progress_bar("runs", total) as advance:
        document = reproduce_table3(plan, on_progress=advance)
    table = Table.of(document["rows"], TRIAL_COLUMNS, title=_TITLE3, caption=_CAPTION3)
    output.print(table.text())
    for row in document["rows"]:
        name = f"{row['robot']} {row['world']} {row['range']:g} m {row['relation'] or 'null'}"
        for failure in row["failures"]:
            output.print(f"{name}, trial {failure['trial']}: {failure['ending']}: {failure['why']}")
    low, high = (100 * bound for bound in document["success_interval"])
    output.print(
        f"Over all: {100 * document['success']:.1f} % [{low:.1f}, {high:.1f}]; "
        f"{total - document['resumed']} runs in {document['wall_s']:.0f} s, "
        f"{document['resumed']} kept from before."
    )
    return document, lambda out: [
        write_text(f"# {_TITLE3}\n\n{_CAPTION3}\n\n{table.markdown()}", out / "table3.md"),
        write_text(document_text(document), out / "table3.json"),
    ]


def _draw(name: str, document: Document, out: Path, output: Output) -> list[Path]:
    """Draw the figures of an experiment if matplotlib is installed."""
    if importlib.util.find_spec("matplotlib") is None:
        output.note('note: no figure without matplotlib: pip install "jaxlangnav[viz]"')
        return []
    from jaxlangnav.viz.rows import reliability_figure, table_figure, time_figure
    from jaxlangnav.viz.style import save
    from jaxlangnav.viz.sweep import range_figure, robustness_figure, unknowns_figure

    figures: dict[str, Callable[..., Any]] = {
        "time": lambda document: time_figure(document["parts_us"]),
        "robustness": robustness_figure,
        "table2": table_figure,
        "figure5": range_figure,
        "unknowns": unknowns_figure,
    }
    paths = [*save(figures[name](document), out / name)]
    if name not in ("time", "robustness") and (panels := reliability_panels(document)):
        subtitle = (
            f"Every step of {document['calibration_episodes']} episodes a row of Table 2; "
            "intervals allow for steps of one episode being alike."
        )
        title = "Calibration: “this object is the goal”"
        paths += save(reliability_figure(panels, title=title, subtitle=subtitle),
                      out / "calibration")  # fmt: skip
    return paths


def reliability_panels(document: Document) -> dict[str, dict[str, Any]]:
    """Pool the reliability curves of Table 2's rows by policy and command over all worlds.

    Several hydrants without a relation form their own curve: the command is ambiguous.
    """
    panels: dict[str, dict[str, list[Any]]] = {}
    for row in document["rows"]:
        reliability = row.get("reliability")
        if reliability is not None and any(reliability["planner"]["events"]):
            is_ambiguous = row["relation"] is None and not row["world"].startswith("1H")
            name = _AMBIGUOUS_CURVE if is_ambiguous else _CURVE_NAMES[row["relation"] or "null"]
            panels.setdefault(row["policy"], {}).setdefault(name, []).append(reliability["planner"])
    return {
        policy: {name: reliability_curve(pool_bins(rows)) for name, rows in curves.items()}
        for policy, curves in panels.items()
    }


STUDIES = {
    "table1": Study(
        title="Table 1: how often sentences are understood",
        intro="Whole sentences whose annotation or behavior is exactly right among those held "
        "out, mean and 95 % interval over random splits of 67 to 33 percent (section 4.1).",
        run=_run_table1,
        tables=lambda document: [table_1(document)],
        notes=lambda _: [
            "The corpora differ: the paper's 39 instructions were never published, ours ship "
            "in the package. The commands of Table 2 are in neither."
        ],
    ),
    "fig1": FIGURE_1,
    "fig3": FACTOR_GRAPH,
    "fig4": FIGURE_4,
    "time": Study(
        title="Where the time goes",
        intro="The parts of one decision cycle of one episode, each compiled alone and timed on "
        "the same beliefs in a batch; planner, motion and what else there are is left over.",
        run=_run_timing,
        notes=lambda document: [
            "{device}, {threads} threads, load {load} at the start; JAX {jax}; policy {policy}. "
            "CPU time of all threads.".format_map(document["machine"])
        ],
    ),
    "conversation": Study(title=spoken.CONVERSATION.title, run=_run_conversation),
    "table3": Study(title=_TITLE3, run=_run_table3),
}
"""All other experiments."""
_DURATIONS = {
    "table1": (1, 60.0), "table2": (4200, 200.0), "table3": (11, 94.0), "fig1": (1, 40.0),
    "fig3": (1, 2.0), "fig4": (1, 40.0), "fig5": (4200, 200.0), "unknowns": (4200, 200.0),
    "conversation": (800, 390.0), "robustness": (10000, 600.0), "time": (1, 60.0),
}  # fmt: skip
"""Items and seconds on two cores, roughly: each is replaced by the first run on a machine."""
REPORTED = ("table1", "fig1", "fig3", "fig4", "table2", "fig5", "unknowns", "time")
"""Experiments of the report, in order."""


def check_sizes(names: Sequence[str], settings: Settings) -> None:
    """Check memory needs and libraries of experiments before the first one runs."""
    for name in names:
        if name in GRIDS:
            experiment, options = _experiment(name, settings)
            experiment.check(options)
        elif name in ("fig1", "fig4"):
            check_recording(navigator_config("faithful", settings.num_figure_particles), MAX_STEPS)
        elif name == "table3":
            from jaxlangnav.robots.libraries import check_libraries

            check_libraries()


def _num_items(name: str, settings: Settings) -> int:
    """Count the episodes or trials on which the duration of an experiment depends, else 1."""
    if name in GRIDS:
        experiment, options = _experiment(name, settings)
        return experiment.total_episodes(options)
    counts = {
        "conversation": settings.options.episodes * len(spoken.ROWS),
        "table3": (settings.args.trials or 10) + 1,
    }
    return counts.get(name, 1)


def _estimate(name: str, settings: Settings) -> float:
    """Estimate the duration of an experiment in seconds, compilation included."""
    return runtime.expected_duration(name, _num_items(name, settings), default=_DURATIONS[name])


def run_one(name: str, settings: Settings, output: Output) -> tuple[dict[str, Any], Study]:
    """Run an experiment, print its results, write its files and draw its figures."""
    study = _episode_study(name, settings) if name in GRIDS else STUDIES[name]
    output.note(f"{name}: about {runtime.duration_text(_estimate(name, settings))}")
    begin = time.perf_counter()
    document, write = study.run(settings, output)
    document |= {"wall_s": time.perf_counter() - begin, "files": []} | document
    if not document.get("resumed"):
        runtime.save_duration(name, document["wall_s"], _num_items(name, settings))
    if settings.args.out is not None:
        document["files"] += [str(path) for path in write(settings.args.out)]
    for path in document["files"]:
        output.print(f"Wrote {path}")
    return document, study


def run_all(settings: Settings, output: Output) -> Document:
    """Run all experiments; with a folder, ``report.html`` is written after each.

    A run that was interrupted goes on: the folder keeps what is finished until all is.
    """
    begin = time.perf_counter()
    seconds = {name: _estimate(name, settings) for name in REPORTED}
    parts = ", ".join(f"{name} {runtime.duration_text(each)}" for name, each in seconds.items())
    output.note(f"about {runtime.duration_text(sum(seconds.values()))}: {parts}")
    documents: dict[str, Any] = {"report": None}
    sections = []
    models, out = pytree_hash(load_shipped()), settings.args.out
    paths = {} if out is None else {name: out / f"{name}_part.json" for name in REPORTED}
    for name in REPORTED:
        origin = [settings.args.command(name), __version__, models]
        if part := read_part(paths.get(name), origin):
            output.note(f"{name}: finished by the run that was interrupted")
        else:
            document, study = run_one(name, settings, output)
            section = dataclasses.asdict(study.section(document, origin[0]))
            part = {"origin": origin, "document": document, "section": section}
            if out is not None:
                write_text(document_text(part), paths[name])
        documents[name] = part["document"]
        sections.append(msgspec.convert(part["section"], Section, dec_hook=lambda to, x: to(x)))
        if out is not None:
            documents["report"] = str(_write_page(sections, settings, time.perf_counter() - begin))
    for path in paths.values():
        path.unlink()
    if documents["report"] is not None:
        output.print(f"Wrote {documents['report']}")
    return documents


def _write_page(sections: list[Section], settings: Settings, seconds: float) -> Path:
    """Write ``report.html`` with the sections of the experiments that have been run."""
    assert settings.args.out is not None
    setup = manifest({}, models=load_shipped())
    device, machine = setup["device"], setup["machine"]
    libraries = ", ".join(f"{name} {version}" for name, version in setup["libraries"].items())
    values = settings.values.items()
    facts = {
        "command": settings.args.command("all"),
        "versions": f"jaxlangnav {__version__}, Python {setup['python']}, {libraries}",
        "models": f"as shipped, SHA-256 {setup['models_sha256']}",
        "seed": f"{settings.options.seed}; {settings.sensitivity_seed} in the study of the "
        "paper's unknowns",
        "episodes": f"{settings.options.episodes} a row and policy",
        "changed numbers": ", ".join(f"{'.'.join(i)} = {value}" for i, value in values),
        "machine": f"{machine['system']} {machine['cpu']}, {machine['cores']} cores; "
        f"JAX on {device['count']} × {device['kind']}",
        "wall time": f"{seconds:.0f} s, compilation included",
        "the paper": _PAPER,
    }
    title = "Following commands in unknown places: ours beside the paper's"
    return write_text(report_html(title, sections, facts=facts), settings.args.out / "report.html")
