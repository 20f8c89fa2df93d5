"""Table 2 of the paper: success and distance in simulated worlds (section 4.2).

Our rows stand beside the printed ones. The paper gives no geometry, no noise and no field of view;
worlds and noise are those of ``jaxlangnav.world`` and every row says how many runs it rests on.
"""

from collections.abc import Sequence
from typing import Any, Unpack

from jaxlangnav.experiments.experiment import Experiment, Options
from jaxlangnav.experiments.rows import RowSpec
from jaxlangnav.world.templates import TABLE_2

CALIBRATION_EPISODES = 32
"""Episodes of a row in which every step's belief is held against the truth."""

EXPERIMENT = Experiment(
    name="table2",
    specs=tuple(
        RowSpec(world=row.world, range=row.range, relation=row.relation) for row in TABLE_2
    ),
    title="Table 2: ours beside the paper's",
)
"""The seven rows, in the paper's order."""


def reproduce_table2(
    *, calibration_episodes: int = CALIBRATION_EPISODES, **options: Unpack[Options]
) -> dict[str, Any]:
    """Run the seven rows of Table 2 for every policy.

    Args:
        calibration_episodes: of each row, the first so many are judged step by step.
        options: as ``Experiment.run`` takes them.

    Returns:
        The document, see ``Experiment.run``.

    Raises:
        ValueError: fewer than one episode, or an unknown policy.
    """
    return EXPERIMENT.run(calibration_episodes=calibration_episodes, **options)


def total_episodes(*, episodes: int, policies: Sequence[str]) -> int:
    """Count the runs of the table, for a progress bar."""
    return EXPERIMENT.total_episodes(episodes=episodes, policies=policies)
