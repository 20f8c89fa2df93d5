"""From sentences to a batch of grounded instructions, by the shipped models (section 3.1)."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp

from jaxlangnav.grounding.instruction import Instruction

SENTENCES = {
    "null": "go to the hydrant",
    "behind": "go to the hydrant behind the cone",
    "nearest": "go to the hydrant nearest to the cone",
}
"""The three commands of Table 2 by their relation; none of them is in a training corpus."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class GroundedSentences:
    """Sentences as the engine takes them, and the models that read them."""

    texts: tuple[str, ...]
    instructions: Instruction
    """Leaves [I, …], in the order of the texts."""
    models: Any
    """The trained weights, for a manifest's hash."""


def ground_sentences(texts: Sequence[str]) -> GroundedSentences:
    """Parse and ground sentences with the shipped models.

    Args:
        texts: one sentence each.

    Returns:
        The instructions, stacked.

    Raises:
        ValueError: a sentence is not understood or asks for nothing to be done, or there is none.
    """
    if not texts:
        raise ValueError("no sentence given")
    from jaxlangnav.grounding.instruction import understand
    from jaxlangnav.grounding.weights import load_shipped

    models = load_shipped()
    understood = [understand(text, models) for text in texts]
    for one in understood:
        one.check_task()
    return GroundedSentences(
        texts=tuple(texts),
        instructions=jax.tree.map(
            lambda *leaves: jnp.stack(leaves), *(one.instruction for one in understood)
        ),
        models=models,
    )
