"""The shipped weights: saving, loading, and where they came from.

A file holds both models, the object types, the command that made it and a hash of the corpus.
"""

import json
from functools import cache
from importlib import resources
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from jaxlangnav.grounding.behavior_properties import PROPERTY_NAMES
from jaxlangnav.grounding.instruction import GroundingModel
from jaxlangnav.grounding.model import CorrespondenceModel, Vocabulary
from jaxlangnav.language.lexicon import load_lexicon

SHIPPED = "weights.npz"


def _pack(name: str, model: CorrespondenceModel) -> dict[str, np.ndarray]:
    """Flatten a model to named arrays; weights too small to matter are dropped."""
    arrays = {f"{name}/{kind}": weight.astype(np.float32) for kind, weight in model.weights.items()}
    header = {
        "names": model.vocabulary.names,
        "without": sorted(model.vocabulary.without),
        "temperature": model.temperature,
        "properties": {k: PROPERTY_NAMES[k] for k in model.weights if k in PROPERTY_NAMES},
    }
    return arrays | {f"{name}.json": np.array(json.dumps(header))}


def _unpack(name: str, arrays: dict[str, np.ndarray]) -> CorrespondenceModel:
    """Build a model from named arrays."""
    header = json.loads(str(arrays[f"{name}.json"]))
    prefix = f"{name}/"
    weights = {key.removeprefix(prefix): a for key, a in arrays.items() if key.startswith(prefix)}
    for kind, names in header.get("properties", {}).items():
        if tuple(names) != PROPERTY_NAMES.get(kind):
            raise ValueError(f"the properties of '{kind}' are others than this version's")
    vocabulary = Vocabulary(tuple(header["names"]), frozenset(header["without"]))
    return CorrespondenceModel(vocabulary, weights, float(header["temperature"]))


def save(path: Path, model: GroundingModel, *, command: str, corpus_hash: str) -> None:
    """Write weights.

    Args:
        path: file to write, ``.npz``.
        model: both models.
        command: what made them, for whoever wants to make them again.
        corpus_hash: of the corpus they were trained on.
    """
    about = {"command": command, "corpus": corpus_hash, "types": model.type_names}
    arrays = _pack("annotation", model.annotation) | _pack("behavior", model.behavior)
    np.savez_compressed(path, allow_pickle=False, **arrays, about=np.array(json.dumps(about)))


def load(path: Path) -> GroundingModel:
    """Read weights.

    Object types come from the lexicon, which may have more than the weights were trained with.

    Args:
        path: file written by ``save``.

    Returns:
        Both models.

    Raises:
        ValueError: the file is not readable as weights, or its types disagree with the lexicon.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        trained = tuple(json.loads(str(arrays["about"]))["types"])
        models = _unpack("annotation", arrays), _unpack("behavior", arrays)
    except (OSError, EOFError, KeyError, ValueError, BadZipFile) as error:
        raise ValueError(f"{path}: not a file of weights ({error})") from error
    type_names = load_lexicon().type_names
    if type_names[: len(trained)] != trained:
        raise ValueError(f"{path}: trained with types {trained}, but the lexicon has {type_names}")
    return GroundingModel(*models, type_names)


def about(path: Path) -> dict[str, object]:
    """Read where weights came from: command, corpus hash, types."""
    with np.load(path, allow_pickle=False) as archive:
        return json.loads(str(archive["about"]))


def shipped_path() -> Path:
    """Find the weights of the package."""
    return Path(str(resources.files("jaxlangnav.grounding"))) / "data" / SHIPPED


@cache
def load_shipped() -> GroundingModel:
    """Read the weights of the package; the same object at every call."""
    return load(shipped_path())
