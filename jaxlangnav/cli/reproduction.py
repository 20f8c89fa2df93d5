"""The experiments behind ``jaxlangnav reproduce``: run, print, draw, write, report."""

import dataclasses
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxlangnav import __version__
from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.settings import Place, apply
from jaxlangnav.experiments.archive import manifest
from jaxlangnav.experiments.report import Section, write_html
from jaxlangnav.messages import MotionParams, SensorParams, default_motion, default_sensor
from jaxlangnav.navigator import NavigatorParams


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What is run, and where it is written."""

    episodes: int
    policies: tuple[str, ...]
    seed: int
    seed_unknowns: int
    """Of the study of the paper's unknowns."""
    extra: bool
    """Whether Table 2 has rows that the paper lacks."""
    ranges: tuple[float, ...]
    """Metres, in place of those of Table 2's rows and of Figure 5; none for their own."""
    particles: int
    particles_drawn: int
    """P of the episodes that are drawn."""
    params: NavigatorParams
    values: Mapping[Place, Any]
    """Numbers of engine, detector and motion that are not the defaults."""
    out: Path | None
    command: Callable[[str], str]
    """Writes the command that runs an experiment again."""

    def sensor(self) -> SensorParams:
        """Build the detector of drawn worlds; its range is a matter of each row."""
        return apply(default_sensor(), self.values, "sensor")

    def motion(self) -> MotionParams:
        """Build the odometry of drawn worlds."""
        return apply(default_motion(), self.values, "motion")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """An experiment that has been run."""

    document: dict[str, Any]
    section: Section


def check_sizes(names: Sequence[str], settings: Settings) -> None:
    """Refuse, before the first of some experiments is run, what one of them could not do.

    Args:
        names: of the experiments.
        settings: what is run.

    Raises:
        ValueError: more than memory holds; says the size, the limit and what would fit.
    """
    from jaxlangnav.cli import studies
    from jaxlangnav.episode import MAX_STEPS
    from jaxlangnav.experiments.policies import navigator_config
    from jaxlangnav.experiments.sizes import check_recording
    from jaxlangnav.studies import unknowns

    episodes, particles = settings.episodes, settings.particles
    for name in names:
        if name in ("table2", "fig5"):
            experiment = studies.experiment_of(name, settings)
            experiment.check(episodes=episodes, policies=settings.policies, num_particles=particles)
        elif name == "unknowns":
            unknowns.check_sizes(episodes=episodes, num_particles=particles)
        elif name in ("fig1", "fig4"):
            check_recording(navigator_config("faithful", settings.particles_drawn), MAX_STEPS)


def run_one(name: str, settings: Settings, output: Output) -> Study:
    """Run one experiment, print what it found and write its files.

    Args:
        name: "table1", "table2", "fig1", "fig3", "fig4", "fig5", "unknowns" or "time".
        settings: what is run, and where it is written.
        output: where people read.

    Returns:
        The document and its part of the report.

    Raises:
        ValueError: an option is outside its limits.
    """
    from jaxlangnav.cli import studies

    study = studies.STUDIES[name](settings, output)
    for path in study.document.get("files", ()):
        output.say(f"Wrote {path}")
    return study


def run_all(names: Sequence[str], settings: Settings, output: Output) -> Document:
    """Run all experiments, and write one page about them where a folder is given.

    Args:
        names: of the experiments, in the order of the page.
        settings: what is run, and where it is written.
        output: where people read.

    Returns:
        Documents by name, and ``report``, the path of the page; None where nothing is written.

    Raises:
        ValueError: an option is outside its limits.
    """
    begin = time.perf_counter()
    studies = {}
    for place, name in enumerate(names, start=1):
        output.note(f"{name} ({place} of {len(names)})")
        studies[name] = run_one(name, settings, output)
    documents: dict[str, Any] = {name: study.document for name, study in studies.items()}
    documents["report"] = None
    if settings.out is not None:
        made = made_by(settings, time.perf_counter() - begin)
        sections = [study.section for study in studies.values()]
        title = "Following commands in unknown places: ours beside the paper's"
        path = write_html(title, sections, settings.out / "report.html", made=made)
        documents["report"] = str(path)
        output.say(f"Wrote {path}")
    return documents


def made_by(settings: Settings, seconds: float) -> dict[str, str]:
    """Say how a whole report was made.

    Args:
        settings: what was run.
        seconds: on the clock on the wall, compilation included.

    Returns:
        Terms and what they are.
    """
    from jaxlangnav.grounding.weights import load_shipped

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
