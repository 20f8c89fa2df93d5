"""Properties of behavior symbols, each declared once: the grounding side of the bilinear score.

A property holds of a symbol where a condition on its object is met (in a world, given the
children's sets), times a gate that the words of the phrase set, apart for each relation:

    property(symbol) = gate(words)[relation] · condition(object, relation)

``behavior_features`` evaluates conditions on the host. On the device the coefficients of all
properties with one condition are added up per phrase (``contraction``), and only conditions are
evaluated in the particles. The order here is that of the columns of the weights (section 3.3).
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from jaxlangnav.grounding.features import Senses
from jaxlangnav.grounding.symbols import NUM_REGIONS
from jaxlangnav.messages import ACTIONS, AT, MODES, NEAR, REGIONS

_AT = (np.arange(NUM_REGIONS) == AT).astype(np.float32)
_NEAR = (np.arange(NUM_REGIONS) == NEAR).astype(np.float32)


class PhraseWords(NamedTuple):
    """What gates read of a phrase."""

    named: np.ndarray  # f32[7] one for the regions that the words name
    has_relations: bool
    is_named: bool  # the words name a type, or the robot
    is_lone: bool  # neither children nor a type
    has_children: bool
    is_restricted: bool  # by a child that says where it is

    @classmethod
    def of(cls, senses: Senses, has_children: bool, is_restricted: bool) -> "PhraseWords":
        """Read a phrase.

        Args:
            senses: of its own words.
            has_children: whether it has child phrases.
            is_restricted: whether some child says where its figure is.

        Returns:
            What the gates need.
        """
        named = np.isin(np.arange(NUM_REGIONS), sorted(senses.relations))
        return cls(
            named=named.astype(np.float32),
            has_relations=bool(senses.relations),
            is_named=bool(senses.types) or senses.is_robot,
            is_lone=not has_children and not senses.types,
            has_children=has_children,
            is_restricted=is_restricted,
        )


Gate = Callable[[PhraseWords], np.ndarray | float]
"""f32[7] by relation, or one number for all."""


@dataclasses.dataclass(frozen=True)
class Property:
    """One property: a column of the weights."""

    name: str
    condition: str  # what must hold of the symbol's object
    gate: Gate = lambda words: 1.0  # what the words must be like


def _each(condition: str, prefix: str) -> tuple[Property, ...]:
    """Give every relation a property of its own."""
    rows = np.eye(NUM_REGIONS, dtype=np.float32)
    return tuple(
        Property(f"{prefix}{name}", condition, lambda words, row=row: row)
        for name, row in zip(REGIONS, rows, strict=True)
    )


OBJECT_PROPERTIES = (
    Property("bias", "always"),
    Property("named", "own"),
    Property("unnamed", "other", lambda words: float(words.is_named)),
    Property("inside", "inside"),
    Property("inside and there", "inside_lies", lambda words: float(words.is_restricted)),
    Property("inside, not there", "inside_elsewhere", lambda words: float(words.is_restricted)),
    Property("not inside", "outside", lambda words: float(words.has_children)),
    Property("named and there", "own_lies", lambda words: float(words.is_restricted)),
    Property("named, the previous goal", "own_previous"),
    Property("previous goal", "previous"),
    Property("like the previous goal", "alike"),
    Property("unlike the previous goal", "unlike"),
    Property("no previous goal", "no_previous"),
)
"""Of the objects of a noun or preposition phrase."""
REGION_PROPERTIES = (
    Property("bias", "base"),
    Property("relation named", "base", lambda words: words.named),
    Property("inside", "inside"),
    Property("inside, relation named", "inside", lambda words: words.named),
    Property(
        "inside, other relation named",
        "inside",
        lambda words: (1.0 - words.named) * words.has_relations,
    ),
    Property("same", "same"),
    Property("neither", "absent", lambda words: float(words.has_children)),
    Property("inside, at by default", "inside", lambda words: _AT * (not words.has_relations)),
    Property("named, relation named", "own", lambda words: words.named),
    Property(
        "lone relation to the robot", "robot", lambda words: words.named * float(words.is_lone)
    ),
    Property("robot", "robot"),
    *_each("base", "is "),
    *_each("inside", "inside, is "),
)
"""Of the regions of a noun or preposition phrase."""
GOAL_PROPERTIES = (
    Property("bias", "base"),
    Property("same", "same"),
    Property("inside", "inside"),
    Property("neither", "absent"),
    Property("at, inside", "inside", lambda words: _AT),
    Property("at, same", "same", lambda words: _AT),
    Property("inside, relation named", "inside", lambda words: words.named),
    Property("same, relation named", "same", lambda words: words.named),
    Property("relation to the robot named", "robot", lambda words: words.named),
    *_each("base", "is "),
    *_each("same", "same, is "),
)
"""Of the goals of a verb phrase."""
CONSTRAINT_PROPERTIES = (
    Property("bias", "base"),
    Property("same", "same"),
    Property("inside", "inside"),
    Property("touched", "touched"),
    Property("near, touched", "touched", lambda words: _NEAR),
    Property("at, touched", "touched", lambda words: _AT),
    Property("untouched", "untouched"),
    Property("kept", "kept"),
    Property("touched, not kept", "new"),
    Property("near, inside", "inside", lambda words: _NEAR),
    Property("at, inside", "inside", lambda words: _AT),
    *_each("base", "is "),
)
"""Of the constraints of a verb phrase."""
_CHOICE = ("bias", "named", "another named", "none named")


def _choices(names: Sequence[str]) -> tuple[str, ...]:
    """Name the properties of a choice by words alone."""
    return (*_CHOICE, *(f"is {name}" for name in names))


PROPERTY_NAMES: dict[str, tuple[str, ...]] = {
    "object": tuple(one.name for one in OBJECT_PROPERTIES),
    "region": tuple(one.name for one in REGION_PROPERTIES),
    "goal": tuple(one.name for one in GOAL_PROPERTIES),
    "constraint": tuple(one.name for one in CONSTRAINT_PROPERTIES),
    "action": _choices(ACTIONS),
    "mode": _choices(MODES),
}
"""Kind of symbol → names of the columns of its weights, which files of weights hold too."""


def evaluate_properties(
    properties: Sequence[Property], words: PhraseWords, conditions: Mapping[str, np.ndarray | bool]
) -> list[np.ndarray]:
    """Evaluate properties on the host.

    Args:
        properties: of a kind of symbol.
        words: of the phrase.
        conditions: by name, bool[N] for objects, or bool[7, N] and what broadcasts to it.

    Returns:
        One column for each, f32 that broadcasts to the symbols.
    """
    columns = []
    for one in properties:
        gate = np.asarray(one.gate(words), np.float32)
        columns.append((gate[:, None] if gate.ndim else gate) * conditions[one.condition])
    return columns


def contract(
    properties: Sequence[Property], words: PhraseWords, coefficients: np.ndarray
) -> dict[str, np.ndarray]:
    """Add up the coefficients f32[F] of the properties that hold under one condition.

    Args:
        properties: of a kind of symbol.
        words: of the phrase.
        coefficients: log-odds per property.

    Returns:
        Condition → f32[7] by relation, or f32[] where no gate tells relations apart.
    """
    terms: dict[str, np.ndarray] = {}
    for one, coefficient in zip(properties, coefficients, strict=True):
        term = coefficient * one.gate(words)
        terms[one.condition] = terms[one.condition] + term if one.condition in terms else term
    return terms
