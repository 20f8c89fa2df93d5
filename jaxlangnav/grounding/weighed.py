"""A tree whose words have met the weights, and what is inferred of it (section 3.1, eq. 4).

Written once for every symbol space: log-odds given the children, ranks, search, beliefs.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding.graph import Path, bottom_up
from jaxlangnav.grounding.search import BEAM_WIDTH, Hypothesis, search
from jaxlangnav.grounding.space import RANK, AnyWorld, BlockSpace, Described
from jaxlangnav.language.phrase import Phrase


@dataclasses.dataclass(frozen=True, kw_only=True)
class PhraseBelief:
    """What a phrase is taken to express."""

    phrase: Phrase
    path: Path
    probability: np.ndarray  # f64[S] that each symbol is expressed
    rank: int  # 1 where its region is meant as an extreme ("nearest"), 2 for the second; or 0

    @property
    def parent(self) -> Path | None:
        """Path of the parent phrase; None at the root of a clause."""
        return self.path[:-1] if len(self.path) > 1 else None


class WeighedPhrase(NamedTuple):
    """A phrase whose words have met the weights."""

    coefficients: Mapping[str, np.ndarray]  # kind → log-odds per property, f32[F], or [K, F]
    described: Described


def weigh_phrases(
    space: BlockSpace[AnyWorld],
    coefficients: Callable[[Phrase], Mapping[str, np.ndarray]],
    root: Phrase,
    world: AnyWorld,
    clause: int,
) -> dict[Path, WeighedPhrase]:
    """Let the words of a tree meet the weights: once, not at every combination below.

    Args:
        space: the symbols.
        coefficients: phrase → kind → f32[F] of a model, or f32[K, F] of K models.
        root: the tree, one clause of a sentence.
        world: the world.
        clause: which clause it is.

    Returns:
        Its phrases by where they stand.
    """
    return {
        node.path: WeighedPhrase(
            coefficients(node.phrase), space.describe(node.phrase, node.path, world)
        )
        for node in bottom_up(root, clause)
    }


@dataclasses.dataclass(frozen=True)
class WeighedTree:
    """A tree in a world, weighed by one model."""

    root: Phrase
    path: Path  # of the root
    size: int  # S
    phrases: dict[Path, WeighedPhrase]

    def log_odds(self, _: Phrase, path: Path, children: Sequence[Hypothesis]) -> np.ndarray:
        """Compute how likely a phrase expresses each symbol, given its children's hypotheses.

        Returns:
            f64[S]; −inf for symbols that it cannot express.
        """
        coefficients, described = self.phrases[path]
        odds = np.full(self.size, -np.inf)
        for kind, block in described.given([child.expressed for child in children]).items():
            odds[block.places] = block.properties @ coefficients[kind]
        return odds

    def search(self, width: int = BEAM_WIDTH) -> list[Hypothesis]:
        """Infer what the root expresses; see ``search.search``."""
        return search(self.root, self.log_odds, width=width, path=self.path)

    def log_ranks(self) -> dict[Path, np.ndarray]:
        """Infer the rank of each phrase that may give one: f64[1 + R] log-probabilities."""
        return {
            path: log_softmax(np.append(0.0, described.ranks @ coefficients[RANK]))
            for path, (coefficients, described) in self.phrases.items()
            if described.ranks is not None
        }

    def beliefs(self) -> list[PhraseBelief]:
        """Compute for every phrase how probable each symbol is; see ``CorrespondenceGraph``."""
        ranks = {path: int(np.argmax(chance)) for path, chance in self.log_ranks().items()}

        def below(phrase: Phrase, path: Path, best: Hypothesis) -> Iterator[PhraseBelief]:
            odds = self.log_odds(phrase, path, best.children)
            chance = np.exp(-np.logaddexp(0.0, -odds))
            yield PhraseBelief(
                phrase=phrase, path=path, probability=chance, rank=ranks.get(path, 0)
            )
            for i, (child, own) in enumerate(zip(phrase.children, best.children, strict=True)):
                yield from below(child, (*path, i), own)

        return list(below(self.root, self.path, self.search()[0]))


def log_softmax(scores: np.ndarray) -> np.ndarray:
    """Normalise scores to log-probabilities."""
    return scores - np.logaddexp.reduce(scores)
