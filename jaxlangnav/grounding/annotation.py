"""Annotation inference: a distribution over what a sentence states of the world (section 3.1).

The annotations are the symbols expressed at the root of the tree; beam search yields a distribution
over sets of them. Beyond the paper's 494 symbols, three attributes are inferred at the phrase that
first expresses a region: its rank ("nearest to" is 1, "the second" 2), whether it is between two
objects, and whether the figure is untyped, as in "the thing" (``ANYTHING``).
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from jaxlangnav.grounding.correspondence import CorrespondenceGraph
from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.properties import Annotations
from jaxlangnav.grounding.search import BEAM_WIDTH, Hypothesis, sum_by_key
from jaxlangnav.grounding.symbols import (
    OBJECT,
    REGION,
    RELATION,
    AnnotationSpace,
    AnnotationSymbol,
    Path,
    post_order,
    region_symbol,
)
from jaxlangnav.inputs.object_types import ANYTHING
from jaxlangnav.language.phrase import Parse, Phrase
from jaxlangnav.language.reference import is_untyped
from jaxlangnav.messages import NONE, ROBOT
from jaxlangnav.relations.table import REGISTRY

LogRanks = Mapping[Path, np.ndarray]
"""Phrase → f64[5], log-probabilities of the ranks 0 to 4."""
RankedAnnotations = tuple[tuple[AnnotationSymbol, int], ...]
"""A set of annotations, each with its rank (0: no superlative); in the order of the space."""
_MAX_SYMBOLS = 12  # maximum number of annotations of a clause (untrained weights express many)


@dataclasses.dataclass(frozen=True)
class AnnotationBelief:
    """Distribution over the sets of annotations of a sentence."""

    clauses: tuple[tuple[tuple[RankedAnnotations, ...], float], ...]
    """Annotations by clause, with their log-probability, best first. A region of "the thing" is a
    relation whose figure is ``ANYTHING``."""
    rank: dict[Path, int]  # phrase → likeliest rank

    def marginals(self) -> list[tuple[AnnotationSymbol, int, float]]:
        """Compute the marginal probability of each annotation in ``clauses``, likeliest first."""
        ranked = sum_by_key(
            (entry, float(np.exp(log_probability)))
            for sets, log_probability in self.clauses
            for entry in dict.fromkeys(itertools.chain(*sets))
        )
        return [(symbol, rank, min(p, 1.0)) for (symbol, rank), p in ranked]


def describe_annotation(
    symbol: AnnotationSymbol, rank: int, probability: float, type_names: Sequence[str]
) -> dict[str, object]:
    """Build the JSON document of an annotation, with names for its indices.

    ``rank`` is 1 for the nearest or extreme object, 2 for the second, 0 for none.

    Returns:
        figure ("thing" of any type), relation, landmark (None where it has none), superlative,
        probability; and rank where it is 2 or more.
    """
    names = {ROBOT: "robot", ANYTHING: "thing", NONE: None}
    figure, landmark = (
        names[end] if end in names else type_names[end] for end in (symbol.figure, symbol.landmark)
    )
    return annotation_document(figure, landmark, symbol.relation, rank, probability)


def annotation_document(
    figure: str | None, landmark: str | None, relation: int, rank: int, probability: float
) -> dict[str, object]:
    """Build the JSON document of an annotation from names; see ``describe_annotation``."""
    document: dict[str, object] = {
        "figure": figure,
        "relation": None if relation == NONE else REGISTRY[relation].name,
        "landmark": landmark,
        "superlative": rank == 1,
        "probability": round(probability, 6),
    }
    return document | ({"rank": rank} if rank > 1 else {})


def _likeliest_ranks(paths: list[Path], rank: LogRanks) -> list[tuple[int, float]]:
    """List the two likeliest ranks of a symbol with their log-probabilities."""
    if not paths:
        return [(0, 0.0)]
    log_probs = min((rank[path] for path in paths), key=lambda values: values[0])
    return [(int(i), float(log_probs[i])) for i in np.argsort(-log_probs, kind="stable")[:2]]


def _split_by_rank(paths: list[Path], rank: LogRanks) -> list[list[Path]]:
    """Group the phrases of a symbol by their likeliest rank: ranks tell objects apart.

    "Avoid the nearest cone and go to the second cone" has "near the robot" for two cones.
    """
    likeliest = {path: int(np.argmax(rank[path])) for path in paths}
    ranks = sorted({*likeliest.values()} - {0})
    if len(ranks) < 2:
        return [paths]
    return [[path for path in paths if likeliest[path] == r] for r in ranks]


def _untyped_phrases(phrase: Phrase, path: Path, *, is_untyped_figure: bool) -> Iterator[Path]:
    """Yield the phrases whose figure is untyped ("the thing")."""
    if is_untyped_figure:
        yield path
    is_new = phrase.label == "NP" and bool(phrase.children)
    for i, child in enumerate(phrase.children):
        is_untyped_child = is_untyped(phrase.children[0]) and i > 0 if is_new else is_untyped_figure
        yield from _untyped_phrases(child, (*path, i), is_untyped_figure=is_untyped_child)


def _clause_sets(
    space: AnnotationSpace, beam: Sequence[Hypothesis], root: Phrase, clause: int, rank: LogRanks
) -> Iterator[tuple[RankedAnnotations, float]]:
    """Yield the ranked annotations of each beam hypothesis of a clause, with log-probability."""
    phrases = {node.path: node.phrase for node in post_order(root, clause)}
    untyped = frozenset(_untyped_phrases(root, (clause,), is_untyped_figure=False))
    for hypothesis in beam:
        symbols, rank_probs = [], []
        for symbol in space.members(hypothesis.expressed)[:_MAX_SYMBOLS]:
            paths = []
            if symbol.kind != OBJECT:
                region = region_symbol(symbol.relation, symbol.landmark)
                indices = [space.index[symbol], space.index[region]]
                expressing = [
                    path for path, h in hypothesis.walk((clause,)) if h.expressed[indices].any()
                ]
                paths = [
                    path
                    for path in expressing  # the lowest phrases that express it
                    if not any(path == below[: len(path)] != below for below in expressing)
                ]
            for index, r in enumerate(REGISTRY):  # relations that share the symbol: by the words
                if r.symbol == symbol.relation and any(phrases[p].has_sense(r.name) for p in paths):
                    symbol = symbol._replace(relation=index)
            has_rank = REGISTRY[symbol.relation].num_landmarks == 1
            untyped_region = symbol._replace(kind=RELATION, figure=ANYTHING)
            for group in _split_by_rank(paths, rank) if has_rank else [paths]:
                is_untyped_figure = symbol.kind == REGION and untyped.intersection(group)
                symbols.append(untyped_region if is_untyped_figure else symbol)
                rank_probs.append(_likeliest_ranks(group if has_rank else [], rank))
        for choice in itertools.product(*rank_probs):
            ranked = tuple((s, r) for s, (r, _) in zip(symbols, choice, strict=True))
            yield ranked, hypothesis.log_probability + sum(log_prob for _, log_prob in choice)


def infer_annotations(
    parse: Parse, model: CorrespondenceModel, type_names: tuple[str, ...], width: int = BEAM_WIDTH
) -> AnnotationBelief:
    """Infer up to ``width`` sets of annotations of a sentence, best first (section 3.1).

    Clauses are independent: their log-probabilities add up.
    """
    graph = CorrespondenceGraph(space := Annotations(type_names), model)
    joint: list[tuple[tuple[RankedAnnotations, ...], float]] = [((), 0.0)]
    rank = dict[Path, int]()
    for clause, root in enumerate(parse.clauses):
        tree = graph.score(root, None, clause)
        beam = tree.search(width)
        log_ranks = tree.log_ranks()
        rank |= {path: int(np.argmax(values)) for path, values in log_ranks.items()}
        clause_sets = _clause_sets(space.symbols_in(None), beam, root, clause, log_ranks)
        pairs = itertools.product(joint, sorted(clause_sets, key=lambda pair: -pair[1])[:width])
        extended = [((*sets, new), a + b) for (sets, a), (new, b) in pairs]
        joint = sorted(extended, key=lambda pair: -pair[1])[:width]
    return AnnotationBelief(tuple(joint), rank)
