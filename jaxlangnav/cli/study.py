"""A study of ``jaxlangnav reproduce`` as one record, and those of Figures 1, 3 and 4, run anew."""

import dataclasses
import functools
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxlangnav.cli.engine import load_models
from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.runtime import waiting
from jaxlangnav.cli.settings import SettingPath, apply
from jaxlangnav.experiments.archive import CompileClock, manifest, write_manifest
from jaxlangnav.experiments.experiment import Options
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.table import Section, Table
from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.files.whole import write_text
from jaxlangnav.grounding.instruction import understand_parse
from jaxlangnav.language.parser import parse
from jaxlangnav.navigator import NavigatorParams
from jaxlangnav.planner.config import POLICIES
from jaxlangnav.pytree import replace
from jaxlangnav.recording import Recording
from jaxlangnav.task.follow import record_episode
from jaxlangnav.task.opening import open_task
from jaxlangnav.viz.html import write_graph, write_html
from jaxlangnav.viz.narrative import describe_moments, moments_table, narrate, pick_moments
from jaxlangnav.viz.panels import belief_figure, values_figure
from jaxlangnav.viz.style import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What is run, and where it is written."""

    options: Options
    """Of the experiments made of episodes; the sensing range is a matter of each row."""
    params: NavigatorParams
    seed_unknowns: int
    """Of the study of the paper's unknowns."""
    extra: bool
    """Whether Table 2 has rows that the paper lacks."""
    ranges: tuple[float, ...]
    """Metres, in place of those of Table 2's rows and of Figure 5; none for their own."""
    particles_drawn: int
    """P of the episodes that are drawn."""
    values: Mapping[SettingPath, Any]
    """Numbers of engine, detector and motion that are not the defaults."""
    out: Path | None
    command: Callable[[str], str]
    """Writes the command that runs an experiment again."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Study:
    """An experiment of ``reproduce``: how it is run, and what stands of it in the report."""

    title: str
    lead: str
    """What it is, and what to see in it."""
    run: Callable[[Settings, Output], dict[str, Any]]
    """Runs it and tells it; the document has ``wall_s`` and the ``files`` that are written."""
    tables: Callable[[Document], list[Table]] = lambda _: []
    notes: Callable[[Document], list[str]] = lambda _: []
    figures: "Callable[[Document], Mapping[str, Callable[[], Figure]]]" = lambda _: {}
    """What draws its figures, by the name of their files."""
    made: Callable[[Document], Mapping[str, str]] = lambda _: {}
    """What else there is to say of how it was made."""

    def section(self, name: str, document: Document, settings: Settings) -> Section:
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
                "command": settings.command(name),
                **self.made(document),
                "wall time": took,
                "files": ", ".join(path.name for path in files),
            },
        )


TEXT = SENTENCES["behind"]
"""The sentence of all three figures."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Figure:
    """A figure of one episode."""

    title: str
    name: str
    """Of its world, and of the files."""
    num_panels: int
    paper: str
    """What the printed figure shows, by its caption."""
    ours: str
    """What to see in ours."""
    draw: Callable[..., Any]


def _study(figure: _Figure) -> Study:
    """Build the study of a figure of one episode."""
    return Study(
        title=figure.title,
        lead=f"{figure.paper} {figure.ours}",
        run=functools.partial(_illustrate, figure),
        tables=lambda document: [moments_table(document["moments"])],
        notes=lambda _: [
            "Probabilities that the goal is an object seen, or unseen left or right of where "
            "the robot faced at first; the spread of the unseen goal; the share of the area seen.",
            "The paper prints no coordinates; the arrangement is ours, a world of the package.",
        ],
        made=lambda one: {
            "episode": f"world {one['world']}, policy {one['policy']}, seed {one['seed']}, "
            f"{one['num_particles']} particles, sensing range {one['range']:g} m",
        },
    )


def _illustrate(figure: _Figure, settings: Settings, output: Output) -> dict[str, Any]:
    """Run the episode of a figure, tell it and draw it."""
    # All policies by default: then the paper's, whose figure it is.
    named = [one for one in settings.options.policies if one in POLICIES]
    policy = named[0] if len(named) == 1 else "faithful"
    begin = time.perf_counter()
    with CompileClock() as clock, waiting(f"an episode in {figure.name}", output):
        recording = _record(figure, policy, settings)
    steps = pick_moments(recording, figure.num_panels)
    output.tell(narrate(recording))
    document = {
        "experiment": figure.name,
        "instruction": TEXT,
        "world": figure.name,
        "policy": policy,
        "seed": settings.options.seed,
        "num_particles": settings.particles_drawn,
        "range": float(recording.scene.sensor.range_max),
        "success": bool(recording.result.is_success),
        "distance": float(recording.result.distance),
        "known_distance": recording.scene.known_distance,
        "steps": int(recording.result.steps),
        "moments": describe_moments(recording, steps),
        "paper": figure.paper,
        "wall_s": time.perf_counter() - begin,
        "compile_s": clock.seconds,
        "files": [],
    }
    if settings.out is not None:
        table = moments_table(document["moments"]).markdown()
        text = f"# {figure.title}\n\n{figure.paper}\n\n{figure.ours}\n\n{table}"
        told = {key: value for key, value in document.items() if key != "moments"}
        made, stem = manifest(told, models=load_models(None)), settings.out / figure.name
        paths = [
            *save(figure.draw(recording, steps=steps), stem),
            write_html(recording, stem.with_suffix(".html")),
            write_text(text, stem.with_suffix(".md")),
            write_manifest(made, settings.out / f"{figure.name}_manifest.json"),
        ]
        document["files"] = [str(path) for path in paths]
    return document


FIGURE_1 = _study(
    _Figure(
        title="Figure 1: the belief over time",
        name="figure1",
        num_panels=6,
        paper="In the paper the robot begins with the cone in its field of view and does not know "
        "the hydrant's location; its belief gathers behind the cone and follows what it sees.",
        ours="The same scene: hypotheses of the hydrant gather behind the cone; those that come "
        "into view and are not there are refuted; then the hydrant is seen.",
        draw=belief_figure,
    )
)
FIGURE_4 = _study(
    _Figure(
        title="Figure 4: the value function over time",
        name="figure4",
        num_panels=4,
        paper="In the paper the robot has observed two cones and hypothesises hydrants behind both "
        "(a); it moves towards the left cluster first, does not find the hydrant there, and the "
        "map's distribution peaks at the right cluster (b); it moves right and observes the "
        "hydrant (c).",
        ours="The same scene: values γ^d of every waypoint over the distribution of the goal "
        "(equations 11 and 12); the table says where the unseen goal is believed to be.",
        draw=values_figure,
    )
)


def _count_factors(settings: Settings, output: Output) -> dict[str, Any]:
    """Build the factor graph of the sentence, count its parts, and draw it: Figure 3."""
    begin = time.perf_counter()
    model, parsed = load_models(None), parse(TEXT)
    document: dict[str, Any] = {
        "experiment": "figure3",
        "instruction": TEXT,
        "graph": understand_parse(parsed, model).graph(7),
        "paper": {"annotation": {"factors": 2964, "variables": 5934},
                  "behavior": {"factors": 383, "variables": 772}},
        "wall_s": time.perf_counter() - begin,
        "files": [],
    }  # fmt: skip
    for row in _factors_table(document).rows:
        output.say(f"{row[0]}: {row[1]} factors (paper {row[2]}), {row[3]} variables ({row[4]})")
    if settings.out is not None:
        pictures = write_graph(parsed, model, settings.out, name="figure3")
        document["files"] = [str(path) for path in pictures]
    return document


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


def _record(figure: _Figure, policy: str, settings: Settings) -> Recording:
    """Run the episode of a figure."""
    understood = understand_parse(parse(TEXT), load_models(None))
    seed = settings.options.seed
    prepared = open_task(figure.name, understood, sensing_range=None, seed=seed)
    task = prepared.task
    sensor = apply(task.sensor, settings.values, "sensor")
    motion = apply(task.motion, settings.values, "motion")
    prepared = dataclasses.replace(prepared, task=replace(task, sensor=sensor, motion=motion))
    return record_episode(
        understood,
        prepared,
        text=TEXT,
        params=replace(settings.params, map=replace(settings.params.map, motion=motion)),
        config=navigator_config(policy, settings.particles_drawn),
    )
