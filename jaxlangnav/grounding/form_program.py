"""The behavior program of a form: coefficients without words (section 3.3).

The trained graph contracts the words of each phrase with its weights. A form has no words, so a
phrase is synthesized for each object and relation of a description: "the hydrant", with "behind"
over "the cone" below it, at log-odds of ±``CERTAIN``. The uncertainty of a form is in the
probabilities of its readings.

A particle infers behavior from types and from the relations of its reading, so a form's objects are
first described in these terms.
"""

import dataclasses
import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from jaxlangnav.grounding.behavior_properties import (
    CONSTRAINT_CONDITIONS,
    OBJECT_CONDITIONS,
    REGION_CONDITIONS,
)
from jaxlangnav.grounding.form import Form, FormReading
from jaxlangnav.grounding.program import (
    LOG_NEVER,
    MAX_DEPTH,
    MAX_NAMED_TYPES,
    NUM_CHILDREN,
    NUM_PHRASES,
    NUM_REGION_SLOTS,
    NUM_TABLES,
    empty_program,
)
from jaxlangnav.grounding.readings import CapacityError
from jaxlangnav.grounding.symbols import NUM_RELATIONS
from jaxlangnav.messages import NEAR, NONE, REGIONS
from jaxlangnav.relations.table import SYMBOL_OF

LandmarkRelation = tuple[int, int, "ObjectDescription"]
"""Relation, rank, and description of the landmark."""
ANY, AGAIN, OTHER = (), ("alike",), ("own_previous",)
"""Reference of a goal to the previous one, as conditions that it must not meet: none; the same
object; another one of its type ("the other cone")."""


@dataclasses.dataclass(frozen=True)
class ObjectDescription:
    """Description of an object by type and relations; equal descriptions are not told apart."""

    kind: int  # object type; ROBOT
    places: frozenset[LandmarkRelation] = frozenset()


@dataclasses.dataclass(frozen=True)
class Destination:
    """A region of a described object: the goal of a command, or a constraint."""

    thing: ObjectDescription
    region: int
    before: tuple[str, ...] = ANY


def _description_of(
    reading: FormReading, thing: int, ancestors: tuple[int, ...] = ()
) -> ObjectDescription:
    """Describe an object by its type and relations, and recursively its landmarks."""
    # Cyclic relations are cut: ``ancestors`` are the objects whose description contains this one.
    path = (*ancestors, thing)
    # Behavior inference treats "between" two landmarks as near each of them.
    places = {
        (SYMBOL_OF[r.relation], r.rank, _description_of(reading, r.landmark, path))
        for r in reading.relations
        if r.figure == thing and r.landmark not in path
    }
    return ObjectDescription(reading.type_of(thing), frozenset(places))


def _destination(reading: FormReading, index: int) -> Destination:
    """Describe the goal of one of a reading's commands."""
    command, last = reading.commands[index], reading.commands[index - 1].thing
    before = ANY
    if index > 0 and reading.type_of(last) == reading.type_of(command.thing):
        before = AGAIN if last == command.thing else OTHER
    return Destination(_description_of(reading, command.thing), command.region, before)


def _satisfies(thing: ObjectDescription, reading: FormReading, index: int) -> bool:
    """Check whether an object of a reading satisfies a description."""
    relations = [r for r in reading.relations if r.figure == index]

    def is_stated(relation: int, rank: int, landmark: ObjectDescription) -> bool:
        # The nearest is near, too; particles do not distinguish ranks beyond the first.
        return any(
            SYMBOL_OF[r.relation] == relation
            and (rank == 0 or min(rank, 2) == min(r.rank, 2))
            and _satisfies(landmark, reading, r.landmark)
            for r in relations
        )

    return reading.type_of(index) == thing.kind and all(is_stated(*place) for place in thing.places)


def _probabilities(form: Form, goals: Sequence[Sequence[Destination]]) -> dict[Destination, float]:
    """Compute the conditional probability of each destination of the readings in a particle."""
    # It is 1 if particles of the other readings never contain the described object, as then the
    # particles' weights carry its probability. An object described by its type alone may always
    # exist; relations are only those that the reading states.
    pairs = list(zip(form.readings, goals, strict=True))
    probabilities: dict[Destination, float] = {}
    for end in dict.fromkeys(end for ends in goals for end in ends):
        prob = sum(reading.probability for reading, ends in pairs if end in ends)
        others = [reading for reading, ends in pairs if end not in ends]
        is_certain = not others or (
            bool(end.thing.places)
            and not any(
                _satisfies(end.thing, reading, index)
                for reading in others
                for index in range(len(reading.types))
            )
        )
        probabilities[end] = 1.0 if is_certain else prob
    return probabilities


# ---------------------------------------------------------------- the program of a command


CERTAIN = 16.0
"""Log-odds of what a form states; the complement has probability 1e-7, lost in rounding."""


@dataclasses.dataclass(frozen=True)
class _Phrase:
    """A synthesized phrase of the program, with its child phrases."""

    row: Mapping[str, Any]  # values of the program's fields
    children: tuple["_Phrase", ...] = ()
    table: int = NONE  # relation table of a restrictor: which objects lie in its region

    def walk(self) -> Iterator["_Phrase"]:
        """Yield the phrases below and this one, bottom-up."""
        for child in self.children:
            yield from child.walk()
        yield self


def clause_of_form(form: Form, index: int) -> dict[str, np.ndarray]:
    """Build the fields of the ``BehaviorProgram`` of one command, host arrays.

    Raises:
        CapacityError: the program cannot hold as much; one line.
    """
    probabilities = _probabilities(form, [[_destination(r, index)] for r in form.readings])
    regions = sorted({end.region for end in probabilities})
    if len(regions) > NUM_REGION_SLOTS:
        names = ", ".join(REGIONS[region] for region in regions)
        raise CapacityError(
            f"command {index + 1} may end in {len(regions)} different regions ({names}); at most "
            f"{NUM_REGION_SLOTS} are held: leave the least likely reading out"
        )
    phrases = []
    for end, prob in probabilities.items():
        row = _slot_fields(regions.index(end.region), end.region, CERTAIN + _log_odds(prob))
        phrases.append(_Phrase(row, (_object_phrase(end.thing, CERTAIN, end.before),)))
    avoided = [
        [Destination(_description_of(r, thing), NEAR) for thing in r.commands[index].avoid]
        for r in form.readings
    ]
    constraints = _probabilities(form, avoided)
    phrases += [_object_phrase(end.thing, _log_odds(prob)) for end, prob in constraints.items()]
    is_used = np.arange(NUM_REGION_SLOTS) < len(regions)
    slots = np.where(is_used, np.arange(NUM_REGION_SLOTS), NONE)
    base = np.where(is_used, -CERTAIN, LOG_NEVER)
    forwarding = {  # fields of a phrase that expresses the goal regions of its children
        "region_relation": np.append(regions, [NONE] * (NUM_REGION_SLOTS - len(regions))),
        "regions": _stack(REGION_CONDITIONS, base=base, same=2.0 * CERTAIN * is_used),
        "region_from": np.tile(slots, (NUM_CHILDREN, 1)),
    }
    # Surplus children are moved below intermediate phrases that pass their regions on.
    row = forwarding | {"objects": _stack(OBJECT_CONDITIONS, always=-CERTAIN, inside=2.0 * CERTAIN)}
    while len(phrases) > NUM_CHILDREN:
        phrases = [_Phrase(row, tuple(phrases[:NUM_CHILDREN])), *phrases[NUM_CHILDREN:]]
    # The verb phrase: the children's regions become goals, their objects constraints.
    verb = forwarding | {
        "is_verb": True,
        "constraint_relation": NEAR,
        "constraints": _stack(CONSTRAINT_CONDITIONS, base=-CERTAIN, inside=2.0 * CERTAIN),
    }
    fields = _to_fields(_Phrase(verb, tuple(phrases)), index)
    for reading in form.readings:
        command = reading.commands[index]
        fields["action"][command.action] += reading.probability
        fields["mode"][command.mode] += reading.probability
    return fields


def _log_odds(probability: float) -> float:
    """Convert a probability to log-odds, at most ``CERTAIN``."""
    if probability >= 1.0:
        return CERTAIN
    return min(CERTAIN, math.log(probability / (1.0 - probability)))


def _object_phrase(thing: ObjectDescription, peak: float, before: tuple[str, ...] = ANY) -> _Phrase:
    """Build the phrase of a description ("the hydrant behind the cone") at log-odds ``peak``."""
    relations = sorted(thing.places, key=lambda place: (*place[:2], repr(place[2])))
    places = []
    for relation, rank, landmark in relations:  # restrictors, such as "behind the cone"
        row = _slot_fields(0, relation, 2.0 * CERTAIN)
        table = relation + NUM_RELATIONS * min(rank, 2)
        places.append(_Phrase(row, (_object_phrase(landmark, CERTAIN),), table))
    restrictors, rest = places[:NUM_CHILDREN], places[NUM_CHILDREN:]
    odds = {"own": -CERTAIN, "other": LOG_NEVER, "own_lies": CERTAIN + (CERTAIN if rest else peak)}
    objects = _stack(OBJECT_CONDITIONS, **odds, **dict.fromkeys(before, LOG_NEVER))
    own = np.array([thing.kind] + [NONE] * (MAX_NAMED_TYPES - 1), np.int32)
    phrase = _Phrase({"own": own, "objects": objects}, tuple(restrictors))
    while rest:  # too many restrictors for one phrase: add a parent of the same objects
        extra, rest = rest[: NUM_CHILDREN - 1], rest[NUM_CHILDREN - 1 :]
        inside = CERTAIN + (CERTAIN if rest else peak)
        objects = _stack(OBJECT_CONDITIONS, always=-CERTAIN, inside_lies=inside)
        phrase = _Phrase({"objects": objects}, (phrase, *extra))
    return phrase


def _slot_fields(slot: int, relation: int, inside: float) -> dict[str, np.ndarray]:
    """Build the fields of one region slot; the other slots are empty."""
    is_here = np.arange(NUM_REGION_SLOTS) == slot
    base = np.where(is_here, -CERTAIN, LOG_NEVER)
    return {
        "region_relation": np.where(is_here, relation, NONE),
        "regions": _stack(REGION_CONDITIONS, base=base, inside=inside * is_here),
    }


def _stack(conditions: Sequence[str], **log_odds: Any) -> np.ndarray:
    """Stack log-odds by condition, zero for the conditions not given."""
    return np.stack(np.broadcast_arrays(*(log_odds.get(name, 0.0) for name in conditions)))


def _to_fields(root: _Phrase, index: int) -> dict[str, np.ndarray]:
    """Write the phrases into the rows of a program in post-order, the root last."""
    phrases = list(root.walk())
    tables = list(dict.fromkeys(p.table for p in phrases if p.table != NONE))
    depths = itertools.accumulate(1 - len(phrase.children) for phrase in phrases)
    for what, size, limit in (
        ("phrases over all readings", len(phrases), NUM_PHRASES),
        ("kinds of relations over all readings", len(tables), NUM_TABLES),
        ("phrases that nest", max(depths), MAX_DEPTH),
    ):
        if size > limit:
            raise CapacityError(
                f"command {index + 1} needs {size} {what}; at most {limit} are held: "
                "leave the least likely reading or a relation out"
            )
    fields = empty_program()
    fields["num_phrases"] = np.asarray(len(phrases), np.int32)
    fields["table"][: len(tables)] = tables
    fields["action"][:] = fields["mode"][:] = 0.0
    for count, phrase in enumerate(phrases):
        row = NUM_PHRASES - 1 if phrase is root else count
        fields["num_children"][row] = len(phrase.children)
        # The last child is on top of the stack, so it is child 0.
        labels = [child.table != NONE for child in phrase.children[::-1]]
        fields["is_restrictor"][row, : len(labels)] = labels
        for name, value in phrase.row.items():
            fields[name][row] = value
        if phrase.table != NONE:
            fields["region_table"][row, 0] = tables.index(phrase.table)
    return fields
