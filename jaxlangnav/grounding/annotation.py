"""Annotation inference: what a sentence says of the unseen world (section 3.1).

The annotations are the symbols expressed at the root of the tree; the search keeps a distribution
over sets of them. Three things are inferred apart from the paper's 494 symbols, at the phrase that
first expresses a region: its rank ("nearest to" is 1, "the second" 2), whether it is between
two things, and whether "the thing" that lies there is called by no type (``ANYTHING``).
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from jaxlangnav.grounding.correspondence import CorrespondenceGraph
from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.properties import Annotations
from jaxlangnav.grounding.search import BEAM_WIDTH, Hypothesis, add_up
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
from jaxlangnav.language.reference import is_thing
from jaxlangnav.messages import NONE, ROBOT
from jaxlangnav.relations.table import REGISTRY

RankedAnnotations = tuple[tuple[AnnotationSymbol, int], ...]
"""A set of annotations, each with its rank (0: no superlative); in the order of the space."""
_MAX_SYMBOLS = 12
"""Annotations of one clause beyond which further ones are not read (untrained weights)."""


@dataclasses.dataclass(frozen=True)
class Belief:
    """Distribution over what a sentence says."""

    clauses: tuple[tuple[tuple[RankedAnnotations, ...], float], ...]
    """Annotations by clause, with their log-probability, best first. A region that is said of "the
    thing" is a relation whose figure is ``ANYTHING``."""
    rank: dict[Path, int]  # phrase → likeliest rank

    def marginals(self) -> list[tuple[AnnotationSymbol, int, float]]:
        """Add up the probability of each annotation, likeliest first, as ``clauses`` has them."""
        ranked = add_up(
            (entry, float(np.exp(log_probability)))
            for said, log_probability in self.clauses
            for entry in dict.fromkeys(itertools.chain(*said))
        )
        return [(symbol, rank, min(p, 1.0)) for (symbol, rank), p in ranked]


def describe_annotation(
    symbol: AnnotationSymbol, rank: int, probability: float, type_names: Sequence[str]
) -> dict[str, object]:
    """Name an annotation for people and for ``ground --json``.

    ``rank`` is 1 where the extreme is meant, 2 where the second is, 0 otherwise.

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
    """Write an annotation of things by their names; see ``describe_annotation``."""
    document: dict[str, object] = {
        "figure": figure,
        "relation": None if relation == NONE else REGISTRY[relation].name,
        "landmark": landmark,
        "superlative": rank == 1,
        "probability": round(probability, 6),
    }
    return document | ({"rank": rank} if rank > 1 else {})


def _rank_chances(paths: list[Path], rank: Mapping[Path, np.ndarray]) -> list[tuple[int, float]]:
    """List the two likeliest ranks of a symbol with their log-probabilities."""
    if not paths:
        return [(0, 0.0)]
    chances = min((rank[path] for path in paths), key=lambda chance: chance[0])
    order = np.argsort(-chances, kind="stable")[:2]
    return [(int(i), float(chances[i])) for i in order]


def _by_rank(paths: list[Path], rank: Mapping[Path, np.ndarray]) -> list[list[Path]]:
    """Part the phrases of a symbol that say different ranks: they speak of different things.

    "Avoid the nearest cone and go to the second cone" says "near the robot" of two cones.
    """
    likeliest = {path: int(np.argmax(rank[path])) for path in paths}
    ranks = sorted({*likeliest.values()} - {0})
    if len(ranks) < 2:
        return [paths]
    return [[path for path in paths if likeliest[path] == one] for one in ranks]


def _said_of_things(phrase: Phrase, path: Path, *, is_of_thing: bool) -> Iterator[Path]:
    """Yield the phrases that say where "the thing" is."""
    if is_of_thing:
        yield path
    is_new = phrase.label == "NP" and bool(phrase.children)
    for i, child in enumerate(phrase.children):
        of_thing = is_thing(phrase.children[0]) and i > 0 if is_new else is_of_thing
        yield from _said_of_things(child, (*path, i), is_of_thing=of_thing)


def _clause_sets(
    space: AnnotationSpace,
    beam: Sequence[Hypothesis],
    root: Phrase,
    clause: int,
    rank: Mapping[Path, np.ndarray],
) -> Iterator[tuple[RankedAnnotations, float]]:
    """Read the beam of a clause as annotations, each with its rank, and their log-probability.

    ``rank`` has for each phrase f64[5], log-probabilities of the ranks 0 to 4.
    """
    phrases = {node.path: node.phrase for node in post_order(root, clause)}
    things = frozenset(_said_of_things(root, (clause,), is_of_thing=False))
    for hypothesis in beam:
        symbols, chances = [], []
        for symbol in space.members(hypothesis.expressed)[:_MAX_SYMBOLS]:
            paths = []
            if symbol.kind != OBJECT:
                region = region_symbol(symbol.relation, symbol.landmark)
                wanted = [space.index[symbol], space.index[region]]
                saying = [
                    path for path, one in hypothesis.walk((clause,)) if one.expressed[wanted].any()
                ]
                paths = [
                    path
                    for path in saying  # those that first express it: none below does
                    if not any(path == below[: len(path)] != below for below in saying)
                ]
            for index, one in enumerate(REGISTRY):  # of one symbol, which the words say
                if one.symbol == symbol.relation and any(phrases[p].says(one.name) for p in paths):
                    symbol = symbol._replace(relation=index)
            has_rank = REGISTRY[symbol.relation].num_landmarks == 1
            of_thing = symbol._replace(kind=RELATION, figure=ANYTHING)
            for own in _by_rank(paths, rank) if has_rank else [paths]:
                is_of_thing = symbol.kind == REGION and things.intersection(own)
                symbols.append(of_thing if is_of_thing else symbol)
                chances.append(_rank_chances(own if has_rank else [], rank))
        for choice in itertools.product(*chances):
            said = tuple((s, r) for s, (r, _) in zip(symbols, choice, strict=True))
            yield said, hypothesis.log_probability + sum(log_chance for _, log_chance in choice)


def infer_annotations(
    parse: Parse, model: CorrespondenceModel, type_names: tuple[str, ...], width: int = BEAM_WIDTH
) -> Belief:
    """Infer what a sentence says: up to ``width`` sets of annotations, best first (section 3.1).

    The clauses are independent and add up.
    """
    graph = CorrespondenceGraph(space := Annotations(type_names), model)
    joint: list[tuple[tuple[RankedAnnotations, ...], float]] = [((), 0.0)]
    rank = dict[Path, int]()
    for clause, root in enumerate(parse.clauses):
        tree = graph.weigh(root, None, clause)
        beam = tree.search(width)
        chances = tree.log_ranks()
        rank |= {path: int(np.argmax(one)) for path, one in chances.items()}
        sets = _clause_sets(space.symbols_in(None), beam, root, clause, chances)
        best = sorted(sets, key=lambda one: -one[1])[:width]
        pairs = itertools.product(joint, best)
        both = [((*said, more), score + own) for (said, score), (more, own) in pairs]
        joint = sorted(both, key=lambda pair: -pair[1])[:width]
    return Belief(tuple(joint), rank)
