"""Symbol spaces: which symbols a phrase may express in a world, and what is seen of each.

Anyone's symbols come as a ``SymbolSpace``: one array of properties. The engine's own are spaces in
blocks (``BlockSpace``): symbols of several kinds, each with weights of its own, of which a phrase
may lack some; and ranks, which a phrase gives its region by its words alone ("the second"). The
correspondence graph knows blocks only, and a ``SymbolSpace`` is a space of one block.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Generic, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from jaxlangnav.grounding.graph import Path
from jaxlangnav.grounding.symbols import NamedSymbols, Symbols
from jaxlangnav.language.phrase import Phrase

KIND, RANK = "symbol", "rank"
"""Names of blocks of weights: of symbols that are all of one kind, and of ranks."""
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


class Block(NamedTuple):
    """Symbols of one kind, and what is seen of them."""

    places: slice | np.ndarray  # of its n symbols among all S
    properties: np.ndarray  # f[n, F]


class Described(NamedTuple):
    """What is seen of the symbols of a phrase."""

    given: Callable[[Sequence[np.ndarray]], Mapping[str, Block]]
    """bool[S] for each child phrase → blocks by kind; symbols in none are not expressed."""
    ranks: np.ndarray | None = None  # f[R, F] of the ranks 1 to R, if it may give any


@runtime_checkable
class BlockSpace(Protocol[World_contra]):
    """Symbols of several kinds, and what is seen of them."""

    @property
    def columns(self) -> Mapping[str, Sequence[str]]:
        """Kind of symbol → names of the F properties; ``RANK`` with them where there are ranks."""
        ...

    def symbols_in(self, world: World_contra) -> Symbols:
        """List the symbols of a world."""
        ...

    def describe(self, phrase: Phrase, path: Path, world: World_contra) -> Described:
        """Describe a phrase's symbols; what does not depend on its children is worked out once.

        Args:
            phrase: the phrase.
            path: where it stands.
            world: the world.

        Returns:
            What is seen of them.
        """
        ...


@dataclasses.dataclass(frozen=True)
class _OneBlock(Generic[AnyWorld]):
    """A space whose symbols are all of one kind."""

    space: SymbolSpace[AnyWorld]

    @property
    def columns(self) -> Mapping[str, Sequence[str]]:
        """The names of its properties."""
        return {KIND: self.space.property_names}

    def symbols_in(self, world: AnyWorld) -> Symbols:
        """List its symbols by name."""
        return NamedSymbols(self.space.symbols(world))

    def describe(self, phrase: Phrase, path: Path, world: AnyWorld) -> Described:
        """Put all of its symbols into one block."""

        def given(children: Sequence[np.ndarray]) -> Mapping[str, Block]:
            return {KIND: Block(slice(None), self.space.properties(phrase, children, world))}

        return Described(given)


def in_blocks(space: SymbolSpace[AnyWorld] | BlockSpace[AnyWorld]) -> BlockSpace[AnyWorld]:
    """Take any space as one in blocks."""
    return space if isinstance(space, BlockSpace) else _OneBlock(space)
