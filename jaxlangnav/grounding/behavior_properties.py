"""Properties of behavior symbols: the symbol features of the bilinear score (section 3.3).

A property of a symbol is a condition on its object (in a world, given the children's sets), times
a gate that depends on the words of the phrase, per relation:

    property(symbol) = gate(words)[relation] · condition(object, relation)

Each is declared once, for training and search on the host (``feature_matrices``) and for the
particles: there only conditions are evaluated, and ``sum_by_condition`` sums the coefficients of
all properties that share one. Order and names are those of the columns in weight files.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxlangnav.grounding.model import PropertyColumns, Senses, by_name, stack_columns
from jaxlangnav.grounding.symbols import NUM_REGIONS, NUM_RELATIONS
from jaxlangnav.grounding.worlds import World
from jaxlangnav.messages import ACTIONS, AT, MODES, NEAR, REGIONS, ROBOT

_AT = (np.arange(NUM_REGIONS) == AT).astype(np.float32)[:, None]
_IS_REGION = np.eye(NUM_REGIONS, dtype=np.float32)[:, :, None]
_NEAR = (np.arange(NUM_REGIONS) == NEAR).astype(np.float32)[:, None]
Conditions = Mapping[str, Any]
"""Name of a condition → where it holds, broadcastable to bool[7, n]."""


class GateInputs(NamedTuple):
    """Inputs of the gates: senses and syntactic structure of a phrase."""

    named_regions: np.ndarray  # f32[7, 1] indicator of the regions that the words name
    has_relations: bool
    names_type: bool  # the words name a type, or the robot
    is_bare: bool  # neither children nor a type
    has_children: bool
    is_restricted: bool  # by a child that states its location

    @classmethod
    def of(cls, senses: Senses, has_children: bool, is_restricted: bool) -> "GateInputs":
        """Build from the senses of a phrase's own words."""
        named_regions = np.isin(np.arange(NUM_REGIONS), sorted(senses.relations))
        return cls(
            named_regions=named_regions.astype(np.float32)[:, None],
            has_relations=bool(senses.relations),
            names_type=bool(senses.types) or senses.is_robot,
            is_bare=not has_children and not senses.types,
            has_children=has_children,
            is_restricted=is_restricted,
        )


def _object_columns(gates: GateInputs, conditions: Conditions) -> PropertyColumns:
    return {
        "bias": conditions["always"],
        "named": conditions["named"],
        "unnamed": gates.names_type * conditions["unnamed"],
        "inside": conditions["in_child"],
        "inside and there": gates.is_restricted * conditions["in_child_located"],
        "inside, not there": gates.is_restricted * conditions["in_child_not_located"],
        "not inside": gates.has_children * conditions["not_in_child"],
        "named and there": gates.is_restricted * conditions["named_located"],
        "named, the previous goal": conditions["named_previous"],
        "previous goal": conditions["previous"],
        "like the previous goal": conditions["like_previous"],
        "unlike the previous goal": conditions["unlike_previous"],
        "no previous goal": conditions["no_previous"],
    }


def _region_columns(gates: GateInputs, conditions: Conditions) -> PropertyColumns:
    named, in_child = gates.named_regions, conditions["in_child"]
    return {
        "bias": conditions["always"],
        "relation named": named * conditions["always"],
        "inside": in_child,
        "inside, relation named": named * in_child,
        "inside, other relation named": (1.0 - named) * gates.has_relations * in_child,
        "same": conditions["region_in_child"],
        "neither": gates.has_children * conditions["neither"],
        "inside, at by default": _AT * (not gates.has_relations) * in_child,
        "named, relation named": named * conditions["named"],
        "lone relation to the robot": named * gates.is_bare * conditions["robot"],
        "robot": conditions["robot"],
        **by_name("is", REGIONS, _IS_REGION * conditions["always"]),
        **by_name("inside, is", REGIONS, _IS_REGION * in_child),
    }


def _goal_columns(gates: GateInputs, conditions: Conditions) -> PropertyColumns:
    return {
        "bias": conditions["always"],
        "same": conditions["region_in_child"],
        "inside": conditions["in_child"],
        "neither": conditions["neither"],
        "at, inside": _AT * conditions["in_child"],
        "at, same": _AT * conditions["region_in_child"],
        "inside, relation named": gates.named_regions * conditions["in_child"],
        "same, relation named": gates.named_regions * conditions["region_in_child"],
        "relation to the robot named": gates.named_regions * conditions["robot"],
        **by_name("is", REGIONS, _IS_REGION * conditions["always"]),
        **by_name("same, is", REGIONS, _IS_REGION * conditions["region_in_child"]),
    }


def _constraint_columns(gates: GateInputs, conditions: Conditions) -> PropertyColumns:
    return {
        "bias": conditions["always"],
        "same": conditions["region_in_child"],
        "inside": conditions["in_child"],
        "touched": conditions["mentioned"],
        "near, touched": _NEAR * conditions["mentioned"],
        "at, touched": _AT * conditions["mentioned"],
        "untouched": conditions["unmentioned"],
        "kept": conditions["constraint_in_child"],
        "touched, not kept": conditions["new_mention"],
        "near, inside": _NEAR * conditions["in_child"],
        "at, inside": _AT * conditions["in_child"],
        **by_name("is", REGIONS, _IS_REGION * conditions["always"]),
    }


PREVIOUS_GOAL = ("named_previous", "previous", "like_previous", "unlike_previous", "no_previous")
OBJECT_CONDITIONS = (
    "always", "named", "unnamed", "in_child", "in_child_located", "in_child_not_located",
    "not_in_child", "named_located", *PREVIOUS_GOAL,
)  # fmt: skip
"""named: the words name the object's type; in_child: a child phrase expresses it; located: it is in
the regions of all restricting children; like_previous: another of the previous goal's type."""
REGION_CONDITIONS = ("always", "in_child", "region_in_child", "neither", "named", "robot")
CONSTRAINT_CONDITIONS = ("always", "region_in_child", "in_child", "mentioned", "unmentioned",
                         "constraint_in_child", "new_mention")  # fmt: skip
"""region_in_child, constraint_in_child: a child expresses this region or constraint; neither: not
even the object; mentioned: a child expresses the object or any region of it."""
_FEATURES = {
    "object": (_object_columns, OBJECT_CONDITIONS),
    "region": (_region_columns, REGION_CONDITIONS),
    "goal": (_goal_columns, REGION_CONDITIONS),
    "constraint": (_constraint_columns, CONSTRAINT_CONDITIONS),
}
"""Kind of symbol → its property columns, and the conditions that they use."""


def sum_by_condition(kind: str, gates: GateInputs, terms: np.ndarray) -> dict[str, np.ndarray]:
    """Sum the terms, f32[F] log-odds, of the properties that share a condition.

    For a kind "object", "region", "goal" or "constraint": condition → f32[7] by relation; equal for
    all relations if the kind is "object".
    """
    columns, names = _FEATURES[kind]
    # Evaluate the columns for one-hot conditions.
    one_hot = dict(zip(names, np.eye(len(names), dtype=np.float32)[:, None], strict=True))
    sums = np.zeros((NUM_REGIONS, len(names)), np.float32)
    for term, column in zip(terms, columns(gates, one_hot).values(), strict=True):
        sums += term * np.asarray(column, np.float32)
    return dict(zip(names, sums.T, strict=True))


def choice_columns(senses: frozenset[int], names: Sequence[str]) -> PropertyColumns:
    """Compute features of the actions or modes, given those that the words name, bool[n] each."""
    named, some = np.isin(np.arange(len(names)), sorted(senses)), bool(senses)
    columns = {"bias": True, "named": named, "another named": ~named & some, "none named": not some}
    return columns | by_name("is", names, np.eye(len(names)))


def choice_tables(senses: Senses) -> dict[str, np.ndarray]:
    """Compute the features of actions f32[2, 6] and modes f32[3, 7] from the words alone."""
    return {
        "action": stack_columns((len(ACTIONS),), choice_columns(senses.actions, ACTIONS)),
        "mode": stack_columns((len(MODES),), choice_columns(senses.modes, MODES)),
    }


def feature_names() -> dict[str, tuple[str, ...]]:
    """List the names of the weights' columns: kind of symbol → F names."""
    gates = GateInputs(_AT, *[False] * 5)
    choices = {"action": ACTIONS, "mode": MODES}
    return {
        kind: tuple(columns(gates, dict.fromkeys(conditions, False)))
        for kind, (columns, conditions) in _FEATURES.items()
    } | {kind: tuple(choice_columns(frozenset(), names)) for kind, names in choices.items()}


# ---------------------------------------------------------------- in a world, on the host


class ChildGroundings(NamedTuple):
    """Union of what the child phrases express in one world."""

    objects: np.ndarray  # bool[N]
    regions: np.ndarray  # bool[7, N] regions, and goals of child verb phrases
    constraints: np.ndarray  # bool[7, N]
    is_located: np.ndarray  # bool[N] in a region of every restricting child; all if there is none


def objects_in_regions(world: World, regions: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """Find the objects in any of the regions bool[7, N], bool[N]; each is "at" itself.

    ``rank`` is i[7]: 0 for every object of the region, 1 for the extreme one, 2 for the second.
    """
    is_inside = regions[AT].copy()
    for relation in range(NUM_RELATIONS):
        table = world.is_ranked[rank[relation] - 1] if rank[relation] else world.is_related
        is_inside |= (table[relation] & regions[relation]).any(1)
    return is_inside & world.is_object


def _conditions(world: World, senses: Senses, child: ChildGroundings) -> Conditions:
    """Evaluate all conditions, each broadcastable to bool[7, N]."""
    is_type = np.isin(world.object_type, sorted(senses.types))
    is_robot = world.object_type == ROBOT
    named = (is_type | (is_robot & senses.is_robot)) & world.is_object
    # An untyped goal ("the thing") ignores the previous goal.
    is_previous = world.is_previous & (not senses.is_thing)
    has_previous = bool(is_previous.any())
    is_like = np.isin(world.object_type, world.object_type[is_previous])
    in_child, region_in_child, is_located = child.objects, child.regions, child.is_located
    mentioned = in_child | region_in_child.any(0)
    return {
        "always": True,
        "named": named,
        "unnamed": ~named,
        "robot": is_robot,
        "in_child": in_child,
        "in_child_located": in_child & is_located,
        "in_child_not_located": in_child & ~is_located,
        "not_in_child": ~in_child,
        "named_located": named & is_located,
        "named_previous": named & is_previous,
        "previous": is_previous,
        "like_previous": is_like & ~is_previous,
        "unlike_previous": ~is_like & has_previous,
        "no_previous": not has_previous,
        "region_in_child": region_in_child,
        "neither": ~in_child & ~region_in_child,
        "mentioned": mentioned,
        "unmentioned": ~mentioned,
        "constraint_in_child": child.constraints,
        "new_mention": mentioned & ~child.constraints,
    }


def feature_matrices(
    world: World, is_verb: bool, senses: Senses, gates: GateInputs, child: ChildGroundings
) -> dict[str, np.ndarray]:
    """Build the feature matrices of a phrase's behavior symbols in one world: kind → f32[n, F].

    A verb phrase expresses goals and constraints, any other objects and regions.
    """
    conditions, matrices = _conditions(world, senses, child), {}
    for kind in ("goal", "constraint") if is_verb else ("object", "region"):
        shape = child.objects.shape if kind == "object" else child.regions.shape
        matrices[kind] = stack_columns(shape, _FEATURES[kind][0](gates, conditions))
    return matrices | (choice_tables(senses) if is_verb else {})
