"""Anaphora resolution across the clauses of a sentence: pronouns and repeated noun phrases.

"Go to the cone, then stop behind it": a pronoun takes the type of the previous command's goal
(sense ``same``: that very object), or of the subject of the previous statement, with its modifiers.
"The hydrant is behind the cone. Go to the hydrant": the modifiers that a statement gives an object
hold for a later mention of it. Ambiguous references are refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

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
    return is_bare and phrase.says("anaphor") and not phrase.says("other")


def leaves(phrase: Phrase) -> list[Phrase]:
    """List the noun phrases that name an object type, except in constraints."""
    if phrase.label == "NP" and not phrase.children:
        return [phrase] if type_sense(phrase) else []
    inner = [child for child in phrase.children if child.label != "VP"]
    return [leaf for child in inner for leaf in leaves(child)]


def head_of(phrase: Phrase) -> Phrase | None:
    """Find the head noun phrase of a clause: the goal of a command, the subject of a statement."""
    if phrase.label == "NP" and not phrase.children:
        return phrase
    inner = [child for child in phrase.children if child.label != "VP"]
    if phrase.label == "S":
        inner = [child for child in inner if child.label == "NP"]
    return head_of(inner[0]) if inner else None


def _refuse(word: Word, reason: str) -> LanguageError:
    return LanguageError.at(word.text, word.position, f"{reason}; name the object")


@dataclass(frozen=True, kw_only=True)
class Antecedent:
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

    def __init__(
        self, before: Phrase | None, *, is_statement: bool, earlier: Antecedent | None = None
    ) -> None:
        self.is_far = before is None and earlier is not None
        self.is_at = earlier is None or earlier.is_at
        self.before = earlier.clause if before is None and earlier is not None else before
        self.is_statement = is_statement
        self.head = None if self.before is None else head_of(self.before)
        self.kind = None if self.head is None else type_sense(self.head)

    def resolve(self, phrase: Phrase, *, is_landmark: bool = False) -> Phrase:
        """Replace the senses of every pronoun below a phrase by those of its antecedent."""
        if phrase.label == "NP" and _has(phrase, PRONOUN):
            return self._meant(phrase, is_landmark)
        if phrase.label == "NP" and not phrase.children:
            return self._again(phrase)
        has_landmarks = _has(phrase, "relation") or _has(phrase, "constraint")
        deeper = is_landmark or phrase.label == "NP" or has_landmarks
        children = []
        for index, child in enumerate(phrase.children):
            is_figure = phrase.label == "NP" and index == 0
            # "The cone near the car" is not the previous cone: its modifier distinguishes it.
            if is_figure and len(phrase.children) > 1 and not _has(child, PRONOUN):
                children.append(self._again(child) if _has(child, "anaphor") else child)
            else:
                children.append(self.resolve(child, is_landmark=deeper and not is_figure))
        return replace(phrase, children=tuple(children))

    def _meant(self, pronoun: Phrase, is_landmark: bool) -> Phrase:
        """Give a pronoun the type of its antecedent."""
        word = next(w for w in pronoun.words if PRONOUN in w.senses)
        before, kind = self.before, self.kind
        if before is None or self.head is None:
            raise _refuse(word, "nothing said before that it could stand for")
        if kind is None or self.head.words[-1].tag == "NNS":
            raise _refuse(word, "what it stands for is not clear")
        others = [str(type_sense(leaf)) for leaf in leaves(before)]
        if is_landmark and before.label == "VP" and len(others) > 1:
            names = " or ".join(dict.fromkeys(f"the {sense[5:]}" for sense in others))
            raise _refuse(word, f"is it {names}?")
        is_command = before.label == "VP" and not self.is_statement
        is_very = is_command and (self.is_at or not self.is_far)
        resolved = _with_senses(pronoun, word, (kind, SAME) if is_very else (kind,))
        modifiers = _modifiers(before) if before.label == "S" else ()
        return _modified(resolved, modifiers) if modifiers else resolved

    def _again(self, leaf: Phrase) -> Phrase:
        """Mark "the cone" as coreferent with the goal of the previous command."""
        one = next((w for w in leaf.words if w.text == "one" and "anaphor" in w.senses), None)
        if one is not None and self.kind is not None and not _has(leaf, "other"):
            return _with_senses(leaf, one, (self.kind,))
        # "The cone" of an earlier utterance may be a different cone.
        is_goal = self.before is not None and self.before.label == "VP" and not self.is_far
        is_same_type = self.kind is not None and self.kind == type_sense(leaf)
        if self.is_statement or not is_goal or not is_same_type or not _is_definite(leaf):
            return leaf
        named = next(word for word in leaf.words if self.kind in word.senses)
        return _with_senses(leaf, named, (*named.senses, SAME))


def _with_senses(phrase: Phrase, word: Word, senses: tuple[str, ...]) -> Phrase:
    words = (replace(w, senses=senses) if w is word else w for w in phrase.words)
    return replace(phrase, words=tuple(words))


def _is_definite(leaf: Phrase) -> bool:
    """Check for a definite singular noun phrase ("the cone") without "other"."""
    is_definite = any(word.text in ("the", "that", "this") for word in leaf.words)
    is_other = leaf.says("other", "anaphor", "place", SAME)
    return is_definite and leaf.words[-1].tag == "NN" and not is_other


def _modifiers(statement: Phrase) -> tuple[Phrase, ...]:
    """List the modifiers that a statement gives its subject."""
    figures = [child for child in statement.children if child.label == "NP"]
    inner = figures[0].children[1:] if figures else ()
    return (*inner, *(child for child in statement.children if child.label != "NP"))


def _modified(leaf: Phrase, modifiers: tuple[Phrase, ...]) -> Phrase:
    return Phrase(label="NP", words=(), children=(leaf, *modifiers))


def _inform(command: Phrase, statement: Phrase, *, is_next: bool) -> Phrase:
    """Add a statement's modifiers to the unmodified goal of a command about the same object."""
    # "Find a cone. It is behind the car": right after a command, "it" is its goal.
    figure, modifiers = head_of(statement), _modifiers(statement)
    kind = None if figure is None else type_sense(figure)
    first = next((i for i, c in enumerate(command.children) if c.label != "VP"), None)
    if figure is None or kind is None or not modifiers or first is None:
        return command
    is_it = is_next and any(word.text == "it" for word in figure.words)

    def put(phrase: Phrase) -> Phrase:
        if phrase.label != "NP":
            return replace(phrase, children=tuple(map(put, phrase.children)))
        is_leaf = not phrase.children and type_sense(phrase) == kind
        is_same = is_leaf and (is_it or _is_definite(phrase))
        return _modified(phrase, modifiers) if is_same else phrase

    children = [put(c) if i == first else c for i, c in enumerate(command.children)]
    return replace(command, children=tuple(children))


def resolve(clauses: list[Phrase], earlier: Antecedent | None = None) -> list[Phrase]:
    """Resolve anaphora clause by clause; ``earlier`` is the antecedent from earlier utterances.

    Modifiers of a statement are copied into the commands that they hold for.

    Raises:
        LanguageError: a pronoun could stand for nothing, or for more than one thing.
    """
    resolved: list[Phrase] = []
    for clause in clauses:
        before = resolved[-1] if resolved else None
        resolver = _Resolver(before, is_statement=clause.label == "S", earlier=earlier)
        resolved.append(resolver.resolve(clause))
    statements = [(i, clause) for i, clause in enumerate(resolved) if clause.label == "S"]
    for index, clause in enumerate(resolved):
        for position, statement in statements if clause.label == "VP" else ():
            clause = _inform(clause, statement, is_next=position == index + 1)
        resolved[index] = clause
    return resolved


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
    joined, done = list(clauses), set()
    for index, clause in enumerate(clauses):
        is_same = any(SAME in word.senses for word in clause.all_words())
        if not commands or not is_constraint(clause) or is_same:
            continue
        done.add(index)
        for command in [i for i in commands if i > index] or commands[-1:]:
            whole = joined[command]
            joined[command] = replace(whole, children=(*whole.children, clause))
    return [clause for index, clause in enumerate(joined) if index not in done]
