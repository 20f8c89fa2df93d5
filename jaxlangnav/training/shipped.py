"""End-to-end training of the shipped models from a corpus (section 4.1).

Weights are fitted on the sentences marked "train". The temperature that divides the log-odds is
chosen on a fifth of those, left out of a first fit, so that the hold-out stays untouched.
"""

import dataclasses
import hashlib
import itertools
import json
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from jaxlangnav.grounding.binding import Detector
from jaxlangnav.grounding.instruction import GroundingModel, understand_parse
from jaxlangnav.grounding.model import CorrespondenceModel, Vocabulary
from jaxlangnav.grounding.rewrites import meaning_key
from jaxlangnav.grounding.search import BEAM_WIDTH
from jaxlangnav.grounding.weights import MODEL_KINDS, load_shipped
from jaxlangnav.language.corpus import Example, load_corpus, read_corpus
from jaxlangnav.language.lexicon import is_reserved, load_lexicon
from jaxlangnav.language.parser import Sentence, acceptance_features, parse_rewritings, parse_tokens
from jaxlangnav.language.phrase import LanguageError, Parse
from jaxlangnav.language.reader.model import ReaderModel
from jaxlangnav.training.examples import (
    Design,
    LabelledInstruction,
    labelled_instruction,
    model_examples,
)
from jaxlangnav.training.fit import build_design, fit
from jaxlangnav.training.reader import (
    CorpusLine,
    ReaderConfig,
    fit_acceptance,
    label_lines,
    train_reader,
)
from jaxlangnav.training.scoring import Scorer, Scores, calibration_error, fit_temperature

MIN_TEMP, MAX_TEMP = 0.05, 20.0
"""Bounds of the temperature search."""
_GRID_SIZE = 61
"""Number of temperatures of the initial grid search: the likelihood may have several peaks."""


class Judged(NamedTuple):
    """Parsed rewritings of one labelled sentence: log-probabilities and correctness."""

    log_probability: tuple[float, ...]
    is_right: tuple[bool, ...]


@dataclasses.dataclass(frozen=True)
class TemperatureFit:
    """Maximum likelihood temperature, with the likelihoods."""

    temperature: float
    log_likelihood: float  # mean over the informative sentences
    log_likelihood_at_one: float  # the same at temperature 1
    used: int  # sentences
    left_out: int
    is_at_bound: bool  # the optimum lies beyond the bounds


def log_likelihood(sentences: Sequence[Judged], temperature: float) -> float:
    """Compute the mean log-likelihood of labels of sentences that each have a right rewriting."""
    total = 0.0
    for it in sentences:
        scores = np.array(it.log_probability) / temperature
        total += np.logaddexp.reduce(scores[np.array(it.is_right)]) - np.logaddexp.reduce(scores)
    return float(total / len(sentences))


def fit_source_temperature(sentences: Sequence[Judged]) -> TemperatureFit:
    """Fit the temperature by maximum likelihood between ``MIN_TEMP`` and ``MAX_TEMP``.

    Raises:
        ValueError: no sentence is informative; one line.
    """
    informative = [it for it in sentences if any(it.is_right) and not all(it.is_right)]
    if not informative:
        raise ValueError(
            f"none of the {len(sentences)} sentences has both a right and a wrong rewriting that "
            "can be read: record more of them"
        )

    def loss(log_temperature: float) -> float:
        return -log_likelihood(informative, math.exp(log_temperature))

    grid = np.linspace(math.log(MIN_TEMP), math.log(MAX_TEMP), _GRID_SIZE)
    best = int(np.argmin([loss(point) for point in grid]))
    bounds = (grid[max(best - 1, 0)], grid[min(best + 1, _GRID_SIZE - 1)])
    result = minimize(lambda x: loss(float(x[0])), x0=grid[best : best + 1], bounds=[bounds])
    is_at_bound = best in (0, _GRID_SIZE - 1)
    temperature = math.exp(grid[best] if is_at_bound else result.x[0])
    return TemperatureFit(
        temperature=temperature,
        log_likelihood=log_likelihood(informative, temperature),
        log_likelihood_at_one=log_likelihood(informative, 1.0),
        used=len(informative),
        left_out=len(sentences) - len(informative),
        is_at_bound=is_at_bound,
    )


MODELS = tuple(MODEL_KINDS)


class TrainingData(NamedTuple):
    """Training data of one model: vocabulary, design and number of factors."""

    vocabulary: Vocabulary
    design: Design
    sizes: np.ndarray  # f[I] (phrase, symbol) factors of each instruction


def training_data(
    name: str, instructions: Sequence[LabelledInstruction], type_names: tuple[str, ...]
) -> TrainingData:
    """Build the training data of one of ``MODELS``."""
    examples = model_examples(name, instructions, type_names)
    sizes = np.zeros(len(instructions))
    for example in examples:
        sizes[example.instruction] += sum(len(block.labels) for block in example.blocks.values())
    return TrainingData(*build_design(examples, MODEL_KINDS[name], len(instructions)), sizes)


class Trained(NamedTuple):
    """Trained models, with a report of training and evaluation."""

    model: GroundingModel
    report: dict[str, Any]


def corpus_hash(examples: Sequence[Example]) -> str:
    """Hash the sentences and labels of a corpus, independent of the file format."""
    digest = hashlib.sha256()
    for example in examples:
        labels = [[sorted(symbols) for symbols in c.annotation] for c in example.clauses]
        digest.update(json.dumps([example.text, example.split, labels]).encode())
        for placed in (labelled.world for labelled in example.worlds):
            # Fixed: a hash of the record itself would change with its name and its fields.
            fields = f"objects={placed.objects}, robot={placed.robot}, previous={placed.previous}"
            digest.update(f"PlacedWorld({fields})".encode())
    return digest.hexdigest()[:16]


def train_models(
    corpus: Path | None = None,
    *,
    kinds: Sequence[str] = MODELS,
    base: GroundingModel | None = None,
    on_progress: Callable[[str], object] = lambda line: None,
) -> Trained:
    """Train one or both models on a corpus and evaluate them on its hold-out.

    Args:
        corpus: a corpus file, or a directory with ``corpus.jsonl``; the package's by default.
        kinds: "annotation", "behavior" or both.
        base: source of a model that is not trained.
        on_progress: called with a line about each stage.

    Raises:
        ValueError: the corpus is invalid, or has no sentence to train on; one model alone is
            trained without ``base``.
    """
    on_progress("reading the corpus")
    if corpus is None:
        examples = load_corpus()
    else:
        examples = read_corpus(corpus / "corpus.jsonl" if corpus.is_dir() else corpus)
    training = [example for example in examples if example.split == "train"]
    if not training:
        raise ValueError("the corpus has no sentence marked 'train'")
    if base is None and not set(MODELS) <= set(kinds):
        raise ValueError("to train one model alone, give the weights that the other comes from")
    tuning = set(sorted({example.template for example in training})[::5])
    type_names = load_lexicon().type_names
    is_tuning = np.array([example.template in tuning for example in training])
    training_instructions = [labelled_instruction(e, type_names) for e in training]
    held_out = [labelled_instruction(e, type_names) for e in examples if e.split == "test"]
    models = {} if base is None else {"annotation": base.annotation, "behavior": base.behavior}
    report: dict[str, Any] = {"corpus": corpus_hash(examples), "sentences": len(examples)}
    for name in [name for name in MODELS if name in kinds]:
        on_progress(f"fitting the {name} model")
        models[name], report[name] = _train_model(
            name, training_instructions, is_tuning, held_out, models, type_names
        )
    return Trained(GroundingModel(models["annotation"], models["behavior"], type_names), report)


def _train_model(
    name: str,
    train: Sequence[LabelledInstruction],
    is_tuning: np.ndarray,
    held_out: Sequence[LabelledInstruction],
    models: dict[str, CorrespondenceModel],
    type_names: tuple[str, ...],
) -> tuple[CorrespondenceModel, dict[str, Any]]:
    """Fit, tune and test one model; the behavior model is tested with the annotation model."""
    start = time.perf_counter()
    data = training_data(name, train, type_names)
    # Fits to all sentences, and to those not used for tuning, in one batch.
    fit_weights = np.stack([np.ones(len(train)), ~is_tuning]).astype(np.float32)
    weights, info = fit(data.design, fit_weights)
    full, part = (CorrespondenceModel(data.vocabulary, w) for w in weights)
    total_seconds = time.perf_counter() - start

    def score(
        model: CorrespondenceModel, temperature: float, tested: Sequence[LabelledInstruction]
    ) -> Scores:
        scaled = [dataclasses.replace(model, temperature=temperature)]
        scorer = Scorer(tested, type_names)
        if name == "annotation":
            return scorer.annotations(scaled).by_width[BEAM_WIDTH][0]
        return scorer.behaviors([models["annotation"]], scaled).by_width[BEAM_WIDTH][0]

    tuning = [*itertools.compress(train, is_tuning)]
    temperature = fit_temperature(lambda t: score(part, t, tuning))
    report = {
        "examples": int(data.sizes.sum()),
        "features": full.num_features,
        "train_s": round(info.seconds, 3),
        "train_compile_s": round(info.compile_seconds, 3),
        "total_s": round(total_seconds, 3),
        "steps": int(info.steps[0]),
        "temperature": temperature,
    }
    if held_out:
        before, after = (score(full, t, held_out) for t in (full.temperature, temperature))
        report |= {
            "held_out": len(after.is_right),
            "accuracy": round(after.accuracy, 4),
            "calibration_error_before": round(calibration_error(before), 4),
            "calibration_error": round(calibration_error(after), 4),
        }
    return dataclasses.replace(full, temperature=temperature), report


_MAX_BLOCK = 2200  # lines held out together: neighbours are of one author and one kind
_JUDGED = 2  # of the lines held out, one in so many is read


def train_shipped_reader(
    rows: Sequence[CorpusLine], on_progress: Callable[[str], None]
) -> tuple[ReaderModel, dict[str, Any]]:
    """Train a reader, and the acceptance of its rewritings on what such readers had not seen.

    Returns:
        The reader, and a report as of ``train_reader`` with ``judged``, the number of sentences
        that the acceptance was fitted to, and ``judged_right``, those that were read right.

    Raises:
        ValueError: too few sentences to learn from.
    """
    config, grounding, judged = ReaderConfig(), load_shipped(), []
    if len(rows) < 2 * config.batch:
        raise ValueError(f"{len(rows)} lines are too few to train on: {2 * config.batch} at least")
    # Of every three blocks the second is held out, then the third, which has the newest lines.
    fold_of = np.arange(len(rows)) // min(_MAX_BLOCK, len(rows) // 6 + 1) % 3
    for fold in (1, 2):
        on_progress(f"reading lines that are held out, part {fold} of 2")
        held = list(itertools.compress(rows, fold_of == fold))[::_JUDGED]
        rest = label_lines(list(itertools.compress(rows, fold_of != fold)))
        reader, _ = train_reader(rest, config=config)
        judged += [one for row in held if (one := _judge(row, reader, grounding)) is not None]
    if not judged:
        raise ValueError("the corpus has too little free speech that the grammar does not read")
    on_progress("training on all lines")
    model, report = train_reader(label_lines(rows), config=config)
    features, is_right = zip(*judged, strict=True)
    report |= {"judged": len(judged), "judged_right": sum(is_right)}
    acceptance = fit_acceptance(features, np.array(is_right))
    return dataclasses.replace(model, acceptance=acceptance), report


def _judge(
    row: CorpusLine, reader: ReaderModel, grounding: GroundingModel
) -> tuple[dict[str, float], bool] | None:
    """Judge the likeliest rewriting of a sentence; None if the grammar reads it, or nothing."""
    names = itertools.filterfalse(is_reserved, map(str.lower, row.names))
    detector = Detector(tuple(dict.fromkeys((*grounding.type_names, *names))))
    labels = detector.plain_labels

    def meaning(tree: Parse) -> tuple[Any, ...]:
        understood = understand_parse(tree, grounding, detector)
        if int(understood.instruction.num_clauses):
            understood.check_task()
        measures = (understood.instruction.metres, understood.instruction.frame)
        return (*meaning_key(understood.instruction), *(np.round(m, 2).tolist() for m in measures))

    sentence, plain = Sentence(row.text, labels), Sentence(row.read or "", labels)
    try:
        parse_tokens(sentence, sentence.tokens)
        return None
    except LanguageError as error:
        rewritings = [] if error.position is None else parse_rewritings(sentence, reader=reader)
    if not rewritings:
        return None
    try:
        expected = None if row.read is None else meaning(parse_tokens(plain, plain.tokens))
        return acceptance_features(rewritings), meaning(rewritings[0].parse) == expected
    except ValueError:
        return None
