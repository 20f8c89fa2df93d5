"""Features of the reader (a CRF): word classes, clauses and neighbours, as named indicators (ours).

Features are names such as ``word=until`` or ``class+1=N``; the model has a weight for each name and
label. An object name is written ``<N>``, so that what is learned of one object holds for all labels
of any detector.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from itertools import accumulate, chain, islice, pairwise

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.language.lexicon import REASONS, TYPE_CLASS, WORDS, load_lexicon
from jaxlangnav.language.nouns import load_nouns, singular
from jaxlangnav.language.tokens import MARKS
from jaxlangnav.messages import RELATIONS

NAME, _RELATION = "N", "rel"
PREPOSITION = "refused:such a relation"
MOTION = "verb:"
"""Prefix of the classes of verbs of ``verbs.toml``."""
_MAX_NAME_WORDS = 4
_LINKS = frozenset({"and", "then", "so", "but", "because", "since", "cause"})
_MERGED = {"mid": _RELATION, "sup_robot": "sup_adj"}
"""Classes merged with another one, as they differ only in the grammar."""
_ENDINGS = ("ly", "ing", "ed", "s")
_NOTHING = "#"


@cache
def load_verbs() -> dict[str, frozenset[str]]:
    """Load the verbs of the package by class."""
    table = parse_toml(read_shipped("language", "verbs.toml"))
    return {name: frozenset(verbs) for name, verbs in table.items()}


@cache
def _classes() -> dict[str, tuple[str, ...]]:
    """Collect the classes of each word: of the lexicon, of refused words and of verbs."""
    classes_of: dict[str, dict[str, None]] = {}
    for name, entries in load_lexicon().entries.items():
        if name in WORDS["uninformative"] or name.startswith("g_") or name.endswith("_ing"):
            continue
        for words, entry in entries.items():
            is_manner = any(s.startswith("mode") for word in entry for s in word.senses)
            label = "manner" if is_manner else _MERGED.get(name, name)
            classes_of.setdefault(words[0], {})[f"{label}.." if words[1:] else label] = None
    names = {reason: name for name, reason in REASONS.items()}
    for word, reason in load_lexicon().refused.items():
        classes_of.setdefault(word, {})[f"refused:{names.get(reason, 'other')}"] = None
    for name, verbs in load_verbs().items():
        for verb in sorted(verbs):
            classes_of.setdefault(verb, {})[MOTION + name] = None
    return {word: tuple(classes) for word, classes in classes_of.items()}


@lru_cache(maxsize=8)
def _known_names(labels: frozenset[str]) -> frozenset[tuple[str, ...]]:
    """Collect the names of known objects as tuples of words."""
    names = frozenset(tuple(name.split()) for name in labels | load_nouns().rooms)
    return names.union(load_lexicon().entries[TYPE_CLASS])


@dataclass(frozen=True)
class ReaderSentence:
    """The words and marks of a sentence, with their classes and clauses."""

    words: tuple[str, ...]
    labels: frozenset[str]  # labels of the detector

    @cached_property
    def is_name(self) -> tuple[bool, ...]:
        """Whether each word belongs to the name of a known object."""
        known = _known_names(self.labels)
        flags: list[bool] = []
        while rest := self.words[len(flags) :]:
            for size in range(min(_MAX_NAME_WORDS, len(rest)), 0, -1):
                name = rest[:size]
                if name in known or tuple(singular(" ".join(name)).split()) in known:
                    flags += [True] * size
                    break
            else:
                flags.append(False)
        return tuple(flags)

    @cached_property
    def classes(self) -> tuple[tuple[str, ...], ...]:
        """The classes of each word, at least one."""
        return tuple(map(classes_of, self.words, self.is_name))

    @cached_property
    def clause(self) -> tuple[int, ...]:
        """Clause index of each word; clauses begin after marks and at conjunctions."""
        is_start = (
            word in MARKS or (word in _LINKS and before not in ("", *MARKS))
            for before, word in pairwise(("", *self.words))
        )
        return tuple(accumulate(map(int, is_start)))

    @cached_property
    def clauses(self) -> tuple[tuple[int, ...], ...]:
        """Word indices of each clause, without marks."""
        count = max(self.clause, default=-1) + 1
        return tuple(
            tuple(i for i, c in enumerate(self.clause) if c == k and self.words[i] not in MARKS)
            for k in range(count)
        )

    @cached_property
    def banned(self) -> frozenset[str]:
        """The names that are to be avoided: those between "avoid" and a verb."""
        words, entries, is_banned, banned = self.words, load_lexicon().entries, False, [""]
        bans = entries["avoid"].keys() | entries["avoid_ing"].keys()
        bans = bans - entries["opener_ing"].keys()  # "mind", which may begin any command
        for index, word in enumerate(words):
            begun = (words[index:stop] for stop in range(index + 1, len(words) + 1))
            is_end = self.is_verb(index) or word in _LINKS - {"and"} | {"while", "when"}
            is_banned = not bans.isdisjoint(begun) or (is_banned and not is_end)
            is_part = self.is_name[index] and is_banned
            banned += [f"{banned.pop()} {singular(word)}"] if is_part else [""]
        return frozenset(banned) - {""}

    @cached_property
    def correction(self) -> int:
        """Index of the first word that corrects what was said before, or the number of words."""
        said = (i for i in range(len(self.words)) if self.is_name[i] or self.is_verb(i))
        later = range(next(said, len(self.words)) + 1, len(self.words))
        signs = (i for i in later if self.words[i] in WORDS["amending"] and not self.is_name[i])
        return next(signs, len(self.words))

    def is_room(self, index: int) -> bool:
        """Check whether the name that begins at a word, or its last word, is a room."""
        stop = next((i for i in range(index, len(self.words)) if not self.is_name[i]), None)
        name = self.words[index:stop]
        return not load_nouns().rooms.isdisjoint({" ".join(name), name[-1]}) if name else False

    def is_verb(self, index: int) -> bool:
        """Check whether a word may be the verb of a command."""
        return any(c in WORDS["orders"] or c.startswith(MOTION) for c in self.classes[index])


def classes_of(word: str, is_name: bool = False) -> tuple[str, ...]:
    """List the classes of a word or mark, at least one."""
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
    return ("?" + next((end for end in _ENDINGS if word.endswith(end)), ""),)


def _describe_clauses(sentence: ReaderSentence) -> list[str]:
    """Encode each clause as a string of binary flags of it and its neighbours."""
    codes, clauses = [], sentence.clauses
    is_order = [_command_verb(sentence, clause) is not None for clause in clauses]
    named = [{singular(sentence.words[i]) for i in c if sentence.is_name[i]} for c in clauses]
    is_goal = [a and bool(b) for a, b in zip(is_order, named, strict=True)]
    for k, clause in enumerate(clauses):
        others = set().union(*named[:k], *named[k + 1 :])
        flags = (
            bool(named[k]),
            is_order[k],
            not named[k].isdisjoint(others),
            not WORDS["finite"].isdisjoint(sentence.words[i] for i in clause),
            any(is_goal[:k]),
            any(is_goal[k + 1 :]),
            bool(others),
        )
        codes.append("".join(str(int(flag)) for flag in flags))
    return codes


def _command_verb(sentence: ReaderSentence, clause: Sequence[int]) -> int | None:
    """Find the verb at the start of a clause, after conjunctions and openers, or None."""
    words, first = sentence.words, [names[0] for names in sentence.classes]
    rest = (i for i in clause if words[i] not in _LINKS and first[i] not in ("opener", "conn"))
    return next((index for index in islice(rest, 1) if sentence.is_verb(index)), None)


def featurize(words: Sequence[str], labels: Collection[str]) -> list[list[str]]:
    """List the names of the active features of each word and mark of a sentence.

    Words and marks are lower-case with corrected spelling; labels are those of the detector.
    """
    sentence = ReaderSentence(tuple(words), frozenset(labels))
    first_classes = [classes[0] for classes in sentence.classes]
    text = [
        "<N>" if is_name and len(classes) == 1 else word
        for word, is_name, classes in zip(words, sentence.is_name, sentence.classes, strict=True)
    ]
    codes = _describe_clauses(sentence)
    return [
        [
            *_neighbours(text, first_classes, index),
            *(f"class={name}" for name in sentence.classes[index]),
            f"ending={word[-3:]}",
            *_in_clause(sentence, codes, first_classes, index),
        ]
        for index, word in enumerate(words)
    ]


def _neighbours(text: Sequence[str], classes: Sequence[str], index: int) -> list[str]:
    """List the features of a word, its class and its neighbours."""

    def at(row: Sequence[str], offset: int) -> str:
        i = index + offset
        return row[i] if 0 <= i < len(row) else _NOTHING

    word, cls = text[index], classes[index]
    features = ["bias", f"word={word}", f"around={at(text, -1)} {at(text, 1)}"]
    for offset in (-2, -1, 1, 2):
        features += [f"word{offset:+}={at(text, offset)}", f"class{offset:+}={at(classes, offset)}"]
    features += [f"words-={at(text, -1)} {word}", f"words+={word} {at(text, 1)}"]
    features += [f"classes-={at(classes, -1)} {cls}", f"classes+={cls} {at(classes, 1)}"]
    features += [f"classes={at(classes, -1)} {cls} {at(classes, 1)}"]
    features += [f"word class-={at(classes, -1)} {word}"]
    features += [f"word class+={word} {at(classes, 1)} {at(classes, 2)}"]
    repeat = next((k for k in range(1, 9) if at(text, k) == word and word not in MARKS), 0)
    return [*features, f"again={min(repeat, 4)} {cls == 'det'}"] if repeat else features


def _in_clause(
    sentence: ReaderSentence, codes: Sequence[str], classes: Sequence[str], index: int
) -> list[str]:
    """List the features of a word's clause, and of its position there."""
    k, cls = sentence.clause[index], classes[index]
    clause = sentence.clauses[k]
    features = [f"clause={codes[k]}", f"clause class={codes[k]} {cls}"]
    if clause:
        opening = [sentence.words[i] for i in clause[:2]]
        verb = _command_verb(sentence, clause)
        place = 0 if index == clause[0] else 2 if index == clause[-1] else 1
        features += [f"begins={opening[0]}", f"begins={' '.join(opening)}"]
        features += [f"begins class={opening[0]} {cls}"]
        features += [f"leads={_NOTHING if verb is None else classes[verb]}", f"place={place}"]
    preceding = [i for i in clause if i < index]
    is_name_end = [a and not b for a, b in pairwise((*sentence.is_name, False))]
    names = sum(is_name_end[i] for i in preceding)
    counts = f"{min(names, 2)}{min(sum(map(sentence.is_verb, preceding)), 2)}"
    features += [f"counts={counts}{min(sum(is_name_end[index:]), 2)}"]
    features += [f"counts class={counts} {cls}"]
    following = range(index, len(classes))
    distance = next((i - index for i in following if sentence.is_name[i]), 5)
    features += [f"to name={min(distance, 5)} {cls}"]
    if index + distance < len(classes):
        features += [f"toward={sentence.words[index]} {sentence.is_room(index + distance)}"]
    # The next mark, name, relation or verb.
    tokens = (
        sentence.words[i] if sentence.words[i] in MARKS else NAME
        for i in following[1:]
        if sentence.words[i] in MARKS
        or sentence.is_name[i]
        or classes[i].startswith((_RELATION, "v_"))
    )
    features += [f"next={next(tokens, _NOTHING)}"]
    count = len(codes)
    if k + 1 < count and sentence.clauses[k + 1]:
        features += [f"next clause={codes[k + 1]} {sentence.words[sentence.clauses[k + 1][0]]}"]
    if k and sentence.clauses[k - 1]:
        features += [f"last clause={codes[k - 1]}"]
    return [*features, f"clauses={min(k, 2)}{min(count - 1 - k, 2)}"]


@cache
def _relations() -> dict[str, int]:
    """Collect the expressions of relations, with indices into ``RELATIONS``."""
    return {
        f" {' '.join(words)} ": RELATIONS.index(sense.removeprefix("relation:"))
        for name in ("rel", "beside", "side", "rel_robot")
        for words, entry in load_lexicon().entries[name].items()
        for sense in chain(*(word.senses for word in entry))
        if sense.startswith("relation:")
    }


def find_relations(words: Sequence[str]) -> set[int]:
    """Find the relations named by expressions among words, as indices into ``RELATIONS``."""
    text = f" {' '.join(words)} "
    return {relation for expression, relation in _relations().items() if expression in text}
