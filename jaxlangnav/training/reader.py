"""Training of the reader, a linear-chain CRF, by MAP estimation with Adam (not in the paper).

    J = mean_s −log p(labels_s | words_s) + λ/2 Σ w²

A corpus line is ``{"text": free speech, "read": its rewriting in the controlled language}``, or
``"read": null`` if it must be refused; ``names`` lists labels of a detector for that sentence, and
it counts ``copies`` times. The labels come from aligning the two, word by word.
"""

import functools
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from msgspec import Meta, field
from scipy.optimize import minimize
from scipy.special import expit

from jaxlangnav.inputs.documents import error_prefix, parse_json, read_lines, shipped_file
from jaxlangnav.inputs.schema import Schema, convert
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.parser import Sentence
from jaxlangnav.language.reader.features import ReaderSentence, featurize, load_verbs
from jaxlangnav.language.reader.model import DELETE, KEEP, REJECT, ReaderModel
from jaxlangnav.language.reader.proposals import Labelling, met_spans
from jaxlangnav.language.tokens import MARKS

_MAX_BYTES = 1 << 24  # of a corpus
_SIMPLE_LABELS = frozenset({"=go", "=go to", "=stop"})
_SMALL_TALK_RATE = 0.3  # probability of adding small talk to a verbatim sentence
_IMPOSSIBLE = -1e4  # log score of an impossible transition
_TINY = 1e-30  # added before the logarithm of a sum that may underflow
_MIN_JUDGED = 20  # features of the acceptance that fewer sentences have are dropped
_ACCEPTANCE_L2 = 10.0
_PADDING = 8  # lengths are rounded up to a multiple of this, to limit compilations


class ReaderConfig(NamedTuple):
    """Hyperparameters of the training of a reader."""

    epochs: int = 9
    batch: int = 512  # sentences
    rate: float = 0.12  # of Adam, with cosine decay to 0
    l2: float = 2e-5
    least_features: int = 3  # rarer features are dropped
    least_labels: int = 3  # different sentences; rarer labels are dropped
    smallest: float = 0.03  # smaller weights are set to 0
    seed: int = 0


class ReaderExample(NamedTuple):
    """A sentence and the label of each of its words."""

    words: tuple[str, ...]
    labels: tuple[str, ...]
    names: frozenset[str]


class ReaderWeights(NamedTuple):
    """Trainable weights of the CRF."""

    emission: Array  # f32[F, L]
    transition: Array  # f32[L, L]
    begin: Array  # f32[L]
    end: Array  # f32[L]


class Batch(NamedTuple):
    """A padded batch of sentences of similar length."""

    features: np.ndarray  # i32[B, T, K] rows of the emission; F: none
    labels: np.ndarray  # i32[B, T]
    is_word: np.ndarray  # f32[B, T]
    weight: np.ndarray  # f32[B] 0 of padding


def align(source: Sequence[str], target: Sequence[str]) -> tuple[str, ...] | None:
    """Label each word (or mark) of a sentence by its alignment to the controlled language.

    None if words are added at the end, which labels cannot express.
    """
    labels, inserted = [KEEP] * len(source), ""
    matcher = SequenceMatcher(None, source, target, autojunk=False)
    for operation, start, stop, begin, end in matcher.get_opcodes():
        replacement = " ".join(target[begin:end])
        if inserted:  # inserted before: only a kept word can express it
            labels[start], inserted = f"{KEEP}>{inserted}", ""
        if operation == "insert":
            inserted = replacement
        elif operation != "equal":
            labels[start:stop] = [DELETE] * (stop - start)
            labels[start] = f"={replacement}" if replacement else DELETE
    return None if inserted else tuple(labels)


class CorpusLine(Schema):
    """A line of a corpus of the reader."""

    text: str
    read: str | None
    names: list[str] = field(default_factory=list)
    copies: Annotated[int, Meta(ge=1, le=100)] = 1

    def __post_init__(self) -> None:
        """Accept any characters, unlike the base class."""


def read_reader_corpus(path: Path | None = None) -> list[CorpusLine]:
    """Read a corpus of the reader; the package's by default.

    Raises:
        ValueError: a line is invalid; the message has its number.
    """
    path = shipped_file("language", "readings.jsonl") if path is None else path
    rows = []
    for line_no, line in read_lines(path, max_bytes=_MAX_BYTES):
        with error_prefix(f"{path.name} line {line_no}"):
            rows.append(convert(parse_json(line), CorpusLine))
    return rows


def label_lines(rows: Sequence[CorpusLine]) -> list[ReaderExample]:
    """Label the words of each line by alignment with its rewriting; skip lines that have none."""
    examples = []
    # A name that is another word as well ("keep", "drive") is one only where its line says so.
    pooled = frozenset(name.lower() for row in rows for name in row.names)
    pooled -= load_lexicon().vocabulary.union(*load_verbs().values())

    @functools.cache  # thousands of names: one set for all lines that add none, or the same
    def with_names(more: frozenset[str]) -> frozenset[str]:
        return pooled | more

    for row in rows:
        names = with_names(frozenset(map(str.lower, row.names)) - pooled)
        words = tuple(token.text for token in Sentence(row.text, names).tokens)
        read = None if row.read is None else row.read.lower().split()
        labels = (REJECT,) * len(words) if read is None else align(words, read)
        if words and labels is not None:
            examples += [ReaderExample(words, labels, names)] * row.copies
    return examples


def vary_sentences(examples: Sequence[ReaderExample], seed: int) -> list[ReaderExample]:
    """Augment the data: replace a verb by another of its class, or add small talk at either end.

    The variations come last. ``seed`` is that of the random choices.
    """
    rng, variations = np.random.default_rng(seed), []
    small_talk = []  # deleted clauses without object names
    for ex in examples:
        sentence = ReaderSentence(ex.words, ex.names)
        for clause in sentence.clauses:
            is_idle = [ex.labels[i] == DELETE and not sentence.is_name[i] for i in clause]
            if len(clause) > 1 and all(is_idle):
                small_talk.append(tuple(ex.words[i] for i in clause))
    classes = [sorted(verbs) for _, verbs in sorted(load_verbs().items())]
    for ex in examples:
        verbs = [i for i, label in enumerate(ex.labels) if label in _SIMPLE_LABELS]
        for index in verbs[:1]:
            alternatives = next((verbs for verbs in classes if ex.words[index] in verbs), [])
            if alternatives:
                words = list(ex.words)
                words[index] = alternatives[rng.integers(len(alternatives))]
                variations.append(ex._replace(words=tuple(words)))
        if small_talk and set(ex.labels) == {KEEP} and rng.random() < _SMALL_TALK_RATE:
            chat = small_talk[rng.integers(len(small_talk))]
            deleted = (DELETE,) * (len(chat) + 1)
            separator = (MARKS[int(rng.integers(len(MARKS)))],)
            if rng.random() < 0.5:
                words, labels = (*chat, *separator, *ex.words), deleted + ex.labels
            else:
                words, labels = (*ex.words, *separator, *chat), ex.labels + deleted
            variations.append(ReaderExample(words, labels, ex.names))
    return [*examples, *variations]


def negative_log_likelihood(weights: ReaderWeights, batch: Batch) -> Array:
    """Compute Σ −log p(labels | words) over a batch by the forward algorithm, f32[], nats."""
    rows = weights.emission.at[batch.features].get(mode="fill", fill_value=0.0)
    scores = rows.sum(axis=2)  # [B, T, L]
    exp_transition = jnp.exp(weights.transition)  # a matrix product in place of L² exponentials

    def step(alpha: Array, inputs: tuple[Array, Array]) -> tuple[Array, None]:
        score, is_word = inputs
        peak = jax.lax.stop_gradient(alpha.max(axis=1, keepdims=True))
        next_alpha = jnp.log(jnp.exp(alpha - peak) @ exp_transition + _TINY) + peak + score
        return jnp.where(is_word[:, None] > 0, next_alpha, alpha), None

    rest = jnp.moveaxis(scores[:, 1:], 1, 0), jnp.asarray(batch.is_word[:, 1:]).T
    alpha, _ = jax.lax.scan(step, weights.begin[None] + scores[:, 0], rest)
    log_total = jax.nn.logsumexp(alpha + weights.end[None], axis=1)
    labels, is_word = jnp.asarray(batch.labels), jnp.asarray(batch.is_word)
    emissions = jnp.take_along_axis(scores, labels[..., None], axis=2)[..., 0]
    transitions = weights.transition[labels[:, :-1], labels[:, 1:]]
    last = jnp.maximum(is_word.sum(axis=1).astype(jnp.int32) - 1, 0)
    end_score = weights.end[jnp.take_along_axis(labels, last[:, None], axis=1)[:, 0]]
    path_score = (emissions * is_word).sum(1) + (transitions * is_word[:, 1:]).sum(1)
    return ((log_total - path_score - weights.begin[labels[:, 0]] - end_score) * batch.weight).sum()


def train_reader(
    examples: Sequence[ReaderExample], *, config: ReaderConfig
) -> tuple[ReaderModel, dict[str, Any]]:
    """Train a reader on labelled sentences, and report on the training.

    The report has sentences, features, labels, loss in nats a sentence, and seconds.

    Raises:
        ValueError: too few sentences to learn from.
    """
    start_time = time.perf_counter()
    label_counts = Counter(label for ex in set(examples) for label in set(ex.labels))
    names = frozenset.intersection(*(ex.names for ex in examples))
    frequent = sorted(label for label, n in label_counts.items() if n >= config.least_labels)
    # A label that inserts an object name would insert it for any sentence.
    insertions = {label: tuple(label.lstrip("K>=").split()) for label in frequent}
    labels = tuple(it for it in frequent if not any(ReaderSentence(insertions[it], names).is_name))
    kept = [ex for ex in examples if set(ex.labels) <= set(labels)]
    if len(kept) < config.batch:
        raise ValueError(f"{len(kept)} sentences are too few to train on: {config.batch} at least")
    kept = vary_sentences(kept, config.seed)
    feature_names = [
        [[*map(sys.intern, word)] for word in featurize(ex.words, ex.names)] for ex in kept
    ]
    counts = Counter(name for sentence in feature_names for word in sentence for name in set(word))
    features = tuple(sorted(name for name, n in counts.items() if n >= config.least_features))
    batches = _batches(kept, feature_names, features, labels, config)
    del feature_names  # gigabytes
    weights, loss = _fit(batches, len(features), labels, config)
    emission = np.where(np.abs(weights.emission) < config.smallest, 0.0, weights.emission)
    is_used = np.abs(emission).max(axis=1) > 0
    model = ReaderModel(
        features=tuple(name for name, used in zip(features, is_used, strict=True) if used),
        labels=labels,
        met=met_spans(Labelling(ReaderSentence(e.words, e.names), e.labels) for e in kept),
        emission=np.round(emission[is_used], 3),
        transition=np.asarray(weights.transition),
        begin=np.asarray(weights.begin),
        end=np.asarray(weights.end),
        acceptance={},
    )
    return model, {
        "sentences": len(kept),
        "features": len(model.features),
        "labels": len(labels),
        "weights": int(np.count_nonzero(model.emission)),
        "loss": loss,
        "train_s": time.perf_counter() - start_time,
    }


def _batches(
    examples: Sequence[ReaderExample],
    feature_names: Sequence[list[list[str]]],
    features: Sequence[str],
    labels: Sequence[str],
    config: ReaderConfig,
) -> list[Batch]:
    """Pack sentences of similar length into padded batches."""
    feature_index = {name: index for index, name in enumerate(features)}
    label_index = {label: index for index, label in enumerate(labels)}
    width = max(len(word) for sentence in feature_names for word in sentence)
    order = sorted(range(len(examples)), key=lambda i: len(examples[i].words))
    batches = []
    for start in range(0, len(order), config.batch):
        indices = order[start : start + config.batch]
        length = -(-len(examples[indices[-1]].words) // _PADDING) * _PADDING
        shape = config.batch, length
        batch = Batch(
            np.full((*shape, width), len(features), np.int32),
            np.zeros(shape, np.int32),
            np.zeros(shape, np.float32),
            (np.arange(config.batch) < len(indices)).astype(np.float32),
        )
        for slot, index in enumerate(indices):
            for time_step, word in enumerate(feature_names[index]):
                active = [feature_index[name] for name in word if name in feature_index]
                batch.features[slot, time_step, : len(active)] = active
            size = len(feature_names[index])
            batch.labels[slot, :size] = [label_index[label] for label in examples[index].labels]
            batch.is_word[slot, :size] = 1.0
        batches.append(batch)
    return batches


def _fit(
    batches: Sequence[Batch], num_features: int, labels: Sequence[str], config: ReaderConfig
) -> tuple[ReaderWeights, float]:
    """Minimise the objective with Adam, deterministically for the same batches and seed."""
    size = len(labels)
    weights = ReaderWeights(*map(jnp.zeros, ((num_features, size), (size, size), size, size)))
    # Transitions between the refusal label and all others are impossible.
    is_refused = np.array([label == REJECT for label in labels])
    mask = np.where(is_refused[:, None] == is_refused, 0.0, _IMPOSSIBLE).astype(np.float32)
    num_steps = config.epochs * len(batches)
    optimizer = optax.adam(optax.cosine_decay_schedule(config.rate, num_steps))

    def objective(weights: ReaderWeights, batch: Batch) -> Array:
        masked = weights._replace(transition=weights.transition + mask)
        mean = negative_log_likelihood(masked, batch) / jnp.maximum(batch.weight.sum(), 1.0)
        return mean + 0.5 * config.l2 * sum((leaf**2).sum() for leaf in weights)

    @functools.partial(jax.jit, donate_argnums=(0, 1))
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


def fit_acceptance(
    features: Sequence[Mapping[str, float]], is_right: np.ndarray
) -> dict[str, float]:
    """Fit a logistic model of whether rewritings are right, bool[N]; L2 but on the bias."""
    counts = Counter(name for row in features for name in row)
    names = sorted(name for name, count in counts.items() if count >= _MIN_JUDGED)
    matrix = np.array([[row.get(name, 0.0) for name in names] for row in features])
    penalty = np.where(np.array(names) == "bias", 0.0, _ACCEPTANCE_L2)

    def loss(weights: np.ndarray) -> tuple[float, np.ndarray]:
        log_odds = matrix @ weights
        value = np.logaddexp(0.0, log_odds).sum() - log_odds[is_right].sum()
        gradient = matrix.T @ (expit(log_odds) - is_right)
        return value + 0.5 * penalty @ weights**2, gradient + penalty * weights

    found = minimize(loss, np.zeros(len(names)), jac=True, method="L-BFGS-B")
    return dict(zip(names, np.round(found.x, 3).tolist(), strict=True))
