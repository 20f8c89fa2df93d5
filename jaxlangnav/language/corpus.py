"""The corpus of instructions with gold annotations and behaviors per phrase (section 4.1).

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
each clause of ``behavior`` have one list of symbols (one number) per phrase: of object types, with
``robot`` for the robot, or of objects of the world by index (``scripts/corpus_labels.py`` composes
them). ``rank`` is 1 where a phrase says "nearest" (or "first", "farthest"), 2 for "second".
Objects have type, x and y (metres, map frame); ``robot`` is x, y and heading; ``previous`` is the
object that the command before this one led to, or null. ``split`` is "train" or "test".
A sentence is parsed by the grammar alone, so that the graph learns its words, not a rewriting's.
``python -m jaxlangnav.language.corpus FILE`` checks a file.
"""

import itertools
import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from msgspec import Meta

from jaxlangnav.inputs.documents import error_prefix, parse_json, read_lines, shipped_file
from jaxlangnav.inputs.limits import MAX_METRES
from jaxlangnav.inputs.sanitize import as_text, sanitize, shorten
from jaxlangnav.inputs.schema import Name, Schema, convert
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import COMMAND, STATEMENT, Parse
from jaxlangnav.messages import ACTIONS, MODES, REGIONS, RELATIONS

MAX_CORPUS_BYTES = 64 << 20
"""Size limit of a corpus; the one of the package has about a million bytes."""
_MAX_OBJECTS = 32  # maximum number of objects of a world
_MAX_MESSAGE = 1200
"""Maximum length of an error message, which may list the phrases of the longest sentence."""
ROBOT_LABEL = "robot"
Labels = tuple[frozenset[str], ...]
"""Gold symbols of each phrase."""
_SYMBOL = re.compile(r"([a-z]+)\(([a-z0-9,_]*)\)")
_Coordinate = Annotated[float, Meta(ge=-MAX_METRES, le=MAX_METRES)]


class _Clause(Schema, forbid_unknown_fields=False):
    kind: str
    phrases: list[str]
    annotation: list[list[str]]
    rank: list[Annotated[int, Meta(ge=0)]]


class _World(Schema, forbid_unknown_fields=False):
    objects: Annotated[list[tuple[str, _Coordinate, _Coordinate]], Meta(max_length=_MAX_OBJECTS)]
    robot: tuple[_Coordinate, _Coordinate, _Coordinate]
    previous: Annotated[int, Meta(ge=0)] | None
    behavior: list[list[list[str]]]


class _Line(Schema, forbid_unknown_fields=False):
    text: str
    template: Name
    split: Literal["train", "test"]
    clauses: list[_Clause]
    worlds: list[_World]


class PlacedWorld(NamedTuple):
    """Objects at known positions, and the pose of the robot."""

    objects: tuple[tuple[str, float, float], ...]  # type, x, y; map frame, metres
    robot: tuple[float, float, float]  # x, y, heading; metres, radians
    previous: int | None = None  # index of the previous command's goal
    attributes: tuple[int, ...] = ()  # attribute code of each object, or empty


class ClauseLabels(NamedTuple):
    """Gold annotation of one clause, per phrase."""

    annotation: Labels  # per phrase of ``root.walk()``
    rank: tuple[int, ...]  # per phrase; 0: not superlative


class WorldLabels(NamedTuple):
    """Gold behavior in one world, per clause and phrase."""

    world: PlacedWorld
    behavior: tuple[Labels, ...]  # per clause


class Example(NamedTuple):
    """One labelled instruction."""

    text: str
    template: str  # sentences of one template share their structure
    split: str  # "train" or "test"; a template is in one split only
    parse: Parse
    clauses: tuple[ClauseLabels, ...]
    worlds: tuple[WorldLabels, ...]


def _check(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(shorten(sanitize(message), _MAX_MESSAGE))


def _check_symbols(
    labels: Sequence[Sequence[str]], legal: Mapping[str, tuple[Sequence[str], ...]]
) -> None:
    """Validate the symbols of phrases against the legal arguments of each kind."""
    for symbol in itertools.chain(*labels):
        _check(
            bool(_SYMBOL.fullmatch(symbol)), f"'{symbol}' is no symbol; expected kind(argument,...)"
        )
        kind, *arguments = re.split("[(,]", symbol[:-1])
        _check(kind in legal, f"'{symbol}': kind must be one of {', '.join(legal)}")
        count = len(legal[kind])
        _check(len(arguments) == count, f"'{symbol}': expected {count} argument(s)")
        for argument, allowed in zip(arguments, legal[kind], strict=True):
            _check(argument in allowed, f"'{symbol}': '{argument}' is none of {', '.join(allowed)}")


def _read_clause(record: _Clause, parsed: Parse, index: int) -> ClauseLabels:
    root, kind = parsed.clauses[index], parsed.kinds[index]
    heads, where = [phrase.head for phrase in root.walk()], f"clause {index}:"
    _check(record.kind == kind, f"{where} kind is '{kind}', not '{record.kind}'")
    _check(record.phrases == heads, f"{where} the parser finds the phrases {' '.join(heads)}")
    for key, labels in (("annotation", record.annotation), ("rank", record.rank)):
        count = len(labels)
        _check(count == len(heads), f"{where} {count} {key} for {len(heads)} phrases")
    types = load_lexicon().type_names
    region = (RELATIONS, (*types, ROBOT_LABEL))
    legal = {"object": (types,), "region": region, "relation": (types, *region)}
    _check_symbols(record.annotation, legal)
    return ClauseLabels(tuple(map(frozenset, record.annotation)), tuple(record.rank))


def _read_world(record: _World, parsed: Parse) -> WorldLabels:
    types = load_lexicon().type_names
    for kind, _, _ in record.objects:
        _check(kind in types, f"object type {as_text(kind)} is none of {', '.join(types)}")
    previous, count = record.previous, len(record.objects)
    _check(
        previous is None or previous < count,
        f"previous must be null or an object's index below {count}, not {previous}",
    )
    indices = tuple(map(str, range(count)))
    places = dict.fromkeys(("region", "goal", "constraint"), (REGIONS, (*indices, ROBOT_LABEL)))
    legal = {"object": (indices,), **places, "action": (ACTIONS,), "mode": (MODES,)}
    _check(len(record.behavior) == len(parsed.clauses), "behavior needs one list per clause")
    for root, labels in zip(parsed.clauses, record.behavior, strict=True):
        phrases = len(list(root.walk()))
        _check(len(labels) == phrases, f"behavior: {len(labels)} labels for {phrases} phrases")
        _check_symbols(labels, legal)
    return WorldLabels(
        world=PlacedWorld(objects=tuple(record.objects), robot=record.robot, previous=previous),
        behavior=tuple(tuple(map(frozenset, labels)) for labels in record.behavior),
    )


def read_example(line: str) -> Example:
    """Parse and validate one line of a corpus, a JSON document as described in this module.

    Raises:
        ValueError: the cause, in one line.
    """
    record = convert(parse_json(line), _Line)
    with error_prefix("the text is refused"):
        parsed = parse(record.text, is_rewritten=False)
    count = len(record.clauses)
    _check(count == len(parsed.clauses), f"{count} clauses, parsed {len(parsed.clauses)}")
    return Example(
        text=record.text,
        template=record.template,
        split=record.split,
        parse=parsed,
        clauses=tuple(_read_clause(c, parsed, index) for index, c in enumerate(record.clauses)),
        worlds=tuple(_read_world(world, parsed) for world in record.worlds),
    )


def read_corpus(path: str | Path) -> tuple[Example, ...]:
    """Read and validate a corpus file; blank lines and lines that begin with ``#`` are skipped.

    Raises:
        ValueError: the first error, as ``file line N: cause``.
    """
    path = Path(path)
    examples: list[Example] = []
    templates: dict[str, str] = {}
    for line_number, line in read_lines(path, max_bytes=MAX_CORPUS_BYTES):
        if line.startswith("#"):
            continue
        with error_prefix(f"{shorten(path.name)} line {line_number}"):
            example = read_example(line)
            split = templates.setdefault(example.template, example.split)
            _check(split == example.split, f"template '{example.template}' is in both splits")
        examples.append(example)
    _check(bool(examples), f"{path.name} holds no instruction")
    return tuple(examples)


@cache
def load_corpus(name: str = "corpus") -> tuple[Example, ...]:
    """Load a corpus of the package: the large one, or "corpus39" (the paper's protocol)."""
    return read_corpus(shipped_file("language", f"{name}.jsonl"))


def main(arguments: list[str]) -> int:
    """Validate corpus files; print one line for each; returns 0 if all are valid, else 2."""
    status = 0
    for path in arguments:
        try:
            examples = read_corpus(path)
        except ValueError as error:
            print(sanitize(str(error)), file=sys.stderr)
            status = 2
            continue
        phrases = sum(len(c.rank) for example in examples for c in example.clauses)
        counts = Counter(kind for example in examples for kind in example.parse.kinds)
        kinds = {kind: counts[kind] for kind in (COMMAND, STATEMENT)}
        print(sanitize(f"{path}: {len(examples)} instructions, {phrases} phrases, {kinds}"))
    return status


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
