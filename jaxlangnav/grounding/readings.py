"""From sets of annotations to the readings that the semantic map takes (sections 3.1, 3.2).

A reading lists what is mentioned and how it is related, in an order in which each relation can be
grounded given the earlier ones: landmarks before the figures placed against them.
"""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from jaxlangnav.grounding.annotation import Belief, Said
from jaxlangnav.grounding.symbols import OBJECT, REGION, Annotation
from jaxlangnav.messages import NONE, ROBOT, Readings

NUM_READINGS, NUM_MENTIONS, NUM_RELATIONS_SAID = 4, 6, 4


@dataclasses.dataclass(frozen=True)
class Reading:
    """One reading: mentions and relations between them."""

    mentions: tuple[int, ...]  # type index or ROBOT
    relations: tuple[tuple[int, int, int, bool], ...]  # figure, relation, landmark, superlative


class CapacityError(ValueError):
    """A sentence says more than the arrays hold."""


def _ordered(said: Said) -> list[tuple[Annotation, int]]:
    """Put a relation after those that place its landmark; plain objects last."""
    relations = [entry for entry in said if entry[0].kind not in (OBJECT, REGION)]
    others = [entry for entry in said if entry[0].kind in (OBJECT, REGION)]
    ordered: list[tuple[Annotation, int]] = []
    while relations:
        waiting = {symbol.figure for symbol, _ in relations}
        ready = [e for e in relations if e[0].landmark not in waiting - {e[0].figure}]
        ordered.append((ready or relations)[0])
        relations.remove(ordered[-1])
    return ordered + others


def read(said: Said) -> Reading:
    """Turn a set of annotations into mentions and relations.

    Things of one type are one thing, unless a relation needs two. A region without a figure
    ("move behind the cone") says that its landmark exists; so does a relation of rank two or more
    ("the second cone") of its figure: where that stands follows from no single relation.

    Args:
        said: annotations of a sentence with their ranks.

    Returns:
        The reading.
    """
    mentions: list[int] = []
    relations: list[tuple[int, int, int, bool]] = []

    def mention(kind: int, other: int = NONE) -> int:
        for i, known in enumerate(mentions):
            if known == kind and i != other:
                return i
        mentions.append(kind)
        return len(mentions) - 1

    for symbol, rank in _ordered(said):
        if symbol.kind in (OBJECT, REGION) or rank > 1:
            for thing in (symbol.landmark, symbol.figure):
                if thing not in (ROBOT, NONE) and thing not in mentions:
                    relations.append((mention(thing), NONE, NONE, False))
            continue
        landmark = mention(symbol.landmark)
        figure = mention(symbol.figure, landmark)
        relations.append((figure, symbol.relation, landmark, rank == 1))
    return Reading(tuple(mentions), tuple(relations))


def _fits(reading: Reading) -> bool:
    """Whether a reading fits the arrays."""
    return len(reading.mentions) <= NUM_MENTIONS and len(reading.relations) <= NUM_RELATIONS_SAID


def to_readings(belief: Belief) -> Readings:
    """Pack the likeliest readings of a sentence.

    Args:
        belief: distribution over sets of annotations.

    Returns:
        K readings, padded; their probabilities sum to one.

    Raises:
        CapacityError: the best reading has more mentions or relations than the arrays hold.
    """
    totals: dict[Reading, float] = {}
    for said, log_probability in belief.sets:
        reading = read(said)
        totals[reading] = float(np.logaddexp(totals.get(reading, -np.inf), log_probability))
    ranked = sorted(totals.items(), key=lambda item: -item[1])
    if not _fits(ranked[0][0]):
        raise CapacityError(
            f"the sentence speaks of {len(ranked[0][0].mentions)} things and "
            f"{len(ranked[0][0].relations)} relations; at most {NUM_MENTIONS} and "
            f"{NUM_RELATIONS_SAID} are held: say less at once"
        )
    return pack([item for item in ranked if _fits(item[0])][:NUM_READINGS])


def pack(ranked: Sequence[tuple[Reading, float]]) -> Readings:
    """Write readings into padded arrays.

    Args:
        ranked: up to K (reading, log-probability), best first.

    Returns:
        Padded arrays, probabilities normalised.
    """
    mention_type = np.full((NUM_READINGS, NUM_MENTIONS), NONE, np.int32)
    table = np.full((3, NUM_READINGS, NUM_RELATIONS_SAID), NONE, np.int32)
    is_superlative = np.zeros((NUM_READINGS, NUM_RELATIONS_SAID), bool)
    log_probability = np.full(NUM_READINGS, -np.inf, np.float32)
    total = np.logaddexp.reduce([score for _, score in ranked])
    for k, (reading, score) in enumerate(ranked):
        mention_type[k, : len(reading.mentions)] = reading.mentions
        log_probability[k] = score - total
        for j, (figure, relation, landmark, flag) in enumerate(reading.relations):
            table[:, k, j] = figure, relation, landmark
            is_superlative[k, j] = flag
    return Readings(
        mention_type=jnp.asarray(mention_type),
        figure=jnp.asarray(table[0]),
        relation=jnp.asarray(table[1]),
        landmark=jnp.asarray(table[2]),
        is_superlative=jnp.asarray(is_superlative),
        log_probability=jnp.asarray(log_probability),
    )
