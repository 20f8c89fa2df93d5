"""Figure 5 of the paper: distance and success against the sensing range (section 4.2).

For "behind" and for "nearest", ranges of 2 to 20 m. The figure itself is drawn by
``jaxlangnav.viz``; here are the numbers. The printed figure gives none; where Table 2 prints a row
of the same world, relation and range, that row stands in ``paper``.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxlangnav.experiments.experiment import Experiment
from jaxlangnav.experiments.monte_carlo import Progress
from jaxlangnav.experiments.policies import DEFAULT_PARTICLES
from jaxlangnav.experiments.rows import RowSpec
from jaxlangnav.experiments.tables import caption, markdown_table, rich_table
from jaxlangnav.world.templates import parse_template

RANGES = (2.0, 3.0, 5.0, 10.0, 15.0, 20.0)
"""Metres, as in the paper."""
RELATIONS = ("behind", "nearest")
WORLDS = ("2H1C",)
"""The template of which Table 2 prints both commands."""
_TITLE = "Figure 5: distance and success against the sensing range"


def markdown(document: dict[str, Any]) -> str:
    """Write the figure's numbers as a Markdown table.

    Args:
        document: of ``reproduce_figure5``.

    Returns:
        A heading, the table, where success falls as the range grows, and the conditions.
    """
    return (
        f"# {_TITLE}\n\n{markdown_table(document)}\n{_describe_falls(document)}\n\n"
        f"{caption(document)}\n"
    )


def render(document: dict[str, Any]) -> Any:
    """Draw the figure's numbers for people.

    Args:
        document: of ``reproduce_figure5``.

    Returns:
        A rich table.
    """
    return rich_table(document, title=_TITLE)


def experiment(worlds: Sequence[str] = WORLDS) -> Experiment:
    """Build the experiment for some worlds.

    Args:
        worlds: templates, such as "2H1C".

    Returns:
        Rows by world and relation, ranges growing.

    Raises:
        ValueError: no world, or an unknown template.
    """
    if not worlds:
        raise ValueError("no world given: name a template such as 2H1C")
    specs = [
        RowSpec(world=parse_template(world).name, range=sensing_range, relation=relation)
        for world in worlds
        for relation in RELATIONS
        for sensing_range in RANGES
    ]
    return Experiment(name="figure5", specs=tuple(specs), markdown=markdown)


def reproduce_figure5(
    *,
    episodes: int = 100,
    policies: Sequence[str] = ("faithful", "informed", "known"),
    seed: int = 0,
    out: str | Path | None = None,
    on_progress: Progress | None = None,
    num_particles: int = DEFAULT_PARTICLES,
    worlds: Sequence[str] = WORLDS,
    environments: int = 0,
) -> dict[str, Any]:
    """Run both commands at every range, for every policy.

    Args:
        episodes: runs a row, a fresh world each; a world is the same at every range.
        policies: names; see ``policies.POLICY_NAMES``.
        seed: root seed of worlds and noise.
        out: folder for Parquet, Markdown and manifest; nothing is written if None.
        on_progress: called with the number of episodes just finished.
        num_particles: P, of the navigator's policies.
        worlds: templates.
        environments: worlds of a template taken in turn, ten in the paper; 0 for a fresh one per
            episode.

    Returns:
        The document, see ``Experiment.run``; ``falls`` lists where success is lower than at the
        range before, their intervals apart.

    Raises:
        ValueError: fewer than one episode, an unknown policy or template.
    """
    document = experiment(worlds).run(
        episodes=episodes,
        policies=policies,
        seed=seed,
        out=out,
        on_progress=on_progress,
        num_particles=num_particles,
        environments=environments,
    )
    return document | {"falls": falls(document)}


def total_episodes(
    *, episodes: int, policies: Sequence[str], worlds: Sequence[str] = WORLDS
) -> int:
    """Count the runs of the figure, for a progress bar."""
    return experiment(worlds).total_episodes(episodes=episodes, policies=policies)


def falls(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Find where success falls as the range grows: the intervals of neighbours do not meet.

    Args:
        document: with ``rows``.

    Returns:
        One entry per fall: ``world``, ``relation``, ``policy``, ``range``, ``from``, ``to``.
    """
    curves: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for row in document["rows"]:
        curves.setdefault((row["world"], row["relation"], row["policy"]), []).append(row)
    found = []
    for (world, relation, policy), rows in curves.items():
        ordered = sorted(rows, key=lambda row: row["range"])
        for before, after in itertools.pairwise(ordered):
            if after["success_ci"][1] < before["success_ci"][0]:
                found.append(
                    {
                        "world": world,
                        "relation": relation,
                        "policy": policy,
                        "range": after["range"],
                        "from": before["success_rate"],
                        "to": after["success_rate"],
                    }
                )
    return found


def _describe_falls(document: dict[str, Any]) -> str:
    """Say in words where success falls."""
    lines = [
        f"{one['policy']}, {one['world']} {one['relation']}: success falls from "
        f"{one['from']:.1f} % to {one['to']:.1f} % at {one['range']:g} m."
        for one in falls(document)
    ]
    return "\n".join(lines) or "Success nowhere falls beyond its intervals as the range grows."
