"""The behavior program of a form: coefficients without words (section 3.3).

The trained graph contracts the words of each phrase with its weights. A form has no words and says
itself what each phrase expresses, so its phrases are made up from what is described: "the hydrant"
with "behind" over "the cone" below it, at log-odds of ±``CERTAIN``. The doubt of a form is in its
probabilities.

A particle infers behavior from types and from the relations of its reading, so a form's things are
described in these terms first.
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
from jaxlangnav.relations.table import SYMBOL

Place = tuple[int, int, "ThingDescription"]
"""Relation, rank, and what the landmark is."""
ANY, AGAIN, OTHER = (), ("alike",), ("own_previous",)
"""How a goal bears on that of the command before, by the conditions that it must not meet: not at
all; the same thing; another of its type ("the other cone")."""


@dataclasses.dataclass(frozen=True)
class ThingDescription:
    """What is said of a thing; two things of one description are not told apart."""

    kind: int  # object type; ROBOT
    places: frozenset[Place] = frozenset()


@dataclasses.dataclass(frozen=True)
class Destination:
    """A region of a thing, where a command ends or which it avoids."""

    thing: ThingDescription
    region: int
    before: tuple[str, ...] = ANY


def _description_of(
    reading: FormReading, thing: int, behind: tuple[int, ...] = ()
) -> ThingDescription:
    """Describe a thing by its relations, and its landmarks by theirs."""
    # Of two that are said to be beside each other, one describes the other and not itself again:
    # ``behind`` are the things whose description this one is part of.
    path = (*behind, thing)
    # Behavior knows what lies between two things as near each of them.
    places = {
        (SYMBOL[one.relation], one.rank, _description_of(reading, one.landmark, path))
        for one in reading.relations
        if one.figure == thing and one.landmark not in path
    }
    return ThingDescription(reading.type_of(thing), frozenset(places))


def _destination_of(reading: FormReading, index: int) -> Destination:
    """Describe the goal of one of a reading's commands."""
    command, last = reading.commands[index], reading.commands[index - 1].thing
    before = ANY
    if index > 0 and reading.type_of(last) == reading.type_of(command.thing):
        before = AGAIN if last == command.thing else OTHER
    return Destination(_description_of(reading, command.thing), command.region, before)


def _fits(thing: ThingDescription, reading: FormReading, index: int) -> bool:
    """Tell whether a thing of a reading has a description, and maybe more."""
    told = [one for one in reading.relations if one.figure == index]

    def is_told(relation: int, rank: int, landmark: ThingDescription) -> bool:
        # The nearest is near, too; of later ranks, a particle does not know which.
        return any(
            SYMBOL[one.relation] == relation
            and (rank == 0 or min(rank, 2) == min(one.rank, 2))
            and _fits(landmark, reading, one.landmark)
            for one in told
        )

    return reading.type_of(index) == thing.kind and all(is_told(*place) for place in thing.places)


def _shares(form: Form, meant: Sequence[Sequence[Destination]]) -> dict[Destination, float]:
    """Find how probable each of what the readings mean is."""
    # That is 1 of one that shows in no particle whose reading does not mean it, for then the
    # particles' weights say how probable it is. Of what nothing is said but its type there may
    # always be one more; relations are only those that the reading tells.
    pairs = list(zip(form.readings, meant, strict=True))
    found: dict[Destination, float] = {}
    for one in dict.fromkeys(own for named in meant for own in named):
        share = sum(reading.probability for reading, named in pairs if one in named)
        others = [reading for reading, named in pairs if one not in named]
        is_sure = not others or (
            bool(one.thing.places)
            and not any(
                _fits(one.thing, reading, index)
                for reading in others
                for index in range(len(reading.types))
            )
        )
        found[one] = 1.0 if is_sure else share
    return found


# ---------------------------------------------------------------- the program of a command


CERTAIN = 16.0
"""Log-odds of what a form says; the probability of the contrary is 1e-7, lost in rounding."""


@dataclasses.dataclass(frozen=True)
class _Phrase:
    """A phrase of the program, above those it is made of."""

    row: Mapping[str, Any]  # values of the program's fields
    children: tuple["_Phrase", ...] = ()
    table: int = NONE  # of a phrase that says where a figure is: what lies in its region

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
    wanted = _shares(form, [[_destination_of(reading, index)] for reading in form.readings])
    regions = sorted({end.region for end in wanted})
    if len(regions) > NUM_REGION_SLOTS:
        names = ", ".join(REGIONS[region] for region in regions)
        raise CapacityError(
            f"command {index + 1} may end in {len(regions)} different regions ({names}); at most "
            f"{NUM_REGION_SLOTS} are held: leave the least likely reading out"
        )
    phrases = []
    for end, share in wanted.items():
        inside = CERTAIN + _log_odds(share)
        row = _in_slot(regions.index(end.region), end.region, inside)
        phrases.append(_Phrase(row, (_thing(end.thing, CERTAIN, end.before),)))
    avoided = [
        [Destination(_description_of(one, thing), NEAR) for thing in one.commands[index].avoid]
        for one in form.readings
    ]
    shares = _shares(form, avoided)
    phrases += [_thing(one.thing, _log_odds(share)) for one, share in shares.items()]
    is_used = np.arange(NUM_REGION_SLOTS) < len(regions)
    slots = np.where(is_used, np.arange(NUM_REGION_SLOTS), NONE)
    base = np.where(is_used, -CERTAIN, LOG_NEVER)
    passing_on = {  # of a phrase that expresses the goal regions of its children
        "region_relation": np.append(regions, [NONE] * (NUM_REGION_SLOTS - len(regions))),
        "regions": _under(REGION_CONDITIONS, base=base, same=2.0 * CERTAIN * is_used),
        "region_from": np.tile(slots, (NUM_CHILDREN, 1)),
    }
    # More phrases than one may have as children go below phrases that pass all of them on.
    row = passing_on | {"objects": _under(OBJECT_CONDITIONS, always=-CERTAIN, inside=2.0 * CERTAIN)}
    while len(phrases) > NUM_CHILDREN:
        phrases = [_Phrase(row, tuple(phrases[:NUM_CHILDREN])), *phrases[NUM_CHILDREN:]]
    # The verb phrase: the children's regions are goals, their objects are to be avoided.
    verb = passing_on | {
        "is_verb": True,
        "constraint_relation": NEAR,
        "constraints": _under(CONSTRAINT_CONDITIONS, base=-CERTAIN, inside=2.0 * CERTAIN),
    }
    fields = _lay_out(_Phrase(verb, tuple(phrases)), index)
    for reading in form.readings:
        command = reading.commands[index]
        fields["action"][command.action] += reading.probability
        fields["mode"][command.mode] += reading.probability
    return fields


def _log_odds(probability: float) -> float:
    """Turn a probability into log-odds that are no surer than ``CERTAIN``."""
    if probability >= 1.0:
        return CERTAIN
    return min(CERTAIN, math.log(probability / (1.0 - probability)))


def _thing(thing: ThingDescription, peak: float, before: tuple[str, ...] = ANY) -> _Phrase:
    """Express the objects of a description, "the hydrant behind the cone", at log-odds ``peak``."""
    ordered = sorted(thing.places, key=lambda place: (*place[:2], repr(place[2])))
    places = []
    for relation, rank, landmark in ordered:  # "behind the cone": to say where a figure is
        row = _in_slot(0, relation, 2.0 * CERTAIN)
        table = relation + NUM_RELATIONS * min(rank, 2)
        places.append(_Phrase(row, (_thing(landmark, CERTAIN),), table))
    first, rest = places[:NUM_CHILDREN], places[NUM_CHILDREN:]
    given = {"own": -CERTAIN, "other": LOG_NEVER, "own_lies": CERTAIN + (CERTAIN if rest else peak)}
    objects = _under(OBJECT_CONDITIONS, **given, **dict.fromkeys(before, LOG_NEVER))
    own = np.array([thing.kind] + [NONE] * (MAX_NAMED_TYPES - 1), np.int32)
    phrase = _Phrase({"own": own, "objects": objects}, tuple(first))
    while rest:  # more places than a phrase has children: a phrase of the same objects above it
        some, rest = rest[: NUM_CHILDREN - 1], rest[NUM_CHILDREN - 1 :]
        there = CERTAIN + (CERTAIN if rest else peak)
        objects = _under(OBJECT_CONDITIONS, always=-CERTAIN, inside_lies=there)
        phrase = _Phrase({"objects": objects}, (phrase, *some))
    return phrase


def _in_slot(slot: int, relation: int, inside: float) -> dict[str, np.ndarray]:
    """Build the fields of one region slot; the others stay empty."""
    is_here = np.arange(NUM_REGION_SLOTS) == slot
    base = np.where(is_here, -CERTAIN, LOG_NEVER)
    return {
        "region_relation": np.where(is_here, relation, NONE),
        "regions": _under(REGION_CONDITIONS, base=base, inside=inside * is_here),
    }


def _under(conditions: Sequence[str], **log_odds: Any) -> np.ndarray:
    """Put log-odds into the columns of their conditions; there are none under the others."""
    return np.stack(np.broadcast_arrays(*(log_odds.get(one, 0.0) for one in conditions)))


def _lay_out(root: _Phrase, index: int) -> dict[str, np.ndarray]:
    """Write the phrases into the rows of a program, bottom-up, the root last."""
    phrases = list(root.walk())
    tables = list(dict.fromkeys(one.table for one in phrases if one.table != NONE))
    depths = itertools.accumulate(1 - len(phrase.children) for phrase in phrases)
    for what, size, most in (
        ("phrases over all readings", len(phrases), NUM_PHRASES),
        ("kinds of relations over all readings", len(tables), NUM_TABLES),
        ("phrases that nest", max(depths), MAX_DEPTH),
    ):
        if size > most:
            raise CapacityError(
                f"command {index + 1} needs {size} {what}; at most {most} are held: "
                "leave the least likely reading or a relation out"
            )
    fields = empty_program()
    fields["num_phrases"] = np.asarray(len(phrases), np.int32)
    fields["table"][: len(tables)] = tables
    fields["action"][:] = fields["mode"][:] = 0.0
    for count, phrase in enumerate(phrases):
        row = NUM_PHRASES - 1 if phrase is root else count
        fields["num_children"][row] = len(phrase.children)
        # The last child lies on top of the stack, and counts first.
        labels = [child.table != NONE for child in phrase.children[::-1]]
        fields["is_restrictor"][row, : len(labels)] = labels
        for name, value in phrase.row.items():
            fields[name][row] = value
        if phrase.table != NONE:
            fields["region_table"][row, 0] = tables.index(phrase.table)
    return fields
