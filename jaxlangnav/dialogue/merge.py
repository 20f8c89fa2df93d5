"""Merge a new utterance into the utterance history A^t (host; section 3.2).

Readings of the history and of the new utterance are multiplied: the K likeliest pairs are kept.
Coreference rules identify new mentions with old ones. What exceeds the arrays' capacity is dropped,
the oldest relations first, and counted. All of it depends on the utterances alone.
"""

import itertools

from jaxlangnav.dialogue.history import (
    History,
    Merged,
    RelationEdge,
    histories_of,
    new_histories,
    renumber,
    to_arrays,
)
from jaxlangnav.dialogue.memory import DiscourseInfo
from jaxlangnav.grounding.instruction import Instruction, Referents
from jaxlangnav.grounding.readings import move_untyped_last, topological_order
from jaxlangnav.messages import BETWEEN, NONE, ROBOT, Readings
from jaxlangnav.pytree import replace


def _resolve(old: History, new: History, spoken: Referents, *, is_loose: bool) -> list[int]:
    """Resolve coreference: the merged index of each mention of the new utterance."""
    indices: list[int] = []
    size, repeated = len(old.mentions), _repeated_mentions(old, new)
    for index, mention in enumerate(new.mentions):
        if index in repeated:
            indices.append(repeated[index])
            continue
        code, is_robot = mention.type_code, mention.type_code == ROBOT
        taken = set() if is_robot else {*indices, *repeated.values()}
        same = [m for m, o in enumerate(old.mentions) if o.type_code == code and m not in taken]
        # Salience: mentions that the task requests come first, then the most recent.
        same.sort(key=lambda m: (old.mentions[m].is_asked, m), reverse=True)
        description = new.description(index)
        if not is_robot and mention.label in spoken.others:
            same = []
        elif not is_robot and mention.label not in spoken.known:
            # Two descriptions may refer to one object where one of them includes the other.
            before = {m: old.description(m) for m in same}
            same = [m for m in same if description <= before[m] or before[m] <= description]
            same = [m for m in same if is_loose or before[m] or not description]
        indices.append(same[0] if same else size)
        size += not same
    return indices


def _repeated_mentions(old: History, new: History) -> dict[int, int]:
    """Match new mentions of a type that occurs twice to old ones of the same description."""
    # Of "the cone behind the cone", repeated, neither cone is the other one.
    codes, matches = [mention.type_code for mention in new.mentions], {}
    for index, code in enumerate(codes):
        text = new.description(index)
        same = [
            m
            for m, o in enumerate(old.mentions)
            if o.type_code == code and m not in matches.values() and old.description(m) == text
        ]
        if text and same and codes.count(code) > 1:
            matches[index] = same[-1]
    return matches


def _product(
    old: History, new: History, spoken: Referents, *, is_new_task: bool, is_loose: bool
) -> History:
    indices = _resolve(old, new, spoken, is_loose=is_loose)
    mentions = [replace(m, is_asked=m.is_asked and not is_new_task) for m in old.mentions]
    for index, mention in zip(indices, new.mentions, strict=True):
        if index == len(mentions):
            mentions.append(replace(mention))
        merged = mentions[index]
        merged.is_asked = merged.is_asked or mention.is_asked
        merged.avoid = max(merged.avoid, mention.avoid)
    edges = list(old.edges)
    old_edges = {edge._replace(utterance=0, source=NONE) for edge in edges}
    for edge in (edge.renumber(indices) for edge in new.edges):
        # From another viewpoint "behind the cone" is another side of it: repeated, it adds a
        # relation. "Between" does not depend on the viewpoint.
        if edge.relation not in (NONE, BETWEEN) or edge._replace(utterance=0) not in old_edges:
            edges.append(edge)
    total, goals = old.log_probability + new.log_probability, renumber(new.new_goals, indices)
    return History(mentions, edges, old.goals, old.pinned, goals, total)


def _is_inconsistent(old: History, new: History, spoken: Referents) -> bool:
    """Tell whether an ambiguous noun, taken as known, has another type in the old reading."""
    # A noun that may name either of two labels has one reading for each.
    before, now = ({mention.label for mention in item.mentions} for item in (old, new))
    return any(
        spoken.known >= set(types) and bool(before & set(types)) and not before & now & set(types)
        for types in spoken.candidates
    )


def _simplify(history: History) -> History:
    """Drop bare existence of related mentions; request mentions that requested ones depend on."""
    ends = [{edge.figure, edge.landmark} for edge in history.edges if edge.relation != NONE]
    related = set().union(*ends)
    history.edges = [e for e in history.edges if e.relation != NONE or e.figure not in related]
    for pair in ends * len(history.mentions):
        mentions = [history.mentions[m] for m in pair]
        if any(mention.is_asked for mention in mentions if mention.type_code != ROBOT):
            for mention in mentions:
                mention.is_asked = True
    return history


def _is_needed(history: History, edge: RelationEdge) -> bool:
    """Tell whether a relation is the last one of a goal, or of a mention to be avoided."""
    goals = {*history.goals, *history.new_goals} - {NONE}
    needed = goals | {m for m, mention in enumerate(history.mentions) if mention.avoid}
    others = {end for o in history.edges if o is not edge for end in (o.figure, o.landmark)}
    return bool({edge.figure, edge.landmark} & needed - others)


def _fit_capacity(history: History, num_mentions: int, num_relations: int) -> History:
    """Drop the oldest relations, and mentions left without any, until the arrays suffice."""
    dropped = 0
    while True:
        related = {end for edge in history.edges for end in (edge.figure, edge.landmark)}
        kept = [m for m in range(len(history.mentions)) if m in related]
        if len(kept) <= num_mentions and len(history.edges) <= num_relations:
            break
        oldest = min(history.edges, key=lambda edge: (_is_needed(history, edge), edge.utterance))
        # "Between" has two relations, which are dropped together.
        is_between = oldest.relation == BETWEEN
        history.edges = [
            edge
            for edge in history.edges
            if edge is not oldest
            and not (is_between and edge.relation == BETWEEN and edge.figure == oldest.figure)
        ]
        dropped += 1
    indices = [kept.index(m) if m in related else NONE for m in range(len(history.mentions))]
    mentions = [history.mentions[m] for m in kept]
    edges = topological_order([edge.renumber(indices) for edge in history.edges])
    return replace(
        history,
        mentions=mentions,
        edges=move_untyped_last(edges, [mention.type_code for mention in mentions]),
        goals=renumber(history.goals, indices),
        new_goals=renumber(history.new_goals, indices),
        num_dropped=dropped,
    )


def merge_utterance(
    readings: Readings,
    words: DiscourseInfo,
    instruction: Instruction,
    spoken: Referents | None,
    *,
    is_new_task: bool,
    is_loose: bool = True,
    is_asked: bool = True,
) -> Merged:
    """Merge a new utterance into the readings of the utterance history.

    Args:
        readings: of the history, leaves [K, ...], of one robot.
        words: discourse information on them.
        instruction: the new utterance.
        spoken: what it refers to; None: as its readings show.
        is_new_task: it replaces the present task, whose mentions are no longer requested.
        is_loose: a described mention may refer to one without any description; false for a new
            task, whose mention is then a new object, as the other one may have been ruled out.
        is_asked: it requests what it refers to; a statement does not.

    Returns:
        The K likeliest merged readings, in arrays of the sizes of ``readings``.
    """
    utterance = int(words.num_heard)
    old = histories_of(readings, words) or [History([], [], [], [], [], 0.0)]
    new = new_histories(instruction, spoken, utterance, is_asked=is_asked)
    new = new or [History([], [], [], [], [NONE] * int(instruction.num_clauses), 0.0)]
    pairs, references = list(itertools.product(old, new)), spoken or Referents()
    merged = [
        _product(*pair, references, is_new_task=is_new_task, is_loose=is_loose)
        for pair in [p for p in pairs if not _is_inconsistent(*p, references)] or pairs
    ]
    merged.sort(key=lambda history: -history.log_probability)
    (k_size, m_size), j_size = readings.mention_type.shape, readings.relation.shape[1]
    ranked = [_fit_capacity(_simplify(history), m_size, j_size) for history in merged[:k_size]]
    ranked[0].num_dropped += int(words.num_dropped)
    return to_arrays(ranked, (k_size, m_size, j_size, words.goal.shape[1]), instruction, utterance)
