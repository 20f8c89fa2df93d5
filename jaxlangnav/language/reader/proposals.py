"""What free speech may stand for in the controlled language, with probabilities (ours).

The reader labels words; a labelling is a sentence of the controlled language, or none. Whatever the
weights say, words go only where they can neither choose a thing nor turn the meaning round: that is
checked for each labelling, and those that fail have no share in any reading.
"""

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from jaxlangnav.language.lexicon import WORDS, load_lexicon
from jaxlangnav.language.nouns import singular
from jaxlangnav.language.reader.features import (
    MOTION,
    NAME,
    PATH_WORD,
    PREPOSITION,
    SPEAKER,
    ReaderSentence,
)
from jaxlangnav.language.reader.model import (
    KEPT,
    LEFT_OUT,
    UNREADABLE,
    ReaderModel,
    find_best,
    load_reader,
    log_partition,
)
from jaxlangnav.language.tokens import MARKS, SpokenToken, strip_marks
from jaxlangnav.messages import RELATIONS
from jaxlangnav.relations.table import REGISTRY

_LABELLINGS = 30
"""Labellings that are looked at."""
_MOST_KEPT = 0.9
"""Of the sentence as it stands: what it takes from the others by being none is bounded."""
_MOST = 8
"""Sentences that are proposed: each takes a parse."""
_ORDERING = frozenset({"go", "go to", "stop", "stop at"})
"""What a verb may be read as without having been met in training."""


@dataclass(frozen=True, kw_only=True)
class Proposal:
    """A sentence that may be meant."""

    probability: float  # of its labellings among all
    tokens: tuple[SpokenToken, ...]
    left_out: tuple[str, ...]
    changes: tuple[tuple[str, str], ...]  # (as said, as read)


@dataclass(frozen=True)
class Labelling:
    """A sentence with a label for each word."""

    sentence: ReaderSentence
    labels: tuple[str, ...]
    seen: frozenset[str] = frozenset()  # telling words with what follows, left out in training
    met: frozenset[str] = frozenset()  # ``stretches`` of the training

    @cached_property
    def kept(self) -> list[bool]:
        """Which words are kept."""
        return [label[0] == KEPT for label in self.labels]

    @cached_property
    def runs(self) -> list[range]:
        """Stretches of words that are not kept."""
        groups = itertools.groupby(range(len(self.kept)), key=self.kept.__getitem__)
        found = [list(group) for is_kept, group in groups if not is_kept]
        return [range(run[0], run[-1] + 1) for run in found]

    def stretch(self, run: range) -> str:
        """Write a stretch of words that are not kept, names as one sign, and what is read."""
        classes, words = self.sentence.classes, self.sentence.words
        words = ["<N>" if classes[i][0][0] in "N?" else words[i] for i in run]
        read = [self.labels[i][1:] for i in run if self.labels[i] != LEFT_OUT]
        return " ".join([*words, "=", *read])

    def is_gone(self, index: int) -> bool:
        """Tell whether the whole clause of a word is left out, and names nothing."""
        clause = self.sentence.clauses[self.sentence.clause[index]]
        return all(self.labels[i] == LEFT_OUT and not self.sentence.is_name[i] for i in clause)

    def _points_back(self) -> bool:
        """Tell whether a word that is kept may mean something of a clause that is left out."""
        words, size = self.sentence.words, len(self.labels)
        first = next((i for i in range(size) if not self.kept[i] and self.is_gone(i)), size)
        for index in range(first + 1, size):
            if self.kept[index] and words[index] in WORDS["pointing"]:
                is_named = any(self.kept[i] and self.sentence.is_name[i] for i in range(index))
                if not is_named or words[index - 1] in WORDS["sought"]:
                    return True
        return False

    def is_met(self) -> bool:
        """Tell whether every stretch that is not kept was read so in training."""
        return self.met.issuperset(map(self.stretch, self.runs))

    def is_sound(self) -> bool:
        """Tell whether what is left out can neither choose a thing nor turn the meaning round.

        A stretch that was met in training may go as it went there.
        """
        new = [run for run in self.runs if self.stretch(run) not in self.met]
        touched = {self.sentence.clause[i] for run in new for i in run}
        return (
            all(self._is_whole(self.sentence.clauses[k]) for k in touched)
            and all(
                PREPOSITION not in classes or self._is_converse(index)
                for index, classes in enumerate(self.sentence.classes)
            )
            and all(map(self._may_go, new))
            and not self._points_back()
        )

    def _may_go(self, run: range) -> bool:
        words, is_name, classes = self.sentence.words, self.sentence.is_name, self.sentence.classes
        named = [i for i in run if is_name[i]]
        is_undone = bool(named) and any(words[i] in WORDS["undoing"] for i in run if i > named[0])
        if named and not is_undone:
            kept = {singular(words[i]) for i, one in enumerate(self.kept) if one and is_name[i]}
            is_chosen = any(not WORDS["choosing"].isdisjoint(classes[i]) for i in run)
            if is_chosen or not kept.issuperset(singular(words[i]) for i in named):
                return False
        if run.start > 0 and run.stop < len(words) and not is_undone:
            # What joins two names would make one of them.
            is_joined = is_name[run.start - 1] and is_name[run.stop]
            if is_joined and self.labels[run.start] == LEFT_OUT:
                return False
        is_refused = any(
            words[i : min(i + len(one), run.stop)] == one and not self.is_gone(i)
            for i in run
            for one in load_lexicon().refused_expressions  # "a bit"
        )
        return not is_refused and all(self._may_go_alone(i, is_undone=is_undone) for i in run)

    def _may_go_alone(self, index: int, *, is_undone: bool) -> bool:
        """Tell whether a word may go, whatever goes with it."""
        classes, word = self.sentence.classes[index], self.sentence.words[index]
        if " ".join(self.sentence.words[index : index + 3]) in self.seen:
            return True
        if not WORDS["contrary"].isdisjoint(classes):
            is_gone = word not in WORDS["conditions"] and self.is_gone(index)
            return is_gone or (is_undone and word == "no")
        if not WORDS["impossible"].isdisjoint(classes) and WORDS["idle"].isdisjoint(classes):
            if self.labels[index] != LEFT_OUT:
                return True
            # A clause that says what somebody does asks for nothing.
            clause = self.sentence.clauses[self.sentence.clause[index]]
            said = [self.sentence.words[i] for i in clause]
            first = next((one for one in said if one not in WORDS["calls"]), "")
            tells = first.split("'")[0] in WORDS["subjects"] and "you" not in said
            return tells and self.is_gone(index)
        if is_undone:
            return True
        if SPEAKER in classes and self.labels[index] != LEFT_OUT and index + 1 < len(self.labels):
            # "my car" is a car; "my left", nothing.
            return not self.kept[index + 1] or any(self.sentence.is_name[index + 1 : index + 3])
        if {PREPOSITION, PATH_WORD} & set(classes) and self._governs_kept(index):
            # Other words may stand for the expression: "one of the".
            before = next((one for one in self.labels[index::-1] if one != LEFT_OUT), KEPT)
            behind = next((one for one in self.labels[index:] if one != LEFT_OUT), KEPT)
            return PATH_WORD not in classes and (before[0] != KEPT or ">" in behind)
        if self.labels[index] != LEFT_OUT:
            return True
        is_choosing = not WORDS["choosing"].isdisjoint(classes) or word in WORDS["degrees"]
        if index and classes[0][0] == "?" and self.sentence.words[index - 1] in WORDS["articles"]:
            is_choosing = True  # it may be a thing that nobody knows
        is_moved = any(label == f"{KEPT}>{word}" for label in self.labels)
        return not is_choosing or is_moved or self.is_gone(index)

    def _is_converse(self, index: int) -> bool:
        """Tell whether a relation put for a preposition is the converse of what goes, if one is."""
        # "The house with the truck in front" is the house behind the truck.
        put = _relations(self.labels[index][1:].split())
        if not put:
            return True
        clause = self.sentence.clauses[self.sentence.clause[index]]
        gone = _relations([self.sentence.words[i] for i in clause if self.labels[i] == LEFT_OUT])
        return put <= {REGISTRY[one].converse for one in gone}

    def _governs_kept(self, index: int) -> bool:
        """Tell whether the name that a preposition stands before is kept."""
        ahead = range(index + 1, len(self.labels))
        first = next((i for i in ahead if "det" not in self.sentence.classes[i]), index)
        return self.kept[first] and self.sentence.is_name[first]

    def _is_whole(self, clause: Sequence[int]) -> bool:
        """Tell whether what is left of a clause is no mere name of something told of."""
        sentence, kept = self.sentence, [i for i in clause if self.kept[i]]
        return (
            not any(sentence.is_name[i] for i in kept)
            or any(self.labels[i] not in (KEPT, LEFT_OUT) for i in clause)
            or any(
                sentence.is_verb(i) or not WORDS["telling"].isdisjoint(sentence.classes[i])
                for i in kept
                if not sentence.is_name[i]
            )
            or all(
                self.kept[i] or not WORDS["idle"].isdisjoint(sentence.classes[i]) for i in clause
            )
        )

    def proposal(self, tokens: Sequence[SpokenToken], probability: float) -> Proposal:
        """Write the sentence of the controlled language, and what became of each word."""
        put: list[SpokenToken] = []
        last = {i: tokens[run[-1]].position for run in self.runs for i in run}
        for index, (token, label) in enumerate(zip(tokens, self.labels, strict=True)):
            before, _, rest = label.partition(">")
            words = (rest if before == KEPT else "" if label == LEFT_OUT else label[1:]).split()
            # New words stand where the words were that they are read for, in order.
            places = range(token.position, last.get(index, token.position) + 1)
            put += [
                SpokenToken(text=word, position=places[min(k, len(places) - 1)])
                for k, word in enumerate(words)
            ]
            put += [token] if label[0] == KEPT else []
        left_out, changes, said_words = [], [], self.sentence.words
        for run in self.runs:
            said = " ".join(said_words[i] for i in run if said_words[i] not in MARKS)
            read = " ".join(self.labels[i][1:] for i in run if self.labels[i] != LEFT_OUT)
            if read:
                changes.append((said, read))
            elif said:
                left_out.append(said)
        return Proposal(
            probability=probability,
            tokens=tuple(strip_marks(put)),
            left_out=tuple(left_out),
            changes=tuple(changes),
        )


def _relations(words: Sequence[str]) -> set[int]:
    """Find the relations that expressions among words name, indices into ``RELATIONS``."""
    text = f" {' '.join(words)} "
    return {
        RELATIONS.index(sense.removeprefix("relation:"))
        for name in ("rel", "beside", "side", "rel_robot")
        for key, entry in load_lexicon().entries[name].items()
        if f" {' '.join(key)} " in text
        for sense in itertools.chain(*(word.senses for word in entry))
        if sense.startswith("relation:")
    }


def _bar(model: ReaderModel, sentence: ReaderSentence) -> np.ndarray:
    """Bar words that a word was never read as: 0 or -∞, [T, L]."""
    # A verb of a class of its own may be read as going or stopping without having been met.
    barred = np.zeros((len(sentence.words), len(model.labels)))
    instead = [(column, label) for column, label in enumerate(model.labels) if label[0] == "="]
    for row, (word, classes) in enumerate(zip(sentence.words, sentence.classes, strict=True)):
        is_verb = any(one.startswith(MOTION) for one in classes) and classes[0] != NAME
        for column, label in instead:
            is_order = label[1:] in _ORDERING
            is_seen = (word, label) in model.seen and not (is_order and "rel.." in classes)
            if not (is_seen or (is_verb and is_order)):
                barred[row, column] = -np.inf
    return barred


def propose_readings(
    tokens: Sequence[SpokenToken], labels: Collection[str] = (), *, is_readable: bool = False
) -> list[Proposal]:
    """Propose sentences of the controlled language that free speech may stand for.

    Args:
        tokens: words and marks, typing errors repaired; one at least.
        labels: names of things that the detector tells apart.
        is_readable: the sentence is one of the controlled language as it stands, and is proposed
            among the others; it alone where it is likelier than all of them.

    Returns:
        The likeliest, best first; of a sentence that is not readable, given that. What is missing
        to 1 is to be refused, or is no sentence, or none that is likely.
    """
    model = load_reader()
    sentence = ReaderSentence(tuple(token.text for token in tokens), frozenset(labels))
    scores = model.scores(sentence.words, sentence.labels)
    log_total = log_partition(scores, model.transition)
    kept = model.labels.index(KEPT)
    moves = (len(scores) - 1) * model.transition[kept, kept]
    as_it_stands = math.exp(scores[:, kept].sum() + moves - log_total)
    found: dict[tuple[str, ...], Proposal] = {}
    if is_readable:
        plain = Proposal(probability=as_it_stands, tokens=tuple(tokens), left_out=(), changes=())
        found[sentence.words] = plain
        if as_it_stands >= 0.5:
            return [plain]
    else:
        log_total += math.log1p(-min(as_it_stands, _MOST_KEPT))
    best = find_best(scores + _bar(model, sentence), model.transition, _LABELLINGS)
    for score, path in best:
        names = tuple(model.labels[i] for i in path)
        labelled = Labelling(sentence, names, model.left_out, model.met)
        is_sound = labelled.is_met() if is_readable else labelled.is_sound()
        if labelled.labels[0] == UNREADABLE or not is_sound:
            continue
        one = labelled.proposal(tokens, math.exp(score - log_total))
        words = tuple(token.text for token in one.tokens)
        if not words or words == sentence.words:
            continue
        if words in found:
            one = replace(found[words], probability=found[words].probability + one.probability)
        if words in found or len(found) < _MOST:
            found[words] = one
    return sorted(found.values(), key=lambda one: -one.probability)
