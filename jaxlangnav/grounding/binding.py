"""Bind the nouns of a sentence to labels and attributes of the detector (section 3.1).

Every sentence defines its own types. Each is a noun with its attributes ("red ball"), and is bound
to one or more labels of the detector: by name, by a synonym, or by its head noun. The trained graph
never sees the labels: it refers to the sentence's types by index into a list, the lexicon's types
first, and its results are mapped to codes of label and attributes (``object_types``) afterwards.
"""

import dataclasses
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np

from jaxlangnav.grounding.program import MAX_NAMED_TYPES
from jaxlangnav.inputs.object_types import (
    ANYTHING,
    ATTRIBUTES,
    MAX_LABELS,
    attribute_code,
    attribute_words,
    group_of,
    label_of,
    type_code,
)
from jaxlangnav.inputs.sanitize import check_names
from jaxlangnav.language.lexicon import TYPE_CLASS, is_reserved, load_lexicon
from jaxlangnav.language.nouns import attributes_of, base_adjective, load_nouns, singular
from jaxlangnav.language.phrase import LanguageError, Parse, Phrase, Word
from jaxlangnav.language.reference import SAME, head_of, is_untyped
from jaxlangnav.language.tokens import normalize
from jaxlangnav.messages import NONE, ROBOT

_TYPE = "type:"
_MAX_LISTED = 12  # labels that an error message lists


class UnknownObjectError(ValueError):
    """A noun that matches no label of the detector."""


class Detector:
    """Labels and attribute groups of a detector; a detection's type is an index into the labels.

    Nouns without a label get indices after those of the labels, and keep them in later
    sentences.
    """

    def __init__(self, labels: Iterable[str], attribute_groups: Iterable[str] = ()) -> None:
        """Validate the labels, in index order, and the groups of ``ATTRIBUTES`` that it reports.

        Raises:
            ValueError: no label, too many, one that is no name, twice, empty or a word of the
                grammar, or no such group; one line.
        """
        self.labels = check_names(labels, "labels", max_count=MAX_LABELS)
        self.attribute_groups = frozenset(
            check_names(attribute_groups, "attributes", max_count=MAX_LABELS)
        )
        self._names = [  # as sentences write them: "Stop_Sign" is "stop sign"
            " ".join(normalize(label).replace("_", " ").replace("-", " ").split())
            for label in self.labels
        ]
        self._unlabelled: list[str] = []
        if fault := self._fault():
            raise ValueError(
                f"the detector's labels have {fault}: give 1 to {MAX_LABELS - 1} names, none "
                "empty or a word like 'the' and 'behind', each once"
            )
        if unknown := sorted(self.attribute_groups - set(ATTRIBUTES)):
            raise ValueError(
                f"the detector cannot report {unknown[0]!r}: attributes are compared by "
                f"{', '.join(ATTRIBUTES)}"
            )

    def _fault(self) -> str:
        """Describe what is wrong with the labels; empty if nothing is."""
        names = self._names
        if not 0 < len(names) < MAX_LABELS:
            return f"{len(names)} names"
        if "" in names:
            return f"an empty name at place {names.index('') + 1}"
        duplicate = next((name for name, count in Counter(names).items() if count > 1), None)
        if duplicate is not None:
            return f"{duplicate!r} twice"
        reserved = next((name for name in names if is_reserved(name)), None)
        return f"{reserved!r}, which has a meaning of its own in every sentence" if reserved else ""

    @property
    def names(self) -> tuple[str, ...]:
        """The labels, then the nouns without a label."""
        return (*self.labels, *self._unlabelled)

    @property
    def plain_labels(self) -> frozenset[str]:
        """The labels and their synonyms in plain words."""
        return frozenset().union(*(load_nouns().synonyms_of(name) for name in self._names))

    def find(self, noun: str) -> tuple[tuple[int, ...], bool]:
        """Find the labels that match a noun, which is lower-case and singular.

        Returns:
            Indices of the labels, possibly none; and whether they match the noun itself, not only
            a hypernym of it.
        """
        if exact := self._matching(noun):
            return exact, True
        foreign = load_lexicon().entries["foreign"]
        by_head = tuple(
            i
            for i, name in enumerate(self._names)
            if singular(name).split()[-1] == noun and tuple(name.split()) not in foreign
        )
        if by_head:
            return by_head, True  # "the sign": any of the detector's signs
        if tuple(noun.split()) in foreign:  # a mail box is no box, and a tree house no house
            return (), False
        hypernym = load_nouns().hypernyms.get(noun)
        return (hypernym and self._matching(hypernym)) or self._matching(noun.split()[-1]), False

    def _matching(self, noun: str) -> tuple[int, ...]:
        """List the labels equal to a noun, or else to a synonym, ignoring spaces."""
        spellings = [{n.replace(" ", ""), singular(n).replace(" ", "")} for n in self._names]
        synonyms = load_nouns().synonyms_of(noun)
        for names in ({noun}, synonyms, _lexicon_names().get(noun, frozenset())):
            variants = {name.replace(" ", "") for name in names}
            if labels := tuple(i for i, forms in enumerate(spellings) if forms & variants):
                return labels
        return ()

    def index_without_label(self, noun: str) -> int:
        """Assign a noun without a label an index after the labels."""
        if noun not in self._unlabelled:
            if len(self.names) + 1 >= MAX_LABELS:
                raise ValueError(f"more than {MAX_LABELS} nouns and labels: start a new navigator")
            self._unlabelled.append(noun)
        return len(self.labels) + self._unlabelled.index(noun)


@cache
def _lexicon_names() -> dict[str, frozenset[str]]:
    names: dict[str, set[str]] = {}
    for words, entry in load_lexicon().entries[TYPE_CLASS].items():
        for sense in (sense for word in entry for sense in word.senses):
            names.setdefault(sense.removeprefix(_TYPE), set()).add(" ".join(words))
    return {sense: frozenset(texts) for sense, texts in names.items()}


class BoundSentence:
    """A sentence whose nouns are bound to labels and attributes of a detector, in order.

    ``tree`` is the parse, in which every noun has the sense ``type:NAME`` of one of ``names``, the
    sentence's types, those of the lexicon first. ``codes`` are those of label and attributes
    that each type may have, and ``notes`` list words that are not used, a line each.
    """

    def __init__(self, tree: Parse, type_names: Sequence[str], detector: Detector) -> None:
        """Bind the nouns of a parse; ``type_names`` are the types of the models.

        Raises:
            UnknownObjectError: the goal of a command has no label, or a noun far too many.
            LanguageError: an attribute is used as a comparative, or two untyped objects differ in
                theirs.
        """
        self.detector = detector
        self.names = list(type_names)
        self.codes: list[tuple[int, ...]] = [() for _ in type_names]
        self.notes: dict[str, None] = {}
        self._untyped: int | None = None  # code of the sentence's untyped objects
        self._last_codes: dict[str, int] = {}  # noun → code of its last mention's attributes
        clauses = [self._bind(c, head_of(c) if c.label == "VP" else None) for c in tree.clauses]
        self.tree = dataclasses.replace(tree, clauses=tuple(clauses))
        # Types not mentioned by the sentence: their labels, or the unused last code.
        self.codes = [
            bound or detector.find(name)[0][:MAX_NAMED_TYPES] or (MAX_LABELS - 1,)
            for name, bound in zip(self.names, self.codes, strict=True)
        ]

    def type_codes(self, named_types: np.ndarray) -> np.ndarray:
        """Replace type indices by codes of label and attributes in a compiled clause, i32[H, 4]."""
        codes = np.full_like(named_types, NONE)
        for row, types in zip(codes, named_types, strict=True):
            listed = [code for t in types[types != NONE] for code in self.codes_of(int(t))]
            row[: len(listed)] = listed[:MAX_NAMED_TYPES]
        return codes

    def codes_of(self, mention: int) -> tuple[int, ...]:
        """List the codes that a type may have; the robot and untyped objects have one each."""
        special = {ROBOT: ROBOT, ANYTHING: self._untyped or ANYTHING}
        return (special[mention],) if mention in special else self.codes[mention]

    def labels_of(self, name: str) -> tuple[int, ...]:
        """List the labels that one of the sentence's types may have, ignoring attributes."""
        if name not in self.names:
            return ()
        return tuple(dict.fromkeys(label_of(k) for k in self.codes[self.names.index(name)]))

    def _bind(self, phrase: Phrase, goal: Phrase | None) -> Phrase:
        children = tuple(self._bind(child, goal) for child in phrase.children)
        rebuilt = dataclasses.replace(phrase, children=children)
        head = next((w for w in phrase.words if w.type_sense), None)
        if is_untyped(phrase):
            word = phrase.words[-1]
            code = type_code(ANYTHING, self._code(phrase, word, ""))
            if self._untyped not in (None, code):
                raise LanguageError(
                    f"'{word.text}' (word {word.position}): two things of unnamed types that "
                    "differ are not told apart in one sentence: say one at a time"
                )
            self._untyped = code
        if phrase.label != "NP" or head is None:
            return rebuilt
        noun = (head.type_sense or "").removeprefix(_TYPE)
        name = self._name(noun, self._code(phrase, head, noun), phrase, is_goal=phrase is goal)
        senses = tuple(_TYPE + name if s == _TYPE + noun else s for s in head.senses)
        words = (dataclasses.replace(w, senses=senses) if w is head else w for w in phrase.words)
        return dataclasses.replace(rebuilt, words=tuple(words))

    def _code(self, phrase: Phrase, head: Word, noun: str) -> int:
        """Encode the attributes that the detector reports, and note those that are not used."""
        attributes, ignored = attributes_of(phrase)
        if SAME in head.senses and not attributes:
            return self._last_codes.get(noun, 0)
        by_group: dict[str | None, str] = {}
        for word, value in attributes:
            group = group_of(value)
            if group not in self.detector.attribute_groups:
                self.notes.setdefault(f"'{word.text}' is not used: my detector reports no {group}")
            elif group in by_group:
                self.notes.setdefault(
                    f"'{word.text}' is not used: one {group} of a thing is compared"
                )
            else:
                by_group[group] = value
        for word in ignored:
            if adjective := base_adjective(word.text):  # detections have no degrees
                raise LanguageError(
                    f"'{word.text}' (word {word.position}): how {adjective} things are is not "
                    f"compared; say '{adjective}', or which one is the nearest"
                )
            self.notes.setdefault(f"'{word.text}' is not used: it is no attribute that is compared")
        self._last_codes[noun] = attribute_code(*by_group.values())
        return self._last_codes[noun]

    def _name(self, noun: str, code: int, phrase: Phrase, *, is_goal: bool) -> str:
        """Find or add the sentence's type for a noun with its attributes."""
        text = noun_text(phrase) or noun
        labels, is_itself = self.detector.find(text)
        if not is_itself:
            noun_labels = self.detector.find(noun)
            labels, is_itself = noun_labels if noun_labels[0] else (labels, is_itself)
        if len(labels) > MAX_NAMED_TYPES:
            listed = ", ".join(self.detector.labels[i] for i in labels[:_MAX_LISTED])
            raise UnknownObjectError(
                f"'{text[:30]}' may be any of {len(labels)} labels of my detector ({listed}, ...): "
                "name one of them"
            )
        if not labels and is_goal:
            position = next(w.position for w in phrase.words if w.type_sense)
            shown = self.detector.labels[:_MAX_LISTED]
            ellipsis = ", ..." if len(self.detector.labels) > len(shown) else ""
            raise UnknownObjectError(
                f"'{text[:30]}' (word {position}): my detector has no label for it; "
                f"it knows {', '.join(shown)}{ellipsis}"
            )
        if not labels:
            labels = (self.detector.index_without_label(noun),)
            self.notes.setdefault(f"my detector has no label for '{text[:30]}': it is never seen")
        elif not is_itself:
            matched = " or ".join(self.detector.labels[i] for i in labels)
            self.notes.setdefault(
                f"my detector has no label for '{text[:30]}': any {matched} may be meant"
            )
        return self._add_type(noun, code, labels)

    def _add_type(self, noun: str, code: int, labels: tuple[int, ...]) -> str:
        """Find the type with these codes, or add it; the lexicon's types keep their indices."""
        codes = tuple(type_code(label, code) for label in labels)
        if noun in self.names and self.codes[self.names.index(noun)] in ((), codes):
            self.codes[self.names.index(noun)] = codes
            return noun
        if codes in self.codes:
            return self.names[self.codes.index(codes)]
        name = " ".join([*attribute_words(code), noun]) if noun in self.names else noun
        while name in self.names:  # of one noun in two wordings, bound to different labels
            name = f"other {name}"
        self.names.append(name)
        self.codes.append(codes)
        return name


def noun_text(phrase: Phrase) -> str:
    """Join a phrase's noun as worded in the sentence, in the singular: "traffic cone"."""
    nouns = [word.text for word in phrase.words if word.tag in ("NN", "NNS") and word.text != "one"]
    return singular(" ".join(nouns)) if nouns else ""
