"""``jaxlangnav reproduce unknowns``: what the paper leaves open, one thing at a time."""

import importlib.util
from pathlib import Path

from jaxlangnav.cli.output import Output
from jaxlangnav.cli.reproduction import Settings, Study
from jaxlangnav.cli.runtime import progress_bar
from jaxlangnav.experiments.report import Section, Table
from jaxlangnav.studies import unknowns_tables
from jaxlangnav.studies.unknowns import reproduce_unknowns, total_episodes


def unknowns(settings: Settings, output: Output) -> Study:
    """Run the study of the paper's unknowns.

    Args:
        settings: episodes, seed, particles, numbers, folder.
        output: where the table is printed.

    Returns:
        The study.
    """
    total = total_episodes(episodes=settings.episodes)
    with progress_bar("episodes", total) as advance:
        document = reproduce_unknowns(
            episodes=settings.episodes,
            seed=settings.seed_unknowns,
            out=settings.out,
            on_progress=advance,
            num_particles=settings.particles,
            params=settings.params,
            sensor=settings.sensor(),
            motion=settings.motion(),
        )
    output.say(unknowns_tables.render(document))
    wall, compiling = document["wall_s"], document["compile_s"]
    output.say(f"{total} episodes in {wall:.1f} s, {compiling:.1f} s of them compilation.")
    pictures: list[Path] = []
    if settings.out is not None:
        pictures = _draw(document, settings.out, output)
        document["files"] += [str(path) for path in pictures]
    headings, lines = unknowns_tables.matrix(document, mark="*")
    long_headings, long_lines = unknowns_tables.long_table(document)
    section = Section(
        title=unknowns_tables.TITLE,
        lead=unknowns_tables.LEAD,
        pictures=[
            (path, "Success and distance of every variation beside the paper's")
            for path in pictures
            if path.suffix == ".svg"
        ],
        tables=[
            Table(headings=headings, rows=lines),
            Table(headings=long_headings, rows=long_lines, fold="All figures"),
        ],
        notes=[
            *unknowns_tables.explained_lines(document),
            *unknowns_tables.caption(document).splitlines(),
        ],
        made={
            "command": settings.command("unknowns"),
            "episodes": f"{document['episodes']} a row and variation, seed {document['seed']}",
            "models": f"SHA-256 {document['models_sha256']}",
            "wall time": f"{wall:.0f} s, {compiling:.0f} s of them compilation",
            "files": ", ".join(Path(one).name for one in document["files"]),
        },
    )
    return Study(document=document, section=section)


def _draw(document: unknowns_tables.Document, out: Path, output: Output) -> list[Path]:
    """Draw the figure, where there is something to draw with."""
    if importlib.util.find_spec("matplotlib") is None:
        output.note('note: no figure without matplotlib: pip install "jaxlangnav[viz]"')
        return []
    from jaxlangnav.viz.style import save
    from jaxlangnav.viz.unknowns import unknowns_figure

    return [*save(unknowns_figure(document), out / "unknowns")]
