"""Turns and distances: places that are told from where the robot stands, or from a thing (ours).

"Go forward two metres, then turn left" names places relative to the robot as it hears it, and "10
feet past the cone" one relative to a thing. What is measured is taken out of the sentence, which
is then read as "go in front of you then go to your left" and "behind the cone"; how far, and from
where, is told beside the tree (``phrase.Measure``). A robot looks where it goes, so that a turn
with nothing after it is a short way in that direction. How it will stand where a command before
leads is not known when the sentence is said: turns and distances from there are refused. The words
stand in ``data/measures.toml``.
"""

import math
import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import resources
from itertools import pairwise

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
class _Words:
    """The contents of ``measures.toml``."""

    units: dict[str, float]
    numbers: dict[str, float]
    motions: tuple[_Motion, ...]
    distance: re.Pattern[str]
    angle: re.Pattern[str]
    places: re.Pattern[str]  # a held distance before what stands between it and a landmark
    instead: dict[str, str]


@dataclass(frozen=True)
class _Held:
    """A distance taken out of the sentence."""

    metres: float
    words: str
    position: int


@dataclass(frozen=True)
class PlacedMeasure:
    """A measure, and the word of the sentence from which its command is known."""

    measure: Measure
    position: int
    words: str = ""  # of a distance from a thing: its place begins with that very word


@dataclass(frozen=True)
class _Part:
    """What stands between two joints: which words, and the motion that they are all about."""

    first: int
    last: int  # one after the last word
    motion: _Motion | None = None
    is_idle: bool = False  # it says nothing but how kindly something is asked for


@cache
def _words() -> _Words:
    """Read the words."""
    text = resources.files("jaxlangnav.language").joinpath("data/measures.toml").read_text("utf-8")
    document = tomllib.loads(text)
    named = "|".join(sorted(document["numbers"], key=len, reverse=True))
    tens = "|".join(n for n, value in document["numbers"].items() if value in range(20, 100, 10))
    ones = "|".join(n for n, value in document["numbers"].items() if 0 < value < 10)
    number = rf"\d+(?:\.\d+)?|(?:{tens})[ -](?:{ones})|{named}"
    units = "|".join(sorted(document["units"], key=len, reverse=True))
    sets = {"N": number, "HOW": rf"(?:(?:{_ABOUT}) )*#\d+"}

    def whole(pattern: str) -> str:
        return _SET.sub(lambda match: f"(?:{sets[match[1]]})", pattern)

    for name, pattern in document["sets"].items():
        sets[name] = whole(pattern)
    places = document["places"]
    between = "|".join(sorted(places, key=len, reverse=True))
    return _Words(
        units=document["units"],
        numbers=document["numbers"],
        motions=tuple(
            _Motion(
                re.compile(whole(one["said"])), "turn" in one, one.get("turn", one.get("toward"))
            )
            for one in document["motions"]
        ),
        distance=re.compile(
            r"(?<![^ ])(?:(?P<half>half) (?:an? )?|(?P<number>\d+(?:\.\d+)?) ?"
            rf"|(?P<word>{number}) )"
            rf"(?:(?P<and>and a half) )?(?P<unit>{units})(?P<later> and a half)?(?![^ ])"
        ),
        angle=re.compile(rf"(?<![^ ])({number}) ?(?:degrees?|deg)(?![^ ])"),
        places=re.compile(rf"(?:(?:{_ABOUT}) )*#(\d+) ({between})(?= )"),
        instead=places,
    )


def _number(text: str) -> float:
    """Read a number, in figures or words."""
    if text[0].isdigit():
        return float(text)
    return float(sum(_words().numbers[word] for word in re.split("[ -]", text)))


def _text(tokens: Sequence[SpokenToken]) -> str:
    return " ".join(token.text for token in tokens)


def _span(text: str, match: re.Match[str], group: int = 0) -> tuple[int, int]:
    """Find which words a match holds: first, and one after the last."""
    first = len(text[: match.start(group)].split())
    return first, first + len(match[group].split())


def take_out(tokens: Sequence[SpokenToken]) -> tuple[list[SpokenToken], list[PlacedMeasure]]:
    """Take turns and distances out of a sentence.

    Args:
        tokens: words and marks.

    Returns:
        The sentence as the grammar reads it, and what has been measured in it.

    Raises:
        LanguageError: a turn or a distance from where the robot will stand later, or of what
            cannot be measured.
    """
    left, held = _hold(list(tokens))
    said: list[PlacedMeasure] = []
    left = _from_things(left, held, said)
    left = _own_motions(left, held, said)
    for token in left:
        if (match := _HELD.fullmatch(token.text)) is not None:
            raise _refuse(held[int(match[1])], REASONS["a distance"])
    return left, said


def _refuse(what: _Held, reason: str) -> LanguageError:
    return LanguageError(f"'{what.words}' (word {what.position}): {reason}", position=what.position)


def _hold(tokens: list[SpokenToken]) -> tuple[list[SpokenToken], list[_Held]]:
    """Put one token in the place of each distance."""
    held: list[_Held] = []
    while (match := _words().distance.search(text := _text(tokens))) is not None:
        first, last = _span(text, match)
        if match["half"]:
            number = 0.5
        else:
            number = _number(match["number"] or match["word"]) + (
                0.5 if match["and"] or match["later"] else 0.0
            )
        metres = number * _words().units[match["unit"]]
        one = _Held(metres, match[0], tokens[first].position)
        if not MEASURE_MIN <= metres <= MEASURE_MAX:
            raise _refuse(
                one,
                f"{metres:.3g} m: distances of {MEASURE_MIN:g} m to {MEASURE_MAX:g} m are "
                "measured; say one of them",
            )
        tokens[first:last] = [replace(tokens[first], text=f"#{len(held)}")]
        held.append(one)
    return tokens, held


def _from_things(
    tokens: list[SpokenToken], held: list[_Held], said: list[PlacedMeasure]
) -> list[SpokenToken]:
    """Take out distances from things: "10 feet past the cone"."""
    while (match := _words().places.search(text := _text(tokens))) is not None:
        first, last = _span(text, match)
        after = tokens[last].text if last < len(tokens) else ""
        if after in ("you", "your") or after in MARKS:
            break
        place = _span(text, match, 2)[0]
        words = _words().instead[match[2]].split()
        one = held[int(match[1])]
        said.append(PlacedMeasure(Measure(metres=one.metres), tokens[place].position, one.words))
        tokens[first:last] = _placed(words, tokens[place:last])
    return tokens


def _placed(words: Sequence[str], over: Sequence[SpokenToken]) -> list[SpokenToken]:
    """Write words in the places of others, in order."""
    return [
        SpokenToken(text=word, position=over[min(index, len(over) - 1)].position)
        for index, word in enumerate(words)
    ]


# ---------------------------------------------------------------- the robot's own motions


@cache
def _around() -> frozenset[tuple[str, ...]]:
    """Collect what may stand around a motion: courtesies, joints, manners."""
    entries = load_lexicon().entries
    names = ("opener", "closer", "adv", "conn", "conn_then")
    return frozenset(key for name in names for key in entries[name]) | {("to",), ("so",)}


def _core(words: Sequence[str]) -> tuple[int, int]:
    """Find what is left of a part without courtesies at both ends."""
    first, last = 0, len(words)
    while size := next((n for n in range(6, 0, -1) if tuple(words[first:][:n]) in _around()), 0):
        if _motion_of(words[first:last]) is not None:
            break
        first += min(size, last - first)
    while size := next(
        (
            n
            for n in range(6, 0, -1)
            if n <= last - first and tuple(words[last - n : last]) in _around()
        ),
        0,
    ):
        if _motion_of(words[first:last]) is not None:
            break
        last -= size
    return first, last


def _motion_of(words: Sequence[str]) -> _Motion | None:
    """Find the motion that words say, all of them."""
    text = " ".join(words)
    found = (one for one in _words().motions if one.said.fullmatch(text))
    return next(found, None) if len(_HELD.findall(text)) < 2 else None


def _parts(tokens: Sequence[SpokenToken]) -> list[_Part]:
    """Split a sentence at its joints."""
    ends = [i for i, token in enumerate(tokens) if token.text in _JOINTS]
    parts = []
    for before, after in pairwise([-1, *ends, len(tokens)]):
        words = [token.text for token in tokens[before + 1 : after]]
        if not words:
            continue
        first, last = _core(words)
        begin = before + 1 + first
        motion = _motion_of(words[first:last])
        parts.append(_Part(begin, before + 1 + last, motion, is_idle=first >= last))
    return parts


def _own_motions(
    tokens: list[SpokenToken], held: list[_Held], said: list[PlacedMeasure]
) -> list[SpokenToken]:
    """Take out how the robot is to move from where it stands."""
    parts = [one for one in _parts(tokens) if not one.is_idle]
    motions = [one for one in parts if one.motion is not None]
    is_plain = not any(one.motion and one.motion.is_turn for one in motions)
    if (
        is_plain
        and len(motions) < 2
        and not any(_held_in(tokens, one) is not None for one in motions)
    ):
        return tokens
    before = next((i for i, one in enumerate(parts) if one.motion is None), len(parts))
    late = next((one for one in parts[before:] if one.motion is not None), None)
    if late is not None:
        raise _stuck(tokens[late.first : late.last], held, _THERE)
    left = list(tokens)
    for place in reversed(_Walk(tokens, held).places(motions)):
        words = ["go", *_WAYS[place.way].split()]
        over = tokens[place.first : place.last]
        manner = [token for token in over if (token.text,) in load_lexicon().entries["adv"]]
        left[place.first : place.last] = [*_placed(words, over), *manner]
        said.append(PlacedMeasure(place.measure, over[0].position))
        joint = [i for i in range(place.since, place.first) if tokens[i].text in _JOINTS]
        if joint and place.since:
            left[joint[0] : joint[-1] + 1] = [replace(tokens[joint[0]], text="then")]
    return left


def _held_in(tokens: Sequence[SpokenToken], part: _Part) -> int | None:
    """Find the distance that a part holds."""
    match = _HELD.search(_text(tokens[part.first : part.last]))
    return None if match is None else int(match[1])


def _stuck(tokens: Sequence[SpokenToken], held: Sequence[_Held], reason: str) -> LanguageError:
    """Refuse a part of the sentence."""
    words = [
        held[int(match[1])].words if (match := _HELD.fullmatch(token.text)) else token.text
        for token in tokens
    ]
    return _refuse(_Held(0.0, " ".join(words), tokens[0].position), reason)


@dataclass(frozen=True)
class _Place:
    """Where a motion leads: words of the sentence, and what is read for them."""

    since: int  # one after the last word of the motion before; 0: it is the first
    first: int
    last: int
    way: int  # degrees to the left of the frame's heading
    measure: Measure


class _Walk:
    """Follows motions one after the other from where the robot stands."""

    def __init__(self, tokens: Sequence[SpokenToken], held: Sequence[_Held]) -> None:
        self.tokens, self.held = tokens, held
        self.x = self.y = 0.0  # metres, robot's frame
        self.heading = self.turned = 0  # degrees to the left; not yet gone that way
        self.why_lost = ""

    def places(self, motions: Sequence[_Part]) -> list[_Place]:
        """List the places that motions lead to, in order."""
        found: list[_Place] = []
        first, since = None, 0
        for part in motions:
            if self.why_lost:
                raise _stuck(self.tokens[part.first : part.last], self.held, self.why_lost)
            first = part.first if first is None else first
            motion = part.motion
            if motion is not None and motion.is_turn:
                self.turned += self._angle(part, motion)
                continue
            found.append(self._gone(part, motion, first, since))
            first, since = None, part.last
        if first is not None:
            found.append(self._turned(motions[-1], first, since))
        return found

    def _angle(self, part: _Part, motion: _Motion) -> int:
        """Read how far a turn goes."""
        text = _text(self.tokens[part.first : part.last])
        match = _words().angle.search(text)
        if match is None or abs(motion.degrees) == 180:
            return motion.degrees
        return round(math.copysign(_number(match[1]), motion.degrees))

    def _place(self, part: _Part, first: int, since: int, toward: int, metres: float) -> _Place:
        """Tell where a way of so many metres leads."""
        way = toward % 360
        heading, way = (self.heading, way) if way in _WAYS else (self.heading + way, 0)
        frame = (self.x, self.y, math.remainder(math.radians(heading), 2.0 * math.pi))
        turn = math.radians(heading + way)
        end = (self.x + metres * math.cos(turn), self.y + metres * math.sin(turn))
        measure = Measure(metres=metres, frame=frame, end=end)
        self.x, self.y = end
        return _Place(since, first, part.last, way, measure)

    def _gone(self, part: _Part, motion: _Motion | None, first: int, since: int) -> _Place:
        """Go some way."""
        toward = 0 if motion is None else motion.degrees
        index = _held_in(self.tokens, part)
        metres = 0.0 if index is None else self.held[index].metres
        place = self._place(part, first, since, self.turned + toward, metres)
        self.heading += self.turned
        if not metres:
            self.why_lost = "how far to go before is not said; say it, as in 'go forward 2 metres'"
        elif toward in (90, -90):
            self.why_lost = (
                "where the robot looks then is not clear; say 'turn left', not 'go left'"
            )
        self.turned = 0
        return place

    def _turned(self, part: _Part, first: int, since: int) -> _Place:
        """Turn, with nothing to go after it."""
        if self.turned % 360 == 0:
            reason = "the robot would look where it looks now; say where to look"
            raise _stuck(self.tokens[part.first : part.last], self.held, reason)
        return self._place(part, first, since, self.turned, TURNED)


# ---------------------------------------------------------------- which command is measured


def of_clauses(clauses: Sequence[Phrase], said: Sequence[PlacedMeasure]) -> tuple[Measure, ...]:
    """Find the command of each measure.

    Args:
        clauses: roots of the trees, in order.
        said: of ``take_out``.

    Returns:
        A measure for each clause; an empty one where nothing is measured.

    Raises:
        LanguageError: a distance that is not from the command's own goal: it tells which thing is
            meant, or belongs to a statement.
    """
    measures = [Measure()] * len(clauses)
    starts = [min(word.position for word in clause.all_words()) for clause in clauses]
    for one in said:
        index = max((i for i, start in enumerate(starts) if start <= one.position), default=0)
        goal = _goal_of(clauses[index])
        is_goal = goal is not None and (
            not one.words or any(word.position == one.position for word in goal.words)
        )
        if not is_goal or measures[index].metres:
            reason = "a distance that tells which thing is meant is not supported; leave it out"
            raise _refuse(_Held(0.0, one.words, one.position), reason)
        measures[index] = one.measure
    return tuple(measures)


def _goal_of(clause: Phrase) -> Phrase | None:
    """Find the phrase of a place that a command leads to; None where it leads to a thing."""
    inner = [child for child in clause.children if child.label != "VP"]
    if clause.label != "VP" or len(inner) != 1 or inner[0].label != "PP":
        return None
    place = inner[0]
    senses = [sense for word in place.words for sense in word.senses]
    if any(sense.startswith("relation:") for sense in senses):
        return place
    return (
        place.children[0] if len(place.children) == 1 and place.children[0].label == "PP" else None
    )
