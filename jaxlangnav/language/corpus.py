"""The corpus: instructions labelled per phrase, for annotation and for behavior (section 4.1).

A corpus is a text file of JSON documents, one instruction a line:

    {"text": "go to the hydrant behind the cone", "template": "rel-plain", "split": "train",
     "clauses": [{"kind": "command",
                  "phrases":    ["NP[the hydrant]", "NP[the cone]", "PP[behind]", ...],
                  "annotation": [["object(hydrant)"], ["object(cone)"], ["region(behind,cone)"]],
                  "rank":       [0, 0, 0]}],
     "worlds": [{"objects": [["hydrant", 8.1, 0.4], ["cone", 6.0, 0.2]], "robot": [0, 0, 0],
                 "previous": null,
                 "behavior": [[["object(0)"], ["object(1)"], ["region(behind,1)"], ...]]}]}

Phrases stand children before parents, as ``Phrase.walk`` yields them; ``annotation``, ``rank`` and
each clause of ``behavior`` have one list of symbols (one number) per phrase. Symbols are those of
``labels.py``. ``rank`` is 1 where a phrase says "nearest" (or "first", "farthest"), 2 for "second".
Objects have type, x and y (metres, map frame); ``robot`` is x, y and heading; ``previous`` is the
object that the command before this one led to, or null. ``split`` is "train" or "test".
A sentence is read by the grammar as it stands, and in other wordings only where that fails: what a
corpus teaches the graph of a word ("toward") is not what a rewriting makes of it.
``python -m jaxlangnav.language.corpus FILE`` checks a file.
"""

import math
import re
import sys
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from jaxlangnav.files.documents import DocumentError, parse_json, read_text
from jaxlangnav.files.limits import FARTHEST
from jaxlangnav.language.labels import ROBOT_LABEL, Labels, PlacedWorld
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import COMMAND, STATEMENT, LanguageError, Parse
from jaxlangnav.messages import ACTIONS, MODES, REGIONS, RELATIONS
from jaxlangnav.plain_text import cut, fault_of_name, printable, shown

SPLITS = ("train", "test")
LARGEST_CORPUS = 64 << 20
"""Bytes of a corpus; the one of the package has about a million."""
_MOST_OBJECTS = 32
"""Objects of one world of a corpus."""
_LONGEST_LINE = 1200
"""Characters of a complaint; one that lists the phrases of the longest sentence needs as many."""
_SYMBOL = re.compile(r"([a-z]+)\(([a-z0-9,_]*)\)")


class CorpusError(ValueError):
    """A corpus that breaks its format; one line naming file, line and what is wrong."""


@dataclass(frozen=True, kw_only=True)
class ClauseLabels:
    """Gold annotation of one clause, per phrase."""

    annotation: Labels  # per phrase of ``root.walk()``
    rank: tuple[int, ...]  # per phrase; 0: not superlative


@dataclass(frozen=True, kw_only=True)
class WorldLabels:
    """Gold behavior in one world, per clause and phrase."""

    world: PlacedWorld
    behavior: tuple[Labels, ...]  # per clause


@dataclass(frozen=True, kw_only=True)
class Example:
    """One labelled instruction."""

    text: str
    template: str  # sentences of one template are alike but for their words
    split: str  # "train" or "test"; a template is in one split only
    parse: Parse
    clauses: tuple[ClauseLabels, ...]
    worlds: tuple[WorldLabels, ...]


def _check(condition: bool, message: str) -> None:
    if not condition:
        raise CorpusError(cut(printable(message), _LONGEST_LINE))


def _check_annotation(symbol: str, types: tuple[str, ...]) -> None:
    """Check one annotation symbol."""
    match = _SYMBOL.fullmatch(symbol)
    _check(match is not None, f"'{symbol}' is no symbol; expected kind(argument,...)")
    kind, _, rest = symbol[:-1].partition("(")
    arguments = rest.split(",")
    landmarks = (*types, ROBOT_LABEL)
    legal = {
        "object": (types,),
        "region": (RELATIONS, landmarks),
        "relation": (types, RELATIONS, landmarks),
    }
    _check(kind in legal, f"'{symbol}': kind must be one of {', '.join(legal)}")
    _check_arguments(symbol, arguments, legal[kind])


def _check_behavior(symbol: str, num_objects: int) -> None:
    """Check one behavior symbol against the number of objects of its world."""
    match = _SYMBOL.fullmatch(symbol)
    _check(match is not None, f"'{symbol}' is no symbol; expected kind(argument,...)")
    kind, _, rest = symbol[:-1].partition("(")
    objects = tuple(str(index) for index in range(num_objects))
    places = (REGIONS, (*objects, ROBOT_LABEL))
    legal = {
        "object": (objects,), "region": places, "goal": places, "constraint": places,
        "action": (ACTIONS,), "mode": (MODES,),
    }  # fmt: skip
    _check(kind in legal, f"'{symbol}': kind must be one of {', '.join(legal)}")
    _check_arguments(symbol, rest.split(","), legal[kind])


def _check_arguments(symbol: str, arguments: list[str], legal: tuple[tuple[str, ...], ...]) -> None:
    count = len(legal)
    _check(len(arguments) == count, f"'{symbol}': expected {count} argument(s)")
    for argument, allowed in zip(arguments, legal, strict=True):
        _check(argument in allowed, f"'{symbol}': '{argument}' is none of {', '.join(allowed)}")


def _read_clause(record: dict[str, Any], found: Parse, index: int) -> ClauseLabels:
    """Read and check one clause against the tree the parser makes."""
    root, kind = found.clauses[index], found.kinds[index]
    heads = [
        f"{phrase.label}[{' '.join(word.text for word in phrase.words)}]" for phrase in root.walk()
    ]
    _check(record["kind"] == kind, f"clause {index}: kind is '{kind}', not '{record['kind']}'")
    _check(
        record["phrases"] == heads,
        f"clause {index}: the parser finds the phrases {' '.join(heads)}",
    )
    for key in ("annotation", "rank"):
        count = len(record[key])
        _check(count == len(heads), f"clause {index}: {count} {key} for {len(heads)} phrases")
    types = load_lexicon().type_names
    for symbols in record["annotation"]:
        for symbol in symbols:
            _check_annotation(symbol, types)
    _check(all(type(r) is int and r >= 0 for r in record["rank"]), "rank must be 0, 1, 2, ...")
    return ClauseLabels(
        annotation=tuple(frozenset(symbols) for symbols in record["annotation"]),
        rank=tuple(record["rank"]),
    )


def _read_world(record: dict[str, Any], found: Parse) -> WorldLabels:
    """Read and check one world and its behavior labels."""
    objects = _read_objects(record["objects"])
    previous = record["previous"]
    _check(
        previous is None or (type(previous) is int and 0 <= previous < len(objects)),
        f"previous must be null or an object's index below {len(objects)}, not {shown(previous)}",
    )
    _check(len(record["robot"]) == 3, "robot must be [x, y, heading]")
    _check(len(record["behavior"]) == len(found.clauses), "behavior needs one list per clause")
    for root, labels in zip(found.clauses, record["behavior"], strict=True):
        count = len(list(root.walk()))
        _check(len(labels) == count, f"behavior: {len(labels)} labels for {count} phrases")
        for symbols in labels:
            for symbol in symbols:
                _check_behavior(symbol, len(objects))
    x, y, heading = (_number(value) for value in record["robot"])
    return WorldLabels(
        world=PlacedWorld(objects=objects, robot=(x, y, heading), previous=previous),
        behavior=tuple(
            tuple(frozenset(symbols) for symbols in labels) for labels in record["behavior"]
        ),
    )


def _read_objects(records: list[Any]) -> tuple[tuple[str, float, float], ...]:
    """Read and check the objects of one world: type, x, y."""
    _check(len(records) <= _MOST_OBJECTS, f"{len(records)} objects: at most {_MOST_OBJECTS}")
    types = load_lexicon().type_names
    for record in records:
        _check(isinstance(record, list) and len(record) == 3, "an object must be [type, x, y]")
        _check(record[0] in types, f"object type {shown(record[0])} is none of {', '.join(types)}")
    return tuple((kind, _number(x), _number(y)) for kind, x, y in records)


def _number(value: Any) -> float:
    """Read a coordinate or an angle."""
    _check(type(value) in (int, float), f"{shown(value)} must be a number")
    is_near = math.isfinite(value) and abs(value) <= FARTHEST
    _check(is_near, f"{shown(value)} must lie between {-FARTHEST:g} and {FARTHEST:g}")
    return float(value)


def _check_texts(record: Any) -> None:
    """Check that a line is a table whose texts are texts."""
    _check(isinstance(record, dict), f"the line is {shown(record)}, but must be a table")
    for key in ("text", "template", "split"):
        _check(isinstance(record[key], str), f"{key} is {shown(record[key])}, but must be a text")
    fault = fault_of_name(record["template"])
    _check(fault is None, f"template {fault}")


def parse_labelled(text: str) -> Parse:
    """Read a sentence of a corpus: as it stands, or else in other wordings.

    Args:
        text: the sentence.

    Returns:
        Its trees.

    Raises:
        LanguageError: it is refused.
    """
    try:
        return parse(text, is_rewritten=False)
    except LanguageError:
        return parse(text)


def read_example(line: str) -> Example:
    """Read and check one line of a corpus.

    Args:
        line: a JSON document as the head of this module describes.

    Returns:
        The labelled instruction, parsed.

    Raises:
        CorpusError: what is wrong, in one line.
    """
    try:
        record = parse_json(line)
        _check_texts(record)
        found = parse_labelled(record["text"])
        _check(
            record["split"] in SPLITS, f"split must be train or test, not {shown(record['split'])}"
        )
        count = len(record["clauses"])
        _check(count == len(found.clauses), f"{count} clauses, parsed {len(found.clauses)}")
        clauses = [_read_clause(c, found, index) for index, c in enumerate(record["clauses"])]
        worlds = [_read_world(world, found) for world in record["worlds"]]
        return Example(
            text=record["text"], template=record["template"], split=record["split"],
            parse=found, clauses=tuple(clauses), worlds=tuple(worlds),
        )  # fmt: skip
    except DocumentError as error:
        raise CorpusError(f"the line {error}") from None
    except KeyError as error:
        raise CorpusError(f"key {error} is missing") from None
    except LanguageError as error:
        raise CorpusError(f"the text is refused: {error}") from None
    except (TypeError, AttributeError) as error:
        raise CorpusError(f"a value has the wrong form ({cut(str(error))})") from None


def read_corpus(path: str | Path) -> tuple[Example, ...]:
    """Read and check a corpus file; blank lines and lines that begin with ``#`` are skipped.

    Args:
        path: the file.

    Returns:
        Its labelled instructions, in order.

    Raises:
        CorpusError: the first fault, as ``file line N: what``.
    """
    path = Path(path)
    try:
        lines = read_text(path, at_most=LARGEST_CORPUS).splitlines()
    except OSError as error:
        raise CorpusError(f"cannot read {path}: {error.strerror}") from None
    except ValueError as error:
        raise CorpusError(str(error)) from None
    examples: list[Example] = []
    templates: dict[str, str] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            example = read_example(line)
            split = templates.setdefault(example.template, example.split)
            _check(split == example.split, f"template '{example.template}' is in both splits")
        except CorpusError as error:
            raise CorpusError(f"{cut(path.name)} line {number}: {error}") from None
        examples.append(example)
    _check(bool(examples), f"{path.name} holds no instruction")
    return tuple(examples)


@cache
def load_corpus(name: str = "corpus") -> tuple[Example, ...]:
    """Read a corpus of the package.

    Args:
        name: "corpus" (the large one) or "corpus39" (the paper's protocol).

    Returns:
        Its labelled instructions.
    """
    with resources.as_file(resources.files("jaxlangnav.language") / f"data/{name}.jsonl") as path:
        return read_corpus(path)


def main(arguments: list[str]) -> int:
    """Check the corpus files named; print one line for each; 0 when all are sound, else 2."""
    status = 0
    for path in arguments:
        try:
            examples = read_corpus(path)
        except CorpusError as error:
            print(printable(str(error)), file=sys.stderr)
            status = 2
            continue
        phrases = sum(len(c.rank) for example in examples for c in example.clauses)
        kinds = {COMMAND: 0, STATEMENT: 0}
        for example in examples:
            for kind in example.parse.kinds:
                kinds[kind] += 1
        told = f"{path}: {len(examples)} instructions, {phrases} phrases, {kinds}"
        print(printable(told))
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
