"""The Distributed Correspondence Graph, with the engine's symbols or anyone's (section 3.1, eq. 4).

What a robot's maker brings is a ``SymbolSpace``: which symbols a phrase may express in a world, and
what is seen of each. Trees, labels and worlds are the maker's own too; ``read_tree`` writes trees
without a parser. Everything else is what this package uses itself: its annotations and behaviors
are two more spaces (``properties``), with the same model, training, and search that is exact but
for the beam.
"""

import dataclasses
import re
from collections.abc import Callable, Sequence
from typing import Any, Generic

import numpy as np

from jaxlangnav.grounding.graph import FactorGraph, build
from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.search import BEAM_WIDTH
from jaxlangnav.grounding.space import KIND, AnyWorld, BlockSpace, SymbolSpace, in_blocks
from jaxlangnav.grounding.weighed import PhraseBelief, WeighedTree, weigh_phrases
from jaxlangnav.language.phrase import Phrase, Word

__all__ = [
    "KIND",
    "CorrespondenceGraph",
    "Labelled",
    "PhraseBelief",
    "SymbolSet",
    "SymbolSpace",
    "read_tree",
]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Labelled(Generic[AnyWorld]):
    """A tree in a world, with the symbols that each phrase expresses."""

    root: Phrase
    world: AnyWorld
    expressed: Sequence[frozenset[Any]]  # per phrase of ``root.walk()``, children before parents
    ranks: Sequence[int] = ()  # that they give, 0 for none; only where the space has ranks
    clause: int = 0  # which of its sentence


@dataclasses.dataclass(frozen=True, kw_only=True)
class SymbolSet:
    """What a sentence may mean."""

    symbols: tuple[Any, ...]  # expressed at the root, as the space has them: names, by default
    probability: float  # of this set; what is missing to one was cut by the beam


@dataclasses.dataclass(frozen=True)
class CorrespondenceGraph(Generic[AnyWorld]):
    """A symbol space with a trained model."""

    space: SymbolSpace[AnyWorld] | BlockSpace[AnyWorld]
    model: CorrespondenceModel

    @property
    def weights(self) -> np.ndarray:
        """The weight of every word feature (row) by every property (column), f32[W, F]."""
        return np.hstack([self.model.weights[kind] for kind in in_blocks(self.space).columns])

    def strongest(self, count: int = 10) -> list[tuple[str, str, float]]:
        """List the weights that are largest in size: word feature, property, weight."""
        weights, columns = self.weights, in_blocks(self.space).columns
        properties = [name for names in columns.values() for name in names]
        names = self.model.vocabulary.names
        order = np.argsort(-np.abs(weights), axis=None, kind="stable")[:count]
        rows, places = np.unravel_index(order, weights.shape)
        return [
            (names[int(w)], properties[int(f)], float(weights[w, f]))
            for w, f in zip(rows, places, strict=True)
        ]

    def ground(
        self, root: Phrase, world: AnyWorld, width: int = BEAM_WIDTH, clause: int = 0
    ) -> list[SymbolSet]:
        """Infer what a sentence means in a world.

        Args:
            root: its tree.
            world: the world.
            width: beam width.
            clause: which of its clauses the tree is.

        Returns:
            Up to ``width`` sets of symbols, likeliest first.
        """
        symbols = in_blocks(self.space).symbols_in(world)
        return [
            SymbolSet(
                symbols=symbols.members(one.expressed),
                probability=float(np.exp(one.log_probability)),
            )
            for one in self.weigh(root, world, clause).search(width)
        ]

    def beliefs(self, root: Phrase, world: AnyWorld) -> list[PhraseBelief]:
        """Compute for every phrase how probable each symbol is, parents first.

        Each phrase is given what its children express in the likeliest reading.
        """
        return self.weigh(root, world).beliefs()

    def factor_graph(self, root: Phrase, world: AnyWorld) -> FactorGraph:
        """Construct the factor graph of a sentence in a world."""
        return build([root], in_blocks(self.space).symbols_in(world))

    def accuracy(self, labelled: Sequence[Labelled[AnyWorld]]) -> float:
        """Compute the share of trees whose likeliest set at the root is exactly the gold one."""
        right = [
            frozenset(self.ground(one.root, one.world, clause=one.clause)[0].symbols)
            == one.expressed[-1]
            for one in labelled
        ]
        return float(np.mean(right))

    def weigh(self, root: Phrase, world: AnyWorld, clause: int = 0) -> WeighedTree:
        """Let the words of a clause meet the weights; see ``weigh_phrases``."""
        space = in_blocks(self.space)
        phrases = weigh_phrases(space, self.model.coefficients, root, world, clause)
        return WeighedTree(root, (clause,), space.symbols_in(world).size, phrases)


_TOKEN = re.compile(r"\s*(?:([A-Z]+)\[([^\]]*)\]|([{},]))")


def read_tree(text: str, word_of: Callable[[str], Word] | None = None) -> Phrase:
    """Read a tree as ``str(phrase)`` writes it: ``VP[go to]{NP[the cone], PP[behind]{NP[it]}}``.

    Args:
        text: the tree; labels are capitals, a phrase's own words stand in brackets, its children
            in braces.
        word_of: makes a word, with tag and senses, of its text; by default a plain word.

    Returns:
        The tree; words are counted in the order of the text.

    Raises:
        ValueError: the text is no tree; the message says where.
    """
    make = word_of or (lambda word: Word(text=word, tag="", lemma=word))
    place = position = 0

    def fail() -> ValueError:
        return ValueError(f"no tree: cannot read '{text[place : place + 20]}' in '{text}'")

    def take(marks: str) -> re.Match[str]:
        """Take one of the marks, or the head of a phrase where there are none."""
        nonlocal place
        found = _TOKEN.match(text, place)
        if found is None or (found[3] not in marks if found[3] else marks != ""):
            raise fail()
        place = found.end()
        return found

    def phrase() -> Phrase:
        nonlocal position
        head, words = take(""), []
        for word in head[2].split():
            position += 1
            words.append(dataclasses.replace(make(word), position=position))
        children: list[Phrase] = []
        if text[place:].lstrip().startswith("{"):
            mark = take("{")[3]
            while mark != "}":
                children.append(phrase())
                mark = take(",}")[3]
        return Phrase(label=head[1], words=tuple(words), children=tuple(children))

    tree = phrase()
    if text[place:].strip():
        raise fail()
    return tree
