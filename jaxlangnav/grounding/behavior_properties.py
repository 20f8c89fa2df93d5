"""Properties of behavior symbols: the grounding side of the bilinear score (section 3.3).

A property of a symbol is a condition on its object (in a world, given the children's sets), times
a gate that depends on the words of the phrase, per relation:

    property(symbol) = gate(words)[relation] · condition(object, relation)

Each is declared once, for training and search on the host (``behavior_tables``) and for the
particles: there only conditions are evaluated, and ``contract`` sums the coefficients of all
properties that share a condition. The order of declaration is that of the weights' columns.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxlangnav.grounding.model import PropertyColumns, Senses, by_name, stack_columns
from jaxlangnav.grounding.symbols import NUM_REGIONS, NUM_RELATIONS
from jaxlangnav.grounding.worlds import World
from jaxlangnav.messages import ACTIONS, AT, MODES, NEAR, REGIONS, ROBOT

_AT = (np.arange(NUM_REGIONS) == AT).astype(np.float32)[:, None]
_EACH = np.eye(NUM_REGIONS, dtype=np.float32)[:, :, None]
_NEAR = (np.arange(NUM_REGIONS) == NEAR).astype(np.float32)[:, None]
Conditions = Mapping[str, Any]
"""Name of a condition → where it is met, broadcastable to bool[7, n]."""


class PhraseWords(NamedTuple):
    """Inputs of the gates: senses and shape of a phrase."""

    named: np.ndarray  # f32[7, 1] indicator of the regions that the words name
    has_relations: bool
    is_named: bool  # the words name a type, or the robot
    is_lone: bool  # neither children nor a type
    has_children: bool
    is_restricted: bool  # by a child that states its location

    @classmethod
    def of(cls, senses: Senses, has_children: bool, is_restricted: bool) -> "PhraseWords":
        """Build from the senses of a phrase's own words."""
        named = np.isin(np.arange(NUM_REGIONS), sorted(senses.relations))
        return cls(
            named=named.astype(np.float32)[:, None],
            has_relations=bool(senses.relations),
            is_named=bool(senses.types) or senses.is_robot,
            is_lone=not has_children and not senses.types,
            has_children=has_children,
            is_restricted=is_restricted,
        )


def _object_columns(words: PhraseWords, met: Conditions) -> PropertyColumns:
    return {
        "bias": met["always"],
        "named": met["own"],
        "unnamed": words.is_named * met["other"],
        "inside": met["inside"],
        "inside and there": words.is_restricted * met["inside_lies"],
        "inside, not there": words.is_restricted * met["inside_elsewhere"],
        "not inside": words.has_children * met["outside"],
        "named and there": words.is_restricted * met["own_lies"],
        "named, the previous goal": met["own_previous"],
        "previous goal": met["previous"],
        "like the previous goal": met["alike"],
        "unlike the previous goal": met["unlike"],
        "no previous goal": met["no_previous"],
    }


def _region_columns(words: PhraseWords, met: Conditions) -> PropertyColumns:
    inside = met["inside"]
    return {
        "bias": met["base"],
        "relation named": words.named * met["base"],
        "inside": inside,
        "inside, relation named": words.named * inside,
        "inside, other relation named": (1.0 - words.named) * words.has_relations * inside,
        "same": met["same"],
        "neither": words.has_children * met["absent"],
        "inside, at by default": _AT * (not words.has_relations) * inside,
        "named, relation named": words.named * met["own"],
        "lone relation to the robot": words.named * words.is_lone * met["robot"],
        "robot": met["robot"],
        **by_name("is", REGIONS, _EACH * met["base"]),
        **by_name("inside, is", REGIONS, _EACH * inside),
    }


def _goal_columns(words: PhraseWords, met: Conditions) -> PropertyColumns:
    return {
        "bias": met["base"],
        "same": met["same"],
        "inside": met["inside"],
        "neither": met["absent"],
        "at, inside": _AT * met["inside"],
        "at, same": _AT * met["same"],
        "inside, relation named": words.named * met["inside"],
        "same, relation named": words.named * met["same"],
        "relation to the robot named": words.named * met["robot"],
        **by_name("is", REGIONS, _EACH * met["base"]),
        **by_name("same, is", REGIONS, _EACH * met["same"]),
    }


def _constraint_columns(words: PhraseWords, met: Conditions) -> PropertyColumns:
    return {
        "bias": met["base"],
        "same": met["same"],
        "inside": met["inside"],
        "touched": met["touched"],
        "near, touched": _NEAR * met["touched"],
        "at, touched": _AT * met["touched"],
        "untouched": met["untouched"],
        "kept": met["kept"],
        "touched, not kept": met["new"],
        "near, inside": _NEAR * met["inside"],
        "at, inside": _AT * met["inside"],
        **by_name("is", REGIONS, _EACH * met["base"]),
    }


PREVIOUS = ("own_previous", "previous", "alike", "unlike", "no_previous")
OBJECT_CONDITIONS = (
    "always", "own", "other", "inside", "inside_lies", "inside_elsewhere", "outside", "own_lies",
    *PREVIOUS,
)  # fmt: skip
"""own, other: the words name the object or not; inside, outside: a child expresses it or not; lies,
elsewhere: in all restricting regions or not; alike, unlike: of the previous goal's type or not."""
REGION_CONDITIONS = ("base", "inside", "same", "absent", "own", "robot")
CONSTRAINT_CONDITIONS = ("base", "same", "inside", "touched", "untouched", "kept", "new")
"""inside: a child expresses the object; same: the same region; absent: neither; touched: the object
or a region of it; kept: the same constraint; own: the words name the object; robot: it is."""
_DECLARED = {
    "object": (_object_columns, OBJECT_CONDITIONS),
    "region": (_region_columns, REGION_CONDITIONS),
    "goal": (_goal_columns, REGION_CONDITIONS),
    "constraint": (_constraint_columns, CONSTRAINT_CONDITIONS),
}
"""Kind of symbol → its property columns, and the conditions that they use."""


def contract(kind: str, words: PhraseWords, coefficients: np.ndarray) -> dict[str, np.ndarray]:
    """Sum the coefficients, f32[F] log-odds, of the properties that share a condition.

    For a kind "object", "region", "goal" or "constraint": condition → f32[7] by relation; equal for
    all relations if the kind is "object".
    """
    columns, conditions = _DECLARED[kind]
    # Evaluate the columns for one-hot conditions.
    met = dict(zip(conditions, np.eye(len(conditions), dtype=np.float32)[:, None], strict=True))
    terms = np.zeros((NUM_REGIONS, len(conditions)), np.float32)
    for coefficient, column in zip(coefficients, columns(words, met).values(), strict=True):
        terms += coefficient * np.asarray(column, np.float32)
    return dict(zip(conditions, terms.T, strict=True))


def choice_columns(named: frozenset[int], names: Sequence[str]) -> PropertyColumns:
    """Compute features of the actions or modes, given those named by the words, bool[n] each."""
    own, is_any = np.isin(np.arange(len(names)), sorted(named)), bool(named)
    columns = {"bias": True, "named": own, "another named": ~own & is_any, "none named": not is_any}
    return columns | by_name("is", names, np.eye(len(names)))


def choice_tables(senses: Senses) -> dict[str, np.ndarray]:
    """Compute the features of actions f32[2, 6] and modes f32[3, 7] from the words alone."""
    return {
        "action": stack_columns((len(ACTIONS),), choice_columns(senses.actions, ACTIONS)),
        "mode": stack_columns((len(MODES),), choice_columns(senses.modes, MODES)),
    }


def behavior_names() -> dict[str, tuple[str, ...]]:
    """List the names of the weights' columns: kind of symbol → F names."""
    words = PhraseWords(_AT, *[False] * 5)
    choices = {"action": ACTIONS, "mode": MODES}
    return {
        kind: tuple(columns(words, dict.fromkeys(conditions, False)))
        for kind, (columns, conditions) in _DECLARED.items()
    } | {kind: tuple(choice_columns(frozenset(), names)) for kind, names in choices.items()}


# ---------------------------------------------------------------- in a world, on the host


class ChildGroundings(NamedTuple):
    """Union of what the child phrases express in one world."""

    objects: np.ndarray  # bool[N]
    regions: np.ndarray  # bool[7, N] regions, and goals of child verb phrases
    constraints: np.ndarray  # bool[7, N]
    lies: np.ndarray  # bool[N] lies in a region of every restricting child; all if there is none


def lies_in(world: World, regions: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """Find the objects that lie in one of the regions bool[7, N], bool[N]; each is "at" itself.

    ``rank`` is i[7]: 0 for every object of the region, 1 for the extreme one, 2 for the second.
    """
    lies = regions[AT].copy()
    for relation in range(NUM_RELATIONS):
        table = world.is_ranked[rank[relation] - 1] if rank[relation] else world.is_related
        lies |= (table[relation] & regions[relation]).any(1)
    return lies & world.is_object


def _conditions(world: World, senses: Senses, child: ChildGroundings) -> Conditions:
    """Evaluate all conditions, each broadcastable to bool[7, N]."""
    is_type = np.isin(world.object_type, sorted(senses.types))
    is_robot = world.object_type == ROBOT
    own = (is_type | (is_robot & senses.is_robot)) & world.is_object
    # An untyped goal ("the thing") ignores the previous goal.
    is_previous = world.is_previous & (not senses.is_thing)
    has_previous = bool(is_previous.any())
    alike = np.isin(world.object_type, world.object_type[is_previous])
    inside, same, lies = child.objects, child.regions, child.lies
    touched = inside | same.any(0)
    return {
        "always": True,
        "base": True,
        "own": own,
        "other": ~own,
        "robot": is_robot,
        "inside": inside,
        "inside_lies": inside & lies,
        "inside_elsewhere": inside & ~lies,
        "outside": ~inside,
        "own_lies": own & lies,
        "own_previous": own & is_previous,
        "previous": is_previous,
        "alike": alike & ~is_previous,
        "unlike": ~alike & has_previous,
        "no_previous": not has_previous,
        "same": same,
        "absent": ~inside & ~same,
        "touched": touched,
        "untouched": ~touched,
        "kept": child.constraints,
        "new": touched & ~child.constraints,
    }


def behavior_tables(
    world: World, is_verb: bool, senses: Senses, words: PhraseWords, child: ChildGroundings
) -> dict[str, np.ndarray]:
    """Build the feature matrices of a phrase's behavior symbols in one world: kind → f32[n, F].

    A verb phrase expresses goals and constraints, any other objects and regions.
    """
    met, tables = _conditions(world, senses, child), {}
    for kind in ("goal", "constraint") if is_verb else ("object", "region"):
        shape = child.objects.shape if kind == "object" else child.regions.shape
        tables[kind] = stack_columns(shape, _DECLARED[kind][0](words, met))
    return tables | (choice_tables(senses) if is_verb else {})
