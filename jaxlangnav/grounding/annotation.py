"""Annotation inference: what a sentence says of the unseen world (section 3.1).

The annotations are the symbols expressed at the root of the tree. The search keeps a distribution
over sets of them. Whether a region is meant as an extreme ("nearest to") is a binary factor of
its own at each phrase, outside the paper's 494 symbols, and belongs to the symbols whose region
that phrase expressed first.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from jaxlangnav.grounding.examples import Path, annotation_properties
from jaxlangnav.grounding.features import senses_of
from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.search import BEAM_WIDTH, Hypothesis, best_sets, search
from jaxlangnav.grounding.symbols import (
    OBJECT,
    Annotation,
    AnnotationSpace,
    region_symbol,
)
from jaxlangnav.language.phrase import Parse, Phrase
from jaxlangnav.messages import NONE, RELATIONS, ROBOT

Said = tuple[tuple[Annotation, bool], ...]
"""A set of annotations, each with whether it is a superlative; in the order of the space."""


@dataclasses.dataclass(frozen=True)
class Belief:
    """Distribution over what a sentence says."""

    sets: tuple[tuple[Said, float], ...]  # (annotations, log-probability), best first
    superlative: dict[Path, float]  # phrase → probability that it means an extreme

    def marginals(self) -> list[tuple[Annotation, bool, float]]:
        """Add up the probability of each annotation over the sets, likeliest first."""
        total: dict[tuple[Annotation, bool], float] = {}
        for said, log_probability in self.sets:
            for entry in said:
                total[entry] = total.get(entry, 0.0) + float(np.exp(log_probability))
        ranked = sorted(total.items(), key=lambda item: -item[1])
        return [(symbol, flag, min(p, 1.0)) for (symbol, flag), p in ranked]


def describe(
    symbol: Annotation, is_superlative: bool, probability: float, type_names: Sequence[str]
) -> dict[str, object]:
    """Name an annotation for people and for ``ground --json``.

    Args:
        symbol: the annotation.
        is_superlative: whether the extreme is meant.
        probability: its marginal probability.
        type_names: object types.

    Returns:
        figure, relation, landmark (None where it has none), superlative, probability.
    """

    def name(index: int) -> str | None:
        if index == ROBOT:
            return "robot"
        return None if index == NONE else type_names[index]

    return {
        "figure": name(symbol.figure),
        "relation": None if symbol.relation == NONE else RELATIONS[symbol.relation],
        "landmark": name(symbol.landmark),
        "superlative": is_superlative,
        "probability": round(probability, 6),
    }


def _log_odds_of(
    root: Phrase, clause: int, model: CorrespondenceModel, type_names: tuple[str, ...]
):
    """Build the log-odds of the annotation symbols for ``search``."""
    space = AnnotationSpace(len(type_names))
    prepared = {
        path: (model.coefficients(phrase), senses_of(phrase, type_names))
        for phrase, path in walk(root, (clause,))
    }

    def log_odds(_: Phrase, path: Path, children: Sequence[Hypothesis]) -> np.ndarray:
        coefficients, senses = prepared[path]
        tables = annotation_properties(space, senses, [child.expressed for child in children])
        return np.concatenate(
            [tables[kind] @ coefficients[kind] for kind in ("object", "region", "relation")]
        ).astype(np.float64)

    superlative = {
        path: float(coefficients["superlative"][0]) for path, (coefficients, _) in prepared.items()
    }
    return log_odds, superlative


def walk(phrase: Phrase, path: Path) -> Iterator[tuple[Phrase, Path]]:
    """Yield every phrase of a clause with its path, parents first."""
    yield phrase, path
    for i, child in enumerate(phrase.children):
        yield from walk(child, (*path, i))


def _origins(
    space: AnnotationSpace, hypothesis: Hypothesis, path: Path, symbol: Annotation
) -> Iterator[Path]:
    """Find the phrases that first express a symbol or the region it is in."""
    region = region_symbol(symbol.relation, symbol.landmark)
    wanted = [space.index[s] for s in {symbol, region}]
    below = False
    for i, child in enumerate(hypothesis.children):
        for origin in _origins(space, child, (*path, i), symbol):
            below = True
            yield origin
    if not below and hypothesis.expressed[wanted].any():
        yield path


def _superlative_odds(
    space: AnnotationSpace,
    hypothesis: Hypothesis,
    clause: int,
    symbol: Annotation,
    superlative: dict[Path, float],
) -> float:
    """Evaluate the log-odds that a symbol is meant as an extreme; −inf for plain objects."""
    if symbol.kind == OBJECT:
        return -np.inf
    origins = _origins(space, hypothesis, (clause,), symbol)
    return max((superlative[path] for path in origins), default=-np.inf)


def infer_clause(
    root: Phrase,
    clause: int,
    model: CorrespondenceModel,
    type_names: tuple[str, ...],
    width: int = BEAM_WIDTH,
) -> Belief:
    """Infer the distribution over annotations of one clause.

    Args:
        root: the clause.
        clause: its position in the sentence.
        model: annotation model.
        type_names: object types.
        width: beam width.

    Returns:
        Up to ``width`` sets and their probabilities (not renormalised over the beam).
    """
    space = AnnotationSpace(len(type_names))
    log_odds, superlative = _log_odds_of(root, clause, model, type_names)
    found: list[tuple[Said, float]] = []
    for hypothesis in search(root, log_odds, width=width, path=(clause,)):
        symbols = space.members(hypothesis.expressed)
        odds = np.array(
            [_superlative_odds(space, hypothesis, clause, s, superlative) for s in symbols]
        )
        for flags, log_flags in best_sets(odds, width):
            said = tuple(zip(symbols, flags.tolist(), strict=True))
            found.append((said, hypothesis.log_probability + log_flags))
    found.sort(key=lambda pair: -pair[1])
    chances = {path: float(1.0 / (1.0 + np.exp(-odds))) for path, odds in superlative.items()}
    return Belief(tuple(found[:width]), chances)


def infer_annotations(
    parse: Parse,
    model: CorrespondenceModel,
    type_names: tuple[str, ...],
    width: int = BEAM_WIDTH,
) -> Belief:
    """Infer what a whole sentence says: the clauses are independent and add up (section 3.1).

    Args:
        parse: the sentence.
        model: annotation model.
        type_names: object types.
        width: beam width.

    Returns:
        Up to ``width`` sets of annotations, best first.
    """
    joint: list[tuple[Said, float]] = [((), 0.0)]
    superlative: dict[Path, float] = {}
    for clause, root in enumerate(parse.clauses):
        belief = infer_clause(root, clause, model, type_names, width)
        superlative |= belief.superlative
        totals: dict[Said, float] = {}
        for (said, score), (more, own) in itertools.product(joint, belief.sets):
            union = tuple(dict.fromkeys((*said, *more)))
            totals[union] = float(np.logaddexp(totals.get(union, -np.inf), score + own))
        joint = sorted(totals.items(), key=lambda pair: -pair[1])[:width]
    return Belief(tuple(joint), superlative)
