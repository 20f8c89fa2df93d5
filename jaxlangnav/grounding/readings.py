"""From sets of annotations to the readings that the semantic map takes (sections 3.1, 3.2).

A reading lists what is mentioned and how it is related, in an order in which each relation can be
grounded given the earlier ones: landmarks before the figures placed against them.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeVar

import jax
import numpy as np

from jaxlangnav.grounding.annotation import Belief, RankedAnnotations
from jaxlangnav.grounding.search import add_up
from jaxlangnav.grounding.symbols import OBJECT, REGION
from jaxlangnav.inputs.object_types import is_anything
from jaxlangnav.inputs.sanitize import as_text
from jaxlangnav.messages import BETWEEN, NONE, ROBOT, Readings
from jaxlangnav.pytree import replace

NUM_READINGS, NUM_MENTIONS, NUM_RELATIONS_SAID = 4, 6, 4


@dataclasses.dataclass(frozen=True, kw_only=True)
class Capacity:
    """How much of a conversation is kept; sizes of arrays, a change recompiles."""

    num_mentions: int = 10
    num_relations: int = 8

    def __post_init__(self) -> None:
        """Refuse what does not hold one sentence."""
        for name, least in (("num_mentions", NUM_MENTIONS), ("num_relations", NUM_RELATIONS_SAID)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise ValueError(
                    f"{name} is {as_text(value)}, but must be a whole number and at least {least}: "
                    "what one sentence may say"
                )


class Relation(NamedTuple):
    """Where a figure is; figure and landmark are things, types or mentions by their number."""

    figure: int
    relation: int  # in ``relations.REGISTRY``; NONE, with the landmark, where it only exists
    landmark: int
    rank: int  # 0 plain, 1 the extreme one of its type, 2 the second, ...


@dataclasses.dataclass(frozen=True)
class Reading:
    """One reading: mentions and relations between them."""

    mentions: tuple[int, ...]  # type index, ANYTHING or ROBOT
    relations: tuple[Relation, ...]


class CapacityError(ValueError):
    """A sentence says more than the arrays hold."""


Entry = TypeVar("Entry", bound=tuple[int, ...])
"""A relation, whatever else is known of it: its figure stands first, its landmark third."""


def in_order(relations: Iterable[Entry]) -> list[Entry]:
    """Put a relation after those that place its landmark.

    Where figures and landmarks go round in a circle, the first of them comes first.
    """
    left, ordered = list(relations), []
    while left:
        waiting = {entry[0] for entry in left}
        ready = [entry for entry in left if entry[2] not in waiting - {entry[0]}]
        ordered.append((ready or left)[0])
        left.remove(ordered[-1])
    return ordered


def things_last(relations: Sequence[Entry], kinds: Sequence[int]) -> list[Entry]:
    """Put what is said of things called by no type last: they are none of the others.

    Where such a thing is a landmark, the entries, in order, stay as they are. ``kinds`` are those
    of all mentions.
    """
    things = {index for index, kind in enumerate(kinds) if is_anything(kind)}
    if things & {entry[2] for entry in relations}:
        return list(relations)
    return sorted(relations, key=lambda entry: entry[0] in things)


Description = frozenset[tuple[int, int, int]]
"""What is said of a thing: relation, type of the landmark, rank."""


class _Reader:
    """Collects mentions and relations, clause by clause."""

    def __init__(self) -> None:
        self.mentions: list[int] = []
        self.described: list[Description] = []
        self.relations: list[Relation] = []

    def read(self, said: RankedAnnotations) -> None:
        """Read one clause."""
        related = [
            Relation(*symbol[1:], rank)
            for symbol, rank in said
            if symbol.kind not in (OBJECT, REGION)
        ]
        told: dict[int, set[tuple[int, int, int]]] = {}
        for figure, relation, landmark, rank in related:
            told.setdefault(figure, set()).add((relation, landmark, rank))
        own: list[tuple[int, int]] = []  # mentions of this clause, and how each is ranked

        def mention(kind: int, *others: int, rank: int = 0, is_pair: bool = False) -> int:
            for k, (i, known) in enumerate(own):
                is_alike = self.mentions[i] == kind and i not in others
                if is_alike and 0 in (known, rank, known - rank):
                    own[k] = (i, known or rank)
                    return i
            is_again = any(self.mentions[i] == kind for i, _ in own) and not is_pair
            description = frozenset(told.get(kind, ()))
            index = NONE if is_again else self._find(kind, description, others)
            if index == NONE:
                index = len(self.mentions)
                self.mentions.append(kind)
                self.described.append(description)
            own.append((index, rank))
            return index

        ordered = in_order(related)
        for place, one in enumerate(ordered):
            if one.relation != BETWEEN:
                landmark = mention(one.landmark)
                figure = mention(one.figure, landmark, rank=one.rank)
                self._say([Relation(figure, one.relation, landmark, one.rank)])
                continue
            pair = [k for k, it in enumerate(ordered) if it[:2] == (one.figure, BETWEEN)]
            if place == pair[-1]:  # with the last, both landmarks are placed
                self._lie_between(one, [ordered[k].landmark for k in pair], mention)
        # Objects and regions come last: things exist of which nothing has been said yet.
        for symbol, _ in said:
            for kind in (symbol.landmark, symbol.figure):
                if symbol.kind in (OBJECT, REGION) and kind >= 0:
                    is_new = kind not in self.mentions
                    index = mention(kind)
                    if is_new:
                        self.relations.append(Relation(index, NONE, NONE, 0))

    def _say(self, edges: Sequence[Relation]) -> None:
        self.relations += [edge for edge in edges if edge not in self.relations]

    def _lie_between(self, symbol: Relation, sides: list[int], mention: Callable[..., int]) -> None:
        """Say that a thing lies between two others; of one type alone there are two of it."""
        first, second = (sides * 2)[:2]
        if symbol.figure in (first, second):
            # In an earlier clause it has been settled which of its type is which.
            said: dict[int, set[int]] = {}
            for own, relation, landmark, _ in self.relations:
                if relation == BETWEEN and self.mentions[own] == symbol.figure:
                    said.setdefault(own, set()).add(self.mentions[landmark])
            if {first, second} in said.values():
                return
        one = mention(first)
        other = mention(second, one, is_pair=first == second)
        figure = mention(symbol.figure, one, other)
        self._say([symbol._replace(figure=figure, landmark=side) for side in (one, other)])

    def _find(self, kind: int, description: Description, others: Sequence[int]) -> int:
        """Find a thing of an earlier clause that this may be: what is said of one is no less."""
        for i in reversed(range(len(self.mentions))):
            is_alike = description <= self.described[i] or self.described[i] <= description
            if self.mentions[i] == kind and i not in others and (kind == ROBOT or is_alike):
                self.described[i] = self.described[i] | description
                return i
        return NONE


def read(*clauses: RankedAnnotations) -> Reading:
    """Turn sets of annotations, those of each clause with their ranks, into mentions and relations.

    Things of one type in a clause are one thing, unless a relation needs two or they have different
    ranks. In a later clause they are the same thing again unless something else is said of each:
    "go to the cone on your left, then to the cone on your right" speaks of two. A region without
    a figure ("move behind the cone") says that its landmark exists.
    """
    reader = _Reader()
    for said in clauses:
        reader.read(said)
    relations = things_last(reader.relations, reader.mentions)
    robots = {index for index, kind in enumerate(reader.mentions) if kind == ROBOT}
    apart = [one for one in relations if one.landmark not in robots | {NONE}]
    joined = {end for one in apart for end in (one.figure, one.landmark)}
    # What is seen of a pair shows where the other one is, which a side of the robot hardly does.
    relations = sorted(relations, key=lambda one: one.landmark in robots and one.figure in joined)
    return Reading(tuple(reader.mentions), tuple(relations))


def _fits(reading: Reading) -> bool:
    return len(reading.mentions) <= NUM_MENTIONS and len(reading.relations) <= NUM_RELATIONS_SAID


def to_readings(
    belief: Belief, kinds_of: Callable[[int], tuple[int, ...]] = lambda kind: (kind,)
) -> Readings:
    """Pack the likeliest readings of a sentence, padded to K; their probabilities sum to one.

    ``kinds_of`` lists the kinds that each type of the sentence may be; by default a type is a kind.
    Each way to choose among several is a reading of its own.

    Raises:
        CapacityError: the best reading has more mentions or relations than the arrays hold.
    """
    ranked = add_up(((read(*said), score) for said, score in belief.clauses), np.logaddexp)
    if not _fits(ranked[0][0]):
        raise CapacityError(
            f"the sentence speaks of {len(ranked[0][0].mentions)} things and "
            f"{len(ranked[0][0].relations)} relations; at most {NUM_MENTIONS} and "
            f"{NUM_RELATIONS_SAID} are held: say less at once"
        )
    found = []
    for reading, score in [item for item in ranked if _fits(item[0])][:NUM_READINGS]:
        types = tuple(dict.fromkeys(reading.mentions))
        ways = list(itertools.product(*map(kinds_of, types)))
        for way in ways:  # each with its share of the probability
            kinds = dict(zip(types, way, strict=True))
            one = dataclasses.replace(reading, mentions=tuple(map(kinds.get, reading.mentions)))
            found.append((one, score - math.log(len(ways))))
    return pad_readings(found[:NUM_READINGS])


def widen(readings: Readings, capacity: Capacity) -> Readings:
    """Pad the readings of one sentence with room for what else may be said (host)."""
    wide = {}
    for name in ("mention_type", "figure", "relation", "landmark", "rank"):
        leaf = np.asarray(getattr(readings, name))
        is_mention = name == "mention_type"
        size = capacity.num_mentions if is_mention else capacity.num_relations
        room = ((0, 0), (0, size - leaf.shape[1]))
        wide[name] = np.pad(leaf, room, constant_values=0 if name == "rank" else NONE)
    return replace(readings, **jax.device_put(wide))


def pad_readings(ranked: Sequence[tuple[Reading, float]]) -> Readings:
    """Write up to K (reading, log-probability), best first, into padded arrays, normalised."""
    mention_type = np.full((NUM_READINGS, NUM_MENTIONS), NONE, np.int32)
    edges = np.full((NUM_READINGS, NUM_RELATIONS_SAID, 4), (NONE, NONE, NONE, 0), np.int32)
    log_probability = np.full(NUM_READINGS, -np.inf, np.float32)
    total = np.logaddexp.reduce([score for _, score in ranked])
    for k, (reading, score) in enumerate(ranked):
        mention_type[k, : len(reading.mentions)] = reading.mentions
        log_probability[k] = score - total
        edges[k, : len(reading.relations)] = np.reshape(reading.relations, (-1, 4))
    names = ("mention_type", "figure", "relation", "landmark", "rank", "log_probability")
    leaves = jax.device_put((mention_type, *np.moveaxis(edges, 2, 0), log_probability))
    return Readings(**dict(zip(names, leaves, strict=True)))


def unpad_readings(readings: Readings) -> list[tuple[Reading, float]]:
    """Undo ``pad_readings``: (reading, log-probability) in the order of the arrays."""
    fields = jax.device_get(readings)
    found = []
    for k in np.flatnonzero(np.isfinite(fields.log_probability)):
        edges = fields.edges(int(k))
        relations = tuple(map(Relation._make, edges[fields.figure[k] != NONE].tolist()))
        kinds = fields.mention_type[k]
        mentions = tuple(kinds[kinds != NONE].tolist())
        found.append((Reading(mentions, relations), float(fields.log_probability[k])))
    return found
