"""The log-linear correspondence model: a bilinear score per kind of symbol (eq. 4).

    log p(φ = 1 | λ, γ, Γ) / p(φ = 0 | λ, γ, Γ) = words(λ)ᵀ W_kind properties(γ, Γ)

A feature of the paper is a product of a correspondence value, a property of the words and a
property of the grounding, so the score is bilinear. The word features are here, names with values;
the grounding features are in ``properties`` and ``behavior_properties``. Contracting the words
leaves a few coefficients per phrase and kind of symbol, once per sentence.

A word carries its identity (lemma), part of speech and lexicon senses; a word without senses also
its character n-grams, hashed. A phrase carries a bias, its label, shape and child labels. So a
synonym has the senses of what it stands for, and even an unknown word has a part of speech, a
shape and n-grams: properties of agreement ("the type that the words name") need no retraining.
"""

import dataclasses
import zlib
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import ACTIONS, MODES, REGIONS

PropertyColumns = Mapping[str, np.ndarray | bool]
"""Name of a property → its values for the symbols of one kind; arrays that broadcast to them."""
ANNOTATION_KINDS = ("symbol", "rank")
BEHAVIOR_KINDS = ("object", "region", "goal", "constraint", "action", "mode")
NUM_GRAMS = 128
"""Buckets of the hashed character n-grams."""
RESTRICTORS = ("PP", "ADJP", "SBAR")
"""Labels of child phrases that state the location of a noun phrase's figure."""
IDENTITY_SCALE = 0.4
WORD_SCALE = 0.2
GRAM_SCALE = 0.3
_GROUPS = {
    "word": ("word",),
    "tag": ("tag",),
    "sense": ("sense", "class", "below"),
    "gram": ("gram",),
    "shape": ("label", "length", "child", "pair", "children"),
}
"""Group of word features → prefixes of their names."""
FEATURE_GROUPS = tuple(_GROUPS)
"""Groups of word features that an ablation may leave out."""


class Senses(NamedTuple):
    """Lexicon senses of a phrase's own words, as indices."""

    types: frozenset[int]
    relations: frozenset[int]  # indices into REGIONS
    actions: frozenset[int]
    modes: frozenset[int]
    ranks: frozenset[int]  # 1 for a plain superlative, n for the n-th
    is_robot: bool
    is_thing: bool = False  # "the thing", "the one": untyped, and not "the other one"


def _indices(senses: set[str], prefix: str, names: tuple[str, ...]) -> frozenset[int]:
    return frozenset(i for i, name in enumerate(names) if f"{prefix}:{name}" in senses)


def senses_of(phrase: Phrase, type_names: tuple[str, ...]) -> Senses:
    """Collect the senses of a phrase's own words: indices of types, regions, actions and modes."""
    senses = {sense for word in phrase.words for sense in word.senses}
    ranks = {int(sense[5:]) for sense in senses if sense.startswith("rank:")}
    return Senses(
        types=_indices(senses, "type", type_names),
        relations=_indices(senses, "relation", REGIONS),
        actions=_indices(senses, "action", ACTIONS),
        modes=_indices(senses, "mode", MODES),
        ranks=frozenset(ranks or ({1} if "superlative" in senses else set())),
        is_robot="robot" in senses or "type:robot" in senses,
        is_thing="anaphor" in senses
        and "other" not in senses
        and not any(sense.startswith("type:") for sense in senses),
    )


def feature_group(name: str) -> str:
    """Look up the group of a word feature: one of ``FEATURE_GROUPS``, or "bias"."""
    prefix = name.partition("=")[0]
    return next((group for group, names in _GROUPS.items() if prefix in names), prefix)


def word_features(phrase: Phrase, without: frozenset[str] = frozenset()) -> dict[str, float]:
    """Compute the word features of a phrase as name → value; absent features are zero.

    Its children count by label and sense class only; groups of ``FEATURE_GROUPS`` may be left out.
    """
    features = {"bias": 1.0}
    for word in phrase.words:
        features[f"word={word.lemma}"] = WORD_SCALE
        features[f"tag={word.tag}"] = 0.5
        for sense in word.senses:
            features[f"sense={sense}"] = IDENTITY_SCALE
            features[f"class={sense.partition(':')[0]}"] = 1.0
        padded = "" if word.senses else f"^{word.text}$"
        for i in range(len(padded) - 2):  # CRC32 is the same in every process
            gram = zlib.crc32(padded[i : i + 3].encode()) % NUM_GRAMS
            features[f"gram={gram}"] = GRAM_SCALE
    features[f"label={phrase.label}"] = 1.0
    features[f"length={min(len(phrase.words), 3)}"] = 0.5
    for child in phrase.children:
        features[f"child={child.label}"] = 1.0
        features[f"pair={phrase.label}>{child.label}"] = 0.2
        classes = {sense.partition(":")[0] for word in child.words for sense in word.senses}
        for name in classes or {"none"}:
            features[f"below={child.label}:{name}"] = 0.5
    features[f"children={min(len(phrase.children), 3)}"] = 0.5
    if not without:
        return features
    return {name: value for name, value in features.items() if feature_group(name) not in without}


@dataclasses.dataclass(frozen=True)
class Vocabulary:
    """Names of the word features a model was trained with, and the groups it leaves out."""

    names: tuple[str, ...]
    without: frozenset[str] = frozenset()

    @cached_property
    def _column(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}

    def vector(self, phrase: Phrase) -> np.ndarray:
        """Compute the word features of a phrase, f32[W], without those unseen in training."""
        vector = np.zeros(len(self.names), np.float32)
        for name, value in word_features(phrase, self.without).items():
            if name in self._column:
                vector[self._column[name]] = value
        return vector


@dataclasses.dataclass(frozen=True)
class CorrespondenceModel:
    """A trained correspondence model, for annotation or behavior: vocabulary and weights."""

    vocabulary: Vocabulary
    weights: dict[str, np.ndarray]  # kind → f32[W, F]
    temperature: float = 1.0  # log-odds are divided by it; fitted on held-out data

    def coefficients(self, phrase: Phrase) -> dict[str, np.ndarray]:
        """Contract a phrase's words: kind → f32[F], log-odds per property of the grounding."""
        vector = self.vocabulary.vector(phrase) / self.temperature
        return {kind: vector @ weight for kind, weight in self.weights.items()}

    @property
    def num_features(self) -> int:
        """Number of features as the paper counts them: 2 × word features × properties."""
        return 2 * sum(weight.size for weight in self.weights.values())


def stack_columns(shape: tuple[int, ...], columns: PropertyColumns) -> np.ndarray:
    """Stack properties of the symbols of one kind, broadcast to their shape, f32[S, F]."""
    values = np.empty((*shape, len(columns)), np.float32)
    for i, column in enumerate(columns.values()):
        values[..., i] = column
    return values.reshape(-1, len(columns))


def by_name(prefix: str, names: Iterable[Any], rows: np.ndarray) -> dict[str, np.ndarray]:
    """Build one property per row, named ``prefix name``."""
    return {f"{prefix} {name}": row for name, row in zip(names, rows, strict=True)}


def build_vocabulary(phrases: list[Phrase], without: frozenset[str] = frozenset()) -> Vocabulary:
    """Collect the word features of phrases, sorted, so that their order does not matter."""
    names = {name for phrase in phrases for name in word_features(phrase, without)}
    return Vocabulary(tuple(sorted(names)), without)
