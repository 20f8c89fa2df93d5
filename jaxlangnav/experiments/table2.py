"""Table 2 of the paper: success and distance in simulated worlds (section 4.2).

Our rows stand beside the printed ones. The paper gives no geometry, no noise and no field of view;
worlds and noise are those of ``jaxlangnav.world`` and every row says how many runs it rests on.
"""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxlangnav.experiments.compilation import CompileClock
from jaxlangnav.experiments.monte_carlo import Progress
from jaxlangnav.experiments.policies import DEFAULT_PARTICLES, check_policies
from jaxlangnav.experiments.report import write_report
from jaxlangnav.experiments.rows import (
    RowSpec,
    bound_rows,
    check_episodes,
    default_noise,
    printed_rows,
    run_rows,
)
from jaxlangnav.experiments.sentences import SENTENCES, ground_sentences
from jaxlangnav.experiments.tables import caption, markdown_table, rich_table
from jaxlangnav.world.templates import TABLE_2

SPECS = tuple(RowSpec(world=row.world, range=row.range, relation=row.relation) for row in TABLE_2)
"""The seven rows, in the paper's order."""
_TITLE = "Table 2: ours beside the paper's"


def reproduce_table2(
    *,
    episodes: int = 100,
    policies: Sequence[str] = ("faithful",),
    seed: int = 0,
    out: str | Path | None = None,
    on_progress: Progress | None = None,
    num_particles: int = DEFAULT_PARTICLES,
) -> dict[str, Any]:
    """Run the seven rows of Table 2 for every policy.

    Args:
        episodes: runs a row, a fresh world each.
        policies: names; see ``policies.POLICY_NAMES``.
        seed: root seed of worlds and noise.
        out: folder for Parquet, Markdown and manifest; nothing is written if None.
        on_progress: called with the number of episodes just finished.
        num_particles: P, of the navigator's policies.

    Returns:
        The document: ``rows``, ``paper``, ``bounds``, ``sentences``, ``noise``, ``wall_s`` without
        compilation, ``compile_s``, ``files``. Rates in percent, distances in metres.

    Raises:
        ValueError: fewer than one episode, or an unknown policy.
    """
    check_episodes(episodes)
    names = check_policies(policies)
    begin = time.perf_counter()
    with CompileClock() as clock:
        sentences = ground_sentences(list(SENTENCES.values()))
        found = run_rows(
            SPECS,
            sentences,
            policies=names,
            episodes=episodes,
            seed=seed,
            num_particles=num_particles,
            on_progress=on_progress,
        )
    document: dict[str, Any] = {
        "experiment": "table2",
        "episodes": episodes,
        "policies": list(names),
        "seed": seed,
        "num_particles": num_particles,
        "sentences": SENTENCES,
        "noise": default_noise(),
        "rows": found.rows,
        "paper": printed_rows(TABLE_2),
        "bounds": bound_rows(SPECS),
        "wall_s": time.perf_counter() - begin - clock.seconds,
        "compile_s": clock.seconds,
        "files": [],
    }
    if out is not None:
        text = markdown(document)
        files = write_report(Path(out), "table2", document, found.columns, text, sentences.models)
        document["files"] = [str(path) for path in files]
    return document


def total_episodes(*, episodes: int, policies: Sequence[str]) -> int:
    """Count the runs of the table, for a progress bar."""
    return len(SPECS) * len(check_policies(policies)) * episodes


def markdown(document: dict[str, Any]) -> str:
    """Write the table as Markdown, ours beside the paper's.

    Args:
        document: of ``reproduce_table2``.

    Returns:
        A heading, the table and what it was measured under.
    """
    return f"# {_TITLE}\n\n{markdown_table(document)}\n{caption(document)}\n"


def render(document: dict[str, Any]) -> Any:
    """Draw the table for people.

    Args:
        document: of ``reproduce_table2``.

    Returns:
        A rich table.
    """
    return rich_table(document, title=_TITLE)
