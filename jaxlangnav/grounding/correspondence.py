"""The Distributed Correspondence Graph by itself, with anyone's symbols (section 3.1, eq. 4).

What a robot's maker brings is a ``SymbolSpace``: which symbols a phrase may express in a world, and
what is seen of each. Trees, labels and worlds are the maker's own too; ``read_tree`` writes trees
without a parser. Everything else is what this package uses itself: the bilinear model, its
training, and the search that is exact but for the beam.
"""

import dataclasses
import itertools
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Generic, Protocol, TypeVar

import numpy as np

from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.search import BEAM_WIDTH, Hypothesis, LogOdds, search
from jaxlangnav.language.phrase import Phrase, Word

KIND = "symbol"
"""Name of the one block of weights."""
AnyWorld = TypeVar("AnyWorld")
World_contra = TypeVar("World_contra", contravariant=True)


class SymbolSpace(Protocol[World_contra]):
    """Someone's symbols, and what is seen of them."""

    @property
    def property_names(self) -> Sequence[str]:
        """What the F properties are, for people who look at the weights."""
        ...

    def symbols(self, world: World_contra) -> Sequence[str]:
        """Name the S symbols that a phrase may express in a world, all different."""
        ...

    def properties(
        self, phrase: Phrase, children: Sequence[np.ndarray], world: World_contra
    ) -> np.ndarray:
        """Describe every symbol, given what the child phrases express.

        Args:
            phrase: the phrase; the words below it count through the children alone.
            children: bool[S] for each child phrase, in order.
            world: the world.

        Returns:
            f[S, F].
        """
        ...


@dataclasses.dataclass(frozen=True, kw_only=True)
class Labelled(Generic[AnyWorld]):
    """A tree in a world, with the symbols that each phrase expresses."""

    root: Phrase
    world: AnyWorld
    expressed: Sequence[frozenset[str]]  # per phrase of ``root.walk()``, children before parents


@dataclasses.dataclass(frozen=True, kw_only=True)
class SymbolSet:
    """What a sentence may mean."""

    symbols: tuple[str, ...]  # expressed at the root
    probability: float  # of this set; what is missing to one was cut by the beam


@dataclasses.dataclass(frozen=True, kw_only=True)
class PhraseBelief:
    """What a phrase is taken to express."""

    phrase: Phrase
    path: tuple[int, ...]
    probability: np.ndarray  # f64[S] that each symbol is expressed
    rank: int  # 1 where its region is meant as an extreme ("nearest"), 2 for the second; or 0

    @property
    def parent(self) -> tuple[int, ...] | None:
        """Path of the parent phrase; None at the root of a clause."""
        return self.path[:-1] if len(self.path) > 1 else None


@dataclasses.dataclass(frozen=True)
class CorrespondenceGraph(Generic[AnyWorld]):
    """A symbol space with a trained model."""

    space: SymbolSpace[AnyWorld]
    model: CorrespondenceModel

    @property
    def weights(self) -> np.ndarray:
        """The weight of every word feature (row) by every property (column), f32[W, F]."""
        return self.model.weights[KIND]

    def strongest(self, count: int = 10) -> list[tuple[str, str, float]]:
        """List the weights that are largest in size: word feature, property, weight."""
        weights, properties = self.weights, self.space.property_names
        names = self.model.vocabulary.names
        order = np.argsort(-np.abs(weights), axis=None, kind="stable")[:count]
        rows, columns = np.unravel_index(order, weights.shape)
        return [
            (names[int(w)], properties[int(f)], float(weights[w, f]))
            for w, f in zip(rows, columns, strict=True)
        ]

    def ground(self, root: Phrase, world: AnyWorld, width: int = BEAM_WIDTH) -> list[SymbolSet]:
        """Infer what a sentence means in a world.

        Args:
            root: its tree.
            world: the world.
            width: beam width.

        Returns:
            Up to ``width`` sets of symbols, likeliest first.
        """
        names = self.space.symbols(world)
        return [
            SymbolSet(
                symbols=tuple(itertools.compress(names, one.expressed)),
                probability=float(np.exp(one.log_probability)),
            )
            for one in search(root, self._log_odds(world), width=width)
        ]

    def beliefs(self, root: Phrase, world: AnyWorld) -> list[PhraseBelief]:
        """Compute for every phrase how probable each symbol is, parents first.

        Each phrase is given what its children express in the likeliest reading.
        """
        log_odds = self._log_odds(world)
        best = search(root, log_odds, path=(0,))[0]
        return list(beliefs_below(root, (0,), best, log_odds))

    def accuracy(self, labelled: Sequence[Labelled[AnyWorld]]) -> float:
        """Compute the share of trees whose likeliest set at the root is exactly the gold one."""
        right = [
            frozenset(self.ground(one.root, one.world)[0].symbols) == one.expressed[-1]
            for one in labelled
        ]
        return float(np.mean(right))

    def _log_odds(self, world: AnyWorld) -> LogOdds:
        known: dict[tuple[int, ...], np.ndarray] = {}

        def log_odds(
            phrase: Phrase, path: tuple[int, ...], children: Sequence[Hypothesis]
        ) -> np.ndarray:
            if path not in known:  # words meet the weights once, not at every combination below
                known[path] = self.model.coefficients(phrase)[KIND]
            seen = self.space.properties(phrase, [child.expressed for child in children], world)
            return (seen @ known[path]).astype(np.float64)

        return log_odds


def beliefs_below(
    phrase: Phrase,
    path: tuple[int, ...],
    best: Hypothesis,
    log_odds: LogOdds,
    ranks: Mapping[tuple[int, ...], int] | None = None,
) -> Iterator[PhraseBelief]:
    """Yield the beliefs of a phrase and of all below it, parents first.

    Args:
        phrase: the phrase.
        path: where it stands.
        best: its likeliest hypothesis.
        log_odds: the model.
        ranks: superlatives by path, where there are any.

    Yields:
        One belief per phrase.
    """
    odds = log_odds(phrase, path, best.children)
    rank = (ranks or {}).get(path, 0)
    probability = np.exp(-np.logaddexp(0.0, -odds))
    yield PhraseBelief(phrase=phrase, path=path, probability=probability, rank=rank)
    for index, (child, below) in enumerate(zip(phrase.children, best.children, strict=True)):
        yield from beliefs_below(child, (*path, index), below, log_odds, ranks)


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
