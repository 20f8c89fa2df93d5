"""Table 2 of the paper: success and distance in simulated worlds (section 4.2).

Our rows stand beside the printed ones. The paper gives no geometry, no noise and no field of view;
worlds and noise are those of ``jaxlangnav.world`` and every row says how many runs it rests on.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxlangnav.experiments.experiment import Experiment
from jaxlangnav.experiments.monte_carlo import Progress
from jaxlangnav.experiments.policies import DEFAULT_PARTICLES
from jaxlangnav.experiments.rows import RowSpec
from jaxlangnav.experiments.tables import caption, markdown_table, rich_table
from jaxlangnav.world.templates import TABLE_2

CALIBRATION_EPISODES = 32
"""Episodes of a row in which every step's belief is held against the truth."""
_TITLE = "Table 2: ours beside the paper's"


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


EXPERIMENT = Experiment(
    name="table2",
    specs=tuple(
        RowSpec(world=row.world, range=row.range, relation=row.relation) for row in TABLE_2
    ),
    markdown=markdown,
)
"""The seven rows, in the paper's order."""


def reproduce_table2(
    *,
    episodes: int = 100,
    policies: Sequence[str] = ("faithful",),
    seed: int = 0,
    out: str | Path | None = None,
    on_progress: Progress | None = None,
    num_particles: int = DEFAULT_PARTICLES,
    calibration_episodes: int = CALIBRATION_EPISODES,
    environments: int = 0,
) -> dict[str, Any]:
    """Run the seven rows of Table 2 for every policy.

    Args:
        episodes: runs a row, a fresh world each.
        policies: names; see ``policies.POLICY_NAMES``.
        seed: root seed of worlds and noise.
        out: folder for Parquet, Markdown and manifest; nothing is written if None.
        on_progress: called with the number of episodes just finished.
        num_particles: P, of the navigator's policies.
        calibration_episodes: of each row, the first so many are judged step by step.
        environments: worlds of a template taken in turn, ten in the paper; 0 for a fresh one per
            episode.

    Returns:
        The document, see ``Experiment.run``.

    Raises:
        ValueError: fewer than one episode, or an unknown policy.
    """
    return EXPERIMENT.run(
        episodes=episodes,
        policies=policies,
        seed=seed,
        out=out,
        on_progress=on_progress,
        num_particles=num_particles,
        calibration_episodes=calibration_episodes,
        environments=environments,
    )


def total_episodes(*, episodes: int, policies: Sequence[str]) -> int:
    """Count the runs of the table, for a progress bar."""
    return EXPERIMENT.total_episodes(episodes=episodes, policies=policies)
