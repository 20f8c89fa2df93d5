"""Anaphora resolution across the clauses of a sentence: pronouns and repeated noun phrases.

"Go to the cone, then stop behind it": a pronoun takes the type of the previous command's goal
(sense ``same``: that very object), or of the subject of the previous statement, with its modifiers.
"The hydrant is behind the cone. Go to the hydrant": the modifiers that a statement gives an object
hold for a later mention of it. Ambiguous references are refused.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from jaxlangnav.language.phrase import LanguageError, Phrase, Word

PRONOUN, SAME = "pronoun", "same"


def _has(phrase: Phrase, prefix: str) -> bool:
    return any(sense.startswith(prefix) for word in phrase.words for sense in word.senses)


def type_sense(phrase: Phrase) -> str | None:
    """Find the object type sense of a phrase's own words, or None."""
    return next((word.type_sense for word in phrase.words if word.type_sense), None)


def is_untyped(phrase: Phrase) -> bool:
    """Check whether a noun phrase is untyped: "the thing", "the one"."""
    is_bare = phrase.label == "NP" and not phrase.children and type_sense(phrase) is None
    return is_bare and phrase.has_sense("anaphor") and not phrase.has_sense("other")


def leaves(phrase: Phrase) -> list[Phrase]:
    """List the noun phrases that name an object type, except in constraints."""
    if phrase.label == "NP" and not phrase.children:
        return [phrase] if type_sense(phrase) else []
    return [leaf for child in phrase.children if child.label != "VP" for leaf in leaves(child)]


def head_of(phrase: Phrase) -> Phrase | None:
    """Find the head noun phrase of a clause: the goal of a command, the subject of a statement."""
    if phrase.label == "NP" and not phrase.children:
        return phrase
    inner = [child for child in phrase.children if child.label != "VP"]
    if phrase.label == "S":
        inner = [child for child in inner if child.label == "NP"]
    return head_of(inner[0]) if inner else None


def _error(word: Word, reason: str) -> LanguageError:
    return LanguageError.at(word.text, word.position, f"{reason}; name the object")


class Antecedent(NamedTuple):
    """Antecedent from earlier utterances, for pronouns."""

    kind: str  # object type
    is_at: bool  # the robot is at such an object, or heading to it: "it" is that one

    @property
    def clause(self) -> Phrase:
        """A minimal command whose goal it is."""
        word = Word(text=self.kind, tag="NN", lemma=self.kind, senses=(f"type:{self.kind}",))
        return Phrase(label="VP", words=(), children=(Phrase(label="NP", words=(word,)),))


class _Resolver:
    """Resolver of the pronouns of one clause against the previous clause."""

    def __init__(self, previous: Phrase | None, earlier: Antecedent | None, kind: str) -> None:
        """Resolve a clause of a label by the one before, or by an earlier utterance if none is."""
        self.earlier = earlier if previous is None else None
        self.previous = previous if self.earlier is None else self.earlier.clause
        self.is_statement = kind == "S"
        self.head = None if self.previous is None else head_of(self.previous)
        self.type_sense = None if self.head is None else type_sense(self.head)

    def resolve(self, phrase: Phrase, *, is_landmark: bool = False) -> Phrase:
        """Replace the senses of every pronoun below a phrase by those of its antecedent."""
        if phrase.label == "NP" and _has(phrase, PRONOUN):
            return self._resolve_pronoun(phrase, is_landmark)
        if phrase.label == "NP" and not phrase.children:
            return self._corefer(phrase)
        has_landmarks = _has(phrase, "relation") or _has(phrase, "constraint")
        below_landmark = is_landmark or phrase.label == "NP" or has_landmarks
        children = []
        for index, child in enumerate(phrase.children):
            is_figure = phrase.label == "NP" and index == 0
            # "The cone near the car" is not the previous cone: its modifier distinguishes it.
            if is_figure and len(phrase.children) > 1 and not _has(child, PRONOUN):
                children.append(self._corefer(child) if _has(child, "anaphor") else child)
            else:
                children.append(self.resolve(child, is_landmark=below_landmark and not is_figure))
        return replace(phrase, children=tuple(children))

    def _resolve_pronoun(self, pronoun: Phrase, is_landmark: bool) -> Phrase:
        """Give a pronoun the type of its antecedent."""
        word = next(w for w in pronoun.words if PRONOUN in w.senses)
        before, sense = self.previous, self.type_sense
        if before is None or self.head is None:
            raise _error(word, "nothing said before that it could stand for")
        if sense is None or self.head.words[-1].tag == "NNS":
            raise _error(word, "what it stands for is not clear")
        senses = [str(type_sense(leaf)) for leaf in leaves(before)]
        if is_landmark and before.label == "VP" and len(senses) > 1:
            names = " or ".join(dict.fromkeys(f"the {sense[5:]}" for sense in senses))
            raise _error(word, f"is it {names}?")
        is_command = before.label == "VP" and not self.is_statement
        is_same_object = is_command and (self.earlier is None or self.earlier.is_at)
        resolved = _with_senses(pronoun, word, (sense, SAME) if is_same_object else (sense,))
        modifiers = _modifiers(before) if before.label == "S" else ()
        return _modify(resolved, modifiers) if modifiers else resolved

    def _corefer(self, leaf: Phrase) -> Phrase:
        """Mark "the cone" as coreferent with the goal of the previous command."""
        pronoun = next((w for w in leaf.words if w.text == "one" and "anaphor" in w.senses), None)
        if pronoun is not None and self.type_sense is not None and not _has(leaf, "other"):
            return _with_senses(leaf, pronoun, (self.type_sense,))
        # "The cone" of an earlier utterance may be a different cone.
        is_goal = self.earlier is None and self.previous is not None and self.previous.label == "VP"
        is_same_type = self.type_sense is not None and self.type_sense == type_sense(leaf)
        if self.is_statement or not is_goal or not is_same_type or not _is_definite(leaf):
            return leaf
        named = next(word for word in leaf.words if self.type_sense in word.senses)
        return _with_senses(leaf, named, (*named.senses, SAME))


def _with_senses(phrase: Phrase, word: Word, senses: tuple[str, ...]) -> Phrase:
    words = (replace(w, senses=senses) if w is word else w for w in phrase.words)
    return replace(phrase, words=tuple(words))


def _is_definite(leaf: Phrase) -> bool:
    """Check for a definite singular noun phrase ("the cone", "cone") without "other"."""
    determiners = {word.text for word in leaf.words if word.tag == "DT"}
    is_other = leaf.has_sense("other", "anaphor", "place", SAME)
    return determiners <= {"the", "that", "this"} and leaf.words[-1].tag == "NN" and not is_other


def _modifiers(statement: Phrase) -> tuple[Phrase, ...]:
    """List the modifiers that a statement gives its subject."""
    figures = [child for child in statement.children if child.label == "NP"]
    inner = figures[0].children[1:] if figures else ()
    return (*inner, *(child for child in statement.children if child.label != "NP"))


def _modify(leaf: Phrase, modifiers: tuple[Phrase, ...]) -> Phrase:
    return Phrase(label="NP", words=(), children=(leaf, *modifiers))


def _add_modifiers(command: Phrase, statement: Phrase, *, is_next: bool) -> Phrase:
    """Add a statement's modifiers to the unmodified goal of a command about the same object."""
    # "Find a cone. It is behind the car": right after a command, "it" is its goal.
    subject, modifiers = head_of(statement), _modifiers(statement)
    sense = None if subject is None else type_sense(subject)
    goal_index = next((i for i, c in enumerate(command.children) if c.label != "VP"), None)
    if subject is None or sense is None or not modifiers or goal_index is None:
        return command
    is_it = is_next and any(word.text == "it" for word in subject.words)

    def rewrite(phrase: Phrase) -> Phrase:
        if phrase.label != "NP":
            return replace(phrase, children=tuple(map(rewrite, phrase.children)))
        is_leaf = not phrase.children and type_sense(phrase) == sense
        is_same = is_leaf and (is_it or _is_definite(phrase))
        return _modify(phrase, modifiers) if is_same else phrase

    children = [rewrite(c) if i == goal_index else c for i, c in enumerate(command.children)]
    return replace(command, children=tuple(children))


def resolve(clauses: list[Phrase], earlier: Antecedent | None = None) -> list[Phrase]:
    """Resolve anaphora clause by clause; ``earlier`` is the antecedent from earlier utterances.

    Modifiers of a statement are copied into the commands that they hold for.

    Raises:
        LanguageError: a pronoun could stand for nothing, or for more than one thing.
    """
    resolved: list[Phrase] = []
    for clause in clauses:
        previous = resolved[-1] if resolved else None
        resolved.append(_Resolver(previous, earlier, clause.label).resolve(clause))
    statements = [(i, clause) for i, clause in enumerate(resolved) if clause.label == "S"]
    for index, clause in enumerate(resolved):
        for position, statement in statements if clause.label == "VP" else ():
            clause = _add_modifiers(clause, statement, is_next=position == index + 1)
        resolved[index] = clause
    return resolved


# ---------------------------------------------------- clauses that name a place before its command


def join_topics(clauses: Sequence[Phrase]) -> list[Phrase]:
    """Put a topic, a place named without a verb, where the next command refers to it.

    "The cone by the car: stop behind it" is one command (left dislocation), unlike "the cone, then
    go behind it".
    """
    joined = [*clauses[:1]]
    for clause in clauses[1:]:
        topic = joined[-1]
        is_topic = topic.label == "VP" and not (_has(topic, "action") or is_constraint(topic))
        is_next = not {"and", "then"}.isdisjoint(word.text for word in clause.words)
        command = clause if is_next or not is_topic else _substitute(clause, topic.children[0])
        if command != clause:
            command = replace(command, children=(*command.children, *topic.children[1:]))
            joined.pop()
        joined.append(command)
    return joined


def _substitute(phrase: Phrase, topic: Phrase) -> Phrase:
    """Replace the noun phrase that refers to a topic; a region only by "there"."""
    texts = {word.text for word in phrase.words}
    if phrase.label == "NP" and (phrase.has_sense(SAME) or texts == {"that", "one"}):
        return topic if topic.label == "NP" or "there" in texts else phrase
    return replace(phrase, children=tuple(_substitute(it, topic) for it in phrase.children))


# ---------------------------------------------------- clauses that only say what to keep away from
# "Go to the car. Then avoid the cone" constrains the way to the car; "avoid the cone" alone asks
# for nothing to be done. Only a sentence of its own makes such a clause: within one the grammar
# puts the constraint below its command.


def is_constraint(clause: Phrase) -> bool:
    """Check whether a clause is a constraint without an action."""
    return clause.label == "VP" and _has(clause, "constraint") and not _has(clause, "action")


def join_constraints(clauses: Sequence[Phrase]) -> list[Phrase]:
    """Attach constraint clauses to the commands of the same sentence.

    Returns:
        The clauses, where each constraint has become a part of every command after it, or of the
        last command before it if none follows. Without any command they stay as they are; so does
        one on the very goal of the command before ("go to the car, then stay away from it").
    """
    commands = [i for i, c in enumerate(clauses) if c.label == "VP" and not is_constraint(c)]
    joined, moved = list(clauses), set()
    for index, clause in enumerate(clauses):
        is_same = any(SAME in word.senses for word in clause.all_words())
        if commands and is_constraint(clause) and not is_same:
            moved.add(index)
            for command in [i for i in commands if i > index] or commands[-1:]:
                tree = joined[command]
                joined[command] = replace(tree, children=(*tree.children, clause))
    return [clause for index, clause in enumerate(joined) if index not in moved]
