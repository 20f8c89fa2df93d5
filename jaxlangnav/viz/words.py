"""Words for numbers: directions, distances, probabilities and readings in plain English."""

import math

import numpy as np

from jaxlangnav.episode.recording import StaticScene
from jaxlangnav.grounding.asked import Asked
from jaxlangnav.language.lexicon import plural
from jaxlangnav.messages import AT, NONE, REGIONS, ROBOT, Fault, relation_name
from jaxlangnav.relations.table import RELATION_WORDS

SUPERLATIVE_WORDS = {
    "front": "most in front of",
    "behind": "most behind",
    "left": "farthest left of",
    "right": "farthest right of",
    "near": "nearest to",
    "far": "farthest from",
}
FAULT_WORDS = {
    Fault.PLACE: "its area or its start cannot be",
    Fault.POSE: "its pose cannot be",
    Fault.JUMP: "its pose is farther off than it can have gone",
    Fault.SENSOR: "its detector cannot be as it is said to be",
    Fault.DETECTION: "it was shown what its detector cannot see",
    Fault.CONTRADICTION: "it was shown two things at one place",
    Fault.WEIGHTS: "all of its hypotheses had died",
    Fault.COMMAND: "nothing is asked of it",
}
_SURE = 0.95
"""From here on a command's probability is not worth a word."""
ORDINALS = ("second", "third", "fourth")
_EIGHTHS = (
    "ahead",
    "ahead to the left",
    "to the left",
    "behind to the left",
    "behind",
    "behind to the right",
    "to the right",
    "ahead to the right",
)


def whereabouts(x: float, y: float, robot_x: float, robot_y: float, heading: float) -> str:
    """Say where a place is as the robot would: "3.2 m ahead to the left", or "right here".

    Places are in metres, map frame, the heading in radians.
    """
    distance = math.hypot(x - robot_x, y - robot_y)
    if distance < 0.3:
        return "right here"
    bearing = math.atan2(y - robot_y, x - robot_x) - heading
    return f"{distance:.1f} m {_EIGHTHS[round(bearing / (math.pi / 4)) % 8]}"


def percent(probability: float) -> str:
    """Say a probability in per cent, never a certainty it is not: "< 1 %", "> 99 %"."""
    if 0.0 < probability < 0.01:
        return "< 1 %"
    if 0.99 < probability < 1.0 - 1e-6:
        return "> 99 %"
    return f"{100 * probability:.0f} %"


def article(noun: str) -> str:
    """Put "a" or "an" before a noun."""
    return f"{'an' if noun[:1] in 'aeiou' else 'a'} {noun}"


def counted(nouns: list[str]) -> str:
    """Count things of each kind, in the order of their first mention: "a hydrant and two cones"."""
    words = ("", "", "two", "three", "four")
    parts = []
    for noun in dict.fromkeys(nouns):
        number = nouns.count(noun)
        word = words[number] if number < len(words) else str(number)
        parts.append(article(noun) if number == 1 else f"{word} {plural(noun)}")
    return listed(parts)


def listed(parts: list[str]) -> str:
    """Join parts as in speech: "a, b and c"."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def describe_reading(scene: StaticScene, index: int) -> str:
    """Say what a reading claims of the world: "a hydrant behind a cone", or "nothing"."""
    readings = scene.readings
    used = readings.landmark[index][readings.relation[index] != NONE]
    heads = np.setdiff1d(np.flatnonzero(readings.mention_type[index] >= 0), used)
    return listed([_thing_words(scene, index, one) for one in heads]) if heads.size else "nothing"


def _thing_words(scene: StaticScene, index: int, mention: int) -> str:
    """Describe a thing that a reading mentions by its relations: "a hydrant behind a cone"."""
    readings = scene.readings
    types, relations = readings.mention_type[index], readings.relation[index]
    figures, landmarks = readings.figure[index], readings.landmark[index]

    def relation_words(edge: int) -> str:
        rank = int(readings.rank[index, edge])
        name = relation_name(int(relations[edge]), rank)
        if rank <= 0:
            return RELATION_WORDS.get(name, name)
        place = f"{ORDINALS[min(rank, 4) - 2]} " if rank > 1 else ""
        return place + SUPERLATIVE_WORDS[name]

    def thing(mention: int, path: tuple[int, ...]) -> str:
        if mention == ROBOT or int(types[mention]) == ROBOT:
            return "the robot"
        said: dict[str, list[str]] = {}
        for edge in range(len(relations)):
            landmark = int(landmarks[edge])
            is_edge = int(figures[edge]) == mention and int(relations[edge]) != NONE
            if is_edge and landmark not in path:
                side = thing(landmark, (*path, mention))
                said.setdefault(relation_words(edge), []).append(side)
        parts = [f"{words} {listed(things)}" for words, things in said.items()]
        return " ".join([article(scene.type_name(int(types[mention]))), *parts])

    return thing(mention, ())


def describe_asked(scene: StaticScene) -> list[str]:
    """Say what each command asks for, by the likeliest reading: "go to the hydrant"."""
    best = int(np.argmax(scene.readings.log_probability))

    def thing(mention: int) -> str:
        words = _thing_words(scene, best, mention)
        first, _, rest = words.partition(" ")
        return f"the {rest}" if first in ("a", "an") else words

    def asked(one: Asked) -> str:
        goal = "another one than before" if one.mention == NONE else thing(one.mention)
        if one.mention != NONE and one.region != AT:
            goal = f"{RELATION_WORDS[REGIONS[one.region]]} {goal}"
        verb = "find" if one.action == "find" else "go to" if one.region == AT else "go"
        pace = "" if one.mode == "normal" else f" {one.mode}"
        keep = [thing(mention) for _, mention, _ in one.avoid]
        away = f", keeping away from {listed(keep)}" if keep else ""
        doubt = "" if one.probability >= _SURE else f" ({percent(one.probability)})"
        return f"{verb} {goal}{pace}{away}{doubt}"

    return [asked(one) for one in scene.asks]


def describe_readings(scene: StaticScene, *, least: float = 0.01) -> list[tuple[str, float]]:
    """Say what the sentence may mean with at least some probability, the likeliest claim first."""
    total: dict[str, float] = {}
    for index, log_probability in enumerate(scene.readings.log_probability):
        probability = math.exp(float(log_probability))
        if probability > 0.0:
            claim = describe_reading(scene, index)
            total[claim] = total.get(claim, 0.0) + probability
    ranked = sorted(total.items(), key=lambda item: -item[1])
    return [(claim, probability) for claim, probability in ranked if probability >= least]
