"""Things as a form describes them: by type and by where they are said to be (section 3.3).

Behavior is inferred in a particle from types and from the relations of its reading, so what a form
asks for has to be said in the same terms.
"""

import dataclasses

from jaxlangnav.grounding.form import Form, FormReading

Place = tuple[int, int, "ThingDescription"]
"""Relation, rank, and what the landmark is."""
ANY, AGAIN, OTHER = range(3)
"""How a goal bears on that of the command before: not at all; the same thing; another of its type
("the other cone")."""


@dataclasses.dataclass(frozen=True)
class ThingDescription:
    """What is said of a thing; two things of one description are not told apart."""

    kind: int  # object type; ROBOT
    places: frozenset[Place] = frozenset()


@dataclasses.dataclass(frozen=True)
class Destination:
    """Where a command ends."""

    thing: ThingDescription
    region: int
    before: int = ANY


def description_of(
    reading: FormReading, thing: int, behind: tuple[int, ...] = ()
) -> ThingDescription:
    """Describe a thing by its relations, and its landmarks by theirs.

    Args:
        reading: which holds it.
        thing: its index; ``ROBOT``.
        behind: things whose description this one is part of: of two that are said to be beside
            each other, one describes the other and not itself again.

    Returns:
        The description.
    """
    path = (*behind, thing)
    # Behavior knows what lies between two things as near each of them.
    places = {
        (one.relation, max(one.rank, 0), description_of(reading, one.landmark, path))
        for one in reading.relations
        if one.figure == thing and one.landmark not in path
    }
    return ThingDescription(reading.type_of(thing), frozenset(places))


def destination_of(reading: FormReading, index: int) -> Destination:
    """Describe the goal of one of a reading's commands."""
    command = reading.commands[index]
    goal = Destination(description_of(reading, command.thing), command.region)
    if index == 0:
        return goal
    last = reading.commands[index - 1].thing
    if last == command.thing:
        return dataclasses.replace(goal, before=AGAIN)
    is_alike = reading.type_of(last) == goal.thing.kind
    return dataclasses.replace(goal, before=OTHER if is_alike else ANY)


def may_fit(thing: ThingDescription, reading: FormReading) -> bool:
    """Tell whether something may be so described in a particle that believes a reading.

    Of what nothing is said but its type there may always be one more; relations are only those
    that the reading tells.
    """
    return not thing.places or any(
        _fits(thing, reading, index) for index in range(len(reading.types))
    )


def _fits(thing: ThingDescription, reading: FormReading, index: int) -> bool:
    """Tell whether a thing of a reading has a description, and maybe more."""
    told = [one for one in reading.relations if one.figure == index]

    def is_told(relation: int, rank: int, landmark: ThingDescription) -> bool:
        # The nearest is near, too; of later ranks, a particle does not know which.
        return any(
            one.relation == relation
            and (rank == 0 or min(rank, 2) == min(one.rank, 2))
            and _fits(landmark, reading, one.landmark)
            for one in told
        )

    return reading.type_of(index) == thing.kind and all(is_told(*place) for place in thing.places)


def destinations(form: Form, index: int) -> dict[Destination, float]:
    """Find the goals of a command.

    Args:
        form: whose readings may differ in what they ask for.
        index: which command.

    Returns:
        The probability of each goal; 1 of one that shows in no particle whose reading has another
        goal, for then the particles' weights say how probable it is.
    """
    meant = [destination_of(reading, index) for reading in form.readings]
    pairs = list(zip(form.readings, meant, strict=True))
    found: dict[Destination, float] = {}
    for end in dict.fromkeys(meant):
        share = sum(reading.probability for reading, own in pairs if own == end)
        is_sure = not any(own != end and may_fit(end.thing, reading) for reading, own in pairs)
        found[end] = 1.0 if is_sure else share
    return found


def avoidances(form: Form, index: int) -> dict[ThingDescription, float]:
    """Find what is to be kept away from on the way of a command.

    Args:
        form: whose readings may differ in it.
        index: which command.

    Returns:
        Descriptions with probabilities, as ``destinations``.
    """
    named = [
        [description_of(reading, thing) for thing in reading.commands[index].avoid]
        for reading in form.readings
    ]
    found: dict[ThingDescription, float] = {}
    for thing in dict.fromkeys(one for names in named for one in names):
        pairs = list(zip(form.readings, named, strict=True))
        share = sum(reading.probability for reading, names in pairs if thing in names)
        is_sure = not any(thing not in names and may_fit(thing, one) for one, names in pairs)
        found[thing] = 1.0 if is_sure else share
    return found
