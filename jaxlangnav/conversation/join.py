"""Joining what has been said with what is said now (host; section 3.2, the history A^t).

Readings of earlier utterances and of the new one are multiplied: of all pairs the K likeliest stay.
A thing of the new one is a thing spoken of before where language says so. What does not fit the
arrays leaves, the oldest relations first, and is counted.

How words are joined depends on the words alone, not on the robot. So one ``Joined`` serves a whole
batch that has heard the same, and says where in the old arrays each entry came from.
"""

import dataclasses
import itertools
from collections.abc import Sequence

import jax
import numpy as np

from jaxlangnav.conversation.memory import AVOID_ALL, AVOID_IT, Words
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.program import BehaviorProgram
from jaxlangnav.grounding.readings import in_order, things_last
from jaxlangnav.grounding.spoken import Spoken
from jaxlangnav.kinds import label_of
from jaxlangnav.messages import BETWEEN, NONE, ROBOT, Readings
from jaxlangnav.pytree import pytree


@pytree
class Joined:
    """What has been said with what is said now; C commands of the new utterance lead."""

    readings: Readings
    words: Words  # with the goals of the old commands
    new_goal: jax.Array  # i32[K, C] mention that each new command is about
    new_pinned: jax.Array  # bool[K, C] earlier utterances say which one that is
    from_relation: jax.Array  # i32[K, J] where it was among the old ones, k J + j; NONE: it is new
    from_mention: jax.Array  # i32[K, M] likewise, k M + m
    program: BehaviorProgram  # of the new utterance, leaves [C, ...]
    num_clauses: jax.Array  # i32[] of the new utterance
    metres: jax.Array  # f32[C] as ``Instruction`` has it
    frame: jax.Array  # f32[C, 3] likewise


@dataclasses.dataclass(frozen=True)
class _Edge:
    """One relation, and who said it."""

    figure: int
    relation: int
    landmark: int
    rank: int
    heard: int
    source: int = NONE

    def moved(self, place: Sequence[int]) -> "_Edge":
        """Renumber its mentions."""
        landmark = NONE if self.landmark == NONE else place[self.landmark]
        return dataclasses.replace(self, figure=place[self.figure], landmark=landmark)


@dataclasses.dataclass
class _Mention:
    """One thing spoken of."""

    kind: int
    is_asked: bool
    avoid: int = 0
    source: int = NONE

    @property
    def label(self) -> int:
        """Its type, whatever it looks like."""
        return int(label_of(self.kind))


@dataclasses.dataclass
class _Reading:
    """One reading of all that has been said."""

    mentions: list[_Mention]
    edges: list[_Edge]
    goals: list[int]  # of the old commands
    pinned: list[bool]  # likewise
    new_goals: list[int]
    log_probability: float
    num_dropped: int = 0

    def is_told(self, goal: int, heard: int, *, is_now: bool) -> bool:
        """Tell whether the utterance now, or those before, say where the thing of a goal is."""
        return goal != NONE and any(
            goal in (one.figure, one.landmark) and (one.heard == heard) == is_now
            for one in self.edges
            if one.relation != NONE
        )

    def description(self, mention: int) -> frozenset[tuple[int, ...]]:
        """List what is said of a thing; what is said of the robot is so where it was said."""
        return frozenset(
            (one.relation, kind, one.rank, one.heard if kind == ROBOT else NONE)
            for one in self.edges
            if one.figure == mention and one.relation != NONE
            for kind in (self.mentions[one.landmark].kind,)
        )


@dataclasses.dataclass(frozen=True)
class _About:
    """What readings are about, on the host; as ``Words``."""

    is_asked: np.ndarray
    avoid: np.ndarray
    goal: np.ndarray
    is_pinned: np.ndarray
    heard: np.ndarray

    @classmethod
    def of(cls, words: Words) -> "_About":
        """Fetch it from the device."""
        names = [field.name for field in dataclasses.fields(cls)]
        return cls(*jax.device_get([getattr(words, name) for name in names]))


def _read(readings: Readings, about: _About) -> list[_Reading]:
    """Read arrays into records, the likeliest first."""
    table = jax.device_get(readings)
    num_mentions, num_relations = table.mention_type.shape[1], table.relation.shape[1]
    found = []
    for k in np.argsort(-table.log_probability, kind="stable"):
        if table.log_probability[k] == -np.inf:
            continue
        mentions = [
            _Mention(int(kind), bool(about.is_asked[k, m]), int(about.avoid[k, m]),
                     int(k) * num_mentions + m)
            for m, kind in enumerate(table.mention_type[k]) if kind != NONE
        ]  # fmt: skip
        edges = [
            _Edge(*(int(leaf[k, j]) for leaf in (table.figure, table.relation, table.landmark,
                    table.rank, about.heard)), source=int(k) * num_relations + j)
            for j in range(num_relations) if table.figure[k, j] != NONE
        ]  # fmt: skip
        goals = [int(goal) for goal in about.goal[k]]
        pinned = [bool(one) for one in about.is_pinned[k]]
        log_probability = float(table.log_probability[k])
        found.append(_Reading(mentions, edges, goals, pinned, [], log_probability))
    return found


def _goals(reading: _Reading, spoken: Spoken | None, num_clauses: int) -> list[int]:
    """Find the mention that each command of a sentence is about."""
    kinds = spoken.goals if spoken is not None else ()
    landmarks = {one.landmark for one in reading.edges}
    goals: list[int] = []
    for index in range(num_clauses):
        kind = kinds[index] if index < len(kinds) else None
        if kind is None:
            alike = [m for m, one in enumerate(reading.mentions) if one.kind != ROBOT]
        else:
            alike = [m for m, one in enumerate(reading.mentions) if one.label == kind]
        alike = [m for m in alike if m not in landmarks] or alike
        before = sum(one == kind for one in kinds[:index])
        goals.append(alike[min(before, len(alike) - 1)] if alike and kind != NONE else NONE)
    return goals


def _new_readings(
    instruction: Instruction, spoken: Spoken | None, heard: int, *, is_asked: bool
) -> list[_Reading]:
    """Read the new utterance."""
    readings, number = instruction.readings, int(instruction.num_clauses)
    shape, size = readings.mention_type.shape, instruction.program.num_phrases.shape[-1]
    about = _About(
        is_asked=np.full(shape, is_asked),
        avoid=np.zeros(shape, np.int32),
        goal=np.full((shape[0], size), NONE),
        is_pinned=np.zeros((shape[0], size), bool),
        heard=np.full(readings.relation.shape, heard),
    )
    found = _read(readings, about)
    for reading in found:
        reading.new_goals = _goals(reading, spoken, number)
        reading.edges = [dataclasses.replace(one, source=NONE) for one in reading.edges]
        landmarks = {one.landmark for one in reading.edges}
        for index, one in enumerate(reading.mentions):
            one.source = NONE
            for kind, is_all in spoken.avoided if spoken is not None else ():
                if one.label == kind and index not in landmarks:
                    one.avoid = AVOID_ALL if is_all else AVOID_IT
    return found


def _places(old: _Reading, new: _Reading, spoken: Spoken | None, *, is_loose: bool) -> list[int]:
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
        if one.kind != ROBOT and spoken is not None and one.label in spoken.others:
            alike = []
        elif one.kind != ROBOT and not (spoken is not None and one.label in spoken.known):
            alike = [m for m in alike if _may_be(said, old.description(m), is_loose=is_loose)]
        places.append(alike[0] if alike else size)
        size += not alike
    return places


def _said_again(old: _Reading, new: _Reading) -> dict[int, int]:
    """Find what the new utterance describes, beside others of its kind, as it has been before.

    Of "the cone behind the cone", said again, neither cone is the other one.
    """
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


def _may_be(new: frozenset, old: frozenset, *, is_loose: bool) -> bool:
    """Tell whether two descriptions may be of one thing: what is said of one is no less."""
    return (new <= old or old <= new) and (is_loose or bool(old) or not new)


def _product(
    old: _Reading, new: _Reading, spoken: Spoken | None, *, is_new_task: bool, is_loose: bool
) -> _Reading:
    """Say two readings together."""
    places = _places(old, new, spoken, is_loose=is_loose)
    mentions = [
        dataclasses.replace(one, is_asked=one.is_asked and not is_new_task) for one in old.mentions
    ]
    for place, one in zip(places, new.mentions, strict=True):
        if place == len(mentions):
            mentions.append(dataclasses.replace(one))
            continue
        known = mentions[place]
        known.is_asked = known.is_asked or one.is_asked
        known.avoid = max(known.avoid, one.avoid)
    edges = list(old.edges)
    known_edges = {dataclasses.replace(one, heard=0, source=NONE) for one in edges}
    for one in (edge.moved(places) for edge in new.edges):
        # From another place "behind the cone" is another side of it: said again, it is news.
        # What lies between two things does so from anywhere.
        is_news = one.relation != NONE and one.rank != BETWEEN
        if is_news or dataclasses.replace(one, heard=0) not in known_edges:
            edges.append(one)
    goals = [NONE if goal == NONE else places[goal] for goal in new.new_goals]
    total = old.log_probability + new.log_probability
    return _Reading(mentions, edges, old.goals, old.pinned, goals, total, old.num_dropped)


def _tidied(reading: _Reading) -> _Reading:
    """Leave out that a thing exists where more is said of it; ask for what the goals hang on."""
    ends = [{one.figure, one.landmark} for one in reading.edges if one.relation != NONE]
    placed = set().union(*ends)
    reading.edges = [
        one for one in reading.edges if one.relation != NONE or one.figure not in placed
    ]
    for _ in reading.mentions:
        for pair in ends:
            if any(reading.mentions[m].is_asked for m in pair if reading.mentions[m].kind != ROBOT):
                for m in pair:
                    reading.mentions[m].is_asked = True
    return reading


def _is_needed(reading: _Reading, edge: _Edge) -> bool:
    """Tell whether a relation is the last that speaks of a goal, or of what is to be avoided."""
    goals = {*reading.goals, *reading.new_goals} - {NONE}
    needed = goals | {m for m, one in enumerate(reading.mentions) if one.avoid}
    others = [one for one in reading.edges if one is not edge]
    held = {end for one in others for end in (one.figure, one.landmark)}
    return bool({edge.figure, edge.landmark} & needed - held)


def _goes_with(edge: _Edge, dropped: _Edge) -> bool:
    """Tell whether a relation goes where another one does: "between" says nothing by halves."""
    return edge is dropped or (
        edge.rank == dropped.rank == BETWEEN and edge.figure == dropped.figure
    )


def _fitted(reading: _Reading, num_mentions: int, num_relations: int) -> _Reading:
    """Drop the oldest relations, and what nothing speaks of any more, until the arrays hold it."""
    dropped = 0
    while True:
        touched = {end for one in reading.edges for end in (one.figure, one.landmark)}
        kept = [m for m in range(len(reading.mentions)) if m in touched]
        if len(kept) <= num_mentions and len(reading.edges) <= num_relations:
            break
        oldest = min(reading.edges, key=lambda one: (_is_needed(reading, one), one.heard))
        reading.edges = [one for one in reading.edges if not _goes_with(one, oldest)]
        dropped += 1
    place = [kept.index(m) if m in touched else NONE for m in range(len(reading.mentions))]

    def at(goals: list[int]) -> list[int]:
        return [NONE if goal == NONE else place[goal] for goal in goals]

    def ends(one: _Edge) -> tuple[int, int]:
        return one.figure, one.landmark

    mentions = [reading.mentions[m] for m in kept]
    moved = in_order([one.moved(place) for one in reading.edges], ends)
    return _Reading(
        mentions,
        things_last(moved, ends, [one.kind for one in mentions]),
        at(reading.goals),
        reading.pinned,
        at(reading.new_goals),
        reading.log_probability,
        reading.num_dropped + dropped,
    )


def _write(
    ranked: Sequence[_Reading],
    sizes: tuple[int, int, int, int],
    instruction: Instruction,
    heard: int,
) -> Joined:
    """Write readings into padded arrays of K, M, J and C."""
    k_size, m_size, j_size, c_size = sizes
    mention = {
        name: np.full((k_size, m_size), fill, kind)
        for name, fill, kind in (
            ("kind", NONE, np.int32), ("is_asked", False, bool), ("avoid", 0, np.int32),
            ("source", NONE, np.int32),
        )
    }  # fmt: skip
    edge = {
        name: np.full((k_size, j_size), fill, np.int32)
        for name, fill in (
            ("figure", NONE), ("relation", NONE), ("landmark", NONE), ("rank", 0), ("heard", 0),
            ("source", NONE),
        )
    }  # fmt: skip
    goals = np.full((2, k_size, c_size), NONE, np.int32)
    pinned = np.zeros((2, k_size, c_size), bool)
    log_probability = np.full(k_size, -np.inf, np.float32)
    total = np.logaddexp.reduce([one.log_probability for one in ranked])
    for k, reading in enumerate(ranked):
        log_probability[k] = reading.log_probability - total
        for table, entries in ((mention, reading.mentions), (edge, reading.edges)):
            for place, entry in enumerate(entries):
                for name, leaf in table.items():
                    leaf[k, place] = getattr(entry, name)
        for leaf, own in zip(goals, (reading.goals, reading.new_goals), strict=True):
            leaf[k, : len(own)] = own
        told = [reading.is_told(goal, heard, is_now=True) for goal in reading.goals]
        pinned[0, k, : len(told)] = np.logical_or(told, reading.pinned)
        told = [reading.is_told(goal, heard, is_now=False) for goal in reading.new_goals]
        pinned[1, k, : len(told)] = told
    readings = {
        "mention_type": mention["kind"],
        **{name: edge[name] for name in ("figure", "relation", "landmark", "rank")},
        "log_probability": log_probability,
    }
    words = {
        "is_asked": mention["is_asked"],
        "avoid": mention["avoid"],
        "goal": goals[0],
        "is_pinned": pinned[0],
        "heard": edge["heard"],
        "num_heard": np.int32(heard + 1),
        "num_dropped": np.int32(ranked[0].num_dropped),
    }
    sources = {
        "new_goal": goals[1],
        "new_pinned": pinned[1],
        "from_relation": edge["source"],
        "from_mention": mention["source"],
    }
    return Joined(
        readings=Readings(**jax.device_put(readings)),
        words=Words(**jax.device_put(words)),
        program=instruction.program,
        num_clauses=instruction.num_clauses,
        metres=instruction.metres,
        frame=instruction.frame,
        **jax.device_put(sources),
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
) -> Joined:
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
    old = _read(readings, _About.of(words)) or [_Reading([], [], [], [], [], 0.0)]
    new = _new_readings(instruction, spoken, heard, is_asked=is_asked)
    new = new or [_Reading([], [], [], [], [NONE] * int(instruction.num_clauses), 0.0)]
    both = [
        _product(one, other, spoken, is_new_task=is_new_task, is_loose=is_loose)
        for one, other in itertools.product(old, new)
    ]
    both.sort(key=lambda one: -one.log_probability)
    (k_size, m_size), j_size = readings.mention_type.shape, readings.relation.shape[1]
    ranked = [_fitted(_tidied(one), m_size, j_size) for one in both[:k_size]]
    ranked[0].num_dropped += int(words.num_dropped)
    sizes = k_size, m_size, j_size, words.goal.shape[1]
    return _write(ranked, sizes, instruction, heard)


def first_words(instruction: Instruction, spoken: Spoken | None) -> Words:
    """Tell what the first sentence is about.

    Args:
        instruction: grounded, padded to the arrays of the conversation.
        spoken: what it speaks of; None: as its readings show.

    Returns:
        What its readings are about.
    """
    readings = instruction.readings
    k_size, m_size = readings.mention_type.shape
    size = instruction.program.num_phrases.shape[-1]
    goal = np.full((k_size, size), NONE, np.int32)
    order = np.argsort(-np.asarray(readings.log_probability), kind="stable")
    for k, one in zip(order, _new_readings(instruction, spoken, 0, is_asked=True), strict=False):
        goal[k, : len(one.new_goals)] = one.new_goals
    fields = {
        "is_asked": np.ones((k_size, m_size), bool),
        "avoid": np.zeros((k_size, m_size), np.int32),
        "goal": goal,
        "is_pinned": np.zeros(goal.shape, bool),
        "heard": np.zeros(readings.relation.shape, np.int32),
        "num_heard": np.int32(1),
        "num_dropped": np.int32(0),
    }
    return Words(**jax.device_put(fields))
