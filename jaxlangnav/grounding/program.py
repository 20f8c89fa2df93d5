"""The behavior program: a sentence with its words contracted away (section 3.3).

Contracting the words of a sentence with the weights leaves a few coefficients per phrase, and
inference per particle and step reads only these. All sentences have the same shapes, so a new
sentence is new data and never a new program.

A phrase rarely expresses more than one relation, so of the seven regions each object has, only
the ``NUM_REGION_SLOTS`` whose log-odds can become largest are kept (for constraints: one).
"""

from collections.abc import Mapping
from itertools import accumulate

import numpy as np
from jax import Array

from jaxlangnav.grounding.behavior_properties import (
    CONSTRAINT_CONDITIONS,
    OBJECT_CONDITIONS,
    PREVIOUS,
    REGION_CONDITIONS,
    PhraseWords,
    choice_tables,
    contract,
)
from jaxlangnav.grounding.model import RESTRICTORS, CorrespondenceModel, senses_of
from jaxlangnav.grounding.properties import find_ranks
from jaxlangnav.grounding.symbols import NUM_REGIONS, NUM_RELATIONS, Node, Path, post_order
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import AT, NONE, ROBOT
from jaxlangnav.pytree import pytree

NUM_PHRASES, NUM_CHILDREN, NUM_REGION_SLOTS = 24, 3, 2
MAX_NAMED_TYPES = 4
"""Kinds that the words of one phrase may name."""
NUM_TABLES = 5
"""Different relations in which a sentence may place figures."""
MAX_DEPTH = 6
"""Phrases that may wait for their parent at the same time."""
LOG_NEVER = -1e4
"""Log-odds of a symbol that a phrase cannot express."""
NOTHING = -1
"""Children of a padded row: it leaves the stack as it is."""
AT_TABLE = 3 * NUM_RELATIONS


@pytree
class BehaviorProgram:
    """Coefficients of one clause: phrases bottom-up, then padding, the root in the last row.

    H rows, 3 children, L region slots, T tables. Log-odds are sums over the conditions that hold.
    The children of a phrase are what lies on top of the stack; the last child is child 0.
    """

    num_phrases: Array  # i32[]
    num_children: Array  # i32[H]; NOTHING in padded rows
    is_verb: Array  # bool[H] expresses goals and constraints, otherwise objects and regions
    is_restrictor: Array  # bool[H, 3] the child says where the figure is
    own: Array  # i32[H, 4] kinds that the words name; NONE beyond them
    objects: Array  # f32[H, 13] log-odds added under each of ``OBJECT_CONDITIONS``
    table: Array  # i32[T] 0-5 related, 6-11 extreme of its type, 12-17 the second, third, ... that
    # the sentence means, 18 at; NONE where unused
    region_relation: Array  # i32[H, L] relation of each slot; NONE where empty
    region_table: Array  # i32[H, L] which table says what lies in the region; NONE
    region_from: Array  # i32[H, 3, L] slot of the child with the same relation; NONE
    regions: Array  # f32[H, 6, L] added under each of ``REGION_CONDITIONS``
    constraint_relation: Array  # i32[H]
    constraint_from: Array  # i32[H, 3] 0 where the child has the same constraint; NONE
    constraint_region: Array  # i32[H, 3] slot of the child with the same relation; NONE
    constraints: Array  # f32[H, 7] added under each of ``CONSTRAINT_CONDITIONS``
    action: Array  # f32[2] probability
    mode: Array  # f32[3] probability


CLAUSE_FIELDS = ("num_phrases", "table", "action", "mode")
"""Fields that have no row for each phrase."""


def empty_program() -> dict[str, np.ndarray]:
    """Build the fields of a program that expresses nothing."""
    h, k, s = NUM_PHRASES, NUM_CHILDREN, NUM_REGION_SLOTS
    f32, i32 = np.float32, np.int32
    fields: dict[str, np.ndarray] = {
        "num_phrases": np.zeros((), i32),
        "num_children": np.full(h, NOTHING, i32),
        "is_verb": np.zeros(h, bool),
        "is_restrictor": np.zeros((h, k), bool),
        "own": np.full((h, MAX_NAMED_TYPES), NONE, i32),
        "objects": np.zeros((h, len(OBJECT_CONDITIONS)), f32),
        "table": np.full(NUM_TABLES, NONE, i32),
        "region_relation": np.full((h, s), NONE, i32),
        "region_table": np.full((h, s), NONE, i32),
        "region_from": np.full((h, k, s), NONE, i32),
        "regions": np.zeros((h, len(REGION_CONDITIONS), s), f32),
        "constraint_relation": np.full(h, NONE, i32),
        "constraint_from": np.full((h, k), NONE, i32),
        "constraint_region": np.full((h, k), NONE, i32),
        "constraints": np.zeros((h, len(CONSTRAINT_CONDITIONS)), f32),
        "action": np.array([1, 0], f32),
        "mode": np.array([1, 0, 0], f32),
    }
    for name in ("objects", "regions", "constraints"):
        fields[name][:, 0] = LOG_NEVER
    return fields


def _reach(
    fields: dict[str, np.ndarray], children: tuple[int, ...], terms: dict[str, np.ndarray]
) -> np.ndarray:
    """Bound the log-odds of each relation that some child may express from above, f32[7]."""
    is_held = np.isin(np.arange(NUM_REGIONS), fields["region_relation"][list(children)])
    bound = terms["base"].copy()
    for name in ("inside", "touched", "kept", "new", "own", "robot"):
        bound += np.maximum(terms.get(name, 0), 0)
    bound += np.where(is_held, np.maximum(terms["same"], 0), 0)
    rest = np.maximum(terms.get("absent", 0), 0) + np.maximum(terms.get("untouched", 0), 0)
    return np.asarray(bound + rest)


def softmax(log_odds: np.ndarray) -> np.ndarray:
    """Turn log-odds into the distribution given that exactly one is expressed."""
    weight = np.exp(log_odds - log_odds.max())
    return (weight / weight.sum()).astype(np.float32)


def _slot_of(fields: dict[str, np.ndarray], row: int, relation: int) -> int:
    """Find the slot of a phrase that has a relation; NONE."""
    held = np.flatnonzero(fields["region_relation"][row] == relation)
    return int(held[0]) if len(held) else NONE


def _fill_regions(
    fields: dict[str, np.ndarray],
    row: int,
    children: tuple[int, ...],
    terms: dict[str, np.ndarray],
    meant: np.ndarray,
) -> list[tuple[float, int, int, int]]:
    """Choose the slots of a phrase; of each the bound, the row, the slot and the table."""
    reach, slots = _reach(fields, children, terms), []
    for slot, relation in enumerate(np.argsort(-reach, kind="stable")[:NUM_REGION_SLOTS]):
        fields["region_relation"][row, slot] = relation
        table = AT_TABLE if relation == AT else relation + NUM_RELATIONS * min(meant[relation], 2)
        slots.append((float(reach[relation]), row, slot, int(table)))
        fields["regions"][row, :, slot] = [term[relation] for term in terms.values()]
        for k, child in enumerate(children):
            fields["region_from"][row, k, slot] = _slot_of(fields, child, relation)
    return slots


def _fill_constraint(
    fields: dict[str, np.ndarray], row: int, children: tuple[int, ...], terms: dict[str, np.ndarray]
) -> None:
    """Choose the relation of a verb phrase's constraints and write its coefficients."""
    relation = int(np.argmax(_reach(fields, children, terms)))
    fields["constraint_relation"][row] = relation
    fields["constraints"][row] = [term[relation] for term in terms.values()]
    for k, child in enumerate(children):
        if fields["constraint_relation"][child] == relation:
            fields["constraint_from"][row, k] = 0
        fields["constraint_region"][row, k] = _slot_of(fields, child, relation)


def _check_sizes(nodes: tuple[Node, ...]) -> None:
    """Refuse a clause that the arrays do not hold."""
    for what, size, most in (
        ("phrases", len(nodes), NUM_PHRASES),
        ("parts of one phrase", max(len(node.children) for node in nodes), NUM_CHILDREN),
        ("nested phrases", max(accumulate(1 - len(node.children) for node in nodes)), MAX_DEPTH),
    ):
        if size > most:
            raise ValueError(
                f"the command has {size} {what}; at most {most} are held: say less at once"
            )


def compile_clause(
    root: Phrase,
    clause: int,
    model: CorrespondenceModel,
    rank: Mapping[Path, int],
    type_names: tuple[str, ...],
) -> dict[str, np.ndarray]:
    """Contract the words of a clause: the fields of its ``BehaviorProgram``, host arrays.

    Args:
        root: the clause; its root is a verb phrase.
        clause: its position in the sentence.
        model: behavior model.
        rank: of each phrase: 0, 1 nearest, 2 second, ... (annotation model).
        type_names: object types.

    Raises:
        ValueError: the clause has more phrases, or nests deeper, than a program holds.
    """
    nodes = post_order(root, clause)
    _check_sizes(nodes)
    fields = empty_program()
    fields["num_phrases"] = np.asarray(len(nodes), np.int32)
    wanted = []
    for index, node in enumerate(nodes):
        row = NUM_PHRASES - 1 if index == len(nodes) - 1 else index
        children = node.children[::-1]  # the last child counts first
        z = model.coefficients(node.phrase)
        senses = senses_of(node.phrase, type_names)
        labels = [nodes[child].phrase.label in RESTRICTORS for child in children]
        fields["num_children"][row], fields["is_verb"][row] = len(labels), node.is_verb
        fields["is_restrictor"][row, : len(labels)] = labels
        words = PhraseWords.of(senses, bool(node.children), any(labels))
        if node.is_verb:
            terms = contract("goal", words, z["goal"])
            _fill_constraint(fields, row, children, contract("constraint", words, z["constraint"]))
        else:
            terms = contract("region", words, z["region"])
            objects = contract("object", words, z["object"])
            if senses.is_thing:  # whatever the goal before was, to it there is none
                objects["always"] += objects["no_previous"]
                objects |= dict.fromkeys(PREVIOUS, np.zeros(NUM_REGIONS, np.float32))
            fields["objects"][row] = [term[0] for term in objects.values()]
            named = [*sorted(senses.types), *([ROBOT] if senses.is_robot else [])][:MAX_NAMED_TYPES]
            fields["own"][row, : len(named)] = named
        meant = find_ranks(node.phrase, node.path, rank, type_names)
        slots = _fill_regions(fields, row, children, terms, meant)
        if node.phrase.label in RESTRICTORS:
            wanted += slots
    tables: list[int] = []
    for _, row, slot, table in sorted(wanted, key=lambda one: -one[0]):  # the likeliest first
        if table not in tables and len(tables) < NUM_TABLES:
            tables.append(table)
        if table in tables:
            fields["region_table"][row, slot] = tables.index(table)
    fields["table"][: len(tables)] = tables
    z = model.coefficients(root)
    for name, choices in choice_tables(senses_of(root, type_names)).items():
        fields[name] = softmax(choices @ z[name])
    return fields
