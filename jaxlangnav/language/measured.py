"""Metric commands: turns and distances relative to the robot or to a landmark (ours).

"Go forward two metres, then turn left" gives goals relative to the robot as it hears it, and "10
feet past the cone" one relative to a landmark. Measures are extracted from the sentence, which is
then parsed as "go in front of you then go to your left" and "behind the cone"; distance and frame
are stored beside the tree (``phrase.Measure``). A robot faces its direction of motion, so a final
turn becomes a short motion in that direction. The robot's pose after an earlier command is unknown
when the sentence is said, so turns and distances from there are refused. The words are in
``data/measures.toml``.
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from typing import NamedTuple

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.language.lexicon import REASONS, load_lexicon
from jaxlangnav.language.phrase import LanguageError, Measure, Phrase
from jaxlangnav.language.tokens import MARKS, RawToken

TURN_DISTANCE = 0.5
"""Metres of the motion that realises a turn: twice the tolerance for reaching a goal."""
MEASURE_MIN, MEASURE_MAX = 0.3, 200.0
"""Range of distances that are accepted, metres; less counts as already reached."""
_PLACEHOLDER = re.compile(r"#(\d+)")
_SET = re.compile(r"<([A-Z]+)>")
_ABOUT = "for|by|about|around|roughly|approximately|another|some|like|exactly|just|a distance of"
_BREAKS = frozenset({*MARKS, "and", "then"})
_UNKNOWN_POSE = "where the robot will stand then is not known yet: say it when it is there"
_DIRECTIONS = {0: "in front of you", 90: "to your left", 180: "behind you", 270: "to your right"}


class _Motion(NamedTuple):
    """A pattern of a motion relative to the robot, such as "turn left"."""

    pattern: re.Pattern[str]
    is_turn: bool
    degrees: int  # counterclockwise: of the turn, or from heading to motion


class _Dist(NamedTuple):
    """A distance of the sentence, which is replaced there by the placeholder ``#INDEX``."""

    metres: float
    words: str


class PlacedMeasure(NamedTuple):
    """A measure, and the position of a word of its command."""

    measure: Measure
    position: int
    words: str = ""  # of a distance from a landmark, whose phrase begins at ``position``


_TABLE = parse_toml(read_shipped("language", "measures.toml"))
_UNITS = {word: float(metres) for metres, words in _TABLE["units"].items() for word in words}
_OFFSETS = {text: words for words, texts in _TABLE["places"].items() for text in texts}
_NUMBERS = {"a": 1, "an": 1}
_NUMBERS |= {word: n for n, word in enumerate(_TABLE["numbers"]["ones"], start=1)}
_NUMBERS |= {word: 10 * n for n, word in enumerate(_TABLE["numbers"]["tens"], start=2)}


def _alternatives(texts: Iterable[str]) -> str:
    return "|".join(sorted(texts, key=len, reverse=True))


_TENS = _alternatives(name for name, value in _NUMBERS.items() if value in range(20, 100, 10))
_ONES = _alternatives(name for name, value in _NUMBERS.items() if 0 < value < 10)
_NUMBER = rf"\d+(?:\.\d+)?|(?:{_TENS})[ -](?:{_ONES})|{_alternatives(_NUMBERS)}"
_FRACTIONS = {"half", "third", "thirds", "quarter", "quarters", "minus", "negative", "point"}
_QUANTITIES = (_FRACTIONS | _UNITS.keys() | _NUMBERS.keys()) - {"a", "an"}
_DISTANCE = re.compile(
    r"(?<![^ ])(?:(?P<half>(?:one |a )?half) (?:an? )?|(?P<number>\d+(?:\.\d+)?) ?"
    rf"|(?P<word>{_NUMBER}) )"
    rf"(?:(?P<and>and a half) )?(?P<unit>{_alternatives(_UNITS)})(?P<later> and a half)?(?![^ ])"
)
_ANGLE = re.compile(rf"(?<![^ ])({_NUMBER}) ?(?:degrees?|deg)(?![^ ])")
_FROM_LANDMARK = re.compile(rf"(?:(?:{_ABOUT}) )*#(\d+) ({_alternatives(_OFFSETS)})(?= )")
"""A placeholder, and the relation between it and a landmark."""


@cache
def _load_motions() -> tuple[_Motion, ...]:
    """Compile the patterns of motions with sets expanded; those to the left are mirrored."""
    sets = {"N": _NUMBER, "HOW": rf"(?:(?:{_ABOUT}) )*#\d+"}

    def expand(pattern: str) -> str:
        return _SET.sub(lambda match: f"(?:{sets[match[1]]})", pattern)

    for name, pattern in _TABLE["sets"].items():
        sets[name] = expand(pattern)
    motions = []
    for row in _TABLE["motions"]:
        left, degrees = row["pattern"], row.get("turn", row.get("toward"))
        right = left.replace("left", "right").replace("LEFT", "RIGHT")
        for pattern, sign in {right: -1, left: 1}.items():  # one, if it names no side
            motions.append(_Motion(re.compile(expand(pattern)), "turn" in row, sign * degrees))
    return tuple(motions)


def is_quantity(word: str) -> bool:
    """Check whether a word is a number, a fraction, a sign of a number or a unit of length."""
    return word[0].isdigit() or word in _QUANTITIES


def _value(text: str) -> float:
    if text[0].isdigit():
        return float(text)
    return float(sum(_NUMBERS[word] for word in re.split("[ -]", text)))


def _text(tokens: Sequence[RawToken]) -> str:
    return " ".join(token.text for token in tokens)


def _span(text: str, match: re.Match[str], group: int = 0) -> tuple[int, int]:
    """Convert a match to a range of word indices: first, and one after the last."""
    start = len(text[: match.start(group)].split())
    return start, start + len(match[group].split())


def split_measures(tokens: Sequence[RawToken]) -> tuple[list[RawToken], list[PlacedMeasure]]:
    """Extract turns and distances from a sentence.

    Returns:
        The sentence in words of the grammar, and the extracted measures.

    Raises:
        LanguageError: a turn or a distance from a later pose of the robot, or one that is not
            supported.
    """
    rest = list(tokens)
    dists = _replace_distances(rest)
    measures = _from_landmarks(rest, dists)
    rest = _robot_motions(rest, dists, measures)
    if unused := next((token for token in rest if _PLACEHOLDER.fullmatch(token.text)), None):
        raise _error([unused], dists, REASONS["a distance"])
    return rest, measures


def _error(tokens: Sequence[RawToken], dists: Sequence[_Dist], reason: str) -> LanguageError:
    """Build the error for a part of the sentence, quoted with its original words."""
    words = _PLACEHOLDER.sub(lambda match: dists[int(match[1])].words, _text(tokens))
    return LanguageError.at(words, tokens[0].position, reason)


def _replace_distances(tokens: list[RawToken]) -> list[_Dist]:
    """Replace each distance by one placeholder token, in place."""
    dists: list[_Dist] = []
    while (match := _DISTANCE.search(text := _text(tokens))) is not None:
        start, stop = _span(text, match)
        value = 0.5 if match["half"] else _value(match["number"] or match["word"])
        if match["and"] or match["later"]:
            if value % 1.0:
                reason = "it has two fractions; say one number, as in 'go forward 1.5 metres'"
                raise LanguageError.at(match[0], tokens[start].position, reason)
            value += 0.5
        metres = value * _UNITS[match["unit"]]
        if not MEASURE_MIN <= metres <= MEASURE_MAX:
            limits = f"{metres:.3g} m: distances of {MEASURE_MIN:g} m to {MEASURE_MAX:g} m"
            reason = f"{limits} are measured; say one of them"
            raise LanguageError.at(match[0], tokens[start].position, reason)
        tokens[start:stop] = [replace(tokens[start], text=f"#{len(dists)}")]
        dists.append(_Dist(metres, match[0]))
    return dists


def _from_landmarks(tokens: list[RawToken], dists: list[_Dist]) -> list[PlacedMeasure]:
    """Extract distances from landmarks, such as "10 feet past the cone", in place."""
    measures: list[PlacedMeasure] = []
    while (match := _FROM_LANDMARK.search(text := _text(tokens))) is not None:
        start, stop = _span(text, match)
        following = tokens[stop].text if stop < len(tokens) else ""
        if following in ("you", "your") or following in MARKS:
            break
        begin = _span(text, match, 2)[0]
        d = dists[int(match[1])]
        measures.append(PlacedMeasure(Measure(metres=d.metres), tokens[begin].position, d.words))
        tokens[start:stop] = _reword(_OFFSETS[match[2]], tokens[begin:stop])
    return measures


def _reword(words: str, old: Sequence[RawToken]) -> list[RawToken]:
    return [
        RawToken(text=word, position=old[min(index, len(old) - 1)].position)
        for index, word in enumerate(words.split())
    ]


# ---------------------------------------------------------------- motions relative to the robot


@cache
def _fillers() -> frozenset[tuple[str, ...]]:
    """Collect the expressions allowed around a motion: courtesies, conjunctions, adverbs."""
    entries = load_lexicon().entries
    names = ("opener", "closer", "adv", "conn", "conn_then")
    return frozenset(key for name in names for key in entries[name]) | {("to",), ("so",)}


def _match_motion(words: Sequence[str]) -> _Motion | None:
    """Find the motion whose pattern matches all words."""
    text = " ".join(words)
    return next((motion for motion in _load_motions() if motion.pattern.fullmatch(text)), None)


def _segments(tokens: Sequence[RawToken]) -> Iterator[tuple[slice, _Motion | None]]:
    """Split a sentence at marks and conjunctions into parts, each with its motion or None."""
    ends = [i for i, token in enumerate(tokens) if token.text in _BREAKS]
    words = tuple(token.text for token in tokens)
    for before, stop in pairwise([-1, *ends, len(tokens)]):
        start = before + 1
        while (motion := _match_motion(words[start:stop])) is None:
            sizes = range(min(6, stop - start), 0, -1)
            if size := next((n for n in sizes if words[start : start + n] in _fillers()), 0):
                start += size
            elif size := next((n for n in sizes if words[stop - n : stop] in _fillers()), 0):
                stop -= size
            else:
                break
        if start < stop:
            yield slice(start, stop), motion


def _robot_motions(
    tokens: list[RawToken], dists: list[_Dist], measures: list[PlacedMeasure]
) -> list[RawToken]:
    """Extract motions relative to the robot's current pose; their measures are appended."""
    segments = list(_segments(tokens))
    motions = [(segment, motion) for segment, motion in segments if motion is not None]
    if len(motions) < 2 and not any(
        motion.is_turn or _PLACEHOLDER.search(_text(tokens[segment])) for segment, motion in motions
    ):
        return tokens
    before = next((i for i, (_, motion) in enumerate(segments) if motion is None), len(segments))
    if late := [segment for segment, motion in segments[before:] if motion is not None]:
        raise _error(tokens[late[0]], dists, _UNKNOWN_POSE)
    rest = list(tokens)
    for goal in reversed(_dead_reckon(tokens, dists, motions)):
        old = tokens[goal.words]
        manner = [token for token in old if (token.text,) in load_lexicon().entries["adv"]]
        rest[goal.words] = [*_reword(f"go {_DIRECTIONS[goal.angle]}", old), *manner]
        measures.append(PlacedMeasure(goal.measure, old[0].position))
        breaks = [i for i in range(goal.since, goal.words.start) if tokens[i].text in _BREAKS]
        if breaks and goal.since:
            rest[breaks[0] : breaks[-1] + 1] = [replace(tokens[breaks[0]], text="then")]
    return rest


class _MotionGoal(NamedTuple):
    """Goal of a motion: its words in the sentence, direction and measure."""

    since: int  # one after the last word of the previous motion; 0: it is the first
    words: slice
    angle: int  # degrees counterclockwise from the frame's heading
    measure: Measure


def _dead_reckon(
    tokens: Sequence[RawToken], dists: Sequence[_Dist], motions: Sequence[tuple[slice, _Motion]]
) -> list[_MotionGoal]:
    """Compute the goals of successive motions by dead reckoning from the robot's pose."""
    goals: list[_MotionGoal] = []
    x = y = 0.0  # metres, robot's frame
    heading = turned = since = 0  # degrees counterclockwise; ``turned``: pending turns
    start, error = None, ""
    for index, (segment, motion) in enumerate(motions):
        text = _text(tokens[segment])
        if error:
            raise _error(tokens[segment], dists, error)
        start = segment.start if start is None else start
        if motion.is_turn:
            angle = None if abs(motion.degrees) == 180 else _ANGLE.search(text)
            degrees = motion.degrees
            turned += degrees if angle is None else round(math.copysign(_value(angle[1]), degrees))
            if index + 1 < len(motions):
                continue
            if turned % 360 == 0:
                reason = "the robot would look where it looks now; say where to look"
                raise _error(tokens[segment], dists, reason)
            offset, metres = 0, TURN_DISTANCE
        else:
            match = _PLACEHOLDER.search(text)
            offset, metres = motion.degrees, dists[int(match[1])].metres if match else 0.0
        relative = (turned + offset) % 360
        base, relative = (heading, relative) if relative in _DIRECTIONS else (heading + relative, 0)
        frame = (x, y, math.remainder(math.radians(base), 2.0 * math.pi))
        direction = math.radians(base + relative)
        x, y = x + metres * math.cos(direction), y + metres * math.sin(direction)
        measure = Measure(metres=metres, frame=frame, end=(x, y))
        goals.append(_MotionGoal(since, slice(start, segment.stop), relative, measure))
        if not metres:
            error = "how far to go before is not said; say it, as in 'go forward 2 metres'"
        elif offset in (90, -90):
            error = "where the robot looks then is not clear; say 'turn left', not 'go left'"
        heading, turned, start, since = heading + turned, 0, None, segment.stop
    return goals


# ---------------------------------------------------------------- the measure of each command


def measures_of(clauses: Sequence[Phrase], placed: Sequence[PlacedMeasure]) -> tuple[Measure, ...]:
    """Assign the extracted measures to their clauses; a clause without one has an empty measure.

    Raises:
        LanguageError: a distance that is not to the command's goal, but describes an object or
            belongs to a statement.
    """
    measures = [Measure()] * len(clauses)
    starts = [min(word.position for word in clause.all_words()) for clause in clauses]
    for entry in placed:
        index = max((i for i, start in enumerate(starts) if start <= entry.position), default=0)
        goal = _goal_of(clauses[index])
        positions = [] if goal is None else [word.position for word in goal.words]
        is_goal = entry.position in positions if entry.words else goal is not None
        if not is_goal or measures[index].metres:
            reason = "a distance that tells which thing is meant is not supported; leave it out"
            raise LanguageError.at(entry.words, entry.position, reason)
        measures[index] = entry.measure
    return tuple(measures)


def _goal_of(clause: Phrase) -> Phrase | None:
    """Find the goal region phrase of a command; None if its goal is an object."""
    inner = [child for child in clause.children if child.label != "VP"]
    if clause.label != "VP" or len(inner) != 1 or inner[0].label != "PP":
        return None
    region = inner[0]
    if any(sense.startswith("relation:") for word in region.words for sense in word.senses):
        return region
    below = region.children
    return below[0] if len(below) == 1 and below[0].label == "PP" else None
