"""Rewritings of free speech in the controlled language, with probabilities (ours).

The reader labels words; a labelling is a sentence of the controlled language, or a refusal. How
likely a rewriting is to mean what was said is judged by a second model, a logistic one, on features
of its edits: the CRF is too sure of words that it does not know.

    p(right) = σ(Σ_k w_k f_k)
"""

import itertools
import math
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from jaxlangnav.language.lexicon import WORDS
from jaxlangnav.language.measured import is_quantity
from jaxlangnav.language.nouns import singular
from jaxlangnav.language.reader.features import (
    NAME,
    PREPOSITION,
    ReaderSentence,
    classes_of,
    find_relations,
)
from jaxlangnav.language.reader.model import (
    DELETE,
    KEEP,
    REJECT,
    ReaderModel,
    find_best,
    load_reader,
    log_partition,
)
from jaxlangnav.language.tokens import MARKS, RawToken, strip_marks
from jaxlangnav.relations.table import REGISTRY

_NUM_LABELLINGS = 30  # labellings that are checked
_MIN_P = 1e-6  # smaller probabilities count as this in logarithms
MIN_OVERRULING = 0.7  # probability by the CRF at which a meaning overrules the grammar's


class Proposal(NamedTuple):
    """A proposed rewriting of a sentence, with its probability."""

    probability: float  # of its labellings
    tokens: tuple[RawToken, ...]
    left_out: tuple[str, ...]
    changes: tuple[tuple[str, str], ...]  # (as said, as read)
    features: dict[str, float]  # of its edits and its sentence


@dataclass(frozen=True)
class Labelling:
    """A labelled sentence and its edits."""

    sentence: ReaderSentence
    labels: tuple[str, ...]
    met: frozenset[str] = frozenset()  # edited spans of the training data

    @cached_property
    def runs(self) -> list[range]:
        """Maximal spans of words that are edited: replaced, deleted, or with words inserted."""
        groups = itertools.groupby(range(len(self.labels)), key=lambda i: self.labels[i] == KEEP)
        spans = [list(group) for is_kept, group in groups if not is_kept]
        return [range(span[0], span[-1] + 1) for span in spans]

    def span_key(self, run: range) -> str:
        """Format an edited span as a key: its words, names as ``<N>``, and its labels."""
        classes, words = self.sentence.classes, self.sentence.words
        words = ["<N>" if classes[i][0] == NAME else words[i] for i in run]
        return " ".join([*words, *(self.labels[i] for i in run if self.labels[i] != DELETE)])

    def read_as(self, index: int) -> list[str]:
        """List the words that stand for a word in the rewriting."""
        label = self.labels[index]
        is_kept = label[0] == KEEP
        return [*label[2:].split(), self.sentence.words[index]] if is_kept else label[1:].split()

    @cached_property
    def output(self) -> ReaderSentence:
        """The rewriting."""
        words = (word for i in range(len(self.labels)) for word in self.read_as(i))
        return replace(self.sentence, words=tuple(words))

    @cached_property
    def keeps_corrected(self) -> bool:
        """Whether a command stays after "sorry" or "I mean", and what it corrects stays too."""
        middle, is_name = self.sentence.correction, self.sentence.is_name
        kept = [i for i, label in enumerate(self.labels) if label not in (DELETE, REJECT)]
        verbs = [i for i in kept if self.sentence.is_verb(i) and not is_name[i]]
        begin = next((i for i in kept if i in verbs or is_name[i]), middle)
        return begin < middle < max(verbs, default=0)

    def is_faithful(self) -> bool:
        """Check that quantities, bans and corrections stay, and no relation is made up."""
        checks = self._splits_quantity, self._edits_number, self._drops_choice
        is_edited = any(check(run) for run in self.runs for check in checks)
        return (
            not (is_edited or self.keeps_corrected)
            and self.sentence.banned <= self.output.banned
            and all(self._is_converse(i) for run in self.runs for i in run if self.labels[i][1:])
        )

    def _drops_choice(self, run: range) -> bool:
        """Check whether a span deletes what a correction says, or what a rank counts by.

        "…, I mean in front of it", "counting from the left, go to the second tree".
        """
        words, classes, output = self.sentence.words, self.sentence.classes, self.output.words
        deleted = [i for i in run if self.labels[i] == DELETE]
        begin = next((i for i in run[:3] if words[i] in WORDS["amending"]), run.stop)
        said = [i for i in deleted if i > begin and run.start > 0]
        choice = {words[i] for i in said if self.sentence.is_name[i] or "ordinal" in classes[i]}
        choice |= {words[i] for i in said if is_quantity(words[i]) and words[i] != "one"}
        is_ranked = any("ordinal" in classes_of(word) for word in output)
        relations = find_relations([words[i] for i in (deleted if is_ranked else said)])
        return not (choice <= {*output} and relations <= find_relations(output))

    def _edits_number(self, run: range) -> bool:
        """Check whether a span edits digits in a new way, in a clause of which words are kept."""
        words, clause = self.sentence.words, self.sentence.clause
        rest = {clause[i] for i in range(len(words)) if i not in run and words[i] not in MARKS}
        is_number = any(words[i][0].isdigit() and clause[i] in rest for i in run)
        if any(self.labels[i] != DELETE for i in run):  # as in "minus 2 metres"
            is_number |= any(w != "one" and is_quantity(w) for w in words[run.start : run.stop + 1])
        return is_number and self.span_key(run) not in self.met

    def _splits_quantity(self, run: range) -> bool:
        """Check whether a span deletes one part of a quantity: "3 metres and a quarter"."""
        words = self.sentence.words
        deleted = [words[i] for i in run if self.labels[i] == DELETE]
        inner = [word for word in deleted if word not in ("and", "a", "an", "another")]
        before, after = words[run.start - 1 : run.start], words[run.stop : run.stop + 1]
        edges = ((*before, *inner[:1]), (*inner[-1:], *after))
        return any(len(edge) == 2 and all(map(is_quantity, edge)) for edge in edges)

    def _is_converse(self, index: int) -> bool:
        """Check that a new relation is the converse of a deleted one, or was met in training."""
        # "The house with the truck in front" is the house behind the truck.
        words, new = self.sentence.words, find_relations(self.read_as(index))
        clause = self.sentence.clauses[self.sentence.clause[index]]
        deleted = find_relations([words[i] for i in clause if self.labels[i] == DELETE])
        own = find_relations(words[index : index + 1])
        binding = {PREPOSITION, *(WORDS["telling"] if deleted else ())}
        is_met = any(index in run and self.span_key(run) in self.met for run in self.runs)
        # "The car the cone is behind" keeps its second article, with a relation before it.
        is_bound = own or (deleted and self.labels[index][0] == KEEP)
        is_free = is_met and not is_bound and binding.isdisjoint(self.sentence.classes[index])
        return is_free or new <= own.union(REGISTRY[relation].converse for relation in deleted)

    def edit_features(self) -> Counter[str]:
        """Count labels, names kept, and words edited otherwise than in training, by class."""
        words, is_name = self.sentence.words, self.sentence.is_name
        counts = Counter(f"label {label[0]}" for label in self.labels)
        kept = (i for i, label in enumerate(self.labels) if label[0] == KEEP and is_name[i])
        counts["names"] = len({singular(words[i]) for i in kept})
        for run in self.runs:
            if self.span_key(run) in self.met:
                continue
            counts["unmet"] += 1
            for i in run:
                edit = "deleted" if self.labels[i] == DELETE else "replaced"
                counts.update(f"{edit} {name}" for name in self.sentence.classes[i])
                counts.update(f"as {name}" for word in self.read_as(i) for name in classes_of(word))
        return counts

    def proposal(
        self, tokens: Sequence[RawToken], probability: float, p_refused: float
    ) -> Proposal:
        """Build the rewritten sentence, with the list of its edits."""
        output: list[RawToken] = []
        last = {i: tokens[run[-1]].position for run in self.runs for i in run}
        for index, token in enumerate(tokens):
            is_kept, words = self.labels[index][0] == KEEP, self.read_as(index)
            # New words get the positions of the words that they replace, in order.
            stop = token.position if is_kept else last[index]
            output += [
                RawToken(text=word, position=min(token.position + k, stop))
                for k, word in enumerate(words)
            ]
        edits, words = [], self.sentence.words
        for run in self.runs:
            source = " ".join(words[i] for i in run if words[i] not in MARKS)
            edits.append((source, " ".join(word for i in run for word in self.read_as(i))))
        return Proposal(
            probability=probability,
            tokens=tuple(strip_marks(output)),
            left_out=tuple(source for source, target in edits if source and not target),
            changes=tuple((source or ",", target) for source, target in edits if target),
            features={**self.edit_features(), "log refused": safe_log(p_refused)},
        )


def met_spans(labellings: Iterable[Labelling]) -> frozenset[str]:
    """Collect the edited spans of training data, as ``Labelling.span_key`` formats them.

    Without deletions of words that only select objects: "both" may be deleted in one sentence, but
    not in others.
    """
    return frozenset(
        labelling.span_key(run)
        for labelling in labellings
        for run in labelling.runs
        if any(labelling.labels[i] != DELETE for i in run)
        or any(WORDS["choosing"].isdisjoint(labelling.sentence.classes[i]) for i in run)
    )


def propose_readings(
    tokens: Sequence[RawToken],
    labels: Collection[str] = (),
    *,
    is_readable: bool = False,
    model: ReaderModel | None = None,
) -> list[Proposal]:
    """Propose rewritings of free speech in the controlled language, with probabilities.

    Args:
        tokens: words and marks with corrected spelling; at least one.
        labels: labels of the detector.
        is_readable: the sentence can be parsed verbatim, and is proposed among the others, or
            alone if no other can overrule it; the others have edits of the training only.
        model: the reader; that of ``load_reader`` by default.

    Returns:
        The likeliest rewritings, best first. The remaining probability is that of refusal, of the
        verbatim sentence, or of unlikely rewritings.
    """
    model = load_reader() if model is None else model
    sentence = ReaderSentence(tuple(token.text for token in tokens), frozenset(labels))
    scores = model.scores(sentence.words, sentence.labels)
    log_total = log_partition(scores, model.transition)

    def probability(label: str) -> float:
        """Compute the probability that all words have one label."""
        if label not in model.labels:
            return 0.0
        index = model.labels.index(label)
        moves = (len(scores) - 1) * model.transition[index, index]
        return math.exp(scores[:, index].sum() + moves - log_total)

    p_verbatim, p_refused = probability(KEEP), probability(REJECT)
    proposals: dict[tuple[str, ...], Proposal] = {}
    if is_readable:
        verbatim = Proposal(p_verbatim, tuple(tokens), (), (), {})
        proposals[sentence.words] = verbatim
        if p_verbatim > 1.0 - MIN_OVERRULING:
            return [verbatim]
    labellings = [
        (Labelling(sentence, tuple(model.labels[i] for i in path), model.met), score - log_total)
        for score, path in find_best(scores, model.transition, _NUM_LABELLINGS)
    ]
    p_refused += sum(math.exp(log_p) for labelled, log_p in labellings if labelled.keeps_corrected)
    for labelled, log_p in labellings:
        is_refused = labelled.labels[0] == REJECT or not labelled.is_faithful()
        if is_refused or (
            is_readable and not model.met.issuperset(map(labelled.span_key, labelled.runs))
        ):
            continue
        proposal = labelled.proposal(tokens, math.exp(log_p), p_refused)
        words = tuple(token.text for token in proposal.tokens)
        if not words or words == sentence.words:
            continue
        first = proposals.get(words, proposal._replace(probability=0.0))
        total = first.probability + proposal.probability
        proposals[words] = first._replace(probability=total)
    return sorted(proposals.values(), key=lambda proposal: -proposal.probability)


def safe_log(probability: float) -> float:
    """Compute the logarithm of a probability, at least that of ``_MIN_P``."""
    return math.log(max(probability, _MIN_P))
