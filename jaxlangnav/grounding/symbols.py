"""Symbol spaces that phrases ground to: annotations and behaviors (sections 3.1, 3.3, 4.1).

The annotation space needs no world: object types, regions (a relation to a type, or to the robot)
and relations (a figure type in a region). With 8 types that is 8 + 54 + 432 = 494 symbols.
The behavior space is that of one world of n objects: noun and preposition phrases ground to n
objects and 7 n regions (the six relations and "at"), verb phrases to 2 actions, 3 modes, 7 n goal
regions and 7 n constraint regions.

A set of symbols is a boolean vector over a space: one correspondence variable per symbol.
"""

import itertools
import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import cached_property, partial
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import ACTIONS, MODES, NONE, REGIONS, RELATIONS, ROBOT

OBJECT, REGION, RELATION, ACTION, MODE, GOAL, CONSTRAINT = range(7)  # kinds of symbols
KINDS = ("object", "region", "relation", "action", "mode", "goal", "constraint")
NUM_RELATIONS = len(RELATIONS)
NUM_REGIONS = len(REGIONS)
VERB_LABELS = ("VP", "S")
"""Labels of phrases that ground to actions, modes, goals and constraints."""
Symbol = TypeVar("Symbol", bound=Hashable)


class SymbolDomain(Generic[Symbol]):
    """Ordered, distinct symbols of a symbol space, one correspondence variable each."""

    def __init__(self, symbols: Sequence[Symbol]) -> None:
        """Store S distinct symbols in order."""
        self.symbols = symbols
        self.size = len(symbols)

    @cached_property
    def index(self) -> dict[Symbol, int]:
        """Index of each symbol in ``symbols``."""
        return {symbol: i for i, symbol in enumerate(self.symbols)}

    def num_expressible(self, phrase: Phrase) -> int:
        """Count the symbols that a phrase can express, one factor each."""
        return self.size

    def mask(self, symbols: Iterable[Symbol]) -> np.ndarray:
        """Encode symbols of the space as a boolean indicator vector, bool[S]."""
        expressed = np.zeros(self.size, bool)
        expressed[[self.index[symbol] for symbol in symbols]] = True
        return expressed

    def members(self, expressed: np.ndarray) -> tuple[Symbol, ...]:
        """Decode an indicator vector into its symbols, in the order of the space."""
        return tuple(itertools.compress(self.symbols, expressed))


class AnnotationSymbol(NamedTuple):
    """One annotation symbol: an object type, a region or a relation."""

    kind: int  # OBJECT, REGION or RELATION
    figure: int  # type index; NONE for a region
    relation: int = NONE  # relation index; NONE for an object
    landmark: int = NONE  # type index or ROBOT; NONE for an object


class BehaviorSymbol(NamedTuple):
    """One behavior symbol: an object, region, action, mode, goal or constraint."""

    kind: int  # any but RELATION
    relation: int  # region index for regions, goals and constraints; NONE otherwise
    slot: int  # object slot, or index of the action or mode


object_symbol = partial(AnnotationSymbol, OBJECT)
"""Build the symbol of an object type, given its index."""
region_symbol = partial(AnnotationSymbol, REGION, NONE)
"""Build the symbol of a region from relation and landmark, a type index or ROBOT."""
relation_symbol = partial(AnnotationSymbol, RELATION)
"""Build the symbol of a figure in a region: type index, relation, and landmark as of a region."""


class AnnotationSpace(SymbolDomain[AnnotationSymbol]):
    """All annotation symbols over ``num_types`` object types, objects first, relations last."""

    def __init__(self, num_types: int) -> None:
        """List the symbols of T types; the robot has the last landmark index."""
        self.num_types, self.num_landmarks = num_types, num_types + 1
        regions = [(r, m) for r in range(NUM_RELATIONS) for m in (*range(num_types), ROBOT)]
        objects = [object_symbol(t) for t in range(num_types)]
        relations = [relation_symbol(f, r, m) for f in range(num_types) for r, m in regions]
        super().__init__([*objects, *itertools.starmap(region_symbol, regions), *relations])

    def parts(self, expressed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Split a set into objects bool[T], regions bool[6, L] and relations bool[T, 6, L]."""
        shape = (NUM_RELATIONS, self.num_landmarks)
        regions, relations = self.num_types, self.num_types + math.prod(shape)  # offsets
        return (
            expressed[:regions],
            expressed[regions:relations].reshape(shape),
            expressed[relations:].reshape(self.num_types, *shape),
        )


class BehaviorSpace(SymbolDomain[BehaviorSymbol]):
    """All behavior symbols of a world of ``num_objects`` object slots.

    Objects and regions come first (those of noun and preposition phrases), then actions, modes,
    goals and constraints (those of verb phrases).
    """

    def __init__(self, num_objects: int) -> None:
        """List the symbols of n object slots: 7 regions, goals and constraints each."""
        self.num_objects = num_objects
        regions = [(r, i) for r in range(NUM_REGIONS) for i in range(num_objects)]
        by_kind = {
            OBJECT: [(NONE, i) for i in range(num_objects)],
            REGION: regions,
            ACTION: [(NONE, a) for a in range(len(ACTIONS))],
            MODE: [(NONE, m) for m in range(len(MODES))],
            GOAL: regions,
            CONSTRAINT: regions,
        }
        super().__init__([BehaviorSymbol(kind, *ids) for kind in by_kind for ids in by_kind[kind]])
        sizes = [len(pairs) for pairs in by_kind.values()]
        ends = zip(by_kind, sizes, itertools.accumulate(sizes), strict=True)
        self.spans = {kind: (end - size, end) for kind, size, end in ends}  # index ranges

    def num_expressible(self, phrase: Phrase) -> int:
        """Count the symbols that a verb phrase, or any other phrase, can express."""
        num_noun = self.spans[REGION][1]
        return self.size - num_noun if phrase.label in VERB_LABELS else num_noun

    def part(self, expressed: np.ndarray, kind: int) -> np.ndarray:
        """Slice one kind of symbol of [..., S], as [..., n], [..., 7, n], [..., 2] or [..., 3]."""
        begin, end = self.spans[kind]
        values = expressed[..., begin:end]
        if kind in (REGION, GOAL, CONSTRAINT):
            return values.reshape(*values.shape[:-1], NUM_REGIONS, self.num_objects)
        return values


# ---------------------------------------------------------------- phrases as a graph

Path = tuple[int, ...]
"""Clause index, then child indices from the root of the clause."""
Ranks = Mapping[Path, int]
"""Rank that each phrase gives its region: 0 none, 1 nearest, 2 second, ..."""


class Node(NamedTuple):
    """A phrase as a node of the factor graph."""

    phrase: Phrase
    path: Path
    children: tuple[int, ...]  # indices of earlier nodes

    @property
    def is_verb(self) -> bool:
        """Whether the phrase grounds to actions, modes, goals and constraints."""
        return self.phrase.label in VERB_LABELS


def post_order(root: Phrase, clause: int = 0) -> tuple[Node, ...]:
    """Order the phrases of a clause so that children stand before their parents, the root last."""
    nodes: list[Node] = []

    def visit(phrase: Phrase, path: Path) -> int:
        children = tuple(visit(child, (*path, i)) for i, child in enumerate(phrase.children))
        nodes.append(Node(phrase, path, children))
        return len(nodes) - 1

    visit(root, (clause,))
    return tuple(nodes)


def count_factors(clauses: Sequence[Phrase], symbols: SymbolDomain) -> dict[str, int]:
    """Count phrases, factors and variables of a sentence's factor graph (section 3.1, Figure 3).

    Clauses share no factor. Every phrase λ has one factor per symbol, which joins the phrase, the
    grounding γ, its correspondence φ and the groundings of the child phrases. So a phrase with S
    symbols adds S factors, S groundings, S correspondences and itself: 2 S + 1 random variables.

    Returns:
        ``phrases``, ``factors`` and ``variables``; the six-phrase sentence of the paper has 2,964
        factors and 5,934 variables for annotation, 383 and 772 for behavior with seven objects.
    """
    phrases = [phrase for root in clauses for phrase in root.walk()]
    factors = sum(symbols.num_expressible(phrase) for phrase in phrases)
    return {"phrases": len(phrases), "factors": factors, "variables": len(phrases) + 2 * factors}
