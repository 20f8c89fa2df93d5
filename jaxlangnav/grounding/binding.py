"""From a sentence's nouns to what the detector tells apart (section 3.1).

A sentence brings its own types. Each is a noun with its attributes ("red ball"), and is bound to
one or more labels of the detector: by name, by a synonym, or by its head noun. The trained graph
never sees the labels: it speaks of the sentence's types by their place in a list, those of the
lexicon first, and what it says is put into kinds (``object_types``) afterwards.
"""

import dataclasses
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import cache

import numpy as np

from jaxlangnav.grounding.program import NUM_OWN
from jaxlangnav.inputs.object_types import (
    ANYTHING,
    ATTRIBUTES,
    MOST_LABELS,
    attribute_code,
    attribute_words,
    group_of,
    kind_of,
    label_of,
)
from jaxlangnav.inputs.sanitize import check_names
from jaxlangnav.language.lexicon import TYPE_CLASS, load_lexicon
from jaxlangnav.language.nouns import attributes_of, compared, load_nouns, singular
from jaxlangnav.language.own_words import is_of_grammar
from jaxlangnav.language.phrase import LanguageError, Parse, Phrase, Word
from jaxlangnav.language.reference import SAME, head_of, is_thing
from jaxlangnav.language.tokens import plainly
from jaxlangnav.messages import NONE, ROBOT

_TYPE = "type:"
_MOST_TOLD = 12
"""Labels that a refusal lists."""


class UnknownObjectError(ValueError):
    """A noun that nothing the detector tells apart can be."""


class Detector:
    """What a detector tells apart; a detection names its type by the index into the labels.

    Nouns that it has no label for get indices beyond its labels, and keep them, so that they can
    be named, and stay what they are in the next sentence.
    """

    def __init__(self, labels: Iterable[str], attribute_groups: Iterable[str] = ()) -> None:
        """Check the labels, in the order of its indices, and the ``ATTRIBUTES`` that it reports.

        Raises:
            ValueError: no label, too many, one that is no name, twice, empty or a word of the
                grammar, or no such group; one line.
        """
        self.labels = check_names(labels, "labels", at_most=MOST_LABELS)
        self.attribute_groups = frozenset(
            check_names(attribute_groups, "attributes", at_most=MOST_LABELS)
        )
        self._names = [  # as sentences write them: "Stop_Sign" is "stop sign"
            " ".join(plainly(label).replace("_", " ").replace("-", " ").split())
            for label in self.labels
        ]
        self._beyond: list[str] = []
        fault = self._fault()
        if fault:
            raise ValueError(
                f"the detector's labels have {fault}: give 1 to {MOST_LABELS - 1} names, none "
                "empty or a word like 'the' and 'behind', each once"
            )
        unknown = sorted(self.attribute_groups - set(ATTRIBUTES))
        if unknown:
            raise ValueError(
                f"the detector cannot report {unknown[0]!r}: attributes are compared by "
                f"{', '.join(ATTRIBUTES)}"
            )

    def _fault(self) -> str:
        """Say what is wrong with the labels; empty: nothing."""
        names = self._names
        if not 0 < len(names) < MOST_LABELS:
            return f"{len(names)} names"
        if "" in names:
            return f"an empty name at place {names.index('') + 1}"
        twice = next((name for name, number in Counter(names).items() if number > 1), None)
        if twice is not None:
            return f"{twice!r} twice"
        taken = next((name for name in names if is_of_grammar(name)), None)
        return f"{taken!r}, which has a meaning of its own in every sentence" if taken else ""

    @property
    def names(self) -> tuple[str, ...]:
        """The labels, and after them nouns that there was no label for."""
        return (*self.labels, *self._beyond)

    @property
    def plain_labels(self) -> frozenset[str]:
        """The labels and their synonyms as sentences say them."""
        return frozenset().union(*(load_nouns().alike(name) for name in self._names))

    def find(self, noun: str) -> tuple[tuple[int, ...], bool]:
        """Find the labels that a thing of a noun may have, a name in the singular, small letters.

        Returns:
            Indices of the labels, none where it has none; and whether they mean the noun itself,
            not only what it is a kind of.
        """
        if found := self._called(noun):
            return found, True
        foreign = load_lexicon().entries["foreign"]
        kinds = tuple(
            i
            for i, name in enumerate(self._names)
            if singular(name).split()[-1] == noun and tuple(name.split()) not in foreign
        )
        if kinds:
            return kinds, True  # "the sign": any of the detector's signs
        if tuple(noun.split()) in foreign:  # a mail box is no box, and a tree house no house
            return (), False
        broader = load_nouns().broader.get(noun)
        return (broader and self._called(broader)) or self._called(noun.split()[-1]), False

    def _called(self, noun: str) -> tuple[int, ...]:
        """List the labels of a name, or else of its synonyms, written as one word or several."""
        written = [{one.replace(" ", ""), singular(one).replace(" ", "")} for one in self._names]
        for names in _ways_to_say(noun):
            joined = {name.replace(" ", "") for name in names}
            if found := tuple(i for i, own in enumerate(written) if own & joined):
                return found
        return ()

    def beyond(self, noun: str) -> int:
        """Give a noun without a label an index of its own."""
        if noun not in self._beyond:
            if len(self.names) + 1 >= MOST_LABELS:
                raise ValueError(f"more than {MOST_LABELS} nouns and labels: start a new navigator")
            self._beyond.append(noun)
        return len(self.labels) + self._beyond.index(noun)


def _ways_to_say(noun: str) -> Iterator[frozenset[str]]:
    """Yield names of the same thing: the noun, then its synonyms, then the lexicon's."""
    yield frozenset({noun})
    yield load_nouns().alike(noun)
    if noun in _names_of_types():
        yield _names_of_types()[noun]


@cache
def _names_of_types() -> dict[str, frozenset[str]]:
    names: dict[str, set[str]] = {}
    for words, entry in load_lexicon().entries[TYPE_CLASS].items():
        for sense in (sense for word in entry for sense in word.senses):
            names.setdefault(sense.removeprefix(_TYPE), set()).add(" ".join(words))
    return {kind: frozenset(found) for kind, found in names.items()}


class BoundSentence:
    """A sentence whose types are bound to what the detector tells apart, one noun after the other.

    ``tree`` is the sentence, in which every noun has the sense ``type:NAME`` of one of ``names``,
    the sentence's types, those of the lexicon first. ``kinds`` are those that each may be, and
    ``notes`` say in a line each what of the words is not used.
    """

    def __init__(self, tree: Parse, type_names: Sequence[str], detector: Detector) -> None:
        """Bind a sentence, as the parser makes it; ``type_names`` are those of the models.

        Raises:
            UnknownObjectError: the goal of a command has no label, or a noun far too many.
            LanguageError: things are compared by how they look.
        """
        self.detector = detector
        self.names = list(type_names)
        self.kinds: list[tuple[int, ...]] = [() for _ in type_names]
        self.notes: dict[str, None] = {}
        self._thing = ANYTHING  # the kind of what is called by no type
        self._latest: dict[str, int] = {}  # noun → code of its last mention's attributes
        clauses = [
            self._bind(clause, head_of(clause) if clause.label == "VP" else None)
            for clause in tree.clauses
        ]
        self.tree = dataclasses.replace(tree, clauses=tuple(clauses))
        # Of what is not spoken of hardly anything is said, and nothing of what the detector lacks.
        self.kinds = [
            named or detector.find(name)[0][:NUM_OWN] or (MOST_LABELS - 1,)
            for name, named in zip(self.names, self.kinds, strict=True)
        ]

    def rewrite(self, own: np.ndarray) -> np.ndarray:
        """Put kinds in place of the sentence's types in a program's ``own``, i32[H, 4]."""
        rewritten = np.full_like(own, NONE)
        for row, named in zip(rewritten, own, strict=True):
            kinds = [kind for one in named[named != NONE] for kind in self.kinds_of(int(one))]
            row[: len(kinds)] = kinds[:NUM_OWN]
        return rewritten

    def kinds_of(self, mention: int) -> tuple[int, ...]:
        """List the kinds that a type may be; the robot and any thing are of their own."""
        own = {ROBOT: ROBOT, ANYTHING: self._thing}
        return (own[mention],) if mention in own else self.kinds[mention]

    def labels_of(self, name: str) -> tuple[int, ...]:
        """List the labels that one of the sentence's types may have, whatever it looks like."""
        if name not in self.names:
            return ()
        return tuple(dict.fromkeys(label_of(k) for k in self.kinds[self.names.index(name)]))

    def _bind(self, phrase: Phrase, goal: Phrase | None) -> Phrase:
        children = tuple(self._bind(child, goal) for child in phrase.children)
        phrase_now = dataclasses.replace(phrase, children=children)
        head = next((w for w in phrase.words if w.type_sense), None)
        if is_thing(phrase):
            self._thing = kind_of(ANYTHING, self._code(phrase, phrase.words[-1], ""))
        if phrase.label != "NP" or head is None:
            return phrase_now
        noun = (head.type_sense or "").removeprefix(_TYPE)
        name = self._name(noun, self._code(phrase, head, noun), phrase, is_goal=phrase is goal)
        senses = tuple(_TYPE + name if s == _TYPE + noun else s for s in head.senses)
        words = (dataclasses.replace(w, senses=senses) if w is head else w for w in phrase.words)
        return dataclasses.replace(phrase_now, words=tuple(words))

    def _code(self, phrase: Phrase, head: Word, noun: str) -> int:
        """Read the attributes that are compared, and note those that are not."""
        told, idle = attributes_of(phrase)
        if SAME in head.senses and not told:
            return self._latest.get(noun, 0)
        used: dict[str | None, str] = {}
        for word, value in told:
            group = group_of(value)
            if group not in self.detector.attribute_groups:
                self.notes.setdefault(f"'{word.text}' is not used: my detector reports no {group}")
            elif group in used:
                self.notes.setdefault(
                    f"'{word.text}' is not used: one {group} of a thing is compared"
                )
            else:
                used[group] = value
        for word in idle:
            adjective = compared(word.text)
            if adjective is not None:  # how much things look like something is not known
                raise LanguageError(
                    f"'{word.text}' (word {word.position}): how {adjective} things are is not "
                    f"compared; say '{adjective}', or which one is the nearest"
                )
            self.notes.setdefault(f"'{word.text}' is not used: it is no attribute that is compared")
        self._latest[noun] = attribute_code(*used.values())
        return self._latest[noun]

    def _name(self, noun: str, code: int, phrase: Phrase, *, is_goal: bool) -> str:
        """Name the type of the sentence that a noun with its attributes is."""
        said = said_noun(phrase) or noun
        labels, is_itself = self.detector.find(said)
        if not is_itself:
            by_type = self.detector.find(noun)
            labels, is_itself = by_type if by_type[0] else (labels, is_itself)
        if len(labels) > NUM_OWN:
            some = ", ".join(self.detector.labels[i] for i in labels[:_MOST_TOLD])
            raise UnknownObjectError(
                f"'{said[:30]}' may be any of {len(labels)} labels of my detector ({some}, ...): "
                "name one of them"
            )
        if not labels and is_goal:
            position = next(w.position for w in phrase.words if w.type_sense)
            known = self.detector.labels[:_MOST_TOLD]
            more = ", ..." if len(self.detector.labels) > len(known) else ""
            raise UnknownObjectError(
                f"'{said[:30]}' (word {position}): my detector has no label for it; "
                f"it knows {', '.join(known)}{more}"
            )
        if not labels:
            labels = (self.detector.beyond(noun),)
            self.notes.setdefault(f"my detector has no label for '{said[:30]}': it is never seen")
        elif not is_itself:
            taken = " or ".join(self.detector.labels[i] for i in labels)
            self.notes.setdefault(
                f"my detector has no label for '{said[:30]}': any {taken} may be meant"
            )
        return self._enter(noun, code, labels)

    def _enter(self, noun: str, code: int, labels: tuple[int, ...]) -> str:
        """Find the type with these kinds, or add it; the lexicon's types keep their places."""
        kinds = tuple(kind_of(label, code) for label in labels)
        if noun in self.names and self.kinds[self.names.index(noun)] in ((), kinds):
            self.kinds[self.names.index(noun)] = kinds
            return noun
        if kinds in self.kinds:
            return self.names[self.kinds.index(kinds)]
        name = " ".join([*attribute_words(code), noun]) if noun in self.names else noun
        while name in self.names:  # of one noun said in two ways, bound to different labels
            name = f"other {name}"
        self.names.append(name)
        self.kinds.append(kinds)
        return name


def said_noun(phrase: Phrase) -> str:
    """Write the noun of a phrase as it was said, in the singular: "traffic cone"."""
    nouns = [word.text for word in phrase.words if word.tag in ("NN", "NNS") and word.text != "one"]
    return singular(" ".join(nouns)) if nouns else ""
