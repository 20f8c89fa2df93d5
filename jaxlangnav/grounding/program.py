"""Compiled clauses: a sentence's words contracted to coefficients per phrase (section 3.3).

Contracting the words of a sentence with the weights leaves a few coefficients per phrase, and
inference per particle and step reads only these. All sentences have the same shapes, so a new
sentence is new data and needs no compilation by XLA.

A phrase rarely expresses more than one relation, so of the seven regions each object has, only
the ``NUM_REGION_SLOTS`` with the largest upper bound on their log-odds are kept (constraints: one).
"""

from itertools import accumulate

import numpy as np
from jax import Array
from scipy.special import softmax

from jaxlangnav.grounding.behavior_properties import (
    CONSTRAINT_CONDITIONS,
    OBJECT_CONDITIONS,
    PREVIOUS_GOAL,
    REGION_CONDITIONS,
    GateInputs,
    choice_tables,
    sum_by_condition,
)
from jaxlangnav.grounding.model import RESTRICTORS, CorrespondenceModel, senses_of
from jaxlangnav.grounding.properties import find_ranks
from jaxlangnav.grounding.symbols import NUM_REGIONS, NUM_RELATIONS, Node, Ranks, post_order
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import AT, NONE, ROBOT
from jaxlangnav.pytree import pytree

NUM_PHRASES, NUM_CHILDREN, NUM_REGION_SLOTS = 24, 3, 2
MAX_NAMED_TYPES = 4
"""Maximum number of object types named by the words of one phrase."""
NUM_TABLES = 5
"""Maximum number of different relations, with ranks, that restrict figures in a sentence."""
MAX_DEPTH = 6
"""Stack depth: maximum number of phrases whose parent has not been processed."""
LOG_NEVER = -1e4
"""Log-odds of a symbol that a phrase cannot express."""
PADDING = -1
"""Number of children of a padding phrase, which leaves the stack unchanged."""
AT_TABLE = 3 * NUM_RELATIONS


@pytree
class CompiledClause:
    """Coefficients of one clause: phrases bottom-up, then padding, the root in the last row.

    H phrases, 3 children, L region slots, T tables. Log-odds: sums over the conditions that hold.
    The children of a phrase are the top entries of the stack; the last child is child 0.
    """

    num_phrases: Array  # i32[]
    num_children: Array  # i32[H]; PADDING in padding
    is_verb: Array  # bool[H] expresses goals and constraints, otherwise objects and regions
    is_restrictor: Array  # bool[H, 3] the child states the figure's location
    named_types: Array  # i32[H, 4] object types that the words name; NONE beyond them
    objects: Array  # f32[H, 13] log-odds added under each of ``OBJECT_CONDITIONS``
    table: Array  # i32[T] 0-5 related, 6-11 extreme of its type, 12-17 the second, third, ... that
    # the sentence means, 18 at; NONE where unused
    region_relation: Array  # i32[H, L] relation of each slot; NONE where empty
    region_table: Array  # i32[H, L] index of the table for the region; NONE
    child_region_slot: Array  # i32[H, 3, L] slot of the child with the same relation; NONE
    regions: Array  # f32[H, 6, L] added under each of ``REGION_CONDITIONS``
    constraint_relation: Array  # i32[H]
    child_constraint_slot: Array  # i32[H, 3] 0 where the child has the same constraint; NONE
    constraint_region_slot: Array  # i32[H, 3] slot of the child with the same relation; NONE
    constraints: Array  # f32[H, 7] added under each of ``CONSTRAINT_CONDITIONS``
    action: Array  # f32[2] probability
    mode: Array  # f32[3] probability


Fields = dict[str, np.ndarray]
"""Host arrays by name: fields of a clause, or coefficients by condition."""
CLAUSE_FIELDS = ("num_phrases", "table", "action", "mode")
"""Fields of the clause, without an axis over phrases."""


def empty_clause() -> Fields:
    """Build the fields of a clause without phrases."""
    h, k, s = NUM_PHRASES, NUM_CHILDREN, NUM_REGION_SLOTS
    f32, i32 = np.float32, np.int32
    fields = {
        "num_phrases": np.zeros((), i32),
        "num_children": np.full(h, PADDING, i32),
        "is_verb": np.zeros(h, bool),
        "is_restrictor": np.zeros((h, k), bool),
        "named_types": np.full((h, MAX_NAMED_TYPES), NONE, i32),
        "objects": np.zeros((h, len(OBJECT_CONDITIONS)), f32),
        "table": np.full(NUM_TABLES, NONE, i32),
        "region_relation": np.full((h, s), NONE, i32),
        "region_table": np.full((h, s), NONE, i32),
        "child_region_slot": np.full((h, k, s), NONE, i32),
        "regions": np.zeros((h, len(REGION_CONDITIONS), s), f32),
        "constraint_relation": np.full(h, NONE, i32),
        "child_constraint_slot": np.full((h, k), NONE, i32),
        "constraint_region_slot": np.full((h, k), NONE, i32),
        "constraints": np.zeros((h, len(CONSTRAINT_CONDITIONS)), f32),
        "action": np.array([1, 0], f32),
        "mode": np.array([1, 0, 0], f32),
    }
    for name in ("objects", "regions", "constraints"):
        fields[name][:, 0] = LOG_NEVER
    return fields


def _upper_bound(in_child: np.ndarray, terms: Fields) -> np.ndarray:
    """Compute an upper bound on the log-odds of each relation, f32[7], given the children's."""
    lent = terms["region_in_child"] + np.minimum(in_child, 0)  # by a child that expresses it
    own = (term for name, term in terms.items() if name not in ("always", "region_in_child"))
    return terms["always"] + sum(np.maximum(term, 0) for term in (lent, *own))


def _slots_of(fields: Fields, children: tuple[int, ...], relation: int) -> np.ndarray:
    """Find the region slots of the children that have a relation, or NONE, i[k]."""
    is_same = fields["region_relation"][list(children)] == relation
    return np.where(is_same.any(axis=1), is_same.argmax(axis=1), NONE)


def _fill_regions(
    fields: Fields, row: int, children: tuple[int, ...], terms: Fields, bounds: np.ndarray
) -> None:
    """Fill the region slots of a phrase with the relations of the largest bounds."""
    for slot, relation in enumerate(np.argsort(-bounds, kind="stable")[:NUM_REGION_SLOTS]):
        fields["region_relation"][row, slot] = relation
        fields["regions"][row, :, slot] = [term[relation] for term in terms.values()]
        of_children = _slots_of(fields, children, relation)
        fields["child_region_slot"][row, : len(children), slot] = of_children


def _fill_constraint(
    fields: Fields, row: int, children: tuple[int, ...], terms: Fields, bounds: np.ndarray
) -> None:
    """Choose the relation of a verb phrase's constraints and fill in its coefficients."""
    relation = int(np.argmax(bounds))
    fields["constraint_relation"][row] = relation
    fields["constraints"][row] = [term[relation] for term in terms.values()]
    is_same = fields["constraint_relation"][list(children)] == relation
    fields["child_constraint_slot"][row, : len(children)] = np.where(is_same, 0, NONE)
    of_children = _slots_of(fields, children, relation)
    fields["constraint_region_slot"][row, : len(children)] = of_children


def _check_sizes(nodes: tuple[Node, ...]) -> None:
    """Refuse a clause that the arrays do not hold."""
    for parts, size, limit in (
        ("phrases", len(nodes), NUM_PHRASES),
        ("parts of one phrase", max(len(node.children) for node in nodes), NUM_CHILDREN),
        ("nested phrases", max(accumulate(1 - len(node.children) for node in nodes)), MAX_DEPTH),
    ):
        if size > limit:
            raise ValueError(
                f"the command has {size} {parts}; at most {limit} are held: say less at once"
            )


def compile_clause(
    root: Phrase, index: int, model: CorrespondenceModel, rank: Ranks, type_names: tuple[str, ...]
) -> Fields:
    """Contract the words of a clause: the fields of its ``CompiledClause``, host arrays.

    Args:
        root: the clause; its root is a verb phrase.
        index: its position in the sentence.
        model: behavior model.
        rank: of each phrase: 0, 1 nearest, 2 second, ... (annotation model).
        type_names: object types.

    Raises:
        ValueError: the clause has more phrases, or nests deeper, than the arrays hold.
    """
    nodes = post_order(root, index)
    _check_sizes(nodes)
    fields = empty_clause() | {"num_phrases": np.asarray(len(nodes), np.int32)}
    in_slots = np.full((NUM_PHRASES, NUM_REGIONS), -np.inf)  # bounds of the relations in slots
    candidates = []
    for i, node in enumerate(nodes):
        row = NUM_PHRASES - 1 if i == len(nodes) - 1 else i
        children = node.children[::-1]  # the last child is child 0
        z, senses = model.coefficients(node.phrase), senses_of(node.phrase, type_names)
        restricts = [nodes[child].phrase.label in RESTRICTORS for child in children]
        fields["num_children"][row], fields["is_verb"][row] = len(children), node.is_verb
        fields["is_restrictor"][row, : len(children)] = restricts
        below = in_slots[list(children)].max(axis=0, initial=-np.inf)
        gates = GateInputs.of(senses, bool(node.children), any(restricts))
        if node.is_verb:
            terms = sum_by_condition("goal", gates, z["goal"])
            constraints = sum_by_condition("constraint", gates, z["constraint"])
            _fill_constraint(fields, row, children, constraints, _upper_bound(below, constraints))
        else:
            terms = sum_by_condition("region", gates, z["region"])
            objects = sum_by_condition("object", gates, z["object"])
            if senses.is_thing:  # as if there were no previous goal
                objects["always"] += objects["no_previous"]
                objects |= dict.fromkeys(PREVIOUS_GOAL, np.zeros(NUM_REGIONS, np.float32))
            fields["objects"][row] = [term[0] for term in objects.values()]
            named = [*sorted(senses.types), *([ROBOT] if senses.is_robot else [])][:MAX_NAMED_TYPES]
            fields["named_types"][row, : len(named)] = named
        bounds = _upper_bound(below, terms)
        _fill_regions(fields, row, children, terms, bounds)
        related = fields["region_relation"][row]
        in_slots[row, related] = bounds[related]
        if node.phrase.label in RESTRICTORS:
            ranks = np.minimum(find_ranks(node.phrase, node.path, rank, type_names), 2)
            of_table = np.where(related == AT, AT_TABLE, related + NUM_RELATIONS * ranks[related])
            candidates += [(bounds[related[k]], row, k, of_table[k]) for k in range(len(related))]
    candidates.sort(key=lambda slot: -slot[0])
    tables = list(dict.fromkeys(table for *_, table in candidates))[:NUM_TABLES]
    for _, row, slot, table in candidates:
        if table in tables:
            fields["region_table"][row, slot] = tables.index(table)
    fields["table"][: len(tables)] = tables
    z = model.coefficients(root)
    for name, choices in choice_tables(senses_of(root, type_names)).items():
        fields[name] = softmax(choices @ z[name])
    return fields
