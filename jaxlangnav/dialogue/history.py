"""All that has been said, as records of the host: the history A^t of section 3.2.

They are read from the arrays that the engine holds, and written into such arrays. One ``Merged``
serves a whole batch that has heard the same: it says where in the old arrays each entry came from.
"""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.dialogue.memory import AVOID_ALL, AVOID_IT, Words, heard_alone
from jaxlangnav.grounding.instruction import Instruction, Spoken
from jaxlangnav.inputs.object_types import label_of
from jaxlangnav.messages import NONE, ROBOT, Readings
from jaxlangnav.pytree import pytree, replace


@pytree
class Merged:
    """What has been said with what is said now; C commands of the new utterance lead."""

    instruction: Instruction  # the new utterance, with the readings of all that has been said
    words: Words  # with the goals of the old commands
    new_goal: jax.Array  # i32[K, C] mention that each new command is about
    new_pinned: jax.Array  # bool[K, C] earlier utterances say which one that is
    from_relation: jax.Array  # i32[K, J] where it was among the old ones, k J + j; NONE: it is new
    from_mention: jax.Array  # i32[K, M] likewise, k M + m


class Edge(NamedTuple):
    """One relation, as ``Relation`` has it, and who said it."""

    figure: int
    relation: int
    landmark: int
    rank: int
    heard: int
    source: int = NONE

    def moved(self, places: Sequence[int]) -> "Edge":
        """Renumber its mentions."""
        figure, landmark = moved((self.figure, self.landmark), places)
        return self._replace(figure=figure, landmark=landmark)


def moved(mentions: Sequence[int], places: Sequence[int]) -> list[int]:
    """Renumber mentions; ``NONE`` stays."""
    return [NONE if one == NONE else places[one] for one in mentions]


@dataclasses.dataclass
class Mention:
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
class History:
    """One reading of all that has been said."""

    mentions: list[Mention]
    edges: list[Edge]
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


def histories_of(readings: Readings, words: Words) -> list[History]:
    """Read readings of one robot, leaves [K, ...], into records, the likeliest first."""
    table, about = jax.device_get((readings, words))
    num_mentions, num_relations = table.mention_type.shape[1], table.relation.shape[1]
    found = []
    things = np.stack([table.mention_type, about.is_asked, about.avoid], axis=-1)
    ties = (table.figure, table.relation, table.landmark, table.rank, about.heard)
    for k in np.argsort(-table.log_probability, kind="stable").tolist():
        if table.log_probability[k] == -np.inf:
            continue
        mentions = [
            Mention(kind, bool(is_asked), avoid, source=k * num_mentions + m)
            for m, (kind, is_asked, avoid) in enumerate(things[k].tolist())
            if kind != NONE
        ]
        edges = [
            Edge(*row, source=k * num_relations + j)
            for j, row in enumerate(np.stack(ties, axis=-1)[k].tolist())
            if row[0] != NONE
        ]
        goals, pinned = about.goal[k].tolist(), about.is_pinned[k].tolist()
        log_probability = float(table.log_probability[k])
        found.append(History(mentions, edges, goals, pinned, [], log_probability))
    return found


def _goals(reading: History, told: Spoken, landmarks: set[int], num_clauses: int) -> list[int]:
    """Find the mention that each command of a sentence is about."""
    goals: list[int] = []
    for index in range(num_clauses):
        kind = told.goals[index] if index < len(told.goals) else None
        alike = [
            m
            for m, one in enumerate(reading.mentions)
            if (one.kind != ROBOT if kind is None else one.label in told.may_be(kind))
        ]
        alike = [m for m in alike if m not in landmarks] or alike
        before = sum(one == kind for one in told.goals[:index])
        goals.append(alike[min(before, len(alike) - 1)] if alike and kind != NONE else NONE)
    return goals


def new_histories(
    instruction: Instruction, spoken: Spoken | None, heard: int, *, is_asked: bool
) -> list[History]:
    """Read a new, grounded utterance into records, the likeliest first.

    ``spoken`` is what it speaks of, None: as its readings show; ``heard`` its number; ``is_asked``
    whether it asks for what it speaks of.
    """
    number, told = int(instruction.num_clauses), spoken or Spoken()
    words = heard_alone(instruction, heard, is_asked=is_asked, xp=np)
    found = histories_of(instruction.readings, words)
    for reading in found:
        reading.edges = [one._replace(source=NONE) for one in reading.edges]
        landmarks = {one.landmark for one in reading.edges}
        reading.new_goals = _goals(reading, told, landmarks, number)
        for index, one in enumerate(reading.mentions):
            one.source = NONE
            for kind, is_all in told.avoided:
                if one.label == kind and index not in landmarks:
                    one.avoid = AVOID_ALL if is_all else AVOID_IT
    return found


def _table(rows: Iterable[Sequence[Any]], number: int, width: int, empty: Sequence[int]) -> Any:
    """Lay out rows of entries as columns i32[number, width], filled up with what is empty."""
    found = np.full((number, width, len(empty)), empty, np.int32)
    for place, row in enumerate(rows):
        found[place, : len(row)] = np.reshape(row, (-1, len(empty)))
    return np.moveaxis(found, 2, 0)


def written(
    ranked: Sequence[History],
    sizes: tuple[int, int, int, int],
    instruction: Instruction,
    heard: int,
) -> Merged:
    """Write histories, the likeliest first, into arrays of K, M, J and C.

    ``instruction`` is what has been said last, ``heard`` its number; probabilities sum to one.
    """
    number, num_mentions, num_edges, num_commands = sizes
    log_all = [one.log_probability for one in ranked]
    log_probability = np.full(number, -np.inf, np.float32)
    log_probability[: len(ranked)] = np.array(log_all) - np.logaddexp.reduce(log_all)

    things = ([dataclasses.astuple(it) for it in one.mentions] for one in ranked)
    kind, is_asked, avoid, from_mention = _table(things, number, num_mentions, (NONE, 0, 0, NONE))
    ties = (one.edges for one in ranked)
    figure, relation, landmark, rank, said, from_relation = _table(
        ties, number, num_edges, Edge(NONE, NONE, NONE, 0, 0)
    )
    old = (
        [
            (goal, was or one.is_told(goal, heard, is_now=True))
            for goal, was in zip(one.goals, one.pinned, strict=True)
        ]
        for one in ranked
    )
    new = (
        [(goal, one.is_told(goal, heard, is_now=False)) for goal in one.new_goals] for one in ranked
    )
    goal, is_pinned = _table(old, number, num_commands, (NONE, 0))
    new_goal, new_pinned = _table(new, number, num_commands, (NONE, 0))
    readings = Readings(
        mention_type=kind,
        figure=figure,
        relation=relation,
        landmark=landmark,
        rank=rank,
        log_probability=jnp.asarray(log_probability),
    )
    words = Words(
        is_asked=is_asked > 0,
        avoid=avoid,
        goal=goal,
        is_pinned=is_pinned > 0,
        heard=said,
        num_heard=jnp.int32(heard + 1),
        num_dropped=jnp.int32(ranked[0].num_dropped),
    )
    joined = Merged(
        instruction=replace(instruction, readings=readings),
        words=words,
        new_goal=new_goal,
        new_pinned=new_pinned > 0,
        from_relation=from_relation,
        from_mention=from_mention,
    )
    return jax.device_put(joined)


def first_words(instruction: Instruction, spoken: Spoken | None) -> Words:
    """Tell what the readings of the first sentence, padded, are about; ``spoken`` as elsewhere."""
    words = heard_alone(instruction, xp=np)
    goal = np.array(words.goal)
    order = np.argsort(-np.asarray(instruction.readings.log_probability), kind="stable")
    for k, one in zip(order, new_histories(instruction, spoken, 0, is_asked=True), strict=False):
        goal[k, : len(one.new_goals)] = one.new_goals
    return jax.device_put(dataclasses.replace(words, goal=goal))
