"""Generate the sentences of the narrative, and words for numbers, positions and readings.

``scene`` is of the episode, ``frame`` one step. Functions with nothing to report return "".
"""

import math

import numpy as np

from jaxlangnav.episode.recording import Remark, Snapshot, StaticScene, StepView, missing_names
from jaxlangnav.grounding.command_summary import CommandSummary
from jaxlangnav.language.lexicon import plural
from jaxlangnav.messages import AT, NONE, ROBOT, Fault, Status
from jaxlangnav.planner.graph import OBJECT_NODE, VISITED
from jaxlangnav.planner.policy import ARRIVAL_RADIUS
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
_SURE = 0.95  # a command's probability is not reported from here on
ORDINALS = ("second", "third", "fourth")
_DIRECTIONS = (
    "ahead", "ahead to the left", "to the left", "behind to the left", "behind",
    "behind to the right", "to the right", "ahead to the right",
)  # fmt: skip


def describe_offset(x: float, y: float, robot_x: float, robot_y: float, heading: float) -> str:
    """Describe a position (m) relative to a robot pose (m, rad): "3.2 m ahead to the left"."""
    distance = math.hypot(x - robot_x, y - robot_y)
    if distance < 0.3:
        return "right here"
    bearing = math.atan2(y - robot_y, x - robot_x) - heading
    return f"{distance:.1f} m {_DIRECTIONS[round(bearing / (math.pi / 4)) % 8]}"


def percent(probability: float) -> str:
    """Format a probability in per cent, never rounded to 0 or 1: "< 1 %", "> 99 %"."""
    if 0.0 < probability < 0.01:
        return "< 1 %"
    if 0.99 < probability < 1.0 - 1e-6:
        return "> 99 %"
    return f"{100 * probability:.0f} %"


def with_article(noun: str) -> str:
    """Put "a" or "an" before a noun."""
    return f"{'an' if noun[:1] in 'aeiou' else 'a'} {noun}"


def noun_list(nouns: list[str]) -> str:
    """List nouns with their counts, in order of first occurrence: "a hydrant and two cones"."""
    words = ("", "", "two", "three", "four")
    parts = []
    for noun in dict.fromkeys(nouns):
        count = nouns.count(noun)
        word = words[count] if count < len(words) else str(count)
        parts.append(with_article(noun) if count == 1 else f"{word} {plural(noun)}")
    return join_words(parts)


def join_words(parts: list[str]) -> str:
    """Join phrases with commas and a final "and": "a, b and c"."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def describe_reading(scene: StaticScene, index: int) -> str:
    """Verbalize a reading of the sentence: "a hydrant behind a cone", or "nothing"."""
    readings = scene.readings
    landmarks = readings.landmark[index][readings.relation[index] != NONE]
    heads = np.setdiff1d(np.flatnonzero(readings.mention_type[index] >= 0), landmarks)
    return join_words([_mention_words(scene, index, i) for i in heads]) if heads.size else "nothing"


def _mention_words(scene: StaticScene, index: int, mention: int, path: tuple[int, ...] = ()) -> str:
    """Describe a mention of a reading by its relations: "a hydrant behind a cone"."""
    object_type = int(scene.readings.mention_type[index, mention])
    if ROBOT in (mention, object_type):
        return "the robot"
    relatives: dict[str, list[str]] = {}
    for figure, relation, landmark, rank in scene.readings.edges(index).tolist():
        if figure == mention and relation != NONE and landmark not in path:
            landmark_words = _mention_words(scene, index, landmark, (*path, mention))
            relatives.setdefault(_relation_words(relation, rank), []).append(landmark_words)
    parts = [f"{words} {join_words(names)}" for words, names in relatives.items()]
    return " ".join([with_article(scene.type_name(object_type)), *parts])


def _relation_words(relation: int, rank: int) -> str:
    """Describe a relation of a rank, 0 without one: "near", "second nearest to"."""
    if rank == 0:
        return REGISTRY[relation].words
    ordinal = f"{ORDINALS[min(rank, 4) - 2]} " if rank > 1 else ""
    return ordinal + SUPERLATIVE_WORDS[REGISTRY[relation].name]


def describe_commands(scene: StaticScene) -> list[str]:
    """Describe each command by the likeliest reading: "go to the hydrant"."""
    best = int(np.argmax(scene.readings.log_probability))

    def name(mention: int) -> str:
        words = _mention_words(scene, best, mention)
        first, _, noun = words.partition(" ")
        return f"the {noun}" if first in ("a", "an") else words

    def describe(command: CommandSummary) -> str:
        goal = "another one than before" if command.mention == NONE else name(command.mention)
        if command.mention != NONE and command.region != AT:
            metres = f"{command.metres:.3g} m " if command.metres else ""
            goal = f"{metres}{REGISTRY[command.region].words} {goal}"
        verb = "find" if command.action == "find" else "go to" if command.region == AT else "go"
        pace = "" if command.mode == "normal" else f" {command.mode}"
        avoided = [name(mention) for _, mention, _ in command.avoid]
        away = f", keeping away from {join_words(avoided)}" if avoided else ""
        confidence = "" if command.probability >= _SURE else f" ({percent(command.probability)})"
        return f"{verb} {goal}{pace}{away}{confidence}"

    return [describe(command) for command in scene.commands]


def describe_readings(scene: StaticScene, *, min_prob: float = 0.01) -> list[tuple[str, float]]:
    """List the claims of the readings with at least ``min_prob`` probability, likeliest first."""
    total = _sum_by_claim(scene, np.exp(np.asarray(scene.readings.log_probability, float)))
    ranked = sorted(total.items(), key=lambda item: -item[1])
    return [(claim, prob) for claim, prob in ranked if prob >= min_prob]


def _sum_by_claim(scene: StaticScene, probs: np.ndarray) -> dict[str, float]:
    """Sum probabilities of the readings, f64[K], over readings with the same wording (claim)."""
    total: dict[str, float] = {}
    for index in np.flatnonzero(np.isfinite(scene.readings.log_probability)).tolist():
        claim = describe_reading(scene, index)
        total[claim] = total.get(claim, 0.0) + float(probs[index])
    return total


def new_objects(moment: StepView) -> list[summary.ObservedObject]:
    """List the objects first observed in this step: neither their slot nor their place was held."""
    old = [] if moment.before is None else summary.observed_objects(moment.before)

    def is_old(obj: summary.ObservedObject, other: summary.ObservedObject) -> bool:
        # What words come to mention moves to another slot.
        is_near = math.hypot(obj.x - other.x, obj.y - other.y) < 0.5
        return obj.slot == other.slot or (is_near and obj.object_type == other.object_type)

    seen = summary.observed_objects(moment.frame)
    return [obj for obj in seen if not any(is_old(obj, other) for other in old)]


def _offset(frame: Snapshot, x: float, y: float) -> str:
    """Describe a position relative to the robot's believed pose."""
    return describe_offset(x, y, float(frame.robot[0]), float(frame.robot[1]), float(frame.heading))


def describe_utterance(frame: Snapshot, remark: Remark) -> str:
    """Describe an utterance, how it was interpreted and its effects, or why it was refused."""
    who = "Hears" if remark.speaker == "you" else f"Hears {remark.speaker}:"
    if remark.refusal:
        return f"{who} “{remark.text}”, and keeps to its task: {remark.refusal}."
    sentences = [f"{who} “{remark.text}”, {with_article(remark.kind)}."]
    if remark.ruled_out:
        names = [f"the {obj.type_name} {_offset(frame, obj.x, obj.y)}" for obj in remark.ruled_out]
        sentences.append(f"Rules out {join_words(names)}.")
    return " ".join([*sentences, *(f"{note[:1].upper()}{note[1:]}." for note in remark.notes)])


def describe_waiting(frame: Snapshot) -> str:
    """Explain why the robot stands still until it hears something."""
    reasons = {Status.IDLE: ": it has no task", Status.HALTED: ", as it was told"}
    return f"Stands still{reasons.get(Status(int(frame.status)), ' until it hears more')}."


def describe_detections(moment: StepView) -> str:
    """Describe the detections of a step: the new objects, or else those seen again."""
    scene, frame, new = moment.scene, moment.frame, new_objects(moment)
    if new:
        parts = [
            f"{with_article(scene.type_name(obj.object_type))} {_offset(frame, obj.x, obj.y)}"
            for obj in new
        ]
        return f"Discovers {join_words(parts)}."
    types = sorted(int(t) for t in frame.detection_type[frame.is_detection] if t != NONE)
    if not types:
        return "Sees nothing."
    names = [scene.type_name(t) for t in types]
    groups = [
        f"the {name}" if names.count(name) == 1 else f"{names.count(name)} {plural(name)}"
        for name in dict.fromkeys(names)
    ]
    return f"Sees {join_words(groups)} again."


def describe_refutation(moment: StepView) -> str:
    """Report how many particles' hypotheses were refuted by negative information."""
    frame, before = moment.frame, moment.before
    count, total = int(frame.num_regrounded), frame.weight.shape[0]
    if before is None or count < 2:
        return ""
    if bool(frame.is_news) and count == total:
        return "That reopens what the words refer to."
    return f"{count} of {total} hypotheses are refuted and drawn anew." if is_open(before) else ""


def is_open(frame: Snapshot) -> bool:
    """Test whether at least a tenth of the particle weight still has hypothesised objects."""
    # Once all objects are observed, regrounding only refits the same objects.
    return float((frame.weight * frame.is_hypothesised.any(axis=0)).sum()) >= 0.1


def describe_new_reading(moment: StepView) -> str:
    """Report the claim that gained the most probability in a step, if it gained a tenth."""
    if moment.before is None:
        return ""
    current, past = (claim_probabilities(moment.scene, f) for f in (moment.frame, moment.before))
    claim = max(current, key=lambda key: current[key] - past[key])
    if current[claim] - past[claim] < 0.1:
        return ""
    return f"It now reads the words as: {claim} ({percent(current[claim])})."


def claim_probabilities(scene: StaticScene, frame: Snapshot) -> dict[str, float]:
    """Compute each claim's posterior probability: the weight of the particles that hold it."""
    num_readings = len(scene.readings.log_probability)
    return _sum_by_claim(scene, np.bincount(frame.reading, frame.weight, minlength=num_readings))


def _goal_name(scene: StaticScene, frame: Snapshot, slot: int) -> str:
    """Name the goal at an observed object: "the hydrant", "the place behind the cone"."""
    region = int(frame.goal_region[slot])
    is_robot = slot == len(frame.goal_mass) - 1
    types = {obj.slot: obj.object_type for obj in summary.observed_objects(frame)}
    name = "where it started" if is_robot else f"the {scene.type_name(types.get(slot, NONE))}"
    # A region is only asked for where there is goal probability; elsewhere it is the object.
    if region == AT or float(frame.goal_mass[slot]) < 0.02:
        return name
    return f"the place {REGISTRY[region].words} {name}"


def describe_goal(scene: StaticScene, frame: Snapshot) -> str:
    """Describe the posterior over the goal position."""
    order = np.argsort(-frame.goal_mass)
    if int(frame.status) == Status.WHICH_ONE:  # as the question lists them: the nearest first
        order = np.argsort(np.hypot(frame.goal_x - frame.robot[0], frame.goal_y - frame.robot[1]))
    slots = [int(slot) for slot in order if frame.goal_mass[slot] >= 0.05]
    seen = [
        f"{_goal_name(scene, frame, slot)} "
        f"{_offset(frame, float(frame.goal_x[slot]), float(frame.goal_y[slot]))} "
        f"({percent(float(frame.goal_mass[slot]))})"
        for slot in slots
    ]
    verb = "is taken to be" if slots and frame.goal_mass[slots[0]] >= 0.5 else "may be"
    sentences = [f"The goal {verb} {', or '.join(seen)}."] if seen else []
    unseen = float(frame.hypothesis_goal_mass.sum())
    if unseen >= 0.05:
        modes = [
            f"{_offset(frame, x, y)} ({percent(frac * unseen)})"
            for x, y, frac in summary.goal_modes(frame)
            if frac * unseen >= 0.1
        ]
        location = f"likeliest it is {', or '.join(modes)}" if modes else "it could be anywhere"
        if seen:
            sentences.append(f"It may still be unseen ({percent(unseen)}): {location}.")
        else:
            sure = "" if unseen > 0.99 else f" ({percent(unseen)})"
            sentences.append(f"The goal has not been seen yet{sure}: {location}.")
    no_match = 1.0 - unseen - float(frame.goal_mass.sum())
    if no_match >= 0.15:
        sentences.append(f"In {percent(no_match)} of the maps nothing fits the command.")
    return " ".join(sentences)


def describe_decision(scene: StaticScene, frame: Snapshot) -> str:
    """Describe the policy's decision and its reason."""
    missing = describe_missing(scene, frame)
    if bool(frame.is_stop):
        is_find, stop = float(frame.action[1]) > 0.5, float(scene.planner.stop_probability)
        is_measured = any(command.metres for command in scene.commands[int(frame.clause) :][:1])
        reach = ARRIVAL_RADIUS if is_measured else float(scene.planner.reach)
        place = "in view" if is_find else f"within {reach:g} m"
        verb = "Says stop" if bool(frame.is_done) else "This command is done"
        if bool(frame.is_done) and missing:
            return f"{verb}: what fits best is {place}; {missing} was to be found."
        if float(frame.goal_mass.max()) < stop:
            return f"{verb}: what fits best is {place}; a better one is too unlikely to look for."
        return f"{verb}: the goal is {place}, and surer than the {percent(stop)} at which it stops."
    if int(frame.status) == Status.NOT_FOUND:
        missing = missing or "nothing that fits the command"
        explored = percent(summary.explored_fraction(frame))
        return (
            f"Says that there is {missing}: {explored} of the area has been looked at, and that it "
            f"has been missed is less likely than {percent(float(scene.planner.give_up))}."
        )
    if int(frame.status) == Status.WHICH_ONE:
        return "Asks which one is meant: several fit, and looking on would tell too little."
    if int(frame.status) == Status.BLOCKED:
        return "Says that it cannot get on: one waypoint after the other was given up."
    node = None if bool(frame.is_kept) else summary.chosen_node(frame)
    if node is None:
        verb = "Goes on to" if bool(frame.is_kept) else "Heads for"
        return f"{verb} {describe_waypoint(scene, frame)}."
    is_object = int(frame.node_kind[node]) == OBJECT_NODE
    reason = (is_object and scene.portrayal.reason_object) or scene.portrayal.reason
    explanation = reason.format(
        number=len(summary.distinct_nodes(frame)),
        value=float(frame.value[node]),
        tested=percent(summary.tested_mass(scene, frame)),
    )
    return f"Heads for {describe_waypoint(scene, frame)}: {explanation}."


def describe_waypoint(scene: StaticScene, frame: Snapshot) -> str:
    """Name the waypoint and describe its position."""
    location = _offset(frame, float(frame.waypoint[0]), float(frame.waypoint[1]))
    if int(frame.waypoint_kind) == VISITED:
        return f"a place it has been {location}"
    if int(frame.waypoint_kind) != OBJECT_NODE:
        return f"{scene.portrayal.place} {location}"
    x, y = frame.goal_x - frame.waypoint[0], frame.goal_y - frame.waypoint[1]
    slot = int(np.argmin(np.where(frame.is_goal, x * x + y * y, np.inf)))
    return f"{_goal_name(scene, frame, slot)} {location}"


def describe_missing(scene: StaticScene, frame: Snapshot) -> str:
    """Name the mentioned object types not observed so far, "no cone and no bench", or ""."""
    return " and ".join(f"no {name}" for name in missing_names(scene, frame))
