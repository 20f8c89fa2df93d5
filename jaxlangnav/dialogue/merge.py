"""Joining what has been said with what is said now (host; section 3.2, the history A^t).

Readings of earlier utterances and of the new one are multiplied: of all pairs the K likeliest stay.
A thing of the new one is a thing spoken of before where language says so. What does not fit the
arrays leaves, the oldest relations first, and is counted. All of it depends on the words alone.
"""

import dataclasses
import itertools

from jaxlangnav.dialogue.history import (
    Edge,
    History,
    Merged,
    histories_of,
    moved,
    new_histories,
    written,
)
from jaxlangnav.dialogue.memory import Words
from jaxlangnav.grounding.instruction import Instruction, Spoken
from jaxlangnav.grounding.readings import topological_order, untyped_last
from jaxlangnav.messages import BETWEEN, NONE, ROBOT, Readings


def _places(old: History, new: History, told: Spoken, *, is_loose: bool) -> list[int]:
    """Find which mention of all that is said each mention of the new utterance is."""
    places: list[int] = []
    size, again = len(old.mentions), _said_again(old, new)
    for index, one in enumerate(new.mentions):
        if index in again:
            places.append(again[index])
            continue
        taken = {*places, *again.values()} if one.kind != ROBOT else set()
        alike = [m for m, it in enumerate(old.mentions) if it.kind == one.kind and m not in taken]
        # What the task speaks of comes to mind first, then what was spoken of last.
        alike.sort(key=lambda m: (old.mentions[m].is_asked, m), reverse=True)
        said = new.description(index)
        if one.kind != ROBOT and one.label in told.others:
            alike = []
        elif one.kind != ROBOT and one.label not in told.known:
            # Two descriptions may be of one thing where one of them says all that the other does.
            before = {m: old.description(m) for m in alike}
            alike = [m for m in alike if said <= before[m] or before[m] <= said]
            alike = [m for m in alike if is_loose or before[m] or not said]
        places.append(alike[0] if alike else size)
        size += not alike
    return places


def _said_again(old: History, new: History) -> dict[int, int]:
    """Find what the new utterance describes, beside others of its kind, as it has been before."""
    # Of "the cone behind the cone", said again, neither cone is the other one.
    kinds, found = [one.kind for one in new.mentions], {}
    for index, one in enumerate(new.mentions):
        said = new.description(index)
        alike = [
            m
            for m, it in enumerate(old.mentions)
            if it.kind == one.kind and m not in found.values() and old.description(m) == said
        ]
        if said and alike and kinds.count(one.kind) > 1:
            found[index] = alike[-1]
    return found


def _product(
    old: History, new: History, told: Spoken, *, is_new_task: bool, is_loose: bool
) -> History:
    places = _places(old, new, told, is_loose=is_loose)
    mentions = [
        dataclasses.replace(one, is_asked=one.is_asked and not is_new_task) for one in old.mentions
    ]
    for place, one in zip(places, new.mentions, strict=True):
        if place == len(mentions):
            mentions.append(dataclasses.replace(one))
        known = mentions[place]
        known.is_asked = known.is_asked or one.is_asked
        known.avoid = max(known.avoid, one.avoid)
    edges = list(old.edges)
    known_edges = {one._replace(heard=0, source=NONE) for one in edges}
    for one in (edge.moved(places) for edge in new.edges):
        # From another place "behind the cone" is another side of it: said again, it is news.
        # What lies between two things does so from anywhere.
        is_news = one.relation not in (NONE, BETWEEN)
        if is_news or one._replace(heard=0) not in known_edges:
            edges.append(one)
    total, goals = old.log_probability + new.log_probability, moved(new.new_goals, places)
    return History(mentions, edges, old.goals, old.pinned, goals, total, old.num_dropped)


def _is_apart(old: History, new: History, told: Spoken) -> bool:
    """Tell whether what is spoken of as known is of one type before, and of another one now."""
    # Of a noun that may be either of two labels each is a reading of its own.
    before, now = ({one.label for one in said.mentions} for said in (old, new))
    return any(
        told.known >= set(way) and bool(before & set(way)) and not before & now & set(way)
        for way in told.ways
    )


def _tidied(reading: History) -> History:
    """Leave out that a thing exists where more is said of it; ask for what the goals hang on."""
    ends = [{one.figure, one.landmark} for one in reading.edges if one.relation != NONE]
    placed = set().union(*ends)
    reading.edges = [
        one for one in reading.edges if one.relation != NONE or one.figure not in placed
    ]
    for pair in ends * len(reading.mentions):
        things = [reading.mentions[m] for m in pair]
        if any(one.is_asked for one in things if one.kind != ROBOT):
            for one in things:
                one.is_asked = True
    return reading


def _is_needed(reading: History, edge: Edge) -> bool:
    """Tell whether a relation is the last that speaks of a goal, or of what is to be avoided."""
    goals = {*reading.goals, *reading.new_goals} - {NONE}
    needed = goals | {m for m, one in enumerate(reading.mentions) if one.avoid}
    held = {end for one in reading.edges if one is not edge for end in (one.figure, one.landmark)}
    return bool({edge.figure, edge.landmark} & needed - held)


def _fitted(reading: History, num_mentions: int, num_relations: int) -> History:
    """Drop the oldest relations, and what nothing speaks of any more, until the arrays hold it."""
    dropped = 0
    while True:
        touched = {end for one in reading.edges for end in (one.figure, one.landmark)}
        kept = [m for m in range(len(reading.mentions)) if m in touched]
        if len(kept) <= num_mentions and len(reading.edges) <= num_relations:
            break
        oldest = min(reading.edges, key=lambda one: (_is_needed(reading, one), one.heard))
        # "Between" says nothing by halves: a relation goes where its other one does.
        is_half = oldest.relation == BETWEEN
        reading.edges = [
            one
            for one in reading.edges
            if one is not oldest
            and not (is_half and one.relation == BETWEEN and one.figure == oldest.figure)
        ]
        dropped += 1
    place = [kept.index(m) if m in touched else NONE for m in range(len(reading.mentions))]
    mentions = [reading.mentions[m] for m in kept]
    edges = topological_order([one.moved(place) for one in reading.edges])
    return dataclasses.replace(
        reading,
        mentions=mentions,
        edges=untyped_last(edges, [one.kind for one in mentions]),
        goals=moved(reading.goals, place),
        new_goals=moved(reading.new_goals, place),
        num_dropped=reading.num_dropped + dropped,
    )


def join(
    readings: Readings,
    words: Words,
    instruction: Instruction,
    spoken: Spoken | None,
    *,
    is_new_task: bool,
    is_loose: bool = True,
    is_asked: bool = True,
) -> Merged:
    """Join what has been said with what is said now.

    Args:
        readings: of all that has been said, leaves [K, ...], of one robot.
        words: what they are about.
        instruction: what is said now.
        spoken: what it speaks of; None: as its readings show.
        is_new_task: it takes the place of the present task, which need not be looked for any more.
        is_loose: what is said of a thing may be said of one of which nothing was said before; a new
            task speaks of a thing of its own then, for the other one may have been ruled out.
        is_asked: it asks for what it speaks of; a statement does not.

    Returns:
        The K likeliest readings of both, in arrays of the size of ``readings``.
    """
    heard = int(words.num_heard)
    old = histories_of(readings, words) or [History([], [], [], [], [], 0.0)]
    new = new_histories(instruction, spoken, heard, is_asked=is_asked)
    new = new or [History([], [], [], [], [NONE] * int(instruction.num_clauses), 0.0)]
    pairs, told = list(itertools.product(old, new)), spoken or Spoken()
    both = [
        _product(one, other, told, is_new_task=is_new_task, is_loose=is_loose)
        for one, other in [pair for pair in pairs if not _is_apart(*pair, told)] or pairs
    ]
    both.sort(key=lambda one: -one.log_probability)
    (k_size, m_size), j_size = readings.mention_type.shape, readings.relation.shape[1]
    ranked = [_fitted(_tidied(one), m_size, j_size) for one in both[:k_size]]
    ranked[0].num_dropped += int(words.num_dropped)
    sizes = k_size, m_size, j_size, words.goal.shape[1]
    return written(ranked, sizes, instruction, heard)
