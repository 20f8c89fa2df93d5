"""The reader, a linear-chain CRF that labels words: scores and k-best labellings (ours).

    log p(labels | words) = s(y_1) + Σ_t x_t W y_t + Σ_t T(y_t-1, y_t) + e(y_n) − log Z

with x_t the indicator features of word t. A label is ``K`` (keep), ``D`` (delete), ``=words``
(replace by these words), or ``K>words`` (keep, and insert these words before it). A sentence that
must be refused has ``X`` throughout.
"""

import itertools
import json
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
from scipy.special import expit

from jaxlangnav.inputs.arrays import as_value_error, open_arrays, read_floats, read_text_entry
from jaxlangnav.inputs.atomic_files import read_file, replacing
from jaxlangnav.inputs.documents import shipped_file
from jaxlangnav.language.phrase import LanguageError
from jaxlangnav.language.reader.features import featurize

READER_ENV = "JAXLANGNAV_READER"
"""Environment variable that names a user's reader file, in place of the package's."""
KEEP, DELETE, REJECT = "K", "D", "X"
_NUM_CANDIDATES = 12  # labels of a word that are tried in the list of labellings
_MAX_BYTES = 1 << 24
_MAX_TEXT = 1 << 23
_MAX_FEATURES, _MAX_LABELS = 1 << 18, 512


@dataclass(frozen=True)
class ReaderModel:
    """Weights of a trained reader, with label statistics of its training data."""

    features: tuple[str, ...]
    labels: tuple[str, ...]
    met: frozenset[str]  # edited spans with their replacement, of the training data
    emission: np.ndarray  # f32[F, L]
    transition: np.ndarray  # f32[L, L]
    begin: np.ndarray  # f32[L]
    end: np.ndarray  # f32[L]
    acceptance: Mapping[str, float]  # weights of features of a rewriting

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: index for index, name in enumerate(self.features)}

    def accept(self, features: Mapping[str, float]) -> float:
        """Compute the probability that a rewriting with these features means what was said."""
        log_odds = sum(self.acceptance.get(name, 0.0) * value for name, value in features.items())
        return float(expit(log_odds))

    def scores(self, words: Sequence[str], names: Collection[str]) -> np.ndarray:
        """Compute emission scores of each word's labels; ``names`` are the detector's labels.

        Log scores f64[T, L], including those of the first and last label, without transitions.
        """
        rows = [
            self.emission[[self._index[name] for name in active if name in self._index]].sum(axis=0)
            for active in featurize(words, names)
        ]
        scores = np.array(rows, np.float64)
        scores[0] += self.begin
        scores[-1] += self.end
        return scores


def log_partition(scores: np.ndarray, transition: np.ndarray) -> float:
    """Compute log Z by the forward algorithm, from scores f64[T, L] and transitions f32[L, L]."""
    alpha = scores[0]
    for row in scores[1:]:
        alpha = np.logaddexp.reduce(alpha[:, None] + transition, axis=0) + row
    return float(np.logaddexp.reduce(alpha))


def find_best(
    scores: np.ndarray, transition: np.ndarray, count: int
) -> list[tuple[float, tuple[int, ...]]]:
    """Find the ``count`` likeliest labellings by the list Viterbi algorithm.

    Arguments as in ``log_partition``. Returns log score and labels of each, best first.
    """
    labels = np.argsort(-scores, axis=1)[:, :_NUM_CANDIDATES]  # of each word
    best = np.full((len(labels[0]), count), -np.inf)
    best[:, 0] = scores[0, labels[0]]
    backpointers = []
    for step, (before, now) in enumerate(itertools.pairwise(labels), start=1):
        moves = transition[np.ix_(before, now)][:, None, :]
        totals = (best[:, :, None] + moves).reshape(-1, len(now))
        top = np.argpartition(-totals, count - 1, axis=0)[:count]
        order = np.argsort(-np.take_along_axis(totals, top, 0), axis=0, kind="stable")
        top = np.take_along_axis(top, order, 0)
        best = np.take_along_axis(totals, top, 0).T + scores[step, now][:, None]
        backpointers.append(top.T)
    flat = best.ravel()
    labellings = []
    for end in np.argsort(-flat, kind="stable")[:count]:
        if not np.isfinite(flat[end]):
            break
        path, state = [int(labels[-1][end // count])], int(end)
        for allowed, pointers in zip(labels[-2::-1], reversed(backpointers), strict=True):
            state = int(pointers.reshape(-1)[state])
            path.append(int(allowed[state // count]))
        labellings.append((float(flat[end]), tuple(reversed(path))))
    return labellings


def save_reader(path: Path, model: ReaderModel, *, command: str) -> None:
    """Write a reader atomically to an ``.npz`` file; ``command`` is the training command."""
    about = {"command": command, "features": model.features, "labels": model.labels}
    about |= {"met": sorted(model.met), "acceptance": dict(model.acceptance)}
    edges = np.stack([model.begin, model.end])
    with replacing(path) as temporary:
        np.savez_compressed(
            temporary,
            allow_pickle=False,
            about=np.array(json.dumps(about)),
            emission=model.emission.astype(np.float32),
            transition=np.concatenate([model.transition, edges]).astype(np.float32),
        )


def _read(content: bytes) -> ReaderModel:
    """Load and validate a reader; any fault is a ``ValueError``."""
    with as_value_error(), open_arrays(content) as archive:
        about = json.loads(read_text_entry(archive, "about", max_length=_MAX_TEXT))
        features, labels = tuple(about["features"]), tuple(about["labels"])
        if not (0 < len(features) <= _MAX_FEATURES and 0 < len(labels) <= _MAX_LABELS):
            raise ValueError(f"{len(features)} features and {len(labels)} labels")
        names = (*features, *labels, *about["met"], *about["acceptance"])
        if any(type(name) is not str for name in names):
            raise ValueError("a name is no text")
        if not np.isfinite([*about["acceptance"].values()]).all():
            raise ValueError("a weight of the acceptance is not finite")
        edges = read_floats(archive, "transition", (len(labels) + 2, len(labels)))
        return ReaderModel(
            features=features,
            labels=labels,
            met=frozenset(about["met"]),
            emission=read_floats(archive, "emission", (len(features), len(labels))),
            transition=edges[:-2],
            begin=edges[-2],
            end=edges[-1],
            acceptance={name: float(w) for name, w in about["acceptance"].items()},
        )


@cache
def load_reader() -> ReaderModel:
    """Load the reader of the package, or the one that ``JAXLANGNAV_READER`` names.

    Raises:
        LanguageError: that file is no reader; one line.
    """
    env = os.environ.get(READER_ENV)
    if env is None:
        return _read(shipped_file("language", "reader.npz").read_bytes())
    try:
        return _read(read_file(Path(env), max_bytes=_MAX_BYTES))
    except (OSError, ValueError) as error:
        raise LanguageError(f"{READER_ENV}={env}: no reader can be read from it: {error}") from None
