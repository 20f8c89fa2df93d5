"""Rewritings of free speech in the controlled language, with probabilities (ours).

The reader labels words; a labelling is a sentence of the controlled language, or a refusal. Words
may be deleted only if they can neither select an object nor reverse the meaning: that is checked
for each labelling by rules, and labellings that fail must be more probable.
"""

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from jaxlangnav.language.lexicon import WORDS, load_lexicon
from jaxlangnav.language.measured import is_quantity
from jaxlangnav.language.nouns import singular
from jaxlangnav.language.reader.features import (
    NAME,
    PATH_WORD,
    PREPOSITION,
    SIGN,
    ReaderSentence,
    find_relations,
)
from jaxlangnav.language.reader.model import (
    COMMAND_VERBS,
    DELETE,
    KEEP,
    REJECT,
    find_best,
    load_reader,
    log_partition,
    replacement_mask,
)
from jaxlangnav.language.tokens import MARKS, RawToken, strip_marks
from jaxlangnav.relations.table import REGISTRY

_NUM_LABELLINGS = 30
"""Number of labellings that are checked."""
_MAX_VERBATIM = 0.9
"""Limit on the probability of the unparsable verbatim sentence, in renormalising the others."""
_CHOOSING = WORDS["choosing"] | {SIGN}  # "cone 3"
_OPERATORS = WORDS["contrary"] | _CHOOSING
"""Classes of words that negate or select an object."""


class Proposal(NamedTuple):
    """A proposed rewriting of a sentence, with its probability."""

    probability: float  # of its labellings
    tokens: tuple[RawToken, ...]
    left_out: tuple[str, ...]
    changes: tuple[tuple[str, str], ...]  # (as said, as read)
    is_safe: bool = True  # its edits were met in training, or cannot turn the meaning


@dataclass(frozen=True)
class Labelling:
    """A labelled sentence, with the rules that decide whether its edits are safe."""

    sentence: ReaderSentence
    labels: tuple[str, ...]
    seen: frozenset[str] = frozenset()  # deleted trigrams of the training data
    met: frozenset[str] = frozenset()  # edited spans of the training data

    @cached_property
    def kept(self) -> list[bool]:
        """Whether each word is kept."""
        return [label[0] == KEEP for label in self.labels]

    @cached_property
    def runs(self) -> list[range]:
        """Maximal spans of words that are not kept."""
        groups = itertools.groupby(range(len(self.kept)), key=self.kept.__getitem__)
        spans = [list(group) for is_kept, group in groups if not is_kept]
        return [range(span[0], span[-1] + 1) for span in spans]

    def span_key(self, run: range) -> str:
        """Format an edited span as a key: its words, names as ``<N>``, and the replacement."""
        classes, words = self.sentence.classes, self.sentence.words
        words = ["<N>" if classes[i][0] == NAME else words[i] for i in run]
        return " ".join([*words, "=", *self._replacements(run)])

    def _replacements(self, run: range) -> list[str]:
        """List what replaces a span: its labels, and insertions at the words beside it."""
        beside = (*self.labels[max(run.start - 1, 0) : run.start], *self.labels[run.stop :][:1])
        inserted = [label.partition(">")[2] for label in beside]
        return [*(self.labels[i][1:] for i in run if self.labels[i] != DELETE), *inserted]

    def is_deleted(self, index: int) -> bool:
        """Check whether the whole clause of a word is deleted, without object names."""
        clause = self.sentence.clauses[self.sentence.clause[index]]
        return all(self.labels[i] == DELETE and not self.sentence.is_name[i] for i in clause)

    @cached_property
    def _kept_names(self) -> frozenset[int]:
        """Indices of kept words of object names."""
        return frozenset(
            i for i, is_kept in enumerate(self.kept) if is_kept and self.sentence.is_name[i]
        )

    def _has_dangling_pronoun(self) -> bool:
        """Check whether a kept pronoun may refer to an object of a deleted clause."""
        words, size = self.sentence.words, len(self.labels)
        first = next((i for i in range(size) if not self.kept[i] and self.is_deleted(i)), size)
        return any(
            not any(name < index for name in self._kept_names)
            or words[index - 1] in WORDS["sought"]
            for index in range(first + 1, size)
            if self.kept[index] and words[index] in WORDS["pointing"]
        )

    def is_seen(self) -> bool:
        """Check whether every edited span occurs in the training data."""
        return self.met.issuperset(map(self.span_key, self.runs))

    def _is_attested(self) -> bool:
        """Check that words are put only in place of what training has them for, or "go", "stop"."""
        return self._is_faithful() and all(
            self.span_key(run) in self.met or COMMAND_VERBS.issuperset(self._replacements(run))
            for run in self.runs
        )

    def _is_faithful(self) -> bool:
        """Check that no quantity is halved, and relations are replaced by their converse only."""
        return not any(map(self._splits_quantity, self.runs)) and all(
            self._is_converse(i) for i, tag in enumerate(self.labels) if tag[0] == "="
        )

    def _splits_quantity(self, run: range) -> bool:
        """Check whether a span deletes one part of a quantity: "3 metres and a quarter"."""
        words = self.sentence.words
        deleted = [words[i] for i in run if self.labels[i] == DELETE]
        inner = [word for word in deleted if word not in ("and", "a", "an", "another")]
        before, after = words[run.start - 1 : run.start], words[run.stop : run.stop + 1]
        edges = ((*before, *inner[:1]), (*inner[-1:], *after))
        return any(len(edge) == 2 and all(map(is_quantity, edge)) for edge in edges)

    @cached_property
    def _unmet(self) -> list[range]:
        """Edited spans that training did not have."""
        return [run for run in self.runs if self.span_key(run) not in self.met]

    def _is_lost(self, index: int) -> bool:
        """Check whether a deleted word is, or may be, an object of which no name is kept."""
        kept = {singular(self.sentence.words[i]) for i in self._kept_names}
        is_named = self.sentence.is_name[index] and singular(self.sentence.words[index]) not in kept
        return is_named or self._may_be_object(index)

    def keeps_operators(self) -> bool:
        """Check that no word that negates, sets a condition or chooses is deleted, nor an object.

        Words of a replaced span and of whole clauses may go, but no object beside one that is kept.
        """
        words, classes = self.sentence.words, self.sentence.classes
        deleted = [(run, i) for run in self._unmet for i in run if self.labels[i] == DELETE]
        for span, index in deleted:
            is_replaced = any(self._replacements(span))
            clause = self.sentence.clauses[self.sentence.clause[index]]
            is_chosen = words[index] in WORDS["conditions"] or not (
                _OPERATORS.isdisjoint(classes[index]) or self.is_deleted(index)
            )
            if (is_chosen and not is_replaced) or (
                self._is_lost(index) and (is_replaced or not self._kept_names.isdisjoint(clause))
            ):
                return False
        return self._is_faithful()

    def is_safe(self) -> bool:
        """Check that deleted words not met in training neither select a thing nor negate."""
        touched = {self.sentence.clause[i] for run in self._unmet for i in run}
        return (
            self._is_attested()
            and all(self._keeps_verb(self.sentence.clauses[k]) for k in touched)
            and all(map(self._is_span_safe, self._unmet))
            and not self._has_dangling_pronoun()
        )

    def _is_span_safe(self, run: range) -> bool:
        words, is_name, classes = self.sentence.words, self.sentence.is_name, self.sentence.classes
        named = [i for i in run if is_name[i]]
        end = max((i for i in run if words[i] in WORDS["undoing"]), default=run.start)
        is_undone = any(is_name[i] or self._may_be_object(i) for i in range(run.start, end))
        if named and not is_undone:
            kept = {singular(words[i]) for i in self._kept_names}
            is_chosen = any(not _CHOOSING.isdisjoint(classes[i]) for i in run)
            if is_chosen or not kept.issuperset(singular(words[i]) for i in named):
                return False
        # Without the words between, two names would be read as one.
        beside = is_name[run.start - 1 : run.start] + is_name[run.stop : run.stop + 1]
        if beside == (True, True) and self.labels[run.start] == DELETE and not is_undone:
            return False
        is_refused = any(
            words[i : min(i + len(key), run.stop)] == key and not (is_undone or self.is_deleted(i))
            for i in run
            for key in load_lexicon().refused_expressions  # "a bit"
        )
        return not is_refused and all(self._is_word_safe(i, is_undone=is_undone) for i in run)

    def _is_word_safe(self, index: int, *, is_undone: bool) -> bool:
        """Check whether a single word may be deleted or replaced."""
        classes, word = self.sentence.classes[index], self.sentence.words[index]
        if " ".join(self.sentence.words[index : index + 3]) in self.seen:
            return True
        if not WORDS["contrary"].isdisjoint(classes):
            is_removed = word not in WORDS["conditions"] and self.is_deleted(index)
            return is_removed or (is_undone and word == "no")
        if not WORDS["impossible"].isdisjoint(classes) and WORDS["idle"].isdisjoint(classes):
            if self.labels[index] != DELETE:
                return True
            # A clause about somebody's actions is no command.
            clause = self.sentence.clauses[self.sentence.clause[index]]
            words = [self.sentence.words[i] for i in clause]
            first = next((w for w in words if w not in WORDS["calls"]), "")
            tells = first.split("'")[0] in WORDS["subjects"] and "you" not in words
            return tells and self.is_deleted(index)
        if is_undone:
            return True
        if {PREPOSITION, PATH_WORD} & set(classes) and self._is_object_kept(index):
            # A verb before it may replace the expression: "over to the".
            before = next((tag for tag in self.labels[index::-1] if tag != DELETE), KEEP)
            return PATH_WORD not in classes and before[0] != KEEP
        if self.labels[index] != DELETE:
            return True
        is_choosing = not _CHOOSING.isdisjoint(classes) or word in WORDS["degrees"]
        is_moved = any(label == f"{KEEP}>{word}" for label in self.labels)
        is_idle = self.is_deleted(index) and "manner" not in classes
        return is_moved or is_idle or not (is_choosing or self._may_be_object(index))

    def _may_be_object(self, index: int) -> bool:
        """Check whether an unknown word may be an object: it follows an article."""
        is_unknown = self.sentence.classes[index][0][0] == "?"
        return is_unknown and self.sentence.words[max(index - 1, 0)] in WORDS["articles"]

    def _is_converse(self, index: int) -> bool:
        """Check that a relation replacing "with" or "that's" is the converse of the deleted one."""
        # "The house with the truck in front" is the house behind the truck.
        new = find_relations(self.labels[index][1:].split())
        clause = self.sentence.clauses[self.sentence.clause[index]]
        deleted = find_relations(
            [self.sentence.words[i] for i in clause if self.labels[i] == DELETE]
        )
        binding = {PREPOSITION, *(WORDS["telling"] if deleted else ())}
        is_free = binding.isdisjoint(self.sentence.classes[index])
        return is_free or new <= {REGISTRY[relation].converse for relation in deleted}

    def _is_object_kept(self, index: int) -> bool:
        """Check whether the name after a preposition is kept."""
        ahead = range(index + 1, len(self.labels))
        first = next((i for i in ahead if "det" not in self.sentence.classes[i]), index)
        return self.kept[first] and self.sentence.is_name[first]

    def _keeps_verb(self, clause: Sequence[int]) -> bool:
        """Check that the kept words of a clause are more than an object name without a verb."""
        sentence, kept = self.sentence, [i for i in clause if self.kept[i]]
        return (
            not any(sentence.is_name[i] for i in kept)
            or any(self.labels[i] not in (KEEP, DELETE) for i in clause)
            or any(
                sentence.is_verb(i) or not WORDS["telling"].isdisjoint(sentence.classes[i])
                for i in kept
                if not sentence.is_name[i]
            )
            or all(
                self.kept[i] or not WORDS["idle"].isdisjoint(sentence.classes[i]) for i in clause
            )
        )

    def proposal(
        self, tokens: Sequence[RawToken], probability: float, *, is_safe: bool
    ) -> Proposal:
        """Build the rewritten sentence, with the list of its edits."""
        output: list[RawToken] = []
        last = {i: tokens[run[-1]].position for run in self.runs for i in run}
        for index, (token, label) in enumerate(zip(tokens, self.labels, strict=True)):
            head, _, inserted = label.partition(">")
            added = (inserted if head == KEEP else "" if label == DELETE else label[1:]).split()
            # New words get the positions of the words that they replace, in order.
            positions = range(token.position, last.get(index, token.position) + 1)
            output += [
                RawToken(text=word, position=positions[min(k, len(positions) - 1)])
                for k, word in enumerate(added)
            ]
            output += [token] if label[0] == KEEP else []
        edits, words = [], self.sentence.words
        for run in self.runs:
            source = " ".join(words[i] for i in run if words[i] not in MARKS)
            target = " ".join(self.labels[i][1:] for i in run if self.labels[i] != DELETE)
            edits.append((source, target))
        return Proposal(
            probability=probability,
            tokens=tuple(strip_marks(output)),
            left_out=tuple(source for source, target in edits if source and not target),
            changes=tuple(edit for edit in edits if edit[1]),
            is_safe=is_safe,
        )


def propose_readings(
    tokens: Sequence[RawToken], labels: Collection[str] = (), *, is_readable: bool = False
) -> list[Proposal]:
    """Propose rewritings of free speech in the controlled language, with probabilities.

    Args:
        tokens: words and marks with corrected spelling; at least one.
        labels: labels of the detector.
        is_readable: the sentence can be parsed verbatim, and is proposed among the others, or
            alone if its probability is at least 0.5.

    Returns:
        The likeliest rewritings, best first, conditioned on not being verbatim unless
        ``is_readable``. The remaining probability is that of refusal or unlikely rewritings.
    """
    model = load_reader()
    sentence = ReaderSentence(tuple(token.text for token in tokens), frozenset(labels))
    scores = model.scores(sentence.words, sentence.labels)
    log_total = log_partition(scores, model.transition)
    kept = model.labels.index(KEEP)
    moves = (len(scores) - 1) * model.transition[kept, kept]
    p_verbatim = math.exp(scores[:, kept].sum() + moves - log_total)
    proposals: dict[tuple[str, ...], Proposal] = {}
    if is_readable:
        verbatim = Proposal(probability=p_verbatim, tokens=tuple(tokens), left_out=(), changes=())
        proposals[sentence.words] = verbatim
        if p_verbatim >= 0.5:
            return [verbatim]
    else:
        log_total += math.log1p(-min(p_verbatim, _MAX_VERBATIM))
    scores += replacement_mask(model, sentence)
    for score, path in find_best(scores, model.transition, _NUM_LABELLINGS):
        names = tuple(model.labels[i] for i in path)
        labelled = Labelling(sentence, names, model.left_out, model.met)
        is_safe = labelled.is_seen() if is_readable else labelled.is_safe()
        is_possible = is_safe or (not is_readable and labelled.keeps_operators())
        if names[0] == REJECT or not is_possible:
            continue
        proposal = labelled.proposal(tokens, math.exp(score - log_total), is_safe=is_safe)
        words = tuple(token.text for token in proposal.tokens)
        if not words or words == sentence.words:
            continue
        if previous := proposals.get(words):
            proposal = previous._replace(
                probability=previous.probability + proposal.probability,
                is_safe=previous.is_safe or is_safe,
            )
        proposals[words] = proposal
    return sorted(proposals.values(), key=lambda p: -p.probability)
