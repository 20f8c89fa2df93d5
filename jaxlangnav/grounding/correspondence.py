"""The Distributed Correspondence Graph over any symbol space (section 3.1, eq. 4).

A ``SymbolSpace`` says which symbols a phrase may express in a world, and what is seen of each. The
engine's annotations and behaviors are two (``properties``); bring your own symbols, trees and
worlds with another. Symbols are of one or several kinds, each with weights of its own, of which a
phrase may lack some. A phrase may also give its region a rank by its words alone ("the second").
"""

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np

from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.search import BEAM_WIDTH, Children, Hypothesis, search
from jaxlangnav.grounding.symbols import Path, SymbolDomain, post_order
from jaxlangnav.language.phrase import Phrase, Word

KIND, RANK = "symbol", "rank"
"""Names of blocks of weights: of symbols that are all of one kind, and of ranks."""
AnyWorld = TypeVar("AnyWorld")
World_contra = TypeVar("World_contra", contravariant=True)


class Block(NamedTuple):
    """Symbols of one kind, and what is seen of them."""

    places: slice | np.ndarray  # of its n symbols among all S
    properties: np.ndarray  # f[n, F]


class Described(NamedTuple):
    """What is seen of the symbols of a phrase."""

    given: Callable[[Sequence[np.ndarray]], Mapping[str, Block]]
    """bool[S] for each child phrase → blocks by kind; symbols in none are not expressed."""
    ranks: np.ndarray | None = None  # f[R, F] of the ranks 1 to R, if it may give any


class SymbolSpace(Protocol[World_contra]):
    """Someone's symbols, and what is seen of them."""

    @property
    def columns(self) -> Mapping[str, Sequence[str]]:
        """Kind of symbol → names of the F properties; ``RANK`` with them where there are ranks."""
        ...

    def symbols_in(self, world: World_contra) -> SymbolDomain:
        """List the symbols of a world."""
        ...

    def describe(self, phrase: Phrase, path: Path, world: World_contra) -> Described:
        """Describe a phrase's symbols; what does not depend on its children is worked out once.

        The words below the phrase count through the children alone; ``path`` says where it stands.
        """
        ...


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

    symbols: tuple[Any, ...]  # expressed at the root, as the space has them
    probability: float  # of this set; what is missing to one was cut by the beam


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
        return self.path[:-1] or None


class DescribedTree(Generic[AnyWorld]):
    """A tree in a world, and what is seen of its symbols: described once, for any models."""

    def __init__(
        self, space: SymbolSpace[AnyWorld], root: Phrase, world: AnyWorld, clause: int = 0
    ) -> None:
        """Describe the phrases of a clause."""
        self.root, self.path, self.symbols = root, (clause,), space.symbols_in(world)
        nodes = post_order(root, clause)
        self.phrases = {node.path: node.phrase for node in nodes}
        self.described = {
            node.path: space.describe(node.phrase, node.path, world) for node in nodes
        }
        self._blocks: dict[tuple, Mapping[str, Block]] = {}

    def blocks(self, path: Path, children: Children) -> Mapping[str, Block]:
        """Describe the symbols of a phrase, by kind, given bool[S] that each child expresses."""
        key = path, *(child.tobytes() for child in children)
        if key not in self._blocks:
            self._blocks[key] = self.described[path].given(children)
        return self._blocks[key]


class WeighedTree:
    """A tree whose words have been contracted with the weights of a model: once, for all below."""

    def __init__(self, tree: DescribedTree, model: CorrespondenceModel) -> None:
        """Let the words of a clause meet the weights."""
        self.tree, self.symbols = tree, tree.symbols
        self._coefficients = {path: model.coefficients(one) for path, one in tree.phrases.items()}

    def log_odds(self, path: Path, children: Children) -> np.ndarray:
        """Compute how likely a phrase expresses each symbol, given bool[S] that each child does.

        f64[S]; −inf for symbols that it cannot express.
        """
        odds = np.full(self.symbols.size, -np.inf)
        for kind, (places, properties) in self.tree.blocks(path, children).items():
            odds[places] = self._coefficients[path][kind] @ properties.T
        return odds

    def search(self, width: int = BEAM_WIDTH) -> list[Hypothesis]:
        """Infer what the root expresses, best first."""
        return search(self.tree.root, self.log_odds, width=width, path=self.tree.path)

    def log_ranks(self) -> dict[Path, np.ndarray]:
        """Infer the rank of each phrase that may give one: f64[1 + R] log-probabilities."""
        found = {}
        for path, described in self.tree.described.items():
            if described.ranks is not None:
                odds = self._coefficients[path][RANK] @ described.ranks.T
                scores = np.append(0.0, odds.astype(float))
                found[path] = scores - np.logaddexp.reduce(scores)
        return found

    def beliefs(self) -> list[PhraseBelief]:
        """Compute for every phrase how probable each symbol is, parents first.

        Each phrase is given what its children express in the likeliest reading.
        """
        ranks, found = self.log_ranks(), []
        for path, best in self.search()[0].walk(self.tree.path):
            odds = self.log_odds(path, tuple(child.expressed for child in best.children))
            one = PhraseBelief(
                phrase=self.tree.phrases[path],
                path=path,
                probability=np.exp(-np.logaddexp(0.0, -odds)),
                rank=int(np.argmax(ranks.get(path, 0))),
            )
            found.append(one)
        return found


@dataclasses.dataclass(frozen=True)
class CorrespondenceGraph(Generic[AnyWorld]):
    """A symbol space with a trained model."""

    space: SymbolSpace[AnyWorld]
    model: CorrespondenceModel

    def weigh(self, root: Phrase, world: AnyWorld, clause: int = 0) -> WeighedTree:
        """Let the words of a clause meet the weights."""
        return WeighedTree(DescribedTree(self.space, root, world, clause), self.model)

    def ground(self, root: Phrase, world: AnyWorld, width: int = BEAM_WIDTH) -> list[SymbolSet]:
        """Infer what a tree means in a world: up to ``width`` sets of symbols, likeliest first."""
        tree = self.weigh(root, world)
        return [
            SymbolSet(
                symbols=tree.symbols.members(one.expressed),
                probability=float(np.exp(one.log_probability)),
            )
            for one in tree.search(width)
        ]


_TOKEN = re.compile(r"\s*(?:([A-Z]+)\[([^\]]*)\]|([{},]))")


def read_tree(text: str) -> Phrase:
    """Read a tree as ``str(phrase)`` writes it: ``VP[go to]{NP[the cone], PP[behind]{NP[it]}}``.

    Labels are capitals, a phrase's own words stand in brackets, its children in braces. The words
    are plain, and counted in the order of the text.

    Raises:
        ValueError: the text is no tree; the message says where.
    """
    place = position = 0

    def take(marks: str) -> re.Match[str]:
        """Take one of the marks, or the head of a phrase where there are none."""
        nonlocal place
        found = _TOKEN.match(text, place)
        if found is None or (found[3] not in marks if found[3] else marks != ""):
            raise ValueError(f"no tree: cannot read '{text[place : place + 20]}' in '{text}'")
        place = found.end()
        return found

    def phrase() -> Phrase:
        nonlocal position
        head, words, children = take(""), [], []
        for word in head[2].split():
            position += 1
            words.append(Word(text=word, tag="", lemma=word, position=position))
        mark = take("{")[3] if text[place:].lstrip().startswith("{") else "}"
        while mark != "}":
            children.append(phrase())
            mark = take(",}")[3]
        return Phrase(label=head[1], words=tuple(words), children=tuple(children))

    tree = phrase()
    if text[place:].strip():
        take("\0")
    return tree
