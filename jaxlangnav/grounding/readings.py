"""Convert sets of annotations to the readings that the semantic map uses (sections 3.1, 3.2).

A reading lists mentions and relations between them, ordered so that each relation can be grounded
given the earlier ones: landmarks come before their figures.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeVar

import jax
import numpy as np

from jaxlangnav.grounding.annotation import AnnotationBelief, RankedAnnotations
from jaxlangnav.grounding.search import sum_by_key
from jaxlangnav.grounding.symbols import RELATION
from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.inputs.object_types import is_anything
from jaxlangnav.messages import BETWEEN, NONE, ROBOT, Readings

NUM_READINGS, NUM_MENTIONS, NUM_EDGES = 4, 6, 4


@dataclasses.dataclass(frozen=True, kw_only=True)
class Capacity:
    """Array sizes for the mentions and relations of a dialogue; a change recompiles."""

    num_mentions: int = 10
    num_relations: int = 8

    def __post_init__(self) -> None:
        """Refuse sizes that cannot hold one sentence."""
        check_minimum(NUM_MENTIONS, num_mentions=self.num_mentions)
        check_minimum(NUM_EDGES, num_relations=self.num_relations)


class Relation(NamedTuple):
    """A spatial relation; figure and landmark are indices of objects, types or mentions."""

    figure: int
    relation: int  # index in ``relations.REGISTRY``; it and landmark NONE: figure exists
    landmark: int
    rank: int  # 0 none, 1 nearest or extreme of its type, 2 the second, ...


@dataclasses.dataclass(frozen=True)
class Reading:
    """One interpretation of a sentence: mentions and the relations between them."""

    mentions: tuple[int, ...]  # type index, ANYTHING or ROBOT
    relations: tuple[Relation, ...]


class CapacityError(ValueError):
    """A sentence has more mentions or relations than the arrays hold."""


AnyRelation = TypeVar("AnyRelation", bound=tuple[int, ...])
"""Any relation tuple: item 0 the figure, item 2 the landmark."""


def topological_order(relations: Iterable[AnyRelation]) -> list[AnyRelation]:
    """Sort relations topologically: each after those whose figure is its landmark.

    In a cycle, the earliest relation comes first.
    """
    remaining, ordered = list(relations), []
    while remaining:
        pending_figures = {entry[0] for entry in remaining}
        ready = [entry for entry in remaining if entry[2] not in pending_figures - {entry[0]}]
        ordered.append((ready or remaining)[0])
        remaining.remove(ordered[-1])
    return ordered


def move_untyped_last(relations: Sequence[AnyRelation], types: Sequence[int]) -> list[AnyRelation]:
    """Move relations of untyped figures last: their referents differ from all other mentions'.

    If such a figure ("the thing") is a landmark, the order is unchanged. ``types``: of mentions.
    """
    untyped = {index for index, type_ in enumerate(types) if is_anything(type_)}
    if untyped & {entry[2] for entry in relations}:
        return list(relations)
    return sorted(relations, key=lambda entry: entry[0] in untyped)


Description = frozenset[tuple[int, int, int]]
"""Relations of a mention: relation, type of the landmark, rank."""


class _ReadingBuilder:
    """Incremental builder of a reading: adds mentions and relations clause by clause."""

    def __init__(self) -> None:
        self.mentions: list[int] = []
        self.descriptions: list[Description] = []
        self.relations: list[Relation] = []

    def add_clause(self, annotations: RankedAnnotations) -> None:
        """Add the annotations of one clause."""
        relations = [Relation(*s[1:], rank) for s, rank in annotations if s.kind == RELATION]
        descriptions_by_type: dict[int, set[tuple[int, int, int]]] = {}
        for figure, relation, landmark, rank in relations:
            descriptions_by_type.setdefault(figure, set()).add((relation, landmark, rank))
        current: list[tuple[int, int]] = []  # mentions of this clause, with their rank

        def resolve(type_: int, *excluded: int, rank: int = 0, is_between: bool = False) -> int:
            for k, (i, old_rank) in enumerate(current):
                is_same = self.mentions[i] == type_ and i not in excluded
                if is_same and 0 in (old_rank, rank, old_rank - rank):
                    current[k] = (i, old_rank or rank)
                    return i
            is_distinct = any(self.mentions[i] == type_ for i, _ in current) and not is_between
            description = frozenset(descriptions_by_type.get(type_, ()))
            index = NONE if is_distinct else self._antecedent(type_, description, excluded)
            if index == NONE:
                index = len(self.mentions)
                self.mentions.append(type_)
                self.descriptions.append(description)
            current.append((index, rank))
            return index

        ordered = topological_order(relations)
        for position, edge in enumerate(ordered):
            if edge.relation != BETWEEN:
                landmark = resolve(edge.landmark)
                figure = resolve(edge.figure, landmark, rank=edge.rank)
                self._add([Relation(figure, edge.relation, landmark, edge.rank)])
                continue
            pair = [k for k, e in enumerate(ordered) if e[:2] == (edge.figure, BETWEEN)]
            if position == pair[-1]:  # both landmarks have been added
                self._add_between(edge, [ordered[k].landmark for k in pair], resolve)
        # Objects and regions come last: they say that things without a relation exist.
        for symbol, _ in annotations:
            for type_ in (symbol.landmark, symbol.figure):
                if symbol.kind != RELATION and type_ >= 0:
                    is_new, index = type_ not in self.mentions, resolve(type_)
                    if is_new:
                        self.relations.append(Relation(index, NONE, NONE, 0))

    def _add(self, edges: Sequence[Relation]) -> None:
        self.relations += [edge for edge in edges if edge not in self.relations]

    def _add_between(self, edge: Relation, types: list[int], resolve: Callable[..., int]) -> None:
        """Add a figure between two landmarks, which are two objects even if of one type."""
        first, second = (types * 2)[:2]
        if edge.figure in (first, second):
            # An earlier clause may have told the figure from landmarks of its type.
            landmark_types: dict[int, set[int]] = {}
            for figure_, relation, landmark, _ in self.relations:
                if relation == BETWEEN and self.mentions[figure_] == edge.figure:
                    landmark_types.setdefault(figure_, set()).add(self.mentions[landmark])
            if {first, second} in landmark_types.values():
                return
        landmark_a = resolve(first)
        landmark_b = resolve(second, landmark_a, is_between=first == second)
        figure = resolve(edge.figure, landmark_a, landmark_b)
        self._add([edge._replace(figure=figure, landmark=i) for i in (landmark_a, landmark_b)])

    def _antecedent(self, type_: int, description: Description, excluded: Sequence[int]) -> int:
        """Resolve coreference: find an earlier mention whose description is compatible."""
        for i in reversed(range(len(self.mentions))):
            matches = description <= self.descriptions[i] or self.descriptions[i] <= description
            if self.mentions[i] == type_ and i not in excluded and (type_ == ROBOT or matches):
                self.descriptions[i] = self.descriptions[i] | description
                return i
        return NONE


def build_reading(*clauses: RankedAnnotations) -> Reading:
    """Build a reading from ranked annotations by clause, resolving coreference between mentions.

    Mentions of one type in a clause are one object, unless a relation needs two or their ranks
    differ. In a later clause they corefer again unless their descriptions differ: "go to the cone
    on your left, then to the cone on your right" has two. A region without a figure ("move behind
    the cone") says that its landmark exists.
    """
    builder = _ReadingBuilder()
    for annotations in clauses:
        builder.add_clause(annotations)
    relations = move_untyped_last(builder.relations, builder.mentions)
    robots = {index for index, type_ in enumerate(builder.mentions) if type_ == ROBOT}
    object_edges = [edge for edge in relations if edge.landmark not in robots | {NONE}]
    paired = {mention for edge in object_edges for mention in (edge.figure, edge.landmark)}
    # Relations between objects locate a figure better than those to the robot: they come first.
    relations = sorted(relations, key=lambda e: e.landmark in robots and e.figure in paired)
    return Reading(tuple(builder.mentions), tuple(relations))


def _fits_arrays(reading: Reading) -> bool:
    return len(reading.mentions) <= NUM_MENTIONS and len(reading.relations) <= NUM_EDGES


def to_readings(
    belief: AnnotationBelief, types_of: Callable[[int], tuple[int, ...]] = lambda type_: (type_,)
) -> Readings:
    """Pack the likeliest readings of a sentence, padded to K; their probabilities sum to one.

    ``types_of`` lists candidate object types of each type of the sentence; by default, itself.
    Every assignment of candidates is a separate reading.

    Raises:
        CapacityError: the best reading has more mentions or relations than the arrays hold.
    """
    scored = ((build_reading(*sets), score) for sets, score in belief.clauses)
    ranked = sum_by_key(scored, np.logaddexp)
    if not _fits_arrays(ranked[0][0]):
        raise CapacityError(
            f"the sentence speaks of {len(ranked[0][0].mentions)} things and "
            f"{len(ranked[0][0].relations)} relations; at most {NUM_MENTIONS} and "
            f"{NUM_EDGES} are held: say less at once"
        )
    bound_readings = []
    for reading, score in [item for item in ranked if _fits_arrays(item[0])][:NUM_READINGS]:
        types = tuple(dict.fromkeys(reading.mentions))
        choices = list(itertools.product(*map(types_of, types)))
        for choice in choices:  # equally probable
            type_of = dict(zip(types, choice, strict=True))
            bound = dataclasses.replace(reading, mentions=tuple(map(type_of.get, reading.mentions)))
            bound_readings.append((bound, score - math.log(len(choices))))
    return pad_readings(bound_readings[:NUM_READINGS])


def pad_readings(ranked: Sequence[tuple[Reading, float]]) -> Readings:
    """Write up to K (reading, log-probability), best first, into padded arrays, normalised."""
    mention_type = np.full((NUM_READINGS, NUM_MENTIONS), NONE, np.int32)
    edges = np.full((NUM_READINGS, NUM_EDGES, 4), (NONE, NONE, NONE, 0), np.int32)
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
    ranked = []
    for k in np.flatnonzero(np.isfinite(fields.log_probability)):
        edges = fields.edges(int(k))
        relations = tuple(map(Relation._make, edges[fields.figure[k] != NONE].tolist()))
        types = fields.mention_type[k]
        mentions = tuple(types[types != NONE].tolist())
        ranked.append((Reading(mentions, relations), float(fields.log_probability[k])))
    return ranked
