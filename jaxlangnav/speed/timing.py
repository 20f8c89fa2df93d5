"""Where a decision cycle's time goes, over episodes of Table 2's rows (section 4.2's runs)."""

import time
from typing import Any

import numpy as np

from jaxlangnav.experiments.devices import LANES
from jaxlangnav.experiments.sentences import SENTENCES, ground_sentences
from jaxlangnav.experiments.tasks import cell, concatenate, make_tasks, take_tasks
from jaxlangnav.navigator import NavigatorParams
from jaxlangnav.speed.breakdown import measure_parts, share_entries
from jaxlangnav.speed.measuring import describe_machine
from jaxlangnav.world.templates import TABLE_2

_SEED = 4242
"""Of the worlds; none that a table uses by default."""


def cycle_parts(*, params: NavigatorParams, repetitions: int = 3) -> dict[str, Any]:
    """Measure the parts of a cycle, in a batch of episodes of all rows.

    Args:
        params: the navigator's numbers.
        repetitions: how often; the medians count.

    Returns:
        ``cycle_us`` and ``parts_us`` by name, microseconds of one cycle of one episode;
        ``machine``, ``wall_s``. A part that is left over may come out below zero by the noise of
        the others; it is then counted as nothing.
    """
    begin = time.perf_counter()
    machine = describe_machine()
    order = list(SENTENCES)
    number = -(-LANES // len(TABLE_2))
    cells = [
        cell(row.world, row.relation, order.index(row.relation), row.range, number, _SEED)
        for row in TABLE_2
    ]
    tasks = concatenate([make_tasks(one) for one in cells])
    mixed = np.random.default_rng(0).permutation(number * len(TABLE_2))
    instructions = ground_sentences(list(SENTENCES.values())).instructions
    measured = measure_parts(
        take_tasks(tasks, mixed), instructions, params=params, repetitions=repetitions
    )
    whole, *parts = share_entries(measured)
    return {
        "experiment": "time",
        "cycle_us": whole["value"],
        "parts_us": {
            part["name"].removeprefix("share of "): max(0.0, whole["value"] * part["value"] / 100)
            for part in parts
        },
        "machine": machine,
        "wall_s": time.perf_counter() - begin,
        "files": [],
    }
