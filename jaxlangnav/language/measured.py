"""Turns and distances: places that are told from where the robot stands, or from a thing (ours).

"Go forward two metres, then turn left" names places relative to the robot as it hears it, and "10
feet past the cone" one relative to a thing. Measures are taken out of the sentence, which is then
read as "go in front of you then go to your left" and "behind the cone"; how far, and from where,
stands beside the tree (``phrase.Measure``). A robot looks where it goes, so a turn with nothing
after it is a short way in that direction. The robot's pose after an earlier command is not known
when the sentence is said, so turns and distances from there are refused. The words stand in
``data/measures.toml``.
"""

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

from jaxlangnav.inputs.documents import parse_toml, read_shipped
from jaxlangnav.language.lexicon import REASONS, load_lexicon
from jaxlangnav.language.phrase import LanguageError, Measure, Phrase
from jaxlangnav.language.tokens import MARKS, SpokenToken

TURNED = 0.5
"""Metres that a robot goes to have turned: twice what counts as standing on a place."""
MEASURE_MIN, MEASURE_MAX = 0.3, 200.0
"""Metres that can be asked for: less than the first counts as being there already."""
_HELD = re.compile(r"#(\d+)")
_SET = re.compile(r"<([A-Z]+)>")
_ABOUT = "for|by|about|around|roughly|approximately|another|some|like|exactly|just|a distance of"
_JOINTS = frozenset({*MARKS, "and", "then"})
_THERE = "where the robot will stand then is not known yet: say it when it is there"
_WAYS = {0: "in front of you", 90: "to your left", 180: "behind you", 270: "to your right"}


@dataclass(frozen=True)
class _Motion:
    """One way to tell a robot how to move by itself."""

    said: re.Pattern[str]
    is_turn: bool
    degrees: int  # to the left: of the turn, or from the heading to the way


@dataclass(frozen=True)
class _Held:
    """A distance taken out of the sentence, where ``#`` and its index stand for it."""

    metres: float
    words: str


@dataclass(frozen=True)
class PlacedMeasure:
    """A measure, and the word of the sentence from which its command is known."""

    measure: Measure
    position: int
    words: str = ""  # of a distance from a thing: its place begins with that very word


_TABLE = parse_toml(read_shipped("language", "measures.toml"))
_UNITS, _NUMBERS, _PLACES = _TABLE["units"], _TABLE["numbers"], _TABLE["places"]


def _one_of(texts: Iterable[str]) -> str:
    return "|".join(sorted(texts, key=len, reverse=True))


_TENS = _one_of(name for name, value in _NUMBERS.items() if value in range(20, 100, 10))
_ONES = _one_of(name for name, value in _NUMBERS.items() if 0 < value < 10)
_NUMBER = rf"\d+(?:\.\d+)?|(?:{_TENS})[ -](?:{_ONES})|{_one_of(_NUMBERS)}"
_DISTANCE = re.compile(
    r"(?<![^ ])(?:(?P<half>half) (?:an? )?|(?P<number>\d+(?:\.\d+)?) ?"
    rf"|(?P<word>{_NUMBER}) )"
    rf"(?:(?P<and>and a half) )?(?P<unit>{_one_of(_UNITS)})(?P<later> and a half)?(?![^ ])"
)
_ANGLE = re.compile(rf"(?<![^ ])({_NUMBER}) ?(?:degrees?|deg)(?![^ ])")
_FROM_THING = re.compile(rf"(?:(?:{_ABOUT}) )*#(\d+) ({_one_of(_PLACES)})(?= )")
"""A held distance before what stands between it and a landmark."""


@cache
def _motions() -> tuple[_Motion, ...]:
    """Read the ways to tell a robot how to move, the names of alternatives written out."""
    sets = {"N": _NUMBER, "HOW": rf"(?:(?:{_ABOUT}) )*#\d+"}

    def whole(pattern: str) -> str:
        return _SET.sub(lambda match: f"(?:{sets[match[1]]})", pattern)

    for name, pattern in _TABLE["sets"].items():
        sets[name] = whole(pattern)
    return tuple(
        _Motion(re.compile(whole(one["said"])), "turn" in one, one.get("turn", one.get("toward")))
        for one in _TABLE["motions"]
    )


def _number(text: str) -> float:
    if text[0].isdigit():
        return float(text)
    return float(sum(_NUMBERS[word] for word in re.split("[ -]", text)))


def _text(tokens: Sequence[SpokenToken]) -> str:
    return " ".join(token.text for token in tokens)


def _span(text: str, match: re.Match[str], group: int = 0) -> tuple[int, int]:
    """Find which words a match holds: first, and one after the last."""
    first = len(text[: match.start(group)].split())
    return first, first + len(match[group].split())


def take_out(tokens: Sequence[SpokenToken]) -> tuple[list[SpokenToken], list[PlacedMeasure]]:
    """Take turns and distances out of a sentence.

    Returns:
        The sentence as the grammar reads it, and what has been measured in it.

    Raises:
        LanguageError: a turn or a distance from where the robot will stand later, or of what
            cannot be measured.
    """
    left = list(tokens)
    held = _hold(left)
    said = _from_things(left, held)
    left = _own_motions(left, held, said)
    if late := next((token for token in left if _HELD.fullmatch(token.text)), None):
        raise _stuck([late], held, REASONS["a distance"])
    return left, said


def _stuck(tokens: Sequence[SpokenToken], held: Sequence[_Held], reason: str) -> LanguageError:
    """Refuse a part of the sentence, written as it was said."""
    words = _HELD.sub(lambda match: held[int(match[1])].words, _text(tokens))
    return LanguageError.at(words, tokens[0].position, reason)


def _hold(tokens: list[SpokenToken]) -> list[_Held]:
    """Put one token in the place of each distance."""
    held: list[_Held] = []
    while (match := _DISTANCE.search(text := _text(tokens))) is not None:
        first, last = _span(text, match)
        number = 0.5 if match["half"] else _number(match["number"] or match["word"])
        if not match["half"] and (match["and"] or match["later"]):
            number += 0.5
        metres = number * _UNITS[match["unit"]]
        if not MEASURE_MIN <= metres <= MEASURE_MAX:
            limits = f"{metres:.3g} m: distances of {MEASURE_MIN:g} m to {MEASURE_MAX:g} m"
            reason = f"{limits} are measured; say one of them"
            raise LanguageError.at(match[0], tokens[first].position, reason)
        tokens[first:last] = [replace(tokens[first], text=f"#{len(held)}")]
        held.append(_Held(metres, match[0]))
    return held


def _from_things(tokens: list[SpokenToken], held: list[_Held]) -> list[PlacedMeasure]:
    """Take out distances from things: "10 feet past the cone"."""
    said: list[PlacedMeasure] = []
    while (match := _FROM_THING.search(text := _text(tokens))) is not None:
        first, last = _span(text, match)
        after = tokens[last].text if last < len(tokens) else ""
        if after in ("you", "your") or after in MARKS:
            break
        place = _span(text, match, 2)[0]
        one = held[int(match[1])]
        said.append(PlacedMeasure(Measure(metres=one.metres), tokens[place].position, one.words))
        tokens[first:last] = _placed(_PLACES[match[2]], tokens[place:last])
    return said


def _placed(words: str, over: Sequence[SpokenToken]) -> list[SpokenToken]:
    return [
        SpokenToken(text=word, position=over[min(index, len(over) - 1)].position)
        for index, word in enumerate(words.split())
    ]


# ---------------------------------------------------------------- the robot's own motions


@cache
def _around() -> frozenset[tuple[str, ...]]:
    """Collect what may stand around a motion: courtesies, joints, manners."""
    entries = load_lexicon().entries
    names = ("opener", "closer", "adv", "conn", "conn_then")
    return frozenset(key for name in names for key in entries[name]) | {("to",), ("so",)}


def _motion_of(words: Sequence[str]) -> _Motion | None:
    """Find the motion that words say, all of them."""
    text = " ".join(words)
    found = (one for one in _motions() if one.said.fullmatch(text))
    return next(found, None) if len(_HELD.findall(text)) < 2 else None


def _parts(tokens: Sequence[SpokenToken]) -> Iterator[tuple[slice, _Motion | None]]:
    """Split a sentence at its joints into parts without courtesies, each with its motion."""
    ends = [i for i, token in enumerate(tokens) if token.text in _JOINTS]
    words = tuple(token.text for token in tokens)
    for before, last in pairwise([-1, *ends, len(tokens)]):
        first = before + 1
        while (motion := _motion_of(words[first:last])) is None:
            sizes = range(min(6, last - first), 0, -1)
            if size := next((n for n in sizes if words[first : first + n] in _around()), 0):
                first += size
            elif size := next((n for n in sizes if words[last - n : last] in _around()), 0):
                last -= size
            else:
                break
        if first < last:
            yield slice(first, last), motion


def _own_motions(
    tokens: list[SpokenToken], held: list[_Held], said: list[PlacedMeasure]
) -> list[SpokenToken]:
    """Take out how the robot is to move from where it stands."""
    parts = list(_parts(tokens))
    motions = [(part, motion) for part, motion in parts if motion is not None]
    if len(motions) < 2 and not any(
        motion.is_turn or _HELD.search(_text(tokens[part])) for part, motion in motions
    ):
        return tokens
    before = next((i for i, (_, motion) in enumerate(parts) if motion is None), len(parts))
    if late := [part for part, motion in parts[before:] if motion is not None]:
        raise _stuck(tokens[late[0]], held, _THERE)
    left = list(tokens)
    for place in reversed(_follow(tokens, held, motions)):
        over = tokens[place.words]
        manner = [token for token in over if (token.text,) in load_lexicon().entries["adv"]]
        left[place.words] = [*_placed(f"go {_WAYS[place.way]}", over), *manner]
        said.append(PlacedMeasure(place.measure, over[0].position))
        joint = [i for i in range(place.since, place.words.start) if tokens[i].text in _JOINTS]
        if joint and place.since:
            left[joint[0] : joint[-1] + 1] = [replace(tokens[joint[0]], text="then")]
    return left


@dataclass(frozen=True)
class _Place:
    """Where a motion leads: words of the sentence, and what is read for them."""

    since: int  # one after the last word of the motion before; 0: it is the first
    words: slice
    way: int  # degrees to the left of the frame's heading
    measure: Measure


def _follow(
    tokens: Sequence[SpokenToken], held: Sequence[_Held], motions: Sequence[tuple[slice, _Motion]]
) -> list[_Place]:
    """List the places that motions lead to, one after the other from where the robot stands."""
    places: list[_Place] = []
    x = y = 0.0  # metres, robot's frame
    heading = turned = since = 0  # degrees to the left; ``turned``: not yet gone that way
    first, why_lost = None, ""
    for index, (part, motion) in enumerate(motions):
        text = _text(tokens[part])
        if why_lost:
            raise _stuck(tokens[part], held, why_lost)
        first = part.start if first is None else first
        if motion.is_turn:
            angle = None if abs(motion.degrees) == 180 else _ANGLE.search(text)
            degrees = motion.degrees
            turned += degrees if angle is None else round(math.copysign(_number(angle[1]), degrees))
            if index + 1 < len(motions):
                continue
            if turned % 360 == 0:
                reason = "the robot would look where it looks now; say where to look"
                raise _stuck(tokens[part], held, reason)
            toward, metres = 0, TURNED
        else:
            distance = _HELD.search(text)
            toward, metres = motion.degrees, held[int(distance[1])].metres if distance else 0.0
        way = (turned + toward) % 360
        base, way = (heading, way) if way in _WAYS else (heading + way, 0)
        frame = (x, y, math.remainder(math.radians(base), 2.0 * math.pi))
        direction = math.radians(base + way)
        x, y = x + metres * math.cos(direction), y + metres * math.sin(direction)
        measure = Measure(metres=metres, frame=frame, end=(x, y))
        places.append(_Place(since, slice(first, part.stop), way, measure))
        if not metres:
            why_lost = "how far to go before is not said; say it, as in 'go forward 2 metres'"
        elif toward in (90, -90):
            why_lost = "where the robot looks then is not clear; say 'turn left', not 'go left'"
        heading, turned, first, since = heading + turned, 0, None, part.stop
    return places


# ---------------------------------------------------------------- which command is measured


def of_clauses(clauses: Sequence[Phrase], said: Sequence[PlacedMeasure]) -> tuple[Measure, ...]:
    """Find the measure of each clause, of those of ``take_out``; an empty one where none is.

    Raises:
        LanguageError: a distance that is not from the command's own goal: it tells which thing is
            meant, or belongs to a statement.
    """
    measures = [Measure()] * len(clauses)
    starts = [min(word.position for word in clause.all_words()) for clause in clauses]
    for one in said:
        index = max((i for i, start in enumerate(starts) if start <= one.position), default=0)
        goal = _goal_of(clauses[index])
        places = [] if goal is None else [word.position for word in goal.words]
        is_goal = one.position in places if one.words else goal is not None
        if not is_goal or measures[index].metres:
            reason = "a distance that tells which thing is meant is not supported; leave it out"
            raise LanguageError.at(one.words, one.position, reason)
        measures[index] = one.measure
    return tuple(measures)


def _goal_of(clause: Phrase) -> Phrase | None:
    """Find the phrase of a place that a command leads to; None where it leads to a thing."""
    inner = [child for child in clause.children if child.label != "VP"]
    if clause.label != "VP" or len(inner) != 1 or inner[0].label != "PP":
        return None
    place = inner[0]
    if any(sense.startswith("relation:") for word in place.words for sense in word.senses):
        return place
    below = place.children
    return below[0] if len(below) == 1 and below[0].label == "PP" else None
