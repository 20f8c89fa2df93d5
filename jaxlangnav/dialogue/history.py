"""Host-side records of the utterance history A^t (section 3.2), read from and written to arrays.

One ``Merged`` serves a whole batch that has heard the same utterances: it says where in the old
arrays each entry came from.
"""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.dialogue.memory import AVOID_ALL, AVOID_IT, DiscourseInfo, default_discourse
from jaxlangnav.grounding.instruction import Instruction, Referents
from jaxlangnav.inputs.object_types import label_of
from jaxlangnav.messages import NONE, ROBOT, Readings
from jaxlangnav.pytree import pytree, replace


@pytree
class Merged:
    """Readings of all utterances, the new one merged in; the new one has up to C commands."""

    instruction: Instruction  # the new utterance, with the readings of all utterances
    words: DiscourseInfo  # with the goals of the old commands
    new_goal: jax.Array  # i32[K, C] goal mention of each new command
    new_pinned: jax.Array  # bool[K, C] earlier utterances specify which object that is
    from_relation: jax.Array  # i32[K, J] old index k J + j of each relation; NONE: it is new
    from_mention: jax.Array  # i32[K, M] old index k M + m of each mention; NONE: it is new


class RelationEdge(NamedTuple):
    """One relation between mentions, as in ``Readings``, and the utterance that stated it."""

    figure: int
    relation: int
    landmark: int
    rank: int
    utterance: int
    source: int = NONE  # its old index

    def renumber(self, indices: Sequence[int]) -> "RelationEdge":
        """Renumber its mentions."""
        figure, landmark = renumber((self.figure, self.landmark), indices)
        return self._replace(figure=figure, landmark=landmark)


def renumber(mentions: Sequence[int], indices: Sequence[int]) -> list[int]:
    """Renumber mentions; ``NONE`` stays."""
    return [NONE if mention == NONE else indices[mention] for mention in mentions]


@dataclasses.dataclass
class Mention:
    """One object that utterances refer to."""

    type_code: int  # object type: label and attribute bits
    is_asked: bool  # the task refers to it
    avoid: int = 0  # AVOID_IT, AVOID_ALL, or 0
    source: int = NONE  # its old index

    @property
    def label(self) -> int:
        """Its object type, without attributes."""
        return int(label_of(self.type_code))


@dataclasses.dataclass
class History:
    """One reading of all utterances so far."""

    mentions: list[Mention]
    edges: list[RelationEdge]
    goals: list[int]  # goal mention of each old command; NONE: unknown
    pinned: list[bool]  # whether other utterances specify which object that is
    new_goals: list[int]  # goal mention of each command of the new utterance
    log_probability: float
    num_dropped: int = 0  # relations dropped for lack of capacity

    def is_described(self, mention: int, utterance: int, *, is_now: bool) -> bool:
        """Tell whether this utterance (``is_now``) or any other one relates a mention."""
        return mention != NONE and any(
            mention in (edge.figure, edge.landmark) and (edge.utterance == utterance) == is_now
            for edge in self.edges
            if edge.relation != NONE
        )

    def description(self, mention: int) -> frozenset[tuple[int, ...]]:
        """Collect a mention's relations; those to the robot hold only for their own utterance."""
        return frozenset(
            (edge.relation, code, edge.rank, edge.utterance if code == ROBOT else NONE)
            for edge in self.edges
            if edge.figure == mention and edge.relation != NONE
            for code in (self.mentions[edge.landmark].type_code,)
        )


def histories_of(readings: Readings, words: DiscourseInfo) -> list[History]:
    """Convert the readings of one robot, leaves [K, ...], to records, the likeliest first."""
    host, info = jax.device_get((readings, words))
    num_mentions, num_relations = host.mention_type.shape[1], host.relation.shape[1]
    histories = []
    mention_rows = np.stack([host.mention_type, info.is_asked, info.avoid], axis=-1)
    columns = (host.figure, host.relation, host.landmark, host.rank, info.heard)
    for k in np.argsort(-host.log_probability, kind="stable").tolist():
        if host.log_probability[k] == -np.inf:
            continue
        mentions = [
            Mention(type_code, bool(is_asked), avoid, source=k * num_mentions + m)
            for m, (type_code, is_asked, avoid) in enumerate(mention_rows[k].tolist())
            if type_code != NONE
        ]
        edges = [
            RelationEdge(*row, source=k * num_relations + j)
            for j, row in enumerate(np.stack(columns, axis=-1)[k].tolist())
            if row[0] != NONE
        ]
        goals, pinned = info.goal[k].tolist(), info.is_pinned[k].tolist()
        log_probability = float(host.log_probability[k])
        histories.append(History(mentions, edges, goals, pinned, [], log_probability))
    return histories


def _goals(history: History, spoken: Referents, landmarks: set[int], num_clauses: int) -> list[int]:
    """Find the goal mention of each command of a sentence."""
    goals: list[int] = []
    for clause in range(num_clauses):
        goal_type = spoken.goals[clause] if clause < len(spoken.goals) else None
        types = None if goal_type is None else spoken.types_of(goal_type)
        candidates = [
            m
            for m, mention in enumerate(history.mentions)
            if (mention.type_code != ROBOT if types is None else mention.label in types)
        ]
        candidates = [m for m in candidates if m not in landmarks] or candidates
        index = min(spoken.goals[:clause].count(goal_type), len(candidates) - 1)
        goals.append(candidates[index] if candidates and goal_type != NONE else NONE)
    return goals


def new_histories(
    instruction: Instruction, spoken: Referents | None, utterance: int, *, is_asked: bool
) -> list[History]:
    """Convert a new, grounded utterance to records, the likeliest reading first.

    ``spoken`` is what it refers to, None: as its readings show; ``utterance`` its number;
    ``is_asked`` whether it requests what it refers to.
    """
    references = spoken or Referents()
    words = default_discourse(instruction, utterance, is_asked=is_asked, xp=np)
    histories = histories_of(instruction.readings, words)
    for history in histories:
        history.edges = [edge._replace(source=NONE) for edge in history.edges]
        landmarks = {edge.landmark for edge in history.edges}
        history.new_goals = _goals(history, references, landmarks, int(instruction.num_clauses))
        for m, mention in enumerate(history.mentions):
            mention.source = NONE
            for label, is_all in references.avoided:
                if mention.label == label and m not in landmarks:
                    mention.avoid = AVOID_ALL if is_all else AVOID_IT
    return histories


def _table(rows: Iterable[Sequence[Any]], height: int, width: int, padding: Sequence[int]) -> Any:
    """Lay out rows of entries as columns i32[height, width], filled up with ``padding``."""
    table = np.full((height, width, len(padding)), padding, np.int32)
    for index, row in enumerate(rows):
        table[index, : len(row)] = np.reshape(row, (-1, len(padding)))
    return np.moveaxis(table, 2, 0)


def to_arrays(
    ranked: Sequence[History], sizes: Sequence[int], instruction: Instruction, utterance: int
) -> Merged:
    """Convert histories, the likeliest first, to arrays of sizes K, M, J and C.

    ``instruction`` is the latest utterance, ``utterance`` its number; probabilities sum to one.
    """
    k_size, m_size, j_size, c_size = sizes
    log_all = [history.log_probability for history in ranked]
    log_probability = np.full(k_size, -np.inf, np.float32)
    log_probability[: len(ranked)] = np.array(log_all) - np.logaddexp.reduce(log_all)

    mentions = ([dataclasses.astuple(m) for m in history.mentions] for history in ranked)
    codes, is_asked, avoid, from_mention = _table(mentions, k_size, m_size, (NONE, 0, 0, NONE))
    edges = (history.edges for history in ranked)
    padding = RelationEdge(NONE, NONE, NONE, 0, 0)
    figure, relation, landmark, rank, heard, from_relation = _table(edges, k_size, j_size, padding)
    old = (
        [
            (goal, was or history.is_described(goal, utterance, is_now=True))
            for goal, was in zip(history.goals, history.pinned, strict=True)
        ]
        for history in ranked
    )
    new = (
        [(goal, history.is_described(goal, utterance, is_now=False)) for goal in history.new_goals]
        for history in ranked
    )
    goal, is_pinned = _table(old, k_size, c_size, (NONE, 0))
    new_goal, new_pinned = _table(new, k_size, c_size, (NONE, 0))
    readings = Readings(
        mention_type=codes,
        figure=figure,
        relation=relation,
        landmark=landmark,
        rank=rank,
        log_probability=jnp.asarray(log_probability),
    )
    words = DiscourseInfo(
        is_asked=is_asked > 0,
        avoid=avoid,
        goal=goal,
        is_pinned=is_pinned > 0,
        heard=heard,
        num_heard=jnp.int32(utterance + 1),
        num_dropped=jnp.int32(ranked[0].num_dropped),
    )
    merged = Merged(
        instruction=replace(instruction, readings=readings),
        words=words,
        new_goal=new_goal,
        new_pinned=new_pinned > 0,
        from_relation=from_relation,
        from_mention=from_mention,
    )
    return jax.device_put(merged)


def discourse_of(instruction: Instruction, spoken: Referents | None) -> DiscourseInfo:
    """Find the goal mentions of the first utterance in its padded readings."""
    words = default_discourse(instruction, xp=np)
    goal = np.array(words.goal)
    order = np.argsort(-np.asarray(instruction.readings.log_probability), kind="stable")
    for k, new in zip(order, new_histories(instruction, spoken, 0, is_asked=True), strict=False):
        goal[k, : len(new.new_goals)] = new.new_goals
    return jax.device_put(dataclasses.replace(words, goal=goal))
