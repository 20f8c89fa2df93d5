"""Weight files of the trained models: saving, validated loading, and provenance.

A file holds both models, the object types, the training command and a hash of the corpus. It is
untrusted input: names, shapes and types are checked before anything large is allocated.
"""

import json
from functools import cache
from pathlib import Path
from typing import Annotated, TypeVar
from zipfile import ZipFile

import numpy as np
from msgspec import Meta, field

from jaxlangnav.grounding.instruction import GroundingModel
from jaxlangnav.grounding.model import (
    ANNOTATION_KINDS,
    BEHAVIOR_KINDS,
    CorrespondenceModel,
    Vocabulary,
)
from jaxlangnav.grounding.properties import property_names
from jaxlangnav.inputs.arrays import as_value_error, open_arrays, read_floats, read_text_entry
from jaxlangnav.inputs.atomic_files import read_file, replacing
from jaxlangnav.inputs.documents import shipped_file
from jaxlangnav.inputs.schema import Schema, convert
from jaxlangnav.language.lexicon import load_lexicon

SHIPPED_WEIGHTS = "weights.npz"
_MAX_BYTES = 1 << 22  # size limit of a file; the shipped one has 110 kB
_MAX_TEXT = 1 << 19
"""Length limit of a JSON document in it; the shipped one's longest has 6,382 characters."""
_MAX_NAMES = 1 << 14  # limit on the word features of a model; the shipped ones have 346 and 340
_MAX_WEIGHT = 1e6
"""Limit on the log-odds of one feature; the shipped ones reach 6.6. Larger sums may overflow."""
MODEL_KINDS = {"annotation": ANNOTATION_KINDS, "behavior": BEHAVIOR_KINDS}
"""Kinds of symbols of each model."""


class _Provenance(Schema):
    command: str
    corpus: str
    types: list[str]


class _Header(Schema):
    names: Annotated[list[str], Meta(min_length=1, max_length=_MAX_NAMES)]
    without: list[str]
    temperature: Annotated[float, Meta(ge=0.01, le=100.0)]
    properties: dict[str, list[str]] = field(default_factory=dict)


_Document = TypeVar("_Document", bound=Schema)


def _unpack(name: str, archive: ZipFile) -> CorrespondenceModel:
    header = _document(archive, f"{name}.json", _Header)
    if len(set(header.names)) < len(header.names):
        raise ValueError(f"{name}: one of {len(header.names)} names of features stands twice")
    for kind, columns in header.properties.items():
        if kind not in MODEL_KINDS[name] or tuple(columns) != property_names()[kind]:
            raise ValueError(f"the properties of {kind!r} are others than this version's")
    weights = {}
    for kind in MODEL_KINDS[name]:
        shape = len(header.names), len(property_names()[kind])
        weights[kind] = read_floats(archive, f"{name}/{kind}", shape)
        if np.abs(weights[kind]).max() > _MAX_WEIGHT:
            raise ValueError(f"{name}/{kind}: a weight is beyond {_MAX_WEIGHT:,.0f}")
    vocabulary = Vocabulary(tuple(header.names), frozenset(header.without))
    return CorrespondenceModel(vocabulary, weights, header.temperature)


def _document(archive: ZipFile, name: str, schema: type[_Document]) -> _Document:
    text = read_text_entry(archive, name, max_length=_MAX_TEXT)
    with as_value_error():
        return convert(json.loads(text), schema, where=name)


def save(path: Path, model: GroundingModel, *, command: str, corpus_hash: str) -> None:
    """Write weights atomically as ``.npz``, with their training command and corpus hash."""
    about = {"command": command, "corpus": corpus_hash, "types": model.type_names}
    arrays = {"about": np.array(json.dumps(about))}
    for name, part in (("annotation", model.annotation), ("behavior", model.behavior)):
        for kind, weight in part.weights.items():
            arrays[f"{name}/{kind}"] = weight.astype(np.float32)
        header = {
            "names": part.vocabulary.names,
            "without": sorted(part.vocabulary.without),
            "temperature": part.temperature,
            "properties": {kind: property_names()[kind] for kind in part.weights},
        }
        arrays[f"{name}.json"] = np.array(json.dumps(header))
    with replacing(path) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, **arrays)


def load(path: Path | None) -> GroundingModel:
    """Load weights written by ``save``; the shipped ones if ``path`` is None.

    Object types come from the lexicon, which may have more than the weights were trained with.
    Names, shapes and types are validated, and numbers are finite.

    Raises:
        ValueError: the file is not readable as weights, or its types disagree with the lexicon.
    """
    if path is None:
        return load_shipped()
    weights = [f"{name}/{kind}.npy" for name, kinds in MODEL_KINDS.items() for kind in kinds]
    members = ["about.npy", *(f"{name}.json.npy" for name in MODEL_KINDS), *weights]
    try:
        archive = open_arrays(read_file(path, max_bytes=_MAX_BYTES))
        if sorted(archive.namelist()) != sorted(members):
            raise ValueError("its arrays are not those of two models")
        trained = tuple(_document(archive, "about", _Provenance).types)
        annotation, behavior = (_unpack(name, archive) for name in MODEL_KINDS)
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        why = why.removeprefix(f"{path}: ")
        raise ValueError(f"{path}: not a file of weights ({why})") from error
    type_names = load_lexicon().type_names
    if type_names[: len(trained)] != trained:
        listed = str(trained)[:200]
        raise ValueError(f"{path}: trained with types {listed}, but the lexicon has {type_names}")
    return GroundingModel(annotation, behavior, type_names)


@cache
def load_shipped() -> GroundingModel:
    """Load the shipped weights, cached."""
    return load(shipped_file("grounding", SHIPPED_WEIGHTS))
