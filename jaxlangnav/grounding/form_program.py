"""Compiled clauses of a form: coefficients for behavior inference without words (section 3.3).

The trained graph contracts the words of each phrase with its weights. A form has no words, so a
phrase is synthesized for each object and relation of a description: "the hydrant", with "behind"
over "the cone" below it, at log-odds of ±``CERTAIN``. The uncertainty of a form is in the
probabilities of its readings.

A particle infers behavior from types and from the relations of its reading, so a form's objects are
first described in these terms.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logit

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
    empty_clause,
)
from jaxlangnav.grounding.readings import CapacityError
from jaxlangnav.grounding.symbols import NUM_RELATIONS
from jaxlangnav.messages import NEAR, NONE, REGIONS
from jaxlangnav.relations.table import SYMBOL_OF

LandmarkRelation = tuple[int, int, "Descriptor"]
"""Relation, rank, and description of the landmark."""
ANY, AGAIN, OTHER = (), ("like_previous",), ("named_previous",)
"""Reference of a goal to the previous one, as conditions that it must not meet: none; the same
object; another one of its type ("the other cone")."""


class Descriptor(NamedTuple):
    """Description of an object by type and relations; equal descriptions are not told apart."""

    type: int  # of object; ROBOT
    relations: frozenset[LandmarkRelation] = frozenset()


class Destination(NamedTuple):
    """A region of a described object: the goal of a command, or a constraint."""

    target: Descriptor
    region: int
    previous: tuple[str, ...] = ANY


def _description_of(reading: FormReading, thing: int, parents: tuple[int, ...] = ()) -> Descriptor:
    """Describe an object by its type and relations, and recursively its landmarks."""
    # Cyclic relations are cut: ``parents`` are the objects whose description contains this one.
    path = (*parents, thing)
    # Behavior inference treats "between" two landmarks as near each of them.
    relations = {
        (SYMBOL_OF[r.relation], r.rank, _description_of(reading, r.landmark, path))
        for r in reading.relations
        if r.figure == thing and r.landmark not in path
    }
    return Descriptor(reading.type_of(thing), frozenset(relations))


def _destination(reading: FormReading, index: int) -> Destination:
    """Describe the goal of one of a reading's commands."""
    command, last = reading.commands[index], reading.commands[index - 1].thing
    previous = ANY
    if index > 0 and reading.type_of(last) == reading.type_of(command.thing):
        previous = AGAIN if last == command.thing else OTHER
    return Destination(_description_of(reading, command.thing), command.region, previous)


def _satisfies(target: Descriptor, reading: FormReading, index: int) -> bool:
    """Check whether an object of a reading satisfies a description."""

    def is_stated(relation: int, rank: int, landmark: Descriptor) -> bool:
        # The nearest is near, too; particles do not distinguish ranks beyond the first.
        return any(
            r.figure == index
            and SYMBOL_OF[r.relation] == relation
            and (rank == 0 or min(rank, 2) == min(r.rank, 2))
            and _satisfies(landmark, reading, r.landmark)
            for r in reading.relations
        )

    return reading.type_of(index) == target.type and all(is_stated(*r) for r in target.relations)


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
            bool(end.target.relations)
            and not any(
                _satisfies(end.target, reading, index)
                for reading in others
                for index in range(len(reading.types))
            )
        )
        probabilities[end] = 1.0 if is_certain else prob
    return probabilities


# ---------------------------------------------------------------- the compiled clause of a command

CERTAIN = 16.0
"""Log-odds of what a form states; the complement has probability 1e-7, lost in rounding."""


class _Phrase(NamedTuple):
    """A synthesized phrase of the clause, with its child phrases."""

    fields: Mapping[str, Any]  # values of the clause's fields
    children: tuple["_Phrase", ...] = ()
    table: int = NONE  # relation table of a restrictor: which objects lie in its region

    def walk(self) -> Iterator["_Phrase"]:
        """Yield the phrases below and this one, bottom-up."""
        for child in self.children:
            yield from child.walk()
        yield self


def clause_of_form(form: Form, index: int) -> dict[str, np.ndarray]:
    """Build the fields of the ``CompiledClause`` of one command, host arrays.

    Raises:
        CapacityError: the arrays cannot hold as much; one line.
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
        goal = _slot_fields(regions.index(end.region), end.region, CERTAIN + _log_odds(prob))
        phrases.append(_Phrase(goal, (_object_phrase(end.target, CERTAIN, end.previous),)))
    avoided = [
        [Destination(_description_of(r, thing), NEAR) for thing in r.commands[index].avoid]
        for r in form.readings
    ]
    constraints = _probabilities(form, avoided)
    phrases += [_object_phrase(end.target, _log_odds(prob)) for end, prob in constraints.items()]
    used = np.arange(NUM_REGION_SLOTS) < len(regions)
    slots = np.where(used, np.arange(NUM_REGION_SLOTS), NONE)
    base = np.where(used, -CERTAIN, LOG_NEVER)
    forward = {  # fields of a phrase that expresses the goal regions of its children
        "region_relation": np.append(regions, [NONE] * (NUM_REGION_SLOTS - len(regions))),
        "regions": _stack(REGION_CONDITIONS, always=base, region_in_child=2.0 * CERTAIN * used),
        "child_region_slot": np.tile(slots, (NUM_CHILDREN, 1)),
    }
    # Surplus children are moved below intermediate phrases that pass their regions on.
    node = forward | {"objects": _stack(OBJECT_CONDITIONS, always=-CERTAIN, in_child=2.0 * CERTAIN)}
    while len(phrases) > NUM_CHILDREN:
        phrases = [_Phrase(node, tuple(phrases[:NUM_CHILDREN])), *phrases[NUM_CHILDREN:]]
    # The verb phrase: the children's regions become goals, their objects constraints.
    verb = forward | {
        "is_verb": True,
        "constraint_relation": NEAR,
        "constraints": _stack(CONSTRAINT_CONDITIONS, always=-CERTAIN, in_child=2.0 * CERTAIN),
    }
    fields = _to_fields(_Phrase(verb, tuple(phrases)), index)
    for reading in form.readings:
        command = reading.commands[index]
        fields["action"][command.action] += reading.probability
        fields["mode"][command.mode] += reading.probability
    return fields


def _log_odds(probability: float) -> float:
    """Convert a probability to log-odds, at most ``CERTAIN``."""
    return min(CERTAIN, float(logit(probability)))


def _object_phrase(target: Descriptor, peak: float, previous: tuple[str, ...] = ANY) -> _Phrase:
    """Build the phrase of a description ("the hydrant behind the cone") at log-odds ``peak``."""
    restrictors = []
    for relation, rank, landmark in sorted(target.relations, key=lambda r: (*r[:2], repr(r[2]))):
        fields = _slot_fields(0, relation, 2.0 * CERTAIN)
        table = relation + NUM_RELATIONS * min(rank, 2)
        restrictors.append(_Phrase(fields, (_object_phrase(landmark, CERTAIN),), table))
    children, rest = restrictors[:NUM_CHILDREN], restrictors[NUM_CHILDREN:]
    located = CERTAIN + (CERTAIN if rest else peak)
    odds = {"named": -CERTAIN, "unnamed": LOG_NEVER, "named_located": located}
    objects = _stack(OBJECT_CONDITIONS, **odds, **dict.fromkeys(previous, LOG_NEVER))
    named_types = np.array([target.type] + [NONE] * (MAX_NAMED_TYPES - 1), np.int32)
    phrase = _Phrase({"named_types": named_types, "objects": objects}, tuple(children))
    while rest:  # too many restrictors for one phrase: add a parent of the same objects
        extra, rest = rest[: NUM_CHILDREN - 1], rest[NUM_CHILDREN - 1 :]
        located = CERTAIN + (CERTAIN if rest else peak)
        objects = _stack(OBJECT_CONDITIONS, always=-CERTAIN, in_child_located=located)
        phrase = _Phrase({"objects": objects}, (phrase, *extra))
    return phrase


def _slot_fields(slot: int, relation: int, in_child: float) -> dict[str, np.ndarray]:
    """Build the fields of one region slot; the other slots are empty."""
    is_here = np.arange(NUM_REGION_SLOTS) == slot
    always = np.where(is_here, -CERTAIN, LOG_NEVER)
    return {
        "region_relation": np.where(is_here, relation, NONE),
        "regions": _stack(REGION_CONDITIONS, always=always, in_child=in_child * is_here),
    }


def _stack(conditions: Sequence[str], **log_odds: Any) -> np.ndarray:
    """Stack log-odds by condition, zero for the conditions not given."""
    return np.stack(np.broadcast_arrays(*(log_odds.get(name, 0.0) for name in conditions)))


def _to_fields(root: _Phrase, index: int) -> dict[str, np.ndarray]:
    """Write the phrases into the fields of a clause in post-order, the root last."""
    phrases = list(root.walk())
    tables = list(dict.fromkeys(p.table for p in phrases if p.table != NONE))
    depths = itertools.accumulate(1 - len(phrase.children) for phrase in phrases)
    for parts, size, limit in (
        ("phrases over all readings", len(phrases), NUM_PHRASES),
        ("kinds of relations over all readings", len(tables), NUM_TABLES),
        ("phrases that nest", max(depths), MAX_DEPTH),
    ):
        if size > limit:
            raise CapacityError(
                f"command {index + 1} needs {size} {parts}; at most {limit} are held: "
                "leave the least likely reading or a relation out"
            )
    fields = empty_clause()
    fields["num_phrases"] = np.asarray(len(phrases), np.int32)
    fields["table"][: len(tables)] = tables
    fields["action"][:] = fields["mode"][:] = 0.0
    for count, phrase in enumerate(phrases):
        row = NUM_PHRASES - 1 if phrase is root else count
        fields["num_children"][row] = len(phrase.children)
        # The last child is on top of the stack, so it is child 0.
        restricts = [child.table != NONE for child in phrase.children[::-1]]
        fields["is_restrictor"][row, : len(restricts)] = restricts
        for name, value in phrase.fields.items():
            fields[name][row] = value
        if phrase.table != NONE:
            fields["region_table"][row, 0] = tables.index(phrase.table)
    return fields
