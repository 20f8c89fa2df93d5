"""Training of a correspondence graph with anyone's symbols (section 3.1, eq. 4)."""

from collections.abc import Sequence

from jaxlangnav.grounding.correspondence import CorrespondenceGraph, Labelled
from jaxlangnav.grounding.features import FEATURE_GROUPS
from jaxlangnav.grounding.space import AnyWorld, BlockSpace, SymbolSpace, in_blocks
from jaxlangnav.training.examples import PhraseExample, tree_examples
from jaxlangnav.training.fit import Fit, TrainingConfig, train


def examples_of(
    space: SymbolSpace[AnyWorld] | BlockSpace[AnyWorld], labelled: Sequence[Labelled[AnyWorld]]
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
        example
        for index, one in enumerate(labelled)
        for example in tree_examples(in_blocks(space), one, index)
    ]


def train_graph(
    space: SymbolSpace[AnyWorld] | BlockSpace[AnyWorld],
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
    kinds = tuple(in_blocks(space).columns)
    model, measured = train(examples, kinds, len(labelled), config=config, without=without)
    return CorrespondenceGraph(space, model), measured
