"""Train the models that the package ships, and write them where it looks for them.

python scripts/train_models.py
"""

import json
import sys

from jaxlangnav.grounding.weights import save, shipped_path
from jaxlangnav.training.shipped import train_models


def main() -> None:
    """Train on the package's corpus and replace the shipped weights."""
    trained = train_models(on_progress=lambda line: print(line, file=sys.stderr))
    path = shipped_path()
    command = "python scripts/train_models.py"
    save(path, trained.model, command=command, corpus_hash=trained.report["corpus"])
    print(json.dumps(trained.report, indent=2))


if __name__ == "__main__":
    main()
