"""The experiments behind ``jaxlangnav reproduce`` by their names: one, or all with a report."""

import functools
import time
from collections.abc import Callable, Sequence
from typing import Any

from jaxlangnav import __version__
from jaxlangnav.cli import illustrations, studies
from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.study import Settings, Study
from jaxlangnav.episode import MAX_STEPS
from jaxlangnav.experiments.archive import manifest
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.report import write_report
from jaxlangnav.experiments.sizes import check_recording
from jaxlangnav.grounding.weights import load_shipped

STUDIES: dict[str, Callable[[Settings, Output], Study]] = {
    "table1": studies.table1,
    "fig1": functools.partial(illustrations.illustrate, "fig1"),
    "fig3": illustrations.factor_graph,
    "fig4": functools.partial(illustrations.illustrate, "fig4"),
    "table2": studies.episodes("table2"),
    "fig5": studies.episodes("fig5"),
    "unknowns": studies.episodes("unknowns"),
    "time": studies.timing,
    "conversation": studies.conversation,
    "robustness": studies.episodes("robustness"),
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
        if name in ("table2", "fig5", "unknowns", "robustness"):
            options = studies.options_of(name, settings)
            studies.experiment_of(name, settings).check(options)
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
