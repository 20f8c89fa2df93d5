"""What the reader sees of a sentence: classes of words, clauses and neighbours, by name (ours).

Features are names such as ``word=until`` or ``class+1=N``; the model has a weight for each name and
label. A name of a thing is written ``<N>`` whatever it is, so that what is learned of one thing
holds for all that a detector may tell apart.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import pairwise

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.language.lexicon import REASONS, TYPE_CLASS, WORDS, load_lexicon
from jaxlangnav.language.nouns import load_nouns, singular
from jaxlangnav.language.tokens import MARKS

NAME, _RELATION = "N", "rel"
PREPOSITION, PATH_WORD = "refused:such a relation", "refused:path"
SPEAKER = "refused:the speaker's own place"
MOTION = "verb:"
"""Begins the classes of verbs of ``verbs.toml``."""
_LONGEST_NAME = 4
_JOINTS = frozenset({"and", "then", "so", "but", "because", "since", "cause"})
_SAME = {"mid": _RELATION, "sup_robot": "sup_adj"}
"""Classes that differ for the grammar alone."""
_ENDINGS = ("ly", "ing", "ed", "s")
_NOTHING = "#"


@cache
def load_verbs() -> dict[str, frozenset[str]]:
    """Read the verbs of the package by class."""
    table = parse_toml(read_shipped("language", "verbs.toml"))
    return {name: frozenset(verbs) for name, verbs in table.items()}


@cache
def _classes() -> dict[str, tuple[str, ...]]:
    """Collect the classes of each word: of the lexicon, of what is refused, of verbs."""
    found: dict[str, dict[str, None]] = {}
    for name, entries in load_lexicon().entries.items():
        if name in WORDS["untold"] or name.startswith("g_") or name.endswith("_ing"):
            continue
        for words, entry in entries.items():
            is_manner = any(s.startswith("mode") for word in entry for s in word.senses)
            one = "manner" if is_manner else _SAME.get(name, name)
            found.setdefault(words[0], {})[f"{one}.." if words[1:] else one] = None
    names = {reason: name for name, reason in REASONS.items()}
    for word, reason in load_lexicon().refused.items():
        found.setdefault(word, {})[f"refused:{names.get(reason, 'other')}"] = None
    for name, verbs in load_verbs().items():
        for verb in sorted(verbs):
            found.setdefault(verb, {})[MOTION + name] = None
    return {word: tuple(classes) for word, classes in found.items()}


@lru_cache(maxsize=8)
def _known_names(labels: frozenset[str]) -> frozenset[tuple[str, ...]]:
    """Collect the names of things, word by word."""
    names = frozenset(tuple(one.split()) for one in labels | load_nouns().rooms)
    return names.union(load_lexicon().entries[TYPE_CLASS])


@dataclass(frozen=True)
class ReaderSentence:
    """The words and marks of a sentence, and what they may be."""

    words: tuple[str, ...]
    labels: frozenset[str]  # names of things that the detector tells apart

    @cached_property
    def is_name(self) -> tuple[bool, ...]:
        """Which words belong to the name of a known thing."""
        known = _known_names(self.labels)
        found: list[bool] = []
        while rest := self.words[len(found) :]:
            for size in range(min(_LONGEST_NAME, len(rest)), 0, -1):
                name = rest[:size]
                if name in known or tuple(singular(" ".join(name)).split()) in known:
                    found += [True] * size
                    break
            else:
                found.append(False)
        return tuple(found)

    @cached_property
    def classes(self) -> tuple[tuple[str, ...], ...]:
        """What each word may be; at least one class a word."""
        return tuple(map(_classes_of, self.words, self.is_name))

    @cached_property
    def clause(self) -> tuple[int, ...]:
        """Which clause each word is of; clauses begin behind marks and with joints."""
        found, index = [], 0
        for before, word in zip(("", *self.words), self.words, strict=False):
            is_begun = word in _JOINTS and before not in ("", *MARKS)
            index += word in MARKS or is_begun
            found.append(index)
        return tuple(found)

    @cached_property
    def clauses(self) -> tuple[tuple[int, ...], ...]:
        """The words of each clause, without marks."""
        count = max(self.clause, default=-1) + 1
        return tuple(
            tuple(i for i, of in enumerate(self.clause) if of == k and self.words[i] not in MARKS)
            for k in range(count)
        )

    def is_room(self, index: int) -> bool:
        """Tell whether a name that begins at a word, or its last word, is of a room."""
        stop = next((i for i in range(index, len(self.words)) if not self.is_name[i]), None)
        name = self.words[index:stop]
        return not load_nouns().rooms.isdisjoint({" ".join(name), name[-1]}) if name else False

    def is_verb(self, index: int) -> bool:
        """Tell whether a word may be the verb of an order."""
        return any(one in WORDS["orders"] or one.startswith(MOTION) for one in self.classes[index])


def _classes_of(word: str, is_name: bool) -> tuple[str, ...]:
    if word in MARKS:
        return ("mark",)
    known = _classes().get(word, ())
    if is_name:
        return (NAME, *known)
    if known:
        return known
    if not word[0].isalpha():
        return ("sign",)
    if "'" in word:
        return ("?'",)
    return ("?" + next((one for one in _ENDINGS if word.endswith(one)), ""),)


def _describe_clauses(sentence: ReaderSentence) -> list[str]:
    """Write of each clause what it has, and what stands before and behind it."""
    found, clauses = [], sentence.clauses
    is_order = [_lead(sentence, clause) is not None for clause in clauses]
    named = [{singular(sentence.words[i]) for i in c if sentence.is_name[i]} for c in clauses]
    is_goal = [a and bool(b) for a, b in zip(is_order, named, strict=True)]
    for k, clause in enumerate(clauses):
        others = set().union(*named[:k], *named[k + 1 :])
        marks = (
            bool(named[k]),
            is_order[k],
            not named[k].isdisjoint(others),
            not WORDS["finite"].isdisjoint(sentence.words[i] for i in clause),
            any(is_goal[:k]),
            any(is_goal[k + 1 :]),
            bool(others),
        )
        found.append("".join(str(int(mark)) for mark in marks))
    return found


def _lead(sentence: ReaderSentence, clause: Sequence[int]) -> int | None:
    """Find the verb that a clause begins with, but for words before an order; None for none."""
    for index in clause:
        if sentence.words[index] in _JOINTS or sentence.classes[index][0] in ("opener", "conn"):
            continue
        return index if sentence.is_verb(index) else None
    return None


def featurize(words: Sequence[str], labels: Collection[str]) -> list[list[str]]:
    """List the names of the features of each word and mark of a sentence.

    Words and marks are small, typing errors repaired; labels are of what the detector tells apart.
    """
    sentence = ReaderSentence(tuple(words), frozenset(labels))
    first = [classes[0] for classes in sentence.classes]
    shown = [
        "<N>" if is_name and len(classes) == 1 else word
        for word, is_name, classes in zip(words, sentence.is_name, sentence.classes, strict=True)
    ]
    described = _describe_clauses(sentence)
    return [
        [
            *_neighbours(shown, first, index),
            *(f"class={one}" for one in sentence.classes[index]),
            f"ending={word[-3:]}",
            *_in_clause(sentence, described, first, index),
        ]
        for index, word in enumerate(words)
    ]


def _neighbours(shown: Sequence[str], first: Sequence[str], index: int) -> list[str]:
    """Name a word, its class, and those around it."""

    def at(of: Sequence[str], offset: int) -> str:
        place = index + offset
        return of[place] if 0 <= place < len(of) else _NOTHING

    word, kind = shown[index], first[index]
    named = ["bias", f"word={word}", f"around={at(shown, -1)} {at(shown, 1)}"]
    for offset in (-2, -1, 1, 2):
        named += [f"word{offset:+}={at(shown, offset)}", f"class{offset:+}={at(first, offset)}"]
    named += [f"words-={at(shown, -1)} {word}", f"words+={word} {at(shown, 1)}"]
    named += [f"classes-={at(first, -1)} {kind}", f"classes+={kind} {at(first, 1)}"]
    named += [f"classes={at(first, -1)} {kind} {at(first, 1)}"]
    named += [f"word class-={at(first, -1)} {word}"]
    named += [f"word class+={word} {at(first, 1)} {at(first, 2)}"]
    again = next((k for k in range(1, 9) if at(shown, k) == word and word not in MARKS), 0)
    return [*named, f"again={min(again, 4)} {kind == 'det'}"] if again else named


def _in_clause(
    sentence: ReaderSentence, described: Sequence[str], first: Sequence[str], index: int
) -> list[str]:
    """Name the clause of a word, and where in it the word stands."""
    k, kind = sentence.clause[index], first[index]
    clause = sentence.clauses[k]
    named = [f"clause={described[k]}", f"clause class={described[k]} {kind}"]
    if clause:
        begin = [sentence.words[i] for i in clause[:2]]
        lead = _lead(sentence, clause)
        place = 0 if index == clause[0] else 2 if index == clause[-1] else 1
        named += [f"begins={begin[0]}", f"begins={' '.join(begin)}"]
        named += [f"begins class={begin[0]} {kind}"]
        named += [f"leads={_NOTHING if lead is None else first[lead]}", f"place={place}"]
    before = [i for i in clause if i < index]
    is_name_end = [a and not b for a, b in pairwise((*sentence.is_name, False))]
    names = sum(is_name_end[i] for i in before)
    counts = f"{min(names, 2)}{min(sum(map(sentence.is_verb, before)), 2)}"
    named += [f"counts={counts}{min(sum(is_name_end[index:]), 2)}"]
    named += [f"counts class={counts} {kind}"]
    ahead = range(index, len(first))
    distance = next((i - index for i in ahead if sentence.is_name[i]), 5)
    named += [f"to name={min(distance, 5)} {kind}"]
    if index + distance < len(first):
        named += [f"toward={sentence.words[index]} {sentence.is_room(index + distance)}"]
    # The mark, or the name, relation or verb, that comes first.
    signs = (
        sentence.words[i] if sentence.words[i] in MARKS else NAME
        for i in ahead[1:]
        if sentence.words[i] in MARKS
        or sentence.is_name[i]
        or first[i].startswith((_RELATION, "v_"))
    )
    named += [f"next={next(signs, _NOTHING)}"]
    count = len(described)
    if k + 1 < count and sentence.clauses[k + 1]:
        named += [f"next clause={described[k + 1]} {sentence.words[sentence.clauses[k + 1][0]]}"]
    if k and sentence.clauses[k - 1]:
        named += [f"last clause={described[k - 1]}"]
    return [*named, f"clauses={min(k, 2)}{min(count - 1 - k, 2)}"]
