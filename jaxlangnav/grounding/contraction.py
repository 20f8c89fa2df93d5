"""Words contracted with the weights: what is left of them per phrase (eq. 4, section 3.3).

What a property's words come to stands with the property (``behavior_properties``); here it gets
the shape of a ``BehaviorProgram``.
"""

import numpy as np

from jaxlangnav.grounding.behavior_properties import (
    CONSTRAINT_PROPERTIES,
    GOAL_PROPERTIES,
    OBJECT_PROPERTIES,
    REGION_PROPERTIES,
    PhraseWords,
    contract,
)
from jaxlangnav.grounding.features import Senses
from jaxlangnav.grounding.symbols import NUM_REGIONS, Node
from jaxlangnav.messages import NONE, ROBOT

NUM_OWN = 4
"""Kinds that the words of one phrase may name."""


def softmax(log_odds: np.ndarray) -> np.ndarray:
    """Turn log-odds into the distribution given that exactly one is expressed."""
    weight = np.exp(log_odds - log_odds.max())
    return (weight / weight.sum()).astype(np.float32)


def object_fields(
    coefficients: np.ndarray, senses: Senses, node: Node, is_restricted: bool
) -> dict[str, np.ndarray]:
    """Contract the properties of the objects of a phrase (``OBJECT_PROPERTIES``).

    Args:
        coefficients: f32[13], log-odds per property.
        senses: of the phrase's own words.
        node: the phrase.
        is_restricted: whether some child says where its figure is.

    Returns:
        Fields of a ``BehaviorProgram``.
    """
    named = [*sorted(senses.types), *([ROBOT] if senses.is_robot else [])][:NUM_OWN]
    own = np.array(named + [NONE] * (NUM_OWN - len(named)), np.int32)
    words = PhraseWords.of(senses, bool(node.children), is_restricted)
    terms = contract(OBJECT_PROPERTIES, words, coefficients)
    previous = ("own_previous", "previous", "alike", "unlike", "no_previous")
    if senses.is_thing:  # whatever the goal before was, to it there is none
        terms["always"] = terms["always"] + terms["no_previous"]
        terms |= dict.fromkeys(previous, np.zeros((), np.float32))
    return {
        "object_named": terms["always"] + terms["own"],
        "object_unnamed": terms["always"] + terms["other"],
        "own": own,
        "object_inside": terms["inside"],
        "object_lies": terms["inside_lies"],
        "object_outside": terms["inside_elsewhere"],
        "object_absent": terms["outside"],
        "object_own_lies": terms["own_lies"],
        "object_previous": np.stack([terms[condition] for condition in previous]),
    }


_REGION_TERMS = ("base", "inside", "same", "absent", "own", "robot")
"""Conditions of regions and goals that a program has a field for."""


def _by_relation(terms: dict[str, np.ndarray], names: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Spread terms over the relations, f32[7] each; zero where no property has the condition."""
    return {name: np.full(NUM_REGIONS, terms.get(name, 0.0), np.float32) for name in names}


def region_terms(coefficients: np.ndarray, senses: Senses, node: Node) -> dict[str, np.ndarray]:
    """Contract the region properties of a noun or preposition phrase, f32[7] each."""
    words = PhraseWords.of(senses, bool(node.children), False)
    return _by_relation(contract(REGION_PROPERTIES, words, coefficients), _REGION_TERMS)


def goal_terms(coefficients: np.ndarray, senses: Senses, node: Node) -> dict[str, np.ndarray]:
    """Contract the goal properties of a verb phrase, f32[7] each."""
    words = PhraseWords.of(senses, bool(node.children), False)
    return _by_relation(contract(GOAL_PROPERTIES, words, coefficients), _REGION_TERMS)


def constraint_terms(coefficients: np.ndarray, senses: Senses, node: Node) -> dict[str, np.ndarray]:
    """Contract the constraint properties of a verb phrase, f32[7] each."""
    words = PhraseWords.of(senses, bool(node.children), False)
    terms = contract(CONSTRAINT_PROPERTIES, words, coefficients)
    return _by_relation(terms, tuple(terms))
