"""A study of ``jaxlangnav reproduce`` as one record, and those of Figures 1, 3 and 4, run anew."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.reproduce import Reproduce
from jaxlangnav.cli.runtime import waiting
from jaxlangnav.cli.settings import SettingPath, equip
from jaxlangnav.experiments.archive import CompileClock, manifest, write_manifest
from jaxlangnav.experiments.experiment import Options
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.table import Report, Section, Table
from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.grounding.instruction import understand_parse
from jaxlangnav.grounding.weights import load
from jaxlangnav.inputs.whole_files import write_text
from jaxlangnav.language.parser import parse
from jaxlangnav.navigator import NavigatorParams
from jaxlangnav.planner.config import POLICIES
from jaxlangnav.task.follow import OpenedEpisode, record_episode
from jaxlangnav.task.opening import open_task
from jaxlangnav.viz.html import write_graph, write_html
from jaxlangnav.viz.narrative import describe_moments, moments_table, narrate, select_steps
from jaxlangnav.viz.panels import belief_figure, values_figure
from jaxlangnav.viz.style import save

Found = tuple[dict[str, Any], Callable[[Path], Iterable[Path]]]
"""A document, and what writes the files of it into a folder."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What is run, and where it is written."""

    options: Options
    """Of the experiments made of episodes; the sensing range is a matter of each row."""
    params: NavigatorParams
    ranges: tuple[float, ...]
    """Metres, in place of those of Table 2's rows and of Figure 5; none for their own."""
    values: Mapping[SettingPath, Any]
    """Numbers of engine, detector and motion that are not the defaults."""
    asked: Reproduce  # the other options, and how to run an experiment again

    @property
    def seed_unknowns(self) -> int:
        """Seed of worlds of their own, none that a table or a tuning has used."""
        return 3000 if self.asked.seed is None else self.asked.seed

    @property
    def particles_drawn(self) -> int:
        """P of the episodes that are drawn."""
        return self.asked.particles or 256


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study(Report):
    """An experiment of ``reproduce``: how it is run, and what stands of it in the report."""

    run: Callable[[Settings, Output], Found]  # runs it and tells it
    made: Callable[[Document], Mapping[str, str]] = lambda _: {}
    """What else there is to say of how it was made."""

    def section(self, document: Document, command: str) -> Section:
        """Put what was found into the report; SVG pictures are shown, sharp at any size."""
        wall, files = document["wall_s"], [Path(path) for path in document["files"]]
        took = f"{wall:.{0 if wall > 10 else 1}f} s"
        if "compile_s" in document:
            took += f", {document['compile_s']:.0f} s of them compilation"
        return Section(
            title=self.title,
            lead=self.lead,
            pictures=[(path, f"{self.title}: figure") for path in files if path.suffix == ".svg"],
            tables=self.tables(document),
            notes=self.notes(document),
            made={
                "command": command,
                **self.made(document),
                "wall time": took,
                "files": ", ".join(path.name for path in files),
            },
        )


TEXT = SENTENCES["behind"]  # the sentence of all three figures


_FIGURE_NOTES = [
    "Probabilities that the goal is an object seen, or unseen left or right of where the robot "
    "faced at first; the spread of the unseen goal; the share of the area seen.",
    "The paper prints no coordinates; the arrangement is ours, a world of the package.",
]


def _figure(
    title: str, name: str, num_panels: int, draw: Callable[..., Any], paper: str, ours: str
) -> Study:
    """Build the study of a figure of one episode; ``name`` is of its world and of the files."""

    def run(settings: Settings, output: Output) -> Found:
        # All policies by default: then the paper's, whose figure it is.
        named = [one for one in settings.options.policies if one in POLICIES]
        policy = named[0] if len(named) == 1 else "faithful"
        sizes = navigator_config(policy, settings.particles_drawn)
        with CompileClock() as clock, waiting(f"an episode in {name}", output):
            understood = understand_parse(parse(TEXT), load(None))
            prepared = open_task(name, understood, sensing_range=None, seed=settings.options.seed)
            prepared, params = equip(prepared, settings.values, params=settings.params)
            given = {"text": TEXT, "understood": understood, "prepared": prepared, "params": params}
            episode = record_episode(OpenedEpisode(**given, config=sizes))
        output.tell(narrate(episode))
        steps, scene, result = select_steps(episode, num_panels), episode.scene, episode.result
        document = {
            "experiment": name,
            "instruction": TEXT,
            "world": name,
            "policy": policy,
            "seed": settings.options.seed,
            "num_particles": settings.particles_drawn,
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
            table = moments_table(document["moments"]).markdown()
            told = {key: value for key, value in document.items() if key != "moments"}
            made, stem = manifest(told, models=load(None)), out / name
            text = f"# {title}\n\n{paper}\n\n{ours}\n\n{table}"
            return [
                *save(draw(episode, steps=steps), stem),
                write_html(episode, stem.with_suffix(".html")),
                write_text(text, stem.with_suffix(".md")),
                write_manifest(made, out / f"{name}_manifest.json"),
            ]

        return document, write

    return Study(
        title=title,
        lead=f"{paper} {ours}",
        run=run,
        tables=lambda document: [moments_table(document["moments"])],
        notes=lambda _: _FIGURE_NOTES,
        made=lambda one: {
            "episode": f"world {one['world']}, policy {one['policy']}, seed {one['seed']}, "
            f"{one['num_particles']} particles, sensing range {one['range']:g} m",
        },
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


def _count_factors(_: Settings, output: Output) -> Found:
    """Build the factor graph of the sentence, count its parts, and draw it: Figure 3."""
    model, parsed = load(None), parse(TEXT)
    document: dict[str, Any] = {
        "experiment": "figure3",
        "instruction": TEXT,
        "graph": understand_parse(parsed, model).graph(7),
        "paper": {"annotation": {"factors": 2964, "variables": 5934},
                  "behavior": {"factors": 383, "variables": 772}},
    }  # fmt: skip
    for row in _factors_table(document).rows:
        output.say(f"{row[0]}: {row[1]} factors (paper {row[2]}), {row[3]} variables ({row[4]})")
    return document, lambda out: write_graph(parsed, model, out, name="figure3")


def _factors_table(document: Document) -> Table:
    """Lay out the sizes of the graph beside the paper's."""
    rows = [
        [kind, *(f"{document[who][kind][what]:,}" for what in ("factors", "variables")
                 for who in ("graph", "paper"))]
        for kind in ("annotation", "behavior")
    ]  # fmt: skip
    return Table(headings=["", "factors", "paper", "random variables", "paper"], rows=rows)


FACTOR_GRAPH = Study(
    title="Figure 3: the factor graph of a sentence",
    lead="A Distributed Correspondence Graph of the sentence; the counts are of the graph that "
    "is constructed, with seven objects for behaviors.",
    run=_count_factors,
    tables=lambda document: [_factors_table(document)],
)
"""Figure 3."""
