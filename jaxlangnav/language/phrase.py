"""Records of parse trees: the output of the parser, the input of grounding (λ of eq. 4).

A phrase has its own words and child phrases; the words of a child are not repeated in its parent.
Labels are those of the Penn Treebank. Host-side records without JAX.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

from jaxlangnav.inputs.sanitize import sanitize

COMMAND = "command"
STATEMENT = "statement"
MIN_PROBABILITY = 0.7
"""Threshold on the probability that free speech is read as it was meant (docs/language.md)."""


class LanguageError(ValueError):
    """A sentence that is refused; the message is one line naming the word and its position."""

    def __init__(self, message: str, *, position: int | None = None) -> None:
        """Store the sanitized message, and the position of the offending word."""
        super().__init__(sanitize(message))
        self.position = position

    @classmethod
    def at(cls, words: str, position: int, reason: str) -> "LanguageError":
        """Build the error for words of the sentence that start at ``position``."""
        return cls(f"'{words}' (word {position}): {reason}", position=position)


@dataclass(frozen=True, kw_only=True)
class Word:
    """One word of an instruction."""

    text: str  # lower case, as written (after spelling correction)
    tag: str  # Penn Treebank part of speech
    lemma: str  # singular, infinitive
    senses: tuple[str, ...] = ()  # "type:hydrant", "relation:behind", "action:find", ...
    position: int = 0  # 1-based count of words in the instruction, punctuation not counted

    @property
    def type_sense(self) -> str | None:
        """The sense that names an object type, such as "type:hydrant", or None."""
        return next((sense for sense in self.senses if sense.startswith("type:")), None)


@dataclass(frozen=True, kw_only=True)
class Phrase:
    """A node of the parse tree."""

    label: str  # VP, PP, NP, ADJP, SBAR, S
    words: tuple[Word, ...]  # of this node, in sentence order; may be empty
    children: tuple["Phrase", ...] = ()

    def __str__(self) -> str:
        """Format the phrase on one line, for example ``PP[behind]{NP[the cone]}``."""
        below = "{" + ", ".join(map(str, self.children)) + "}" if self.children else ""
        return self.head + below

    @property
    def head(self) -> str:
        """The phrase without its children: ``PP[behind]``."""
        return f"{self.label}[{' '.join(word.text for word in self.words)}]"

    def has_sense(self, *senses: str) -> bool:
        """Check whether one of the phrase's own words has one of the senses."""
        return any(sense in word.senses for word in self.words for sense in senses)

    def walk(self) -> Iterator["Phrase"]:
        """Yield all phrases, children before parents (the order of inference)."""
        for child in self.children:
            yield from child.walk()
        yield self

    def all_words(self) -> list[Word]:
        """Collect the words of the phrase and its descendants, in sentence order."""
        words = [word for phrase in self.walk() for word in phrase.words]
        return sorted(words, key=lambda word: word.position)

    def to_dict(self) -> dict[str, Any]:
        """Build the nested document that ``jaxlangnav parse --json`` prints."""
        return {
            "label": self.label,
            "words": [{"text": word.text, "tag": word.tag} for word in self.words],
            "children": [child.to_dict() for child in self.children],
        }


class Measure(NamedTuple):
    """Metric part of a command: distance and reference frame, from metres and turns."""

    metres: float = 0.0  # from landmark to goal; 0: the relation's typical distance
    frame: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Reference pose: x, y, heading; metres, radians, frame of the robot when it hears it."""
    end: tuple[float, float] | None = None
    """End position in the same frame, if given relative to the robot."""


@dataclass(frozen=True, kw_only=True)
class Parse:
    """Result of parsing an instruction: a tree per clause, and how it was read."""

    instruction: str  # as given
    clauses: tuple[Phrase, ...]  # roots, in order; one for an ordinary command
    kinds: tuple[str, ...]  # per clause: COMMAND or STATEMENT
    unknown_words: tuple[tuple[str, int], ...]  # (word, position), part of speech was guessed
    repairs: tuple[tuple[str, str], ...]  # (as typed, as read)
    probability: float  # posterior of this tree among all trees of the sentence
    rewrites: tuple[tuple[str, str], ...] = ()  # (as said, as read), in sentence order
    unread: tuple[str, ...] = ()  # small talk and reasons, irrelevant to the task
    measures: tuple[Measure, ...] = ()  # per clause

    def to_dict(self) -> dict[str, Any]:
        """Build a JSON document; several clauses are children of a node labelled ROOT."""
        trees = [clause.to_dict() for clause in self.clauses]
        joined = {"label": "ROOT", "words": [], "children": trees}
        return {
            "instruction": self.instruction,
            "tree": trees[0] if len(trees) == 1 else joined,
            "kinds": list(self.kinds),
            "unknown_words": [{"text": t, "position": p} for t, p in self.unknown_words],
            "repairs": [{"from": a, "to": b} for a, b in self.repairs],
            "rewrites": [{"from": a, "to": b} for a, b in self.rewrites],
            "unread": list(self.unread),
            "measures": [{"metres": m.metres, "frame": list(m.frame)} for m in self.measures],
            "probability": self.probability,
        }
