"""How often each of many models is right on the sentences held out from it (section 4.1).

The splits of a hold-out differ in their weights alone. So a sentence is described once, and
searched by all models that have not seen it together (``search_many``).
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import chex
import numpy as np

from jaxlangnav.grounding.annotation import Belief, clause_belief, join_clauses
from jaxlangnav.grounding.graph import Path
from jaxlangnav.grounding.model import CorrespondenceModel, Vocabulary
from jaxlangnav.grounding.properties import Annotations, Behaviors
from jaxlangnav.grounding.space import RANK
from jaxlangnav.grounding.symbols import Annotation
from jaxlangnav.grounding.weighed import WeighedPhrase, log_softmax, weigh_phrases
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.training.examples import MANY, LabelledInstruction, identify
from jaxlangnav.training.search_many import (
    Beams,
    Children,
    ManyLogOdds,
    search_exactly_many,
    search_many,
)


@dataclasses.dataclass(frozen=True)
class Scores:
    """Results on labelled sentences (and worlds)."""

    is_right: np.ndarray  # bool[E]
    confidence: np.ndarray  # f64[E] probability of the answer given
    log_gold: np.ndarray  # f64[E] log-probability of the gold answer, floored

    @property
    def accuracy(self) -> float:
        """Share that is right."""
        return float(self.is_right.mean()) if len(self.is_right) else float("nan")


@dataclasses.dataclass(frozen=True)
class ExactScores:
    """Results of the likeliest set of all, by enumeration as far as it is needed."""

    is_right: np.ndarray  # bool[E]
    is_proven: np.ndarray  # bool[E] no other set can be likelier (``search_exactly``)

    @property
    def accuracy(self) -> float:
        """Share that is right."""
        return float(self.is_right.mean()) if len(self.is_right) else float("nan")


class Results(NamedTuple):
    """What each of K models got, in the order of its sentences and their worlds."""

    by_width: dict[int, list[Scores]]  # beam width → K scores
    exact: list[ExactScores]  # K scores; empty where the exact search was left out


@dataclasses.dataclass(frozen=True)
class Models:
    """K models of one vocabulary side by side."""

    vocabulary: Vocabulary
    weights: dict[str, np.ndarray]  # kind → f32[K, W, F]
    temperature: np.ndarray  # f32[K]

    @classmethod
    def of(cls, models: Sequence[CorrespondenceModel]) -> "Models":
        """Stack models of one vocabulary."""
        stacked = {kind: np.stack([m.weights[kind] for m in models]) for kind in models[0].weights}
        temperature = np.array([model.temperature for model in models], np.float32)
        return cls(models[0].vocabulary, stacked, temperature)

    def take(self, which: np.ndarray) -> "Models":
        """Choose models, i[M]."""
        chosen = {kind: weight[which] for kind, weight in self.weights.items()}
        return Models(self.vocabulary, chosen, self.temperature[which])

    def coefficients(self, phrase: Phrase) -> dict[str, np.ndarray]:
        """Contract a phrase's words, f32[K, F] a kind; see ``CorrespondenceModel.coefficients``."""
        vector = self.vocabulary.vector(phrase)
        on = np.flatnonzero(vector)
        values = vector[on] / self.temperature[:, None]
        return {
            kind: np.einsum("kw,kwf->kf", values, weight[:, on])
            for kind, weight in self.weights.items()
        }


class Tallied:
    """Results of K models as they come in."""

    def __init__(self, num_models: int, widths: Sequence[int], is_exact: bool) -> None:
        """Begin with none."""
        self.rows = {width: [[] for _ in range(num_models)] for width in widths}
        self.exact = [[] for _ in range(num_models)] if is_exact else []

    def results(self) -> Results:
        """Stack what has come in."""

        def scores(rows: list[tuple[bool, float, float]]) -> Scores:
            right, confidence, log_gold = zip(*rows, strict=True) if rows else ((), (), ())
            return Scores(np.array(right, bool), np.array(confidence), np.array(log_gold))

        return Results(
            {width: [scores(rows) for rows in models] for width, models in self.rows.items()},
            [ExactScores(*np.array(rows, bool).reshape(-1, 2).T) for rows in self.exact],
        )


LOG_FLOOR = -12.0
"""Log-probability that a gold answer counts with where the beam has not got it."""


def gold_annotations(labelled: LabelledInstruction) -> frozenset[Annotation]:
    """Join the gold annotations at the roots of all clauses."""
    roots = (labelled.annotation[(i,)] for i in range(len(labelled.parse.clauses)))
    return frozenset().union(*roots)


def _compare(belief: Belief, gold: frozenset[Annotation]) -> tuple[bool, float, float]:
    """Compare a belief with the gold set, ranks summed out."""
    chance: dict[frozenset[Annotation], float] = {}
    for said, log_probability in belief.sets:
        symbols = frozenset(symbol for symbol, _ in said)
        chance[symbols] = chance.get(symbols, 0.0) + float(np.exp(log_probability))
    best = max(chance, key=lambda symbols: chance[symbols])
    log_gold = max(np.log(chance.get(gold, 0.0) + 1e-300), LOG_FLOOR)
    return best == gold, chance[best], log_gold


def _ranks(phrases: dict[Path, WeighedPhrase], num_models: int) -> list[dict[Path, np.ndarray]]:
    """Compute the log-probabilities of the ranks of every phrase by each model, f64[5] each."""
    found: list[dict[Path, np.ndarray]] = [{} for _ in range(num_models)]
    for path, (coefficients, described) in phrases.items():
        assert described.ranks is not None
        odds = coefficients[RANK] @ described.ranks.T
        for own, row in zip(found, odds, strict=True):
            own[path] = log_softmax(np.append(0.0, row))
    return found


def _many_log_odds(size: int, phrases: dict[Path, WeighedPhrase]) -> ManyLogOdds:
    """Build the log-odds of S symbols; what is seen of them is kept for all models."""
    tables = {}

    def log_odds(_: Phrase, path: Path, children: Children, which: np.ndarray) -> np.ndarray:
        coefficients, described = phrases[path]
        key = path, *(child.tobytes() for child in children)
        if key not in tables:
            blocks = described.given(children).items()
            tables[key] = [(kind, one.places, *_alike(one.properties)) for kind, one in blocks]
        odds = np.full((len(which), size), -np.inf)
        for kind, places, distinct, alike in tables[key]:
            odds[:, places] = (coefficients[kind][which] @ distinct.T)[:, alike]
        return odds

    return log_odds


def _alike(properties: np.ndarray) -> tuple[np.ndarray, slice | np.ndarray]:
    """Join equal symbols where there are many: f32[D, F] distinct ones, and which each is."""
    if len(properties) < MANY:
        return properties, slice(None)
    first, which = identify(properties)
    return properties[first], which


def _kept(
    root: Phrase, clause: int, log_odds: ManyLogOdds, num_models: int
) -> Callable[[int, np.ndarray], Beams]:
    """Search by some of the models; what all of them have been searched for is kept."""
    known: dict[int, Beams] = {}

    def beams_of(width: int, which: np.ndarray) -> Beams:
        if len(which) == num_models:
            if width not in known:
                known[width] = search_many(root, log_odds, num_models, width=width, path=(clause,))
            return known[width]
        chosen = which

        def of_chosen(
            phrase: Phrase, path: Path, children: Children, rows: np.ndarray
        ) -> np.ndarray:
            return log_odds(phrase, path, children, chosen[rows])

        return search_many(root, of_chosen, len(which), width=width, path=(clause,))

    return beams_of


def score_annotations(
    instructions: Sequence[LabelledInstruction],
    models: Models,
    is_tested: np.ndarray,
    type_names: tuple[str, ...],
    *,
    widths: Sequence[int],
    is_exact: bool = False,
    on_sentence: Callable[[], None] = lambda: None,
) -> Results:
    """Compare inferred annotations with the gold ones, one result per model and sentence.

    Args:
        instructions: I labelled sentences.
        models: K annotation models.
        is_tested: bool[K, I], which sentences each model is tested on.
        type_names: object types.
        widths: beam widths.
        is_exact: also find the likeliest of all sets.
        on_sentence: called after each sentence.

    Returns:
        Results of each model in the order of its sentences.
    """
    chex.assert_shape(is_tested, (len(models.temperature), len(instructions)))
    chex.assert_type(is_tested, bool)
    tally = Tallied(len(is_tested), widths, is_exact)
    for labelled, tested in zip(instructions, is_tested.T, strict=True):
        which = np.flatnonzero(tested)
        if len(which):
            _count_sentence(tally, labelled, which, models.take(which), type_names)
        on_sentence()
    return tally.results()


def _count_sentence(
    tally: Tallied,
    labelled: LabelledInstruction,
    which: np.ndarray,
    models: Models,
    type_names: tuple[str, ...],
) -> None:
    """Compare what models i[M] infer of one sentence with its gold annotations."""
    annotations, gold = Annotations(type_names), gold_annotations(labelled)
    space = annotations.symbols_in(None)
    everyone, searched, ranks = np.arange(len(which)), [], []
    for clause, root in enumerate(labelled.parse.clauses):
        phrases = weigh_phrases(annotations, models.coefficients, root, None, clause)
        odds = _many_log_odds(space.size, phrases)
        searched.append(_kept(root, clause, odds, len(which)))
        ranks.append(_ranks(phrases, len(which)))
    for width, rows in tally.rows.items():
        beams = [beams_of(width, everyone) for beams_of in searched]
        for place, model in enumerate(which):
            beliefs = [
                clause_belief(space, of_clause.of(place), clause, rank[place], width)
                for clause, (of_clause, rank) in enumerate(zip(beams, ranks, strict=True))
            ]
            rows[model].append(_compare(join_clauses(beliefs, width), gold))
    if tally.exact:
        found = [search_exactly_many(beams_of, len(which)) for beams_of in searched]
        said = np.any([best for best, _ in found], axis=0)
        is_right = (said == space.mask(gold)).all(1)
        is_proven = np.all([proven for _, proven in found], axis=0)
        for model, *row in zip(which, is_right, is_proven, strict=True):
            tally.exact[model].append(tuple(row))


def _by_rank(
    labelled: LabelledInstruction, annotation: Models, type_names: tuple[str, ...]
) -> Iterator[tuple[np.ndarray, dict[Path, int]]]:
    """Group models by the ranks they infer: i[M] models, and rank by phrase."""
    groups: dict[tuple, list[int]] = {}
    ranks: list[dict[Path, int]] = [{} for _ in annotation.temperature]
    space = Annotations(type_names)
    for clause, root in enumerate(labelled.parse.clauses):
        phrases = weigh_phrases(space, annotation.coefficients, root, None, clause)
        for own, chances in zip(ranks, _ranks(phrases, len(ranks)), strict=True):
            own |= {path: int(np.argmax(chance)) for path, chance in chances.items()}
    for model, own in enumerate(ranks):
        groups.setdefault(tuple(own.items()), []).append(model)
    for own, which in groups.items():
        yield np.array(which), dict(own)


def score_behaviors(
    instructions: Sequence[LabelledInstruction],
    annotation: Models,
    behavior: Models,
    is_tested: np.ndarray,
    type_names: tuple[str, ...],
    *,
    widths: Sequence[int],
    is_exact: bool = False,
    on_sentence: Callable[[], None] = lambda: None,
) -> Results:
    """Compare inferred behaviors with the gold ones, one result per model, sentence and world.

    Args:
        instructions: I labelled sentences with worlds.
        annotation: K annotation models (for ranks: "the second").
        behavior: K behavior models.
        is_tested: bool[K, I], which sentences each model is tested on.
        type_names: object types.
        widths: beam widths.
        is_exact: also find the likeliest of all sets.
        on_sentence: called after each sentence.

    Returns:
        Results of each model in the order of its sentences and their worlds.
    """
    chex.assert_shape(is_tested, (len(behavior.temperature), len(instructions)))
    chex.assert_type(is_tested, bool)
    chex.assert_equal_shape([annotation.temperature, behavior.temperature])
    tally = Tallied(len(is_tested), widths, is_exact)
    for labelled, tested in zip(instructions, is_tested.T, strict=True):
        which = np.flatnonzero(tested)
        groups = _by_rank(labelled, annotation.take(which), type_names) if len(which) else ()
        for group, rank in groups:
            own, space = behavior.take(which[group]), Behaviors(type_names, rank)
            for world, gold in zip(labelled.worlds, labelled.behavior, strict=True):
                symbols, clauses = space.symbols_in(world), []
                for clause, root in enumerate(labelled.parse.clauses):
                    if (clause,) in gold:
                        phrases = weigh_phrases(space, own.coefficients, root, world, clause)
                        odds = _many_log_odds(symbols.size, phrases)
                        beams_of = _kept(root, clause, odds, len(group))
                        clauses.append((beams_of, symbols.mask(gold[(clause,)])))
                _count_world(tally, which[group], clauses)
        on_sentence()
    return tally.results()


def _count_world(
    tally: Tallied,
    models: np.ndarray,
    clauses: Sequence[tuple[Callable[[int, np.ndarray], Beams], np.ndarray]],
) -> None:
    """Compare what models i[M] infer in one world with the gold sets of the clauses."""
    everyone = np.arange(len(models))
    for width, rows in tally.rows.items():
        right, confidence = np.ones(len(models), bool), np.ones(len(models))
        log_gold = np.zeros(len(models))
        for beams_of, gold in clauses:
            beams = beams_of(width, everyone)
            is_gold = (beams.sets == gold).all(1)[beams.index]
            is_gold &= np.isfinite(beams.log_probability)
            right &= is_gold[:, 0]
            confidence *= np.exp(beams.log_probability[:, 0])
            found = np.take_along_axis(beams.log_probability, is_gold.argmax(1)[:, None], 1)[:, 0]
            log_gold += np.where(is_gold.any(1), found, LOG_FLOOR)
        log_gold = np.maximum(log_gold, LOG_FLOOR)
        for model, *row in zip(models, right, confidence, log_gold, strict=True):
            rows[model].append(tuple(row))
    if tally.exact:
        right = proven = np.ones(len(models), bool)
        for beams_of, gold in clauses:
            best, is_sure = search_exactly_many(beams_of, len(models))
            right, proven = right & (best == gold).all(1), proven & is_sure
        for model, *row in zip(models, right, proven, strict=True):
            tally.exact[model].append(tuple(row))
