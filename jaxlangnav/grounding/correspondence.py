"""The Distributed Correspondence Graph over any symbol space (section 3.1, eq. 4).

A ``SymbolSpace`` lists the symbols that a phrase can express in a world, and their features. Those
of annotations and behaviors are in ``properties``; other symbols and worlds need another space.
Each kind of symbol has separate weights, and a phrase may lack symbols of some kinds. A phrase may
also give its region a rank by its words alone ("the second").
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

SYMBOLS, RANKS = "symbol", "rank"
"""Names of weight blocks: of symbols that are all of one kind, and of ranks."""
AnyWorld = TypeVar("AnyWorld")
World_contra = TypeVar("World_contra", contravariant=True)


class Block(NamedTuple):
    """Indices and feature matrix of a phrase's symbols of one kind."""

    indices: slice | np.ndarray  # of the n symbols among all S
    properties: np.ndarray  # f[n, F]


class Described(NamedTuple):
    """Features of a phrase's symbols, given what its child phrases express."""

    given: Callable[[Sequence[np.ndarray]], Mapping[str, Block]]
    """bool[S] for each child phrase → blocks by kind; a symbol in no block is not expressed."""
    ranks: np.ndarray | None = None  # f[R, F] features of the ranks 1 to R, if any


class SymbolSpace(Protocol[World_contra]):
    """Protocol of a symbol space: its symbols and their features."""

    @property
    def columns(self) -> Mapping[str, Sequence[str]]:
        """Kind of symbol → names of its F features; with ``RANKS`` where there are ranks."""
        ...

    def symbols_in(self, world: World_contra) -> SymbolDomain:
        """List the symbols of a world."""
        ...

    def describe(self, phrase: Phrase, path: Path, world: World_contra) -> Described:
        """Compute features of a phrase's symbols; those independent of its children only once.

        Words below the phrase matter only through the children; ``path`` is its tree position.
        """
        ...


@dataclasses.dataclass(frozen=True, kw_only=True)
class Labelled(Generic[AnyWorld]):
    """A training example: a tree in a world, with the symbols that each phrase expresses."""

    root: Phrase
    world: AnyWorld
    expressed: Sequence[frozenset[Any]]  # per phrase of ``root.walk()``, children before parents
    ranks: Sequence[int] = ()  # per phrase, 0 for none; only where the space has ranks
    clause: int = 0  # index of the clause in its sentence


@dataclasses.dataclass(frozen=True, kw_only=True)
class SymbolSet:
    """A candidate meaning: the set of symbols expressed at the root, with its probability."""

    symbols: tuple[Any, ...]  # expressed at the root, as the space has them
    probability: float  # of this set; the beam drops the rest


@dataclasses.dataclass(frozen=True, kw_only=True)
class PhraseBelief:
    """Marginal symbol probabilities of one phrase, and its likeliest rank."""

    phrase: Phrase
    path: Path
    probability: np.ndarray  # f64[S] that each symbol is expressed
    rank: int  # 1 where its region is meant as an extreme ("nearest"), 2 for the second; or 0

    @property
    def parent(self) -> Path | None:
        """Path of the parent phrase; None at the root of a clause."""
        return self.path[:-1] or None


class TreeFeatures(Generic[AnyWorld]):
    """Features of the symbols of a tree in a world, computed once for any model."""

    def __init__(
        self, space: SymbolSpace[AnyWorld], root: Phrase, world: AnyWorld, clause: int = 0
    ) -> None:
        """Compute the features of every phrase of a clause."""
        self.root, self.path, self.symbols = root, (clause,), space.symbols_in(world)
        nodes = post_order(root, clause)
        self.phrases = {n.path: n.phrase for n in nodes}
        self.described = {n.path: space.describe(n.phrase, n.path, world) for n in nodes}
        self._blocks: dict[tuple, Mapping[str, Block]] = {}

    def blocks(self, path: Path, children: Children) -> Mapping[str, Block]:
        """Compute feature blocks of a phrase, by kind, given bool[S] that each child expresses."""
        key = path, *(child.tobytes() for child in children)
        if key not in self._blocks:
            self._blocks[key] = self.described[path].given(children)
        return self._blocks[key]


class ScoredTree:
    """Log-odds of the symbols of a tree: its words are contracted with a model's weights once."""

    def __init__(self, tree: TreeFeatures, model: CorrespondenceModel) -> None:
        """Contract the words of a clause with the weights."""
        self.tree, self.symbols = tree, tree.symbols
        self._coefficients = {path: model.coefficients(p) for path, p in tree.phrases.items()}

    def log_odds(self, path: Path, children: Children) -> np.ndarray:
        """Compute the log-odds of each symbol at a phrase, given bool[S] that each child expresses.

        f64[S]; −inf for symbols that it cannot express.
        """
        odds = np.full(self.symbols.size, -np.inf)
        for kind, (indices, features) in self.tree.blocks(path, children).items():
            odds[indices] = self._coefficients[path][kind] @ features.T
        return odds

    def search(self, width: int = BEAM_WIDTH) -> list[Hypothesis]:
        """Infer the sets of symbols that the root expresses by beam search, best first."""
        return search(self.tree.root, self.log_odds, width=width, path=self.tree.path)

    def log_ranks(self) -> dict[Path, np.ndarray]:
        """Compute log-probabilities f64[1 + R] of the ranks of each phrase that may give one."""
        log_probs = {}
        for path, described in self.tree.described.items():
            if described.ranks is not None:
                odds = self._coefficients[path][RANKS] @ described.ranks.T
                scores = np.append(0.0, odds.astype(float))
                log_probs[path] = scores - np.logaddexp.reduce(scores)
        return log_probs

    def beliefs(self) -> list[PhraseBelief]:
        """Compute the marginal symbol probabilities of every phrase, parents first.

        Each is conditioned on what its children express in the likeliest reading.
        """
        ranks, beliefs = self.log_ranks(), []
        for path, hypothesis in self.search()[0].walk(self.tree.path):
            odds = self.log_odds(path, tuple(child.expressed for child in hypothesis.children))
            belief = PhraseBelief(
                phrase=self.tree.phrases[path],
                path=path,
                probability=np.exp(-np.logaddexp(0.0, -odds)),
                rank=int(np.argmax(ranks.get(path, 0))),
            )
            beliefs.append(belief)
        return beliefs


@dataclasses.dataclass(frozen=True)
class CorrespondenceGraph(Generic[AnyWorld]):
    """A symbol space with a trained correspondence model."""

    space: SymbolSpace[AnyWorld]
    model: CorrespondenceModel

    def score(self, root: Phrase, world: AnyWorld, clause: int = 0) -> ScoredTree:
        """Contract the words of a clause with the weights; see ``ScoredTree``."""
        return ScoredTree(TreeFeatures(self.space, root, world, clause), self.model)

    def ground(self, root: Phrase, world: AnyWorld, width: int = BEAM_WIDTH) -> list[SymbolSet]:
        """Infer what a tree means in a world: up to ``width`` sets of symbols, likeliest first."""
        tree = self.score(root, world)
        return [
            SymbolSet(
                symbols=tree.symbols.members(hypothesis.expressed),
                probability=float(np.exp(hypothesis.log_probability)),
            )
            for hypothesis in tree.search(width)
        ]


_TOKEN = re.compile(r"\s*(?:([A-Z]+)\[([^\]]*)\]|([{},]))")


def read_tree(text: str) -> Phrase:
    """Read a tree as ``str(phrase)`` writes it: ``VP[go to]{NP[the cone], PP[behind]{NP[it]}}``.

    Labels are capitals, a phrase's own words stand in brackets, its children in braces. The words
    are plain, and counted in the order of the text.

    Raises:
        ValueError: the text is no tree; the message says where.
    """
    offset = position = 0

    def take(marks: str) -> re.Match[str]:
        """Take one of the marks, or the head of a phrase where there are none."""
        nonlocal offset
        match = _TOKEN.match(text, offset)
        if match is None or (match[3] not in marks if match[3] else marks != ""):
            raise ValueError(f"no tree: cannot read '{text[offset : offset + 20]}' in '{text}'")
        offset = match.end()
        return match

    def phrase() -> Phrase:
        nonlocal position
        head, words, children = take(""), [], []
        for word in head[2].split():
            position += 1
            words.append(Word(text=word, tag="", lemma=word, position=position))
        mark = take("{")[3] if text[offset:].lstrip().startswith("{") else "}"
        while mark != "}":
            children.append(phrase())
            mark = take(",}")[3]
        return Phrase(label=head[1], words=tuple(words), children=tuple(children))

    tree = phrase()
    if text[offset:].strip():
        take("\0")
    return tree
