"""Training of the reader: a linear-chain CRF, maximum a posteriori by optax's Adam (ours).

    J = mean_s −log p(labels_s | words_s) + λ/2 Σ w²

A corpus line is ``{"text": what was said, "read": the same in the controlled language}``, or
``"read": null`` where nothing may be made of it; ``names`` lists what a detector of that sentence
tells apart. The labels come from aligning the two, word by word.
"""

import dataclasses
import time
from collections import Counter
from collections.abc import Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from jaxlangnav.inputs.documents import parse_json, read_lines, shipped_file
from jaxlangnav.language.lexicon import WORDS
from jaxlangnav.language.parser import split_text
from jaxlangnav.language.reader.features import (
    ReaderSentence,
    featurize,
    load_verbs,
)
from jaxlangnav.language.reader.model import KEPT, LEFT_OUT, UNREADABLE, ReaderModel
from jaxlangnav.language.reader.proposals import Labelling
from jaxlangnav.language.tokens import MARKS

_LARGEST = 1 << 24
"""Bytes of a corpus."""
_TELLING = WORDS["contrary"] | WORDS["impossible"]
_PLAIN = frozenset({"=go", "=go to", "=stop"})
_TALKATIVE = 0.3
"""Share of plain sentences to which talk is added."""
_BARRED = -1e4
"""Log score of a transition that cannot be."""
_PADDING = 8
"""Lengths are rounded up to a multiple, so that few programs are compiled."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReaderConfig:
    """How a reader is trained."""

    epochs: int = 5
    batch: int = 128  # sentences
    rate: float = 0.06  # of Adam, falling to 0 by a cosine
    l2: float = 6e-5
    copies: int = 6  # of each sentence, as often as it is varied: another verb, or talk
    least_features: int = 3  # a feature that is met more rarely has no weight
    least_labels: int = 3  # sentences; a label that is met more rarely is not learned
    smallest: float = 0.03  # weights below are left out
    seed: int = 0


class ReaderExample(NamedTuple):
    """A sentence and the label of each of its words."""

    words: tuple[str, ...]
    labels: tuple[str, ...]
    names: frozenset[str]


class ReaderWeights(NamedTuple):
    """What is trained."""

    emission: Array  # f32[F + 1, L]; row 0 is of no feature
    transition: Array  # f32[L, L]
    begin: Array  # f32[L]
    end: Array  # f32[L]


class Batch(NamedTuple):
    """Sentences of about one length."""

    features: np.ndarray  # i32[B, T, K] rows of the emission; 0: none
    labels: np.ndarray  # i32[B, T]
    is_word: np.ndarray  # f32[B, T]
    weight: np.ndarray  # f32[B] 0 of padding


def align(said: Sequence[str], read: Sequence[str]) -> tuple[str, ...] | None:
    """Label each word (or mark) of a sentence by what stands for it in the controlled language.

    None where words are added at the end, which no label says.
    """
    labels, put = [KEPT] * len(said), ""
    matcher = SequenceMatcher(None, said, read, autojunk=False)
    for kind, first, last, begin, end in matcher.get_opcodes():
        words = " ".join(read[begin:end])
        if put:  # what was added before: only a kept word has room for it
            labels[first], put = f"{KEPT}>{put}", ""
        if kind == "insert":
            put = words
        elif kind != "equal":
            labels[first:last] = [LEFT_OUT] * (last - first)
            labels[first] = f"={words}" if words else LEFT_OUT
    return None if put else tuple(labels)


def read_reader_corpus(path: Path | None = None) -> list[ReaderExample]:
    """Read a corpus of the reader; the package's own by default.

    Sentences that cannot be labelled are left out.

    Raises:
        ValueError: a line is none; one line that names it.
    """
    path = shipped_file("language", "readings.jsonl") if path is None else path
    rows = []
    for number, line in read_lines(path, at_most=_LARGEST):
        row = parse_json(line)
        if not (isinstance(row, dict) and set(row) - {"names"} == {"text", "read"}):
            raise ValueError(f"{path.name} line {number} must have text, read, and maybe names")
        if type(row["text"]) is not str or type(row["read"]) not in (str, type(None)):
            raise ValueError(
                f"{path.name} line {number}: text and read must be texts, or read null"
            )
        rows.append(row)
    names = frozenset(one for row in rows for one in row.get("names", ()))
    found = []
    for row in rows:
        said = tuple(token.text for token in split_text(row["text"], names))
        labels = (
            (UNREADABLE,) * len(said) if row["read"] is None else align(said, row["read"].split())
        )
        if said and labels is not None:
            found.append(ReaderExample(said, labels, names))
    return found


def vary_sentences(
    examples: Sequence[ReaderExample], seed: int, copies: int = 1
) -> list[ReaderExample]:
    """Make sentences as others would say them: another verb of the class, talk before or behind.

    Each of the labelled sentences stands, and is varied, ``copies`` times; those that were made of
    them come last. ``seed`` is of the choices.
    """
    rng, made = np.random.default_rng(seed), []
    talk = []  # clauses that are left out whole and name nothing
    for one in examples:
        sentence = ReaderSentence(one.words, one.names)
        for clause in sentence.clauses:
            is_idle = [one.labels[i] == LEFT_OUT and not sentence.is_name[i] for i in clause]
            if len(clause) > 1 and all(is_idle):
                talk.append(tuple(one.words[i] for i in clause))
    classes = [sorted(verbs) for _, verbs in sorted(load_verbs().items())]
    for one in [*examples] * copies:
        verbs = [i for i, label in enumerate(one.labels) if label in _PLAIN]
        for index in verbs[:1]:
            alike = next((verbs for verbs in classes if one.words[index] in verbs), [])
            if alike:
                words = list(one.words)
                words[index] = alike[rng.integers(len(alike))]
                made.append(one._replace(words=tuple(words)))
        if talk and set(one.labels) == {KEPT} and rng.random() < _TALKATIVE:
            said = talk[rng.integers(len(talk))]
            gone = (LEFT_OUT,) * (len(said) + 1)
            mark = (MARKS[int(rng.integers(len(MARKS)))],)
            if rng.random() < 0.5:
                made.append(ReaderExample((*said, *mark, *one.words), gone + one.labels, one.names))
            else:
                made.append(ReaderExample((*one.words, *mark, *said), one.labels + gone, one.names))
    return [*examples] * copies + made


def negative_log_likelihood(weights: ReaderWeights, batch: Batch) -> Array:
    """Sum -log p(labels | words) over a batch, by the forward algorithm: f32[], nats."""
    scores = weights.emission.at[0].set(0.0)[batch.features].sum(axis=2)  # [B, T, L]

    def step(ahead: Array, at: tuple[Array, Array]) -> tuple[Array, None]:
        row, is_word = at
        summed = jax.nn.logsumexp(ahead[:, :, None] + weights.transition[None], axis=1) + row
        return jnp.where(is_word[:, None] > 0, summed, ahead), None

    rest = jnp.moveaxis(scores[:, 1:], 1, 0), jnp.asarray(batch.is_word[:, 1:]).T
    ahead, _ = jax.lax.scan(step, weights.begin[None] + scores[:, 0], rest)
    log_total = jax.nn.logsumexp(ahead + weights.end[None], axis=1)
    labels, is_word = jnp.asarray(batch.labels), jnp.asarray(batch.is_word)
    chosen = jnp.take_along_axis(scores, labels[..., None], axis=2)[..., 0]
    moved = weights.transition[labels[:, :-1], labels[:, 1:]]
    last = jnp.maximum(is_word.sum(axis=1).astype(jnp.int32) - 1, 0)
    ended = weights.end[jnp.take_along_axis(labels, last[:, None], axis=1)[:, 0]]
    own = (chosen * is_word).sum(1) + (moved * is_word[:, 1:]).sum(1)
    return ((log_total - own - weights.begin[labels[:, 0]] - ended) * batch.weight).sum()


def train_reader(
    examples: Sequence[ReaderExample], *, config: ReaderConfig
) -> tuple[ReaderModel, dict[str, Any]]:
    """Train a reader on labelled sentences.

    The report has sentences, features, labels, loss in nats a sentence, and seconds.

    Raises:
        ValueError: too few sentences to learn from.
    """
    started = time.perf_counter()
    counted = Counter(label for one in examples for label in set(one.labels))
    names = frozenset().union(*(one.names for one in examples))
    frequent = sorted(label for label, n in counted.items() if n >= config.least_labels)
    # What names a thing would name it whatever was said.
    read = {label: tuple(label.lstrip("K>=").split()) for label in frequent}
    labels = tuple(one for one in frequent if not any(ReaderSentence(read[one], names).is_name))
    used = [one for one in examples if set(one.labels) <= set(labels)]
    if len(used) < config.batch:
        raise ValueError(f"{len(used)} sentences are too few to train on: {config.batch} at least")
    used = vary_sentences(used, config.seed, config.copies)
    named = [featurize(one.words, one.names) for one in used]
    met = Counter(name for sentence in named for word in sentence for name in set(word))
    least = config.least_features * config.copies
    features = tuple(sorted(name for name, n in met.items() if n >= least))
    batches = _batches(used, named, features, labels, config)
    weights, loss = _fit(batches, len(features), labels, config)
    emission = np.where(np.abs(weights.emission[1:]) < config.smallest, 0.0, weights.emission[1:])
    is_used = np.abs(emission).max(axis=1) > 0
    pairs = (pair for one in used for pair in zip(one.words, one.labels, strict=True))
    labelled = [Labelling(ReaderSentence(one.words, one.names), one.labels) for one in used]
    model = ReaderModel(
        features=tuple(name for name, used in zip(features, is_used, strict=True) if used),
        labels=labels,
        seen=frozenset((word, label) for word, label in pairs if label[0] == "="),
        left_out=_left_out(used),
        # The stretches of words that are not kept, with what is read for them. Not what only
        # chooses, and for which nothing is read: "both" may go in one sentence alone.
        met=frozenset(
            one.stretch(run)
            for one in labelled
            for run in one.runs
            if any(one.labels[i] != LEFT_OUT for i in run)
            or any(WORDS["choosing"].isdisjoint(one.sentence.classes[i]) for i in run)
        ),
        emission=np.round(emission[is_used], 3),
        transition=np.asarray(weights.transition),
        begin=np.asarray(weights.begin),
        end=np.asarray(weights.end),
    )
    return model, {
        "sentences": len(used),
        "features": len(model.features),
        "labels": len(labels),
        "weights": int(np.count_nonzero(model.emission)),
        "loss": loss,
        "train_s": time.perf_counter() - started,
    }


def _left_out(examples: Sequence[ReaderExample]) -> frozenset[str]:
    """Collect the telling words that were left out, with the two after them: "if you could".

    Not what names something, nor what forbids to do something: "don't go anywhere" may go on.
    """
    found = set()
    for one in examples:
        sentence = ReaderSentence(one.words, one.names)
        for index, label in enumerate(one.labels):
            classes = sentence.classes[index]
            after = range(index + 1, min(index + 3, len(one.words)))
            names = any(sentence.is_name[i] or "det" in sentence.classes[i] for i in after)
            forbids = "refused:negation" in classes and any(
                sentence.is_verb(i) or not WORDS["impossible"].isdisjoint(sentence.classes[i])
                for i in after
            )
            is_telling = not _TELLING.isdisjoint(classes)
            if label == LEFT_OUT and is_telling and not (names or forbids):
                found.add(" ".join(one.words[index : index + 3]))
    return frozenset(found)


def _batches(
    examples: Sequence[ReaderExample],
    named: Sequence[list[list[str]]],
    features: Sequence[str],
    labels: Sequence[str],
    config: ReaderConfig,
) -> list[Batch]:
    """Write sentences as arrays, those of about one length together."""
    row = {name: index for index, name in enumerate(features, start=1)}
    column = {label: index for index, label in enumerate(labels)}
    width = max(len(word) for sentence in named for word in sentence)
    order = sorted(range(len(examples)), key=lambda i: len(examples[i].words))
    batches = []
    for begin in range(0, len(order), config.batch):
        chosen = order[begin : begin + config.batch]
        length = -(-len(examples[chosen[-1]].words) // _PADDING) * _PADDING
        shape = config.batch, length
        batch = Batch(
            np.zeros((*shape, width), np.int32),
            np.zeros(shape, np.int32),
            np.zeros(shape, np.float32),
            (np.arange(config.batch) < len(chosen)).astype(np.float32),
        )
        for lane, index in enumerate(chosen):
            for time_step, word in enumerate(named[index]):
                on = [row[name] for name in word if name in row]
                batch.features[lane, time_step, : len(on)] = on
            size = len(named[index])
            batch.labels[lane, :size] = [column[one] for one in examples[index].labels]
            batch.is_word[lane, :size] = 1.0
        batches.append(batch)
    return batches


def _fit(
    batches: Sequence[Batch], num_features: int, labels: Sequence[str], config: ReaderConfig
) -> tuple[ReaderWeights, float]:
    """Minimise the objective; the same batches and seed give the same weights."""
    size = len(labels)
    weights = ReaderWeights(*map(jnp.zeros, ((num_features + 1, size), (size, size), size, size)))
    # From a sentence that is refused to one that is read there is no transition, nor back.
    is_refused = np.array([label == UNREADABLE for label in labels])
    bars = np.where(is_refused[:, None] == is_refused, 0.0, _BARRED).astype(np.float32)
    num_steps = config.epochs * len(batches)
    optimizer = optax.adam(optax.cosine_decay_schedule(config.rate, num_steps))

    def objective(weights: ReaderWeights, batch: Batch) -> Array:
        barred = weights._replace(transition=weights.transition + bars)
        mean = negative_log_likelihood(barred, batch) / jnp.maximum(batch.weight.sum(), 1.0)
        return mean + 0.5 * config.l2 * sum((leaf**2).sum() for leaf in weights)

    @jax.jit
    def update(
        weights: ReaderWeights, state: optax.OptState, batch: Batch
    ) -> tuple[Any, optax.OptState, Array]:
        loss, slope = jax.value_and_grad(objective)(weights, batch)
        change, state = optimizer.update(slope, state)
        return optax.apply_updates(weights, change), state, loss

    state, losses = optimizer.init(weights), []
    rng = np.random.default_rng(config.seed)
    for _ in range(config.epochs):
        losses = []
        for index in rng.permutation(len(batches)):
            weights, state, loss = update(weights, state, batches[index])
            losses.append(loss)
    weights = weights._replace(transition=weights.transition + bars)
    return jax.tree.map(np.asarray, weights), float(np.mean(losses))
