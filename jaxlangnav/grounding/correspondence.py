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
from jaxlangnav.grounding.search import (
    BEAM_WIDTH,
    Beams,
    Children,
    Hypothesis,
    identify,
    search,
    search_exactly,
)
from jaxlangnav.grounding.symbols import Path, Symbols, bottom_up
from jaxlangnav.language.phrase import Phrase, Word

KIND, RANK = "symbol", "rank"
"""Names of blocks of weights: of symbols that are all of one kind, and of ranks."""
MANY = 64
"""Symbols of a phrase from which on equal ones are joined at once."""
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

    def symbols_in(self, world: World_contra) -> Symbols:
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


class WeighedTree(Generic[AnyWorld]):
    """A tree in a world, its words contracted with the weights of K models: once, for all below."""

    def __init__(
        self,
        space: SymbolSpace[AnyWorld],
        coefficients: Callable[[Phrase], Mapping[str, np.ndarray]],
        root: Phrase,
        world: AnyWorld,
        clause: int = 0,
    ) -> None:
        """Let the words of a clause meet the weights.

        ``coefficients`` takes a phrase to kind → f32[F] of a model, or f32[K, F] of K models.
        """
        self.root, self.path, self.symbols = root, (clause,), space.symbols_in(world)
        self._phrases = {
            node.path: (
                {kind: np.atleast_2d(c) for kind, c in coefficients(node.phrase).items()},
                space.describe(node.phrase, node.path, world),
            )
            for node in bottom_up(root, clause)
        }
        first, _ = self._phrases[self.path]
        self.num_models = len(next(iter(first.values())))
        self._tables: dict[tuple, list[tuple]] = {}
        self._known: dict[int, Beams] = {}

    def log_odds(self, path: Path, children: Children, models: np.ndarray) -> np.ndarray:
        """Compute how likely a phrase expresses each symbol, given bool[S] that each child does.

        f64[M, S] by models i[M]; −inf for symbols that it cannot express.
        """
        coefficients, described = self._phrases[path]
        key = path, *(child.tobytes() for child in children)
        if key not in self._tables:
            self._tables[key] = []
            for kind, (places, distinct) in described.given(children).items():
                alike = slice(None)
                if self.num_models > 1 and len(distinct) >= MANY:  # it pays to join equal symbols
                    first, alike = identify(distinct)
                    distinct = distinct[first]
                self._tables[key].append((kind, places, distinct, alike))
        odds = np.full((len(models), self.symbols.size), -np.inf)
        for kind, places, distinct, alike in self._tables[key]:
            odds[:, places] = (coefficients[kind][models] @ distinct.T)[:, alike]
        return odds

    def beams(self, width: int = BEAM_WIDTH, models: np.ndarray | None = None) -> Beams:
        """Infer what the root expresses by each model, or by i[M] of them; see ``search``."""
        is_part = models is not None and len(models) < self.num_models
        if not is_part and width in self._known:
            return self._known[width]
        which = models if models is not None and is_part else np.arange(self.num_models)
        found = search(
            self.root,
            lambda path, children, rows: self.log_odds(path, children, which[rows]),
            len(which),
            width=width,
            path=self.path,
        )
        if not is_part:
            self._known[width] = found
        return found

    def search(self, width: int = BEAM_WIDTH) -> list[Hypothesis]:
        """Infer what the root expresses by the first model."""
        return self.beams(width).of(0)

    def search_exactly(self) -> tuple[np.ndarray, np.ndarray]:
        """Find the likeliest of all sets by each model, bool[K, S], and what is proven, bool[K]."""
        return search_exactly(self.beams, self.num_models)

    def log_ranks(self) -> dict[Path, np.ndarray]:
        """Infer the rank of each phrase that may give one: f64[K, 1 + R] log-probabilities."""
        found = {}
        for path, (coefficients, described) in self._phrases.items():
            if described.ranks is not None:
                odds = coefficients[RANK] @ described.ranks.T
                scores = np.pad(odds.astype(float), ((0, 0), (1, 0)))
                found[path] = scores - np.logaddexp.reduce(scores, axis=1, keepdims=True)
        return found

    def beliefs(self) -> list[PhraseBelief]:
        """Compute for every phrase how probable each symbol is, parents first.

        Each phrase is given what its children express in the likeliest reading of the first model.
        """
        ranks = {path: int(np.argmax(chances[0])) for path, chances in self.log_ranks().items()}
        phrases = {node.path: node.phrase for node in bottom_up(self.root, *self.path)}
        found = []
        for path, best in self.search()[0].walk(self.path):
            children = tuple(child.expressed for child in best.children)
            chance = np.exp(-np.logaddexp(0.0, -self.log_odds(path, children, np.array([0]))[0]))
            one = PhraseBelief(
                phrase=phrases[path], path=path, probability=chance, rank=ranks.get(path, 0)
            )
            found.append(one)
        return found


@dataclasses.dataclass(frozen=True)
class CorrespondenceGraph(Generic[AnyWorld]):
    """A symbol space with a trained model."""

    space: SymbolSpace[AnyWorld]
    model: CorrespondenceModel

    def weigh(self, root: Phrase, world: AnyWorld, clause: int = 0) -> WeighedTree[AnyWorld]:
        """Let the words of a clause meet the weights."""
        return WeighedTree(self.space, self.model.coefficients, root, world, clause)

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
