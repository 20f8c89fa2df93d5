"""The sentences of the story, one function each, and words for numbers, places and readings.

``scene`` is of the episode, ``frame`` a step of it. What has nothing to tell returns an empty text.
"""

import math

import numpy as np

from jaxlangnav.episode.recording import Frame, Moment, Remark, StaticScene, missing_names
from jaxlangnav.grounding.asked import CommandSummary
from jaxlangnav.language.lexicon import plural
from jaxlangnav.messages import AT, NONE, ROBOT, Fault, Status
from jaxlangnav.planner.graph import OBJECT_NODE, VISITED
from jaxlangnav.relations.table import REGISTRY
from jaxlangnav.viz import summary

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
_SURE = 0.95  # from here on a command's probability is not worth a word
ORDINALS = ("second", "third", "fourth")
_EIGHTHS = (
    "ahead", "ahead to the left", "to the left", "behind to the left", "behind",
    "behind to the right", "to the right", "ahead to the right",
)  # fmt: skip


def whereabouts(x: float, y: float, robot_x: float, robot_y: float, heading: float) -> str:
    """Say where a place (m, rad) is to the robot: "3.2 m ahead to the left", or "right here"."""
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
        relation = REGISTRY[int(relations[edge])]
        if rank == 0:
            return relation.words
        place = f"{ORDINALS[min(rank, 4) - 2]} " if rank > 1 else ""
        return place + SUPERLATIVE_WORDS[relation.name]

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

    def asked(one: CommandSummary) -> str:
        goal = "another one than before" if one.mention == NONE else thing(one.mention)
        if one.mention != NONE and one.region != AT:
            goal = f"{REGISTRY[one.region].words} {goal}"
        verb = "find" if one.action == "find" else "go to" if one.region == AT else "go"
        pace = "" if one.mode == "normal" else f" {one.mode}"
        keep = [thing(mention) for _, mention, _ in one.avoid]
        away = f", keeping away from {listed(keep)}" if keep else ""
        doubt = "" if one.probability >= _SURE else f" ({percent(one.probability)})"
        return f"{verb} {goal}{pace}{away}{doubt}"

    return [asked(one) for one in scene.asks]


def describe_readings(scene: StaticScene, *, least: float = 0.01) -> list[tuple[str, float]]:
    """Say what the sentence may mean with at least some probability, the likeliest claim first."""
    total = _by_claim(scene, np.exp(np.asarray(scene.readings.log_probability, float)))
    ranked = sorted(total.items(), key=lambda item: -item[1])
    return [(claim, probability) for claim, probability in ranked if probability >= least]


def _by_claim(scene: StaticScene, shares: np.ndarray) -> dict[str, float]:
    """Sum up shares of the readings, f64[K]; readings of the same words are one claim."""
    total: dict[str, float] = {}
    for index in np.flatnonzero(np.isfinite(scene.readings.log_probability)).tolist():
        claim = describe_reading(scene, index)
        total[claim] = total.get(claim, 0.0) + float(shares[index])
    return total


def new_objects(moment: Moment) -> list[summary.SeenObject]:
    """List what a step has discovered: observed objects in slots that were empty before."""
    before = () if moment.before is None else summary.seen_objects(moment.before)
    old = {one.slot for one in before}
    return [one for one in summary.seen_objects(moment.frame) if one.slot not in old]


def _place(frame: Frame, x: float, y: float) -> str:
    """Say where a place is, seen from the robot as it believes itself to stand."""
    return whereabouts(x, y, float(frame.robot[0]), float(frame.robot[1]), float(frame.heading))


def heard(frame: Frame, said: Remark) -> str:
    """Tell an utterance: what it was taken for, and what it changed, or why nothing."""
    who = "Hears" if said.speaker == "you" else f"Hears {said.speaker}:"
    if said.refusal:
        return f"{who} “{said.text}”, and keeps to its task: {said.refusal}."
    told = [f"{who} “{said.text}”, {article(said.kind)}."]
    if said.ruled_out:
        things = [f"the {one.type_name} {_place(frame, one.x, one.y)}" for one in said.ruled_out]
        told.append(f"Rules out {listed(things)}.")
    return " ".join([*told, *(f"{note[:1].upper()}{note[1:]}." for note in said.notes)])


def rests(frame: Frame) -> str:
    """Tell that the robot stands still until it hears something."""
    why = {Status.IDLE: ": it has no task", Status.HALTED: ", as it was told"}
    return f"Stands still{why.get(Status(int(frame.status)), ' until it hears more')}."


def seen(moment: Moment) -> str:
    """Tell the detections of a step, discoveries first."""
    scene, frame, new = moment.scene, moment.frame, new_objects(moment)
    if new:
        parts = [
            f"{article(scene.type_name(one.object_type))} {_place(frame, one.x, one.y)}"
            for one in new
        ]
        return f"Discovers {listed(parts)}."
    kinds = sorted(int(kind) for kind in frame.detection_type[frame.is_detection] if kind != NONE)
    if not kinds:
        return "Sees nothing."
    names = [scene.type_name(kind) for kind in kinds]
    groups = [
        f"the {name}" if names.count(name) == 1 else f"{names.count(name)} {plural(name)}"
        for name in dict.fromkeys(names)
    ]
    return f"Sees {listed(groups)} again."


def refuted(moment: Moment) -> str:
    """Tell how many hypotheses what was not there has cost."""
    frame, before = moment.frame, moment.before
    number, total = int(frame.num_regrounded), frame.weight.shape[0]
    if before is None or number < 2:
        return ""
    if bool(frame.is_news) and number == total:
        return "That reopens what the words refer to."
    return f"{number} of {total} hypotheses are refuted and drawn anew." if is_open(before) else ""


def is_open(frame: Frame) -> bool:
    """Tell whether much of the belief is still hypothetical."""
    # With everything seen, what is drawn anew is only a better fit of the same objects.
    return float((frame.weight * frame.is_hypothesised.any(axis=0)).sum()) >= 0.1


def reread(moment: Moment) -> str:
    """Tell how what was seen changes what the words mean; nothing if no claim gained a tenth."""
    if moment.before is None:
        return ""
    now, then = (claim_shares(moment.scene, one) for one in (moment.frame, moment.before))
    claim = max(now, key=lambda one: now[one] - then[one])
    if now[claim] - then[claim] < 0.1:
        return ""
    return f"It now reads the words as: {claim} ({percent(now[claim])})."


def claim_shares(scene: StaticScene, frame: Frame) -> dict[str, float]:
    """Sum up how probable the particles hold each claim."""
    number = len(scene.readings.log_probability)
    return _by_claim(scene, np.bincount(frame.reading, frame.weight, minlength=number))


def _goal_name(scene: StaticScene, frame: Frame, slot: int) -> str:
    """Name the goal place at an observed object: "the hydrant", "the place behind the cone"."""
    region = int(frame.goal_region[slot])
    is_robot = slot == len(frame.goal_mass) - 1
    kinds = {one.slot: one.object_type for one in summary.seen_objects(frame)}
    thing = "where it started" if is_robot else f"the {scene.type_name(kinds.get(slot, NONE))}"
    # A region is only asked for where there is goal probability; elsewhere it is the object.
    if region == AT or float(frame.goal_mass[slot]) < 0.02:
        return thing
    return f"the place {REGISTRY[region].words} {thing}"


def believed(scene: StaticScene, frame: Frame) -> str:
    """Tell where the goal is believed to be."""
    order = np.argsort(-frame.goal_mass)
    fitting = [int(slot) for slot in order if frame.goal_mass[slot] >= 0.05]
    seen = [
        f"{_goal_name(scene, frame, slot)} "
        f"{_place(frame, float(frame.goal_x[slot]), float(frame.goal_y[slot]))} "
        f"({percent(float(frame.goal_mass[slot]))})"
        for slot in fitting
    ]
    verb = "is taken to be" if fitting and frame.goal_mass[fitting[0]] >= 0.5 else "may be"
    told = [f"The goal {verb} {', or '.join(seen)}."] if seen else []
    unseen = float(frame.hypothesis_goal_mass.sum())
    if unseen >= 0.05:
        spots = [
            f"{_place(frame, x, y)} ({percent(share * unseen)})"
            for x, y, share in summary.peaks(frame)
            if share * unseen >= 0.1
        ]
        where = f"likeliest it is {', or '.join(spots)}" if spots else "it could be anywhere"
        if seen:
            told.append(f"It may still be unseen ({percent(unseen)}): {where}.")
        else:
            sure = "" if unseen > 0.99 else f" ({percent(unseen)})"
            told.append(f"The goal has not been seen yet{sure}: {where}.")
    nothing = 1.0 - unseen - float(frame.goal_mass.sum())
    if nothing >= 0.15:
        told.append(f"In {percent(nothing)} of the maps nothing fits the command.")
    return " ".join(told)


def decided(scene: StaticScene, frame: Frame) -> str:
    """Tell what the robot does next, and why."""
    lack = unseen(scene, frame)
    if bool(frame.is_stop):
        is_find, stop = float(frame.action[1]) > 0.5, float(scene.planner.stop_probability)
        where = "in view" if is_find else f"within {float(scene.planner.reach):g} m"
        said = "Says stop" if bool(frame.is_done) else "This command is done"
        if bool(frame.is_done) and lack:
            return f"{said}: what fits best is {where}; {lack} was to be found."
        if float(frame.goal_mass.max()) < stop:
            why = "nothing left to look at would tell more"
            return f"{said}: what fits best is {where}, and {why}."
        return f"{said}: the goal is {where}, and surer than the {percent(stop)} at which it stops."
    if int(frame.status) == Status.NOT_FOUND:
        lack = lack or "nothing that fits the command"
        share = percent(summary.explored_share(frame))
        return (
            f"Says that there is {lack}: {share} of the area has been looked at, and that it has "
            f"been missed is less likely than {percent(float(scene.planner.give_up))}."
        )
    if int(frame.status) == Status.WHICH_ONE:
        return "Asks which one is meant: several fit, and nothing left to see would tell."
    if int(frame.status) == Status.BLOCKED:
        return "Says that it cannot get on: one waypoint after the other was given up."
    if bool(frame.is_kept):
        return f"Goes on to {target(scene, frame)}."
    node = summary.chosen_node(frame)
    if node is None:
        return f"Heads for {target(scene, frame)}."
    reason, of_object = scene.portrayal.reason, scene.portrayal.reason_object
    if of_object is not None and int(frame.node_kind[node]) == OBJECT_NODE:
        reason = of_object
    told = reason.format(
        number=len(summary.distinct_nodes(frame)),
        value=float(frame.value[node]),
        tested=percent(summary.tested_share(scene, frame)),
    )
    return f"Heads for {target(scene, frame)}: {told}."


def target(scene: StaticScene, frame: Frame) -> str:
    """Name the waypoint, and say where it is."""
    where = _place(frame, float(frame.waypoint[0]), float(frame.waypoint[1]))
    if int(frame.waypoint_kind) == VISITED:
        return f"a place it has been {where}"
    if int(frame.waypoint_kind) != OBJECT_NODE:
        return f"{scene.portrayal.place} {where}"
    x, y = frame.goal_x - frame.waypoint[0], frame.goal_y - frame.waypoint[1]
    slot = int(np.argmin(np.where(frame.is_goal, x * x + y * y, np.inf)))
    return f"{_goal_name(scene, frame, slot)} {where}"


def unseen(scene: StaticScene, frame: Frame) -> str:
    """Name what the sentence speaks of and no look has shown, "no cone and no bench"; or ""."""
    return " and ".join(f"no {name}" for name in missing_names(scene, frame))
