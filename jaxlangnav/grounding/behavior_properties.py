"""Properties of behavior symbols: the grounding side of the bilinear score (section 3.3).

A property holds of a symbol where a condition on its object is met (in a world, given the
children's sets), times a gate that the words of the phrase set, apart for each relation:

    property(symbol) = gate(words)[relation] · condition(object, relation)

Each is declared once, for training and search on the host (``behavior_tables``) and for the
particles: there only conditions are evaluated, and ``contract`` adds up the coefficients of all
properties with one condition per phrase. The order of declaration is that of the weights' columns.
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
"""Name of a condition → bool[7, n] where it is met, and what broadcasts to it."""


class PhraseWords(NamedTuple):
    """What gates read of a phrase."""

    named: np.ndarray  # f32[7, 1] one for the regions that the words name
    has_relations: bool
    is_named: bool  # the words name a type, or the robot
    is_lone: bool  # neither children nor a type
    has_children: bool
    is_restricted: bool  # by a child that says where it is

    @classmethod
    def of(cls, senses: Senses, has_children: bool, is_restricted: bool) -> "PhraseWords":
        """Read the senses of a phrase's own words."""
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
"""An object is named by the words, or other; a child expresses it (and it lies in all restricting
regions, or elsewhere) or none does; it was the previous goal, is of its type or of another."""
REGION_CONDITIONS = ("base", "inside", "same", "absent", "own", "robot")
CONSTRAINT_CONDITIONS = ("base", "same", "inside", "touched", "untouched", "kept", "new")
"""A child expresses the object, the region or constraint itself, either or none ("touched": the
object or a region of it); the words name the object; it is the robot."""
_DECLARED = {
    "object": (_object_columns, OBJECT_CONDITIONS),
    "region": (_region_columns, REGION_CONDITIONS),
    "goal": (_goal_columns, REGION_CONDITIONS),
    "constraint": (_constraint_columns, CONSTRAINT_CONDITIONS),
}
"""Kind of symbol → its properties, and the conditions that they may be under."""


def contract(kind: str, words: PhraseWords, coefficients: np.ndarray) -> dict[str, np.ndarray]:
    """Add up the coefficients, f32[F] log-odds, of the properties that hold under one condition.

    Of a kind, "object", "region", "goal" or "constraint": condition → f32[7] by relation; of
    objects all seven are the same.
    """
    columns, conditions = _DECLARED[kind]
    # Of as many things each of which meets one condition alone.
    met = dict(zip(conditions, np.eye(len(conditions), dtype=np.float32)[:, None], strict=True))
    terms = np.zeros((NUM_REGIONS, len(conditions)), np.float32)
    for coefficient, column in zip(coefficients, columns(words, met).values(), strict=True):
        terms += coefficient * np.asarray(column, np.float32)
    return dict(zip(conditions, terms.T, strict=True))


def choice_columns(named: frozenset[int], names: Sequence[str]) -> PropertyColumns:
    """Describe the symbols of actions or modes, of which the words name some, bool[n] each."""
    own, is_named = np.isin(np.arange(len(names)), sorted(named)), bool(named)
    given = {"bias": True, "named": own, "another named": ~own & is_named, "none named": not named}
    return given | by_name("is", names, np.eye(len(names)))


def choice_tables(senses: Senses) -> dict[str, np.ndarray]:
    """Describe actions and modes, f32[2, 6] and f32[3, 7]: they depend on the words alone."""
    return {
        "action": stack_columns((len(ACTIONS),), choice_columns(senses.actions, ACTIONS)),
        "mode": stack_columns((len(MODES),), choice_columns(senses.modes, MODES)),
    }


def behavior_names() -> dict[str, tuple[str, ...]]:
    """Name the columns of the weights: kind of symbol → F names."""
    words = PhraseWords(_AT, *[False] * 5)
    choices = {"action": ACTIONS, "mode": MODES}
    return {
        kind: tuple(columns(words, dict.fromkeys(conditions, False)))
        for kind, (columns, conditions) in _DECLARED.items()
    } | {kind: tuple(choice_columns(frozenset(), names)) for kind, names in choices.items()}


# ---------------------------------------------------------------- in a world, on the host


class ChildGroundings(NamedTuple):
    """What the child phrases express in one world."""

    objects: np.ndarray  # bool[N]
    regions: np.ndarray  # bool[7, N] regions, and goals of child verb phrases
    constraints: np.ndarray  # bool[7, N]
    lies: np.ndarray  # bool[N] lies in a region of every restricting child; all if there is none


def lies_in(world: World, regions: np.ndarray, rank: np.ndarray) -> np.ndarray:
    """Find which objects lie in one of the regions bool[7, N], bool[N]; one lies "at" itself.

    ``rank`` is i[7], 0 where every object of the region is meant, 1 the extreme one, 2 the second.
    """
    lies = regions[AT].copy()
    for relation in range(NUM_RELATIONS):
        table = world.is_ranked[rank[relation] - 1] if rank[relation] else world.is_related
        lies |= (table[relation] & regions[relation]).any(1)
    return lies & world.is_object


def _conditions(world: World, senses: Senses, child: ChildGroundings) -> Conditions:
    """Evaluate all conditions, bool[7, N] and what broadcasts to it."""
    is_type = np.isin(world.object_type, sorted(senses.types))
    is_robot = world.object_type == ROBOT
    own = (is_type | (is_robot & senses.is_robot)) & world.is_object
    # What is called by no type may be anything, whatever the goal before was.
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
    """Describe every behavior symbol of a phrase in one world: kind → f32[symbols of the kind, F].

    A verb phrase expresses goals and constraints, any other objects and regions.
    """
    met, tables = _conditions(world, senses, child), {}
    for kind in ("goal", "constraint") if is_verb else ("object", "region"):
        shape = child.objects.shape if kind == "object" else child.regions.shape
        tables[kind] = stack_columns(shape, _DECLARED[kind][0](words, met))
    return tables | (choice_tables(senses) if is_verb else {})
