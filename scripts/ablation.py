"""What carries words never seen: Table 1's protocol with groups of word features left out."""

import sys
from typing import Any

from jaxlangnav.experiments.table1 import MODELS, evaluate
from jaxlangnav.grounding.model import FEATURE_GROUPS


def ablate(*, splits: int = 40, seed: int = 0) -> list[dict[str, Any]]:
    """Leave out each group of word features in turn: what carries words never seen?

    Args:
        splits: random splits for each.
        seed: of the splits, the same for all.

    Returns:
        One row per choice: ``without``, and the accuracy of both models, percent, on all
        held-out sentences and on those with a word that training never saw (``new_words``).
    """
    choices: list[tuple[str, ...]] = [(), *((group,) for group in FEATURE_GROUPS)]
    choices += [("sense", "gram"), ("sense", "tag", "gram")]
    rows = []
    for without in choices:
        document = evaluate(splits=splits, seed=seed, without=without)
        rows.append(
            {
                "without": " ".join(without) or "nothing",
                **{name: document[name]["accuracy_mean"] for name in MODELS},
                **{f"{name}_ci95": document[name]["accuracy_ci95"] for name in MODELS},
                **{
                    f"{name}_new_words": document[name]["new_words"]["accuracy_mean"]
                    for name in MODELS
                },
            }
        )
    return rows


def main() -> None:
    """Print the table as Markdown: ``python scripts/ablation.py [SPLITS]``."""
    splits = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    print("| without | annotation | with new words | behavior | with new words |")
    print("|---|---|---|---|---|")
    for row in ablate(splits=splits):
        cells = [row["without"]]
        for name in MODELS:
            new = row[f"{name}_new_words"]
            cells += [
                f"{row[name]:.1f} ± {row[f'{name}_ci95']:.1f}",
                "none" if new is None else f"{new:.1f}",
            ]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
