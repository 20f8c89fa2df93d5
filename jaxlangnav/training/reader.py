"""Training of the reader, a linear-chain CRF, by MAP estimation with Adam (ours).

    J = mean_s −log p(labels_s | words_s) + λ/2 Σ w²

A corpus line is ``{"text": free speech, "read": its rewriting in the controlled language}``, or
``"read": null`` if it must be refused; ``names`` lists labels of a detector for that sentence. The
labels come from aligning the two, word by word.
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

_MAX_BYTES = 1 << 24
"""Size limit of a corpus."""
_DECISIVE = WORDS["contrary"] | WORDS["impossible"]
_PLAIN = frozenset({"=go", "=go to", "=stop"})
_SMALL_TALK_RATE = 0.3
"""Probability of adding small talk to a verbatim sentence."""
_IMPOSSIBLE = -1e4
"""Log score of an impossible transition."""
_PADDING = 8
"""Lengths are rounded up to a multiple of this, to limit compilations."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReaderConfig:
    """Hyperparameters of the training of a reader."""

    epochs: int = 5
    batch: int = 128  # sentences
    rate: float = 0.06  # of Adam, with cosine decay to 0
    l2: float = 6e-5
    copies: int = 6  # of each sentence, each with a variation
    least_features: int = 3  # rarer features are dropped
    least_labels: int = 3  # sentences; rarer labels are dropped
    smallest: float = 0.03  # smaller weights are set to 0
    seed: int = 0


class ReaderExample(NamedTuple):
    """A sentence and the label of each of its words."""

    words: tuple[str, ...]
    labels: tuple[str, ...]
    names: frozenset[str]


class ReaderWeights(NamedTuple):
    """Trainable weights of the CRF."""

    emission: Array  # f32[F + 1, L]; row 0 is padding
    transition: Array  # f32[L, L]
    begin: Array  # f32[L]
    end: Array  # f32[L]


class Batch(NamedTuple):
    """A padded batch of sentences of similar length."""

    features: np.ndarray  # i32[B, T, K] rows of the emission; 0: none
    labels: np.ndarray  # i32[B, T]
    is_word: np.ndarray  # f32[B, T]
    weight: np.ndarray  # f32[B] 0 of padding


def align(said: Sequence[str], read: Sequence[str]) -> tuple[str, ...] | None:
    """Label each word (or mark) of a sentence by its alignment to the controlled language.

    None if words are added at the end, which labels cannot express.
    """
    labels, inserted = [KEPT] * len(said), ""
    matcher = SequenceMatcher(None, said, read, autojunk=False)
    for kind, first, last, begin, end in matcher.get_opcodes():
        words = " ".join(read[begin:end])
        if inserted:  # inserted before: only a kept word can carry it
            labels[first], inserted = f"{KEPT}>{inserted}", ""
        if kind == "insert":
            inserted = words
        elif kind != "equal":
            labels[first:last] = [LEFT_OUT] * (last - first)
            labels[first] = f"={words}" if words else LEFT_OUT
    return None if inserted else tuple(labels)


def read_reader_corpus(path: Path | None = None) -> list[ReaderExample]:
    """Read a corpus of the reader; the package's by default.

    Sentences that cannot be labelled are skipped.

    Raises:
        ValueError: a line is invalid; the message has its number.
    """
    path = shipped_file("language", "readings.jsonl") if path is None else path
    rows = []
    for line_no, line in read_lines(path, at_most=_MAX_BYTES):
        row = parse_json(line)
        if not (isinstance(row, dict) and set(row) - {"names"} == {"text", "read"}):
            raise ValueError(f"{path.name} line {line_no} must have text, read, and maybe names")
        if type(row["text"]) is not str or type(row["read"]) not in (str, type(None)):
            raise ValueError(
                f"{path.name} line {line_no}: text and read must be texts, or read null"
            )
        rows.append(row)
    names = frozenset(name for row in rows for name in row.get("names", ()))
    examples = []
    for row in rows:
        words = tuple(token.text for token in split_text(row["text"], names))
        labels = (
            (UNREADABLE,) * len(words) if row["read"] is None else align(words, row["read"].split())
        )
        if words and labels is not None:
            examples.append(ReaderExample(words, labels, names))
    return examples


def vary_sentences(
    examples: Sequence[ReaderExample], seed: int, copies: int = 1
) -> list[ReaderExample]:
    """Augment the data: replace a verb by another of its class, or add small talk at either end.

    Each sentence is repeated, and varied, ``copies`` times; the variations come last. ``seed`` is
    that of the random choices.
    """
    rng, more = np.random.default_rng(seed), []
    talk = []  # deleted clauses without object names
    for ex in examples:
        sentence = ReaderSentence(ex.words, ex.names)
        for clause in sentence.clauses:
            is_idle = [ex.labels[i] == LEFT_OUT and not sentence.is_name[i] for i in clause]
            if len(clause) > 1 and all(is_idle):
                talk.append(tuple(ex.words[i] for i in clause))
    classes = [sorted(verbs) for _, verbs in sorted(load_verbs().items())]
    for ex in [*examples] * copies:
        verbs = [i for i, label in enumerate(ex.labels) if label in _PLAIN]
        for index in verbs[:1]:
            same = next((verbs for verbs in classes if ex.words[index] in verbs), [])
            if same:
                words = list(ex.words)
                words[index] = same[rng.integers(len(same))]
                more.append(ex._replace(words=tuple(words)))
        if talk and set(ex.labels) == {KEPT} and rng.random() < _SMALL_TALK_RATE:
            chat = talk[rng.integers(len(talk))]
            cut = (LEFT_OUT,) * (len(chat) + 1)
            mark = (MARKS[int(rng.integers(len(MARKS)))],)
            if rng.random() < 0.5:
                more.append(ReaderExample((*chat, *mark, *ex.words), cut + ex.labels, ex.names))
            else:
                more.append(ReaderExample((*ex.words, *mark, *chat), ex.labels + cut, ex.names))
    return [*examples] * copies + more


def negative_log_likelihood(weights: ReaderWeights, batch: Batch) -> Array:
    """Compute Σ −log p(labels | words) over a batch by the forward algorithm, f32[], nats."""
    scores = weights.emission.at[0].set(0.0)[batch.features].sum(axis=2)  # [B, T, L]

    def step(alpha: Array, inputs: tuple[Array, Array]) -> tuple[Array, None]:
        row, is_word = inputs
        summed = jax.nn.logsumexp(alpha[:, :, None] + weights.transition[None], axis=1) + row
        return jnp.where(is_word[:, None] > 0, summed, alpha), None

    rest = jnp.moveaxis(scores[:, 1:], 1, 0), jnp.asarray(batch.is_word[:, 1:]).T
    alpha, _ = jax.lax.scan(step, weights.begin[None] + scores[:, 0], rest)
    log_total = jax.nn.logsumexp(alpha + weights.end[None], axis=1)
    labels, is_word = jnp.asarray(batch.labels), jnp.asarray(batch.is_word)
    chosen = jnp.take_along_axis(scores, labels[..., None], axis=2)[..., 0]
    moved = weights.transition[labels[:, :-1], labels[:, 1:]]
    last = jnp.maximum(is_word.sum(axis=1).astype(jnp.int32) - 1, 0)
    ended = weights.end[jnp.take_along_axis(labels, last[:, None], axis=1)[:, 0]]
    path_score = (chosen * is_word).sum(1) + (moved * is_word[:, 1:]).sum(1)
    return ((log_total - path_score - weights.begin[labels[:, 0]] - ended) * batch.weight).sum()


def train_reader(
    examples: Sequence[ReaderExample], *, config: ReaderConfig
) -> tuple[ReaderModel, dict[str, Any]]:
    """Train a reader on labelled sentences, and report on the training.

    The report has sentences, features, labels, loss in nats a sentence, and seconds.

    Raises:
        ValueError: too few sentences to learn from.
    """
    started = time.perf_counter()
    counted = Counter(label for ex in examples for label in set(ex.labels))
    names = frozenset().union(*(ex.names for ex in examples))
    frequent = sorted(label for label, n in counted.items() if n >= config.least_labels)
    # A label that inserts an object name would insert it for any sentence.
    read = {label: tuple(label.lstrip("K>=").split()) for label in frequent}
    labels = tuple(ex for ex in frequent if not any(ReaderSentence(read[ex], names).is_name))
    used = [ex for ex in examples if set(ex.labels) <= set(labels)]
    if len(used) < config.batch:
        raise ValueError(f"{len(used)} sentences are too few to train on: {config.batch} at least")
    used = vary_sentences(used, config.seed, config.copies)
    named = [featurize(ex.words, ex.names) for ex in used]
    counts = Counter(name for sentence in named for word in sentence for name in set(word))
    min_count = config.least_features * config.copies
    features = tuple(sorted(name for name, n in counts.items() if n >= min_count))
    batches = _batches(used, named, features, labels, config)
    weights, loss = _fit(batches, len(features), labels, config)
    emission = np.where(np.abs(weights.emission[1:]) < config.smallest, 0.0, weights.emission[1:])
    is_used = np.abs(emission).max(axis=1) > 0
    pairs = (pair for ex in used for pair in zip(ex.words, ex.labels, strict=True))
    labelled = [Labelling(ReaderSentence(ex.words, ex.names), ex.labels) for ex in used]
    model = ReaderModel(
        features=tuple(name for name, used in zip(features, is_used, strict=True) if used),
        labels=labels,
        seen=frozenset((word, label) for word, label in pairs if label[0] == "="),
        left_out=_deleted_trigrams(used),
        # Edited spans with their replacement, except deletions of words that only select objects:
        # "both" may be deleted in one sentence, but not in others.
        met=frozenset(
            ex.stretch(run)
            for ex in labelled
            for run in ex.runs
            if any(ex.labels[i] != LEFT_OUT for i in run)
            or any(WORDS["choosing"].isdisjoint(ex.sentence.classes[i]) for i in run)
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


def _deleted_trigrams(examples: Sequence[ReaderExample]) -> frozenset[str]:
    """Collect deleted trigrams that begin with a negation, condition or the like: "if you could".

    Not those with object names or prohibitions, as in "don't go anywhere".
    """
    trigrams = set()
    for ex in examples:
        sentence = ReaderSentence(ex.words, ex.names)
        for index, label in enumerate(ex.labels):
            classes = sentence.classes[index]
            after = range(index + 1, min(index + 3, len(ex.words)))
            names = any(sentence.is_name[i] or "det" in sentence.classes[i] for i in after)
            forbids = "refused:negation" in classes and any(
                sentence.is_verb(i) or not WORDS["impossible"].isdisjoint(sentence.classes[i])
                for i in after
            )
            is_telling = not _DECISIVE.isdisjoint(classes)
            if label == LEFT_OUT and is_telling and not (names or forbids):
                trigrams.add(" ".join(ex.words[index : index + 3]))
    return frozenset(trigrams)


def _batches(
    examples: Sequence[ReaderExample],
    named: Sequence[list[list[str]]],
    features: Sequence[str],
    labels: Sequence[str],
    config: ReaderConfig,
) -> list[Batch]:
    """Pack sentences of similar length into padded batches."""
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
                active = [row[name] for name in word if name in row]
                batch.features[lane, time_step, : len(active)] = active
            size = len(named[index])
            batch.labels[lane, :size] = [column[label] for label in examples[index].labels]
            batch.is_word[lane, :size] = 1.0
        batches.append(batch)
    return batches


def _fit(
    batches: Sequence[Batch], num_features: int, labels: Sequence[str], config: ReaderConfig
) -> tuple[ReaderWeights, float]:
    """Minimise the objective with Adam, deterministically for the same batches and seed."""
    size = len(labels)
    weights = ReaderWeights(*map(jnp.zeros, ((num_features + 1, size), (size, size), size, size)))
    # Transitions between the refusal label and all others are impossible.
    is_refused = np.array([label == UNREADABLE for label in labels])
    mask = np.where(is_refused[:, None] == is_refused, 0.0, _IMPOSSIBLE).astype(np.float32)
    num_steps = config.epochs * len(batches)
    optimizer = optax.adam(optax.cosine_decay_schedule(config.rate, num_steps))

    def objective(weights: ReaderWeights, batch: Batch) -> Array:
        masked = weights._replace(transition=weights.transition + mask)
        mean = negative_log_likelihood(masked, batch) / jnp.maximum(batch.weight.sum(), 1.0)
        return mean + 0.5 * config.l2 * sum((leaf**2).sum() for leaf in weights)

    @jax.jit
    def update(
        weights: ReaderWeights, state: optax.OptState, batch: Batch
    ) -> tuple[Any, optax.OptState, Array]:
        loss, gradient = jax.value_and_grad(objective)(weights, batch)
        change, state = optimizer.update(gradient, state)
        return optax.apply_updates(weights, change), state, loss

    state, losses = optimizer.init(weights), []
    rng = np.random.default_rng(config.seed)
    for _ in range(config.epochs):
        losses = []
        for index in rng.permutation(len(batches)):
            weights, state, loss = update(weights, state, batches[index])
            losses.append(loss)
    weights = weights._replace(transition=weights.transition + mask)
    return jax.tree.map(np.asarray, weights), float(np.mean(losses))
