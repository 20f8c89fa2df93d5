"""The corpus of ``language`` as training data: symbols by name become symbols by index."""

from collections.abc import Sequence

from jaxlangnav.grounding.correspondence import CorrespondenceGraph, Labelled
from jaxlangnav.grounding.features import FEATURE_GROUPS
from jaxlangnav.grounding.graph import bottom_up
from jaxlangnav.grounding.space import AnyWorld, BlockSpace, SymbolSpace, in_blocks
from jaxlangnav.grounding.symbols import (
    KINDS,
    OBJECT,
    Annotation,
    BehaviorSymbol,
    object_symbol,
    region_symbol,
    relation_symbol,
)
from jaxlangnav.grounding.worlds import place
from jaxlangnav.language.corpus import Example
from jaxlangnav.language.phrase import COMMAND
from jaxlangnav.messages import ACTIONS, MODES, NONE, REGIONS, RELATIONS, ROBOT
from jaxlangnav.training.examples import LabelledInstruction, PhraseExample, tree_examples
from jaxlangnav.training.fit import Fit, TrainingConfig, train


def _split(text: str) -> tuple[str, list[str]]:
    """Part ``kind(argument,...)`` into kind and arguments."""
    kind, _, rest = text.removesuffix(")").partition("(")
    return kind, rest.split(",")


def read_annotation(text: str, type_names: tuple[str, ...]) -> Annotation:
    """Read an annotation symbol.

    Args:
        text: for example ``relation(hydrant,behind,cone)``.
        type_names: object types.

    Returns:
        The symbol.
    """

    def landmark(name: str) -> int:
        return ROBOT if name == "robot" else type_names.index(name)

    kind, arguments = _split(text)
    if kind == "object":
        return object_symbol(type_names.index(arguments[0]))
    if kind == "region":
        return region_symbol(RELATIONS.index(arguments[0]), landmark(arguments[1]))
    figure, relation, mark = arguments
    return relation_symbol(type_names.index(figure), RELATIONS.index(relation), landmark(mark))


def read_behavior(text: str, num_objects: int) -> BehaviorSymbol:
    """Read a behavior symbol.

    Args:
        text: for example ``goal(at,3)``.
        num_objects: objects of the world; the robot's slot comes after them.

    Returns:
        The symbol.
    """
    name, arguments = _split(text)
    kind = KINDS.index(name)
    last = num_objects if arguments[-1] == "robot" else arguments[-1]
    if kind == OBJECT:
        return BehaviorSymbol(kind, NONE, int(last))
    if name in ("action", "mode"):
        names = ACTIONS if name == "action" else MODES
        return BehaviorSymbol(kind, NONE, names.index(arguments[0]))
    return BehaviorSymbol(kind, REGIONS.index(arguments[0]), int(last))


def labelled_instruction(example: Example, type_names: tuple[str, ...]) -> LabelledInstruction:
    """Turn one labelled instruction into training data.

    Args:
        example: as the corpus has it.
        type_names: object types.

    Returns:
        The instruction by symbol indices. Statements ask for nothing and have no behavior.
    """
    paths = [[n.path for n in bottom_up(root, c)] for c, root in enumerate(example.parse.clauses)]
    annotation, rank = {}, {}
    for clause, labels in zip(paths, example.clauses, strict=True):
        for path, symbols, own in zip(clause, labels.annotation, labels.rank, strict=True):
            annotation[path] = frozenset(read_annotation(text, type_names) for text in symbols)
            rank[path] = own
    behaviors = []
    for labelled in example.worlds:
        count = len(labelled.world.objects)
        behaviors.append(
            {
                path: frozenset(read_behavior(text, count) for text in symbols)
                for clause, labels, kind in zip(
                    paths, labelled.behavior, example.parse.kinds, strict=True
                )
                if kind == COMMAND
                for path, symbols in zip(clause, labels, strict=True)
            }
        )
    worlds = tuple(place(labelled.world, type_names) for labelled in example.worlds)
    return LabelledInstruction(example.parse, annotation, rank, worlds, tuple(behaviors))


def read_examples(
    examples: Sequence[Example], type_names: tuple[str, ...]
) -> list[LabelledInstruction]:
    """Turn a corpus into training data; see ``labelled_instruction``."""
    return [labelled_instruction(example, type_names) for example in examples]


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
