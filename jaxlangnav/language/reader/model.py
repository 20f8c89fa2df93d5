"""The linear-chain CRF that labels words: weights, scores, and the k likeliest labellings (ours).

    log p(labels | words) = s(y_1) + Σ_t x_t W y_t + Σ_t T(y_t-1, y_t) + e(y_n) − log Z

with x_t the features of word t that are on. A label is ``K`` (kept), ``D`` (left out), ``=words``
(these words instead), or ``K>words`` (kept, these words before it). A sentence that must be refused
has ``X`` throughout.
"""

import json
import os
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from jaxlangnav.inputs.arrays import faults_as_values, open_arrays, read_floats, read_text_entry
from jaxlangnav.inputs.documents import shipped_file
from jaxlangnav.inputs.whole_files import read_file, replacing
from jaxlangnav.language.phrase import LanguageError
from jaxlangnav.language.reader.features import featurize

OWN_READER = "JAXLANGNAV_READER"
"""Environment variable that names a reader of one's own, in place of the package's."""
KEPT, LEFT_OUT, UNREADABLE = "K", "D", "X"
_MAX_BYTES = 1 << 24
_MAX_TEXT = 1 << 21
_MAX_FEATURES, _MAX_LABELS = 1 << 16, 256


@dataclass(frozen=True)
class ReaderModel:
    """A trained reader."""

    features: tuple[str, ...]
    labels: tuple[str, ...]
    seen: frozenset[tuple[str, str]]  # (word, label) of the training, where the label has words
    left_out: frozenset[str]  # three words that begin with a telling one, left out in training
    met: frozenset[str]  # stretches that are not kept, with what is read for them, of the training
    emission: np.ndarray  # f32[F, L]
    transition: np.ndarray  # f32[L, L]
    begin: np.ndarray  # f32[L]
    end: np.ndarray  # f32[L]

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: index for index, name in enumerate(self.features)}

    def scores(self, words: Sequence[str], names: Collection[str]) -> np.ndarray:
        """Score the labels of each word by its features; ``names`` are of detected things.

        Log scores f64[T, L], what first and last labels add included, transitions not.
        """
        rows = [
            self.emission[[self._index[one] for one in named if one in self._index]].sum(axis=0)
            for named in featurize(words, names)
        ]
        scores = np.array(rows, np.float64)
        scores[0] += self.begin
        scores[-1] += self.end
        return scores


def log_partition(scores: np.ndarray, transition: np.ndarray) -> float:
    """Sum over all labellings, by the forward algorithm: log Z of f64[T, L] and f32[L, L]."""
    ahead = scores[0]
    for row in scores[1:]:
        ahead = np.logaddexp.reduce(ahead[:, None] + transition, axis=0) + row
    return float(np.logaddexp.reduce(ahead))


def find_best(
    scores: np.ndarray, transition: np.ndarray, count: int
) -> list[tuple[float, tuple[int, ...]]]:
    """Find the ``count`` likeliest labellings, by the Viterbi algorithm with lists.

    Args as of ``log_partition``. Returns log score and labels of each, the best first.
    """
    steps, num_labels = scores.shape
    best = np.full((num_labels, count), -np.inf)
    best[:, 0] = scores[0]
    came_from = np.zeros((steps, num_labels, count), np.int64)
    for step in range(1, steps):
        ways = (best[:, :, None] + transition[:, None, :]).reshape(-1, num_labels)
        chosen = np.argpartition(-ways, count - 1, axis=0)[:count]
        order = np.argsort(-np.take_along_axis(ways, chosen, 0), axis=0, kind="stable")
        chosen = np.take_along_axis(chosen, order, 0)
        best = np.take_along_axis(ways, chosen, 0).T + scores[step][:, None]
        came_from[step] = chosen.T
    flat = best.ravel()
    found = []
    for place in np.argsort(-flat, kind="stable")[:count]:
        if not np.isfinite(flat[place]):
            break
        path, at = [], int(place)
        for step in reversed(came_from):
            path.append(at // count)
            at = int(step.reshape(-1)[at])
        found.append((float(flat[place]), tuple(reversed(path))))
    return found


def save_reader(path: Path, model: ReaderModel, *, command: str) -> None:
    """Write a reader to an ``.npz`` file, all or nothing; ``command`` is what made it."""
    about = {"command": command, "features": model.features, "labels": model.labels}
    about |= {name: sorted(getattr(model, name)) for name in ("seen", "left_out", "met")}
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
    """Read a reader; whatever is wrong with it is a ``ValueError``."""
    with faults_as_values(), open_arrays(content) as archive:
        about = json.loads(read_text_entry(archive, "about", at_most=_MAX_TEXT))
        features, labels = tuple(about["features"]), tuple(about["labels"])
        if not (0 < len(features) <= _MAX_FEATURES and 0 < len(labels) <= _MAX_LABELS):
            raise ValueError(f"{len(features)} features and {len(labels)} labels")
        names = (*features, *labels, *about["left_out"], *about["met"])
        if any(type(one) is not str for one in names):
            raise ValueError("a name is no text")
        edges = read_floats(archive, "transition", (len(labels) + 2, len(labels)))
        return ReaderModel(
            features=features,
            labels=labels,
            seen=frozenset((str(word), str(label)) for word, label in about["seen"]),
            left_out=frozenset(about["left_out"]),
            met=frozenset(about["met"]),
            emission=read_floats(archive, "emission", (len(features), len(labels))),
            transition=edges[:-2],
            begin=edges[-2],
            end=edges[-1],
        )


@cache
def load_reader() -> ReaderModel:
    """Read the reader of the package, or the one that ``JAXLANGNAV_READER`` names.

    Raises:
        LanguageError: that file is no reader; one line.
    """
    own = os.environ.get(OWN_READER)
    if own is None:
        return _read(shipped_file("language", "reader.npz").read_bytes())
    try:
        return _read(read_file(Path(own), at_most=_MAX_BYTES))
    except (OSError, ValueError) as error:
        raise LanguageError(f"{OWN_READER}={own}: no reader can be read from it: {error}") from None
