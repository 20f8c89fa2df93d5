"""The log-linear correspondence model: a bilinear form per kind of symbol (eq. 4).

    log p(φ = 1 | λ, γ, Γ) / p(φ = 0 | λ, γ, Γ) = words(λ)ᵀ W_kind properties(γ, Γ)

Contracting the words first leaves a few coefficients per phrase and kind of symbol; that is done
once per sentence, and nothing downstream sees a word.
"""

import dataclasses
from functools import cached_property

import numpy as np

from jaxlangnav.grounding.features import word_features
from jaxlangnav.language.phrase import Phrase

ANNOTATION_KINDS = ("symbol", "rank")
BEHAVIOR_KINDS = ("object", "region", "goal", "constraint", "action", "mode")


@dataclasses.dataclass(frozen=True)
class Vocabulary:
    """Names of the word-side features a model was trained with, and what it leaves out."""

    names: tuple[str, ...]
    without: frozenset[str] = frozenset()

    @cached_property
    def _column(self) -> dict[str, int]:
        """Where each feature stands."""
        return {name: i for i, name in enumerate(self.names)}

    def vector(self, phrase: Phrase) -> np.ndarray:
        """Describe a phrase; features never seen in training count nothing.

        Args:
            phrase: the phrase.

        Returns:
            f32[W].
        """
        column = self._column
        vector = np.zeros(len(self.names), np.float32)
        for name, value in word_features(phrase, self.without).items():
            if name in column:
                vector[column[name]] = value
        return vector


@dataclasses.dataclass(frozen=True)
class CorrespondenceModel:
    """Weights of one model, annotation or behavior."""

    vocabulary: Vocabulary
    weights: dict[str, np.ndarray]  # kind → f32[W, F]
    temperature: float = 1.0  # log-odds are divided by it; fitted on held-out data

    def coefficients(self, phrase: Phrase) -> dict[str, np.ndarray]:
        """Contract the words of a phrase with the weights.

        Args:
            phrase: the phrase.

        Returns:
            For each kind of symbol, f32[F]: log-odds per property of the grounding.
        """
        vector = self.vocabulary.vector(phrase) / self.temperature
        return {kind: vector @ weight for kind, weight in self.weights.items()}

    @property
    def num_features(self) -> int:
        """Features as the paper counts them: 2 correspondence values × words × properties."""
        return 2 * sum(weight.size for weight in self.weights.values())

    def zeroed(self) -> "CorrespondenceModel":
        """Copy the model with every weight zero: it knows nothing."""
        zeros = {kind: np.zeros_like(weight) for kind, weight in self.weights.items()}
        return dataclasses.replace(self, weights=zeros)


def build_vocabulary(phrases: list[Phrase], without: frozenset[str] = frozenset()) -> Vocabulary:
    """Collect the word-side features of a training set.

    Args:
        phrases: training phrases.
        without: groups of features to leave out.

    Returns:
        The vocabulary, sorted, so that the order of the corpus does not matter.
    """
    names = {name for phrase in phrases for name in word_features(phrase, without)}
    return Vocabulary(tuple(sorted(names)), without)
