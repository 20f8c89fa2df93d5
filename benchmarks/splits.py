"""Eight hold-out splits trained at once against one: the protocol of Table 1, one thread.

    python benchmarks/splits.py [--quick] [--json]

The splits share words, properties and bases; their counts, weights and gradients differ, so the
arithmetic of eight is eight times that of one, and only what is not arithmetic is shared. The fit
is timed from the counts to the weights; "from instructions" also makes the features of all phrases
and joins equal factors, which is done once for all splits. Compilation is left out.
"""

import pinning  # noqa: I001 - before JAX and NumPy start their threads

import statistics
import time
from collections.abc import Callable

import numpy as np
import record
from record import Measurement, entry

from jaxlangnav.experiments.table1 import draw_splits
from jaxlangnav.experiments.table1 import CORPUS, MODELS
from jaxlangnav.training.examples import (
    PhraseExample,
    annotation_examples,
    behavior_examples,
    read_examples,
)
from jaxlangnav.grounding.model import ANNOTATION_KINDS, BEHAVIOR_KINDS
from jaxlangnav.training.fit import build_design, fit
from jaxlangnav.language.corpus import load_corpus
from jaxlangnav.language.lexicon import load_lexicon

SPLITS, TARGET = 8, 2.0


def seconds(work: Callable[[], object], repetitions: int) -> float:
    """Measure CPU seconds, the median."""
    found = []
    for _ in range(repetitions):
        begin = time.process_time()
        work()
        found.append(time.process_time() - begin)
    return statistics.median(found)


def compare(name: str, repetitions: int) -> list[Measurement]:
    """Train one split and eight of one model."""
    types = load_lexicon().type_names
    instructions = read_examples(load_corpus(CORPUS), types)
    shares = (~draw_splits(len(instructions), SPLITS, 0)).astype(np.float32)
    build = annotation_examples if name == "annotation" else behavior_examples
    kinds = ANNOTATION_KINDS if name == "annotation" else BEHAVIOR_KINDS

    def prepare() -> list[PhraseExample]:
        return build(instructions, types)

    _, design = build_design(prepare(), kinds, len(instructions))
    preparing = seconds(
        lambda: build_design(prepare(), kinds, len(instructions)), min(repetitions, 3)
    )
    times = []
    for part in (shares[:1], shares):
        fit(design, part)
        runs = [fit(design, part)[1].cpu_seconds for _ in range(repetitions)]
        times.append(statistics.median(runs))
    one, eight = times

    def over(title: str, more: float) -> list[Measurement]:
        cost = (eight + more) / (one + more)
        name_of = f"training {name}, 8 splits at once, {title}"
        return [
            entry(name_of, eight + more, "s CPU"),
            entry(f"{name_of}: in units of one", cost, "", target=TARGET, is_limit=True),
        ]

    return [*over("the fit", 0.0), *over("from instructions", preparing)]


def entries(*, is_quick: bool) -> list[Measurement]:
    """Measure both models.

    Args:
        is_quick: fewer repetitions.

    Returns:
        Entries of the bench's document.
    """
    return [row for name in MODELS for row in compare(name, 3 if is_quick else 15)]


if __name__ == "__main__":
    record.main(entries, __doc__, pinning.CORE)
