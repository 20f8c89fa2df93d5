"""What carries words never seen: Table 1's protocol with groups of word features left out.

``python scripts/ablation.py [SPLITS]`` prints the accuracy of both models, percent, on all held-out
sentences and on those with a word that training never saw.
"""

import sys

from jaxlangnav.experiments.table1 import MODELS, evaluate
from jaxlangnav.grounding.model import FEATURE_GROUPS
from jaxlangnav.inputs.sanitize import markdown_table


def main() -> None:
    """Leave out each group of word features in turn."""
    splits = int(sys.argv[1]) if len(sys.argv) > 1 else 40
    choices = [(), *((group,) for group in FEATURE_GROUPS), ("sense", "gram")]
    rows = []
    for without in [*choices, ("sense", "tag", "gram")]:
        document = evaluate(splits=splits, without=without)
        cells = [" ".join(without) or "nothing"]
        for one in (document[name] for name in MODELS):
            new = one["new_words"]["accuracy_mean"]
            cells.append(f"{one['accuracy_mean']:.1f} ± {one['accuracy_ci95']:.1f}")
            cells.append("none" if new is None else f"{new:.1f}")
        rows.append(cells)
    names = ("without", "annotation", "with new words", "behavior", "with new words")
    print(markdown_table(names, rows))


if __name__ == "__main__":
    main()
