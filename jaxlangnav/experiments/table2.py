"""Table 2 of the paper: success and distance in simulated worlds (section 4.2).

Our rows stand beside the printed ones. The paper gives no geometry, no noise and no field of view;
worlds and noise are those of ``jaxlangnav.world`` and every row says how many runs it rests on.
The paper ran further worlds and ranges that it does not print; they can be run beside its rows.
"""

from collections.abc import Sequence

from jaxlangnav.experiments.experiment import Experiment
from jaxlangnav.experiments.figure5 import describe_falls
from jaxlangnav.experiments.rows import PRINTED, RowSpec

CALIBRATION_EPISODES = 32
"""Episodes of a row in which every step's belief is held against the truth."""
_LEAD = (
    "Success and distance in simulated worlds, by world and command (section 4.2). A run succeeds "
    "if the robot itself says stop within 1.5 m of the intended goal."
)
EXTRA = (
    ("2H2C", 3.0, "null"),
    ("2H2C", 3.0, "behind"),
    ("2H2C", 5.0, "nearest"),
    ("1H3C", 3.0, "null"),
    ("1H3C", 3.0, "behind"),
    ("3H1C", 3.0, "null"),
    ("3H1C", 3.0, "behind"),
    ("3H1C", 5.0, "nearest"),
)
"""Rows that the paper does not print: its fourth template, and three objects of one kind."""


def table_2(*, extra: bool = False, ranges: Sequence[float] = ()) -> Experiment:
    """Build the table.

    Args:
        extra: whether the rows that the paper does not print stand beneath its own.
        ranges: metres, in place of each row's own.

    Returns:
        Rows in the paper's order, ranges growing.
    """
    printed = [(row.world, row.range, row.relation) for row in PRINTED]
    reaches = sorted(set(ranges))
    return Experiment(
        name="table2",
        title="Table 2: ours beside the paper's",
        lead=_LEAD,
        specs=tuple(
            RowSpec(world=world, range=reach, relation=relation)
            for world, own, relation in [*printed, *(EXTRA if extra else ())]
            for reach in reaches or [own]
        ),
        remark=describe_falls if len(reaches) > 1 else None,
        calibration_episodes=CALIBRATION_EPISODES,
    )
