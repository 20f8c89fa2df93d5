"""Words contracted with the weights: what is left of them per phrase (eq. 4, section 3.3).

Each function takes the coefficients z of the properties in ``behavior_features``, in their order.
"""

import numpy as np

from jaxlangnav.grounding.features import Senses
from jaxlangnav.grounding.graph import Node
from jaxlangnav.grounding.symbols import NUM_REGIONS
from jaxlangnav.messages import AT, NEAR

NUM_TYPES = 15
"""Object types a program tells apart; the robot comes after them."""


def softmax(log_odds: np.ndarray) -> np.ndarray:
    """Turn log-odds into the distribution given that exactly one is expressed."""
    weight = np.exp(log_odds - log_odds.max())
    return (weight / weight.sum()).astype(np.float32)


def object_fields(z: np.ndarray, senses: Senses, node: Node, is_restricted: bool) -> dict:
    """Contract the object properties (``behavior_features.object_properties``) of a phrase."""
    own = np.zeros(NUM_TYPES + 1, bool)
    own[[t for t in senses.types if t < NUM_TYPES]] = True
    own[NUM_TYPES] = senses.is_robot
    is_named = bool(senses.types) or senses.is_robot
    limited = float(is_restricted)
    return {
        "object_named": z[0] + z[1],
        "object_unnamed": z[0] + z[2] * is_named,
        "own": own,
        "object_inside": z[3],
        "object_lies": z[4] * limited,
        "object_outside": z[5] * limited,
        "object_absent": z[6] * bool(node.children),
        "object_own_lies": z[7] * limited,
        "object_previous": z[8:13],
    }


def _named(senses: Senses) -> np.ndarray:
    """Mark the regions that the words name, f32[7]."""
    return np.isin(np.arange(NUM_REGIONS), sorted(senses.relations)).astype(np.float32)


def region_terms(z: np.ndarray, senses: Senses, node: Node) -> dict[str, np.ndarray]:
    """Contract the region properties of a noun or preposition phrase, f32[7] each."""
    named, at = _named(senses), (np.arange(NUM_REGIONS) == AT).astype(np.float32)
    has_relations = bool(senses.relations)
    is_lone = not node.children and not senses.types
    inside = z[2] + z[3] * named + z[4] * (1 - named) * has_relations
    return {
        "base": z[0] + z[1] * named + z[11:18],
        "inside": inside + z[7] * at * (not has_relations) + z[18:25],
        "same": np.full(NUM_REGIONS, z[5], np.float32),
        "absent": np.full(NUM_REGIONS, z[6] * bool(node.children), np.float32),
        "own": z[8] * named,
        "robot": z[9] * named * is_lone + z[10],
    }


def goal_terms(z: np.ndarray, senses: Senses) -> dict[str, np.ndarray]:
    """Contract the goal properties of a verb phrase, f32[7] each."""
    named, at = _named(senses), (np.arange(NUM_REGIONS) == AT).astype(np.float32)
    return {
        "base": z[0] + z[9:16],
        "inside": z[2] + z[4] * at + z[6] * named,
        "same": z[1] + z[5] * at + z[7] * named + z[16:23],
        "absent": np.full(NUM_REGIONS, z[3], np.float32),
        "own": np.zeros(NUM_REGIONS, np.float32),
        "robot": z[8] * named,
    }


def constraint_terms(z: np.ndarray) -> dict[str, np.ndarray]:
    """Contract the constraint properties of a verb phrase, f32[7] each."""
    at = (np.arange(NUM_REGIONS) == AT).astype(np.float32)
    near = (np.arange(NUM_REGIONS) == NEAR).astype(np.float32)
    ones = np.ones(NUM_REGIONS, np.float32)
    return {
        "base": z[0] + z[11:18],
        "same": z[1] * ones,
        "inside": z[2] + z[9] * near + z[10] * at,
        "touched": z[3] + z[4] * near + z[5] * at,
        "untouched": z[6] * ones,
        "kept": z[7] * ones,
        "new": z[8] * ones,
    }
