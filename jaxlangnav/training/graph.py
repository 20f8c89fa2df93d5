"""Training of a correspondence graph with anyone's symbols (section 3.1, eq. 4)."""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxlangnav.grounding.correspondence import (
    KIND,
    AnyWorld,
    CorrespondenceGraph,
    Labelled,
    SymbolSpace,
)
from jaxlangnav.grounding.features import FEATURE_GROUPS
from jaxlangnav.training.examples import PhraseExample, Rows
from jaxlangnav.training.fit import Fit, TrainingConfig, train


def examples_of(
    space: SymbolSpace[AnyWorld], labelled: Sequence[Labelled[AnyWorld]]
) -> list[PhraseExample]:
    """Build training examples: of every phrase, given the gold groundings of its children.

    Args:
        space: the symbols.
        labelled: trees with labels; each counts as an instruction.

    Returns:
        One example per phrase.

    Raises:
        ValueError: a label is no symbol of its world, or the numbers of labels or properties are
            wrong; the message says in which tree.
    """
    return [
        example for index, one in enumerate(labelled) for example in _examples(space, one, index)
    ]


def _examples(
    space: SymbolSpace[AnyWorld], one: Labelled[AnyWorld], index: int
) -> Iterator[PhraseExample]:
    """Build the examples of one tree."""
    phrases = list(one.root.walk())
    if len(phrases) != len(one.expressed):
        raise ValueError(
            f"tree {index}: {len(one.expressed)} labels, but {one.root} has {len(phrases)} phrases"
        )
    names = list(space.symbols(one.world))
    stack: list[np.ndarray] = []
    for phrase, expressed in zip(phrases, one.expressed, strict=True):
        unknown = sorted(expressed - set(names))
        if unknown:
            raise ValueError(f"tree {index}: {unknown[0]} is no symbol of its world")
        label = np.array([name in expressed for name in names])
        first = len(stack) - len(phrase.children)
        seen = np.asarray(space.properties(phrase, stack[first:], one.world), np.float32)
        wanted = len(names), len(space.property_names)
        if seen.shape != wanted:
            raise ValueError(f"tree {index}: properties are {seen.shape}, but must be {wanted}")
        yield PhraseExample(phrase, {KIND: Rows(seen, label)}, index)
        stack[first:] = [label]


def train_graph(
    space: SymbolSpace[AnyWorld],
    labelled: Sequence[Labelled[AnyWorld]],
    *,
    config: TrainingConfig | None = None,
    without: frozenset[str] = frozenset(),
) -> tuple[CorrespondenceGraph[AnyWorld], Fit]:
    """Train a model on labelled trees.

    Args:
        space: the symbols.
        labelled: trees with labels.
        config: regularisation and stopping.
        without: groups of word features to leave out (``FEATURE_GROUPS``).

    Returns:
        The graph, and what was measured.

    Raises:
        ValueError: there is no tree, a label is wrong (``examples_of``), or a group is unknown.
    """
    if not labelled:
        raise ValueError("there is no tree to train on")
    if without - set(FEATURE_GROUPS):
        raise ValueError(f"groups of features are {', '.join(FEATURE_GROUPS)}, not {set(without)}")
    examples = examples_of(space, labelled)
    model, measured = train(examples, (KIND,), len(labelled), config=config, without=without)
    return CorrespondenceGraph(space, model), measured
