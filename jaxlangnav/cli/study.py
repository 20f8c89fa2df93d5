"""The record of an experiment of ``jaxlangnav reproduce``; Figures 1, 3 and 4."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.reproduce import Reproduce
from jaxlangnav.cli.runtime import spinner
from jaxlangnav.cli.settings import OptionPath, apply_to_episode
from jaxlangnav.experiments.archive import CompileClock, manifest, write_manifest
from jaxlangnav.experiments.experiment import Options
from jaxlangnav.experiments.table import Report, Section, Table
from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.grounding.instruction import understand
from jaxlangnav.grounding.weights import load_shipped
from jaxlangnav.inputs.atomic_files import write_text
from jaxlangnav.language.parser import parse
from jaxlangnav.navigator import NavigatorParams
from jaxlangnav.planner.config import POLICIES
from jaxlangnav.task.follow import prepare_episode, record_episode
from jaxlangnav.viz.graph import graph_figure
from jaxlangnav.viz.html import write_html
from jaxlangnav.viz.narrative import MOMENT_COLUMNS, describe_moments, narrate, select_steps
from jaxlangnav.viz.panels import belief_figure, values_figure
from jaxlangnav.viz.style import save
from jaxlangnav.world.files import open_world

StudyResult = tuple[dict[str, Any], Callable[[Path], Iterable[Path]]]
"""A document, and a function that writes its files into a folder."""

_FACTS = {
    "world": "world", "policy": "policy", "episodes": "episodes a row and arm", "seed": "seed",
    "num_particles": "particles", "range": "sensing range, m", "models_sha256": "models, SHA-256",
}  # fmt: skip
"""Keys of documents that the report lists, with what it calls them."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """Options of a run of ``reproduce``."""

    options: Options  # for experiments over episodes; each row sets its sensing range
    params: NavigatorParams
    ranges: tuple[float, ...]
    """Sensing ranges, metres, that replace those of Table 2 and Figure 5; empty: theirs."""
    values: Mapping[OptionPath, Any]  # changed parameters of navigator, sensor and motion
    args: Reproduce  # the other options, and how to run an experiment again

    @property
    def sensitivity_seed(self) -> int:
        """Seed of the experiment ``unknowns``; by default, no table or tuning uses its worlds."""
        return 3000 if self.args.seed is None else self.args.seed

    @property
    def num_figure_particles(self) -> int:
        """Number of particles of the episodes of Figures 1 and 4."""
        return self.args.particles or 256


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study(Report):
    """An experiment of ``reproduce``: its function and its section of the report."""

    run: Callable[[Settings, Output], StudyResult]  # runs it and prints its results

    def section(self, document: Document, command: str) -> Section:
        """Build the section of the report, with its SVG figures and tables."""
        wall, files = document["wall_s"], [Path(path) for path in document["files"]]
        duration = f"{wall:.{0 if wall > 10 else 1}f} s"
        if "compile_s" in document:
            duration += f", {document['compile_s']:.0f} s of them compilation"
        return Section(
            title=self.title,
            intro=self.intro,
            pictures=[(path, f"{self.title}: figure") for path in files if path.suffix == ".svg"],
            tables=self.tables(document),
            notes=self.notes(document),
            facts={
                "command": command,
                **{_FACTS[key]: str(document[key]) for key in _FACTS if key in document},
                "wall time": duration,
                "files": ", ".join(path.name for path in files),
            },
        )


TEXT = SENTENCES["behind"]  # the sentence of all three figures


def _figure(
    title: str, name: str, num_panels: int, draw: Callable[..., Any], paper: str, ours: str
) -> Study:
    """Build the study of a figure of one episode; ``name``: of its world and files."""

    def run(settings: Settings, output: Output) -> StudyResult:
        # The paper's policy unless exactly one is given.
        known = [key for key in settings.options.policies if key in POLICIES]
        policy = known[0] if len(known) == 1 else "faithful"
        seed, particles = settings.options.seed, settings.num_figure_particles
        with CompileClock() as clock, spinner(f"an episode in {name}"):
            understood = understand(TEXT, load_shipped())
            options = open_world(name), None, policy, seed, particles
            prepared = prepare_episode(understood, *options, params=settings.params)
            episode = record_episode(apply_to_episode(prepared, settings.values))
        output.print_wrapped(narrate(episode))
        steps, scene, result = select_steps(episode, num_panels), episode.scene, episode.result
        document = {
            "experiment": name,
            "instruction": TEXT,
            "world": name,
            "policy": policy,
            "seed": seed,
            "num_particles": particles,
            "range": float(scene.sensor.range_max),
            "success": bool(result.is_success),
            "distance": float(result.distance),
            "known_distance": scene.known_distance,
            "steps": int(result.steps),
            "moments": describe_moments(episode, steps),
            "paper": paper,
            "compile_s": clock.seconds,
        }

        def write(out: Path) -> Iterable[Path]:
            table = Table.of(document["moments"], MOMENT_COLUMNS).markdown()
            summary = {key: value for key, value in document.items() if key != "moments"}
            manifest_, stem = manifest(summary, models=load_shipped()), out / name
            return [
                *save(draw(episode, steps=steps), stem),
                write_html(episode, stem.with_suffix(".html")),
                write_text(f"# {title}\n\n{paper}\n\n{ours}\n\n{table}", stem.with_suffix(".md")),
                write_manifest(manifest_, out / f"{name}_manifest.json"),
            ]

        return document, write

    return Study(
        title=title,
        intro=f"{paper} {ours}",
        run=run,
        tables=lambda document: [Table.of(document["moments"], MOMENT_COLUMNS)],
        notes=lambda _: [
            "Probabilities that the goal is an object seen, or unseen left or right of where the "
            "robot faced at first; the spread of the unseen goal; the share of the area seen.",
            "The paper prints no coordinates; the arrangement is ours, a world of the package.",
        ],
    )


FIGURE_1 = _figure(
    "Figure 1: the belief over time",
    "figure1",
    6,
    belief_figure,
    "In the paper the robot begins with the cone in its field of view and does not know "
    "the hydrant's location; its belief gathers behind the cone and follows what it sees.",
    "The same scene: hypotheses of the hydrant gather behind the cone; those that come "
    "into view and are not there are refuted; then the hydrant is seen.",
)
FIGURE_4 = _figure(
    "Figure 4: the value function over time",
    "figure4",
    4,
    values_figure,
    "In the paper the robot has observed two cones and hypothesises hydrants behind both "
    "(a); it moves towards the left cluster first, does not find the hydrant there, and the "
    "map's distribution peaks at the right cluster (b); it moves right and observes the "
    "hydrant (c).",
    "The same scene: values γ^d of every waypoint over the distribution of the goal "
    "(equations 11 and 12); the table says where the unseen goal is believed to be.",
)


def _count_factors(_: Settings, output: Output) -> StudyResult:
    """Build the factor graph of the sentence, count its factors, and draw it (Figure 3)."""
    model = load_shipped()
    document: dict[str, Any] = {
        "experiment": "figure3",
        "instruction": TEXT,
        "graph": understand(TEXT, model).graph(7),
        "paper": {"annotation": {"factors": 2964, "variables": 5934},
                  "behavior": {"factors": 383, "variables": 772}},
    }  # fmt: skip
    for row in _factors_table(document).rows:
        output.print(f"{row[0]}: {row[1]} factors (paper {row[2]}), {row[3]} variables ({row[4]})")
    return document, lambda out: save(graph_figure(parse(TEXT), model), out / "figure3")


def _factors_table(document: Document) -> Table:
    """Build the table of graph sizes beside the paper's."""
    rows = [
        [graph, *(f"{document[source][graph][part]:,}" for part in ("factors", "variables")
                 for source in ("graph", "paper"))]
        for graph in ("annotation", "behavior")
    ]  # fmt: skip
    return Table(headings=["", "factors", "paper", "random variables", "paper"], rows=rows)


FACTOR_GRAPH = Study(
    title="Figure 3: the factor graph of a sentence",
    intro="A Distributed Correspondence Graph of the sentence; the counts are of the graph that "
    "is constructed, with seven objects for behaviors.",
    run=_count_factors,
    tables=lambda document: [_factors_table(document)],
)
"""Figure 3."""
