"""The story of an episode in plain words (what section 4 shows by way of Figures 1 and 4).

What the sentence was taken to mean, what is seen, what is believed now, why this waypoint, why
it stopped. Every number comes from the recording; nothing is made up for the occasion.
"""

import math

import numpy as np

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.messages import NONE
from jaxlangnav.planner.graph import OBJECT
from jaxlangnav.recording import Frame, Recording, Scene
from jaxlangnav.viz import summary
from jaxlangnav.viz.words import (
    article,
    describe_readings,
    listed,
    node_words,
    percent,
    whereabouts,
)
from jaxlangnav.world.simulator import SUCCESS_RADIUS

_SHIFT = 0.1
"""A change of an object's probability of being the goal that is worth a line."""


def opening(scene: Scene) -> list[str]:
    """Tell what was said and how it was understood.

    Args:
        scene: of the episode.

    Returns:
        Lines.
    """
    x_min, x_max, y_min, y_max = scene.area
    claims = describe_readings(scene)
    lines = [f"You said: “{scene.text}”."] if scene.text else []
    if claims:
        first, *others = [f"{claim} ({percent(share)})" for claim, share in claims]
        lines.append(f"It takes this to say that there is {first}.")
        if others:
            lines.append(f"It may also mean {', or '.join(others)}.")
    lines.append(
        f"It knows the edges of its area, {x_max - x_min:.1f} m by {y_max - y_min:.1f} m, and "
        f"nothing that stands there; it sees {float(scene.sensor.range_max):.1f} m far."
    )
    return lines


def new_objects(frame: Frame, before: Frame | None) -> list[summary.SeenObject]:
    """List what this step has discovered.

    Args:
        frame: the step.
        before: the step before; None at first.

    Returns:
        Observed objects in slots that were empty before.
    """
    old = {one.slot for one in summary.seen_objects(before)} if before is not None else set()
    return [one for one in summary.seen_objects(frame) if one.slot not in old]


def tell_step(scene: Scene, frame: Frame, before: Frame | None) -> list[str]:
    """Tell one step: what is seen, what is believed, what it does and why.

    Args:
        scene: of the episode.
        frame: the step.
        before: the step before; None at first.

    Returns:
        One sentence each.
    """
    told = [_seen(scene, frame, before), _refuted(frame, before), _believed(scene, frame)]
    told.append(_decided(scene, frame))
    return [sentence for sentence in told if sentence]


def headline(scene: Scene, frame: Frame, before: Frame | None) -> str:
    """Say a step in a few words, for the head of a panel.

    Args:
        scene: of the episode.
        frame: the step.
        before: the step before; None at first.

    Returns:
        "discovers a cone", "stops", …
    """
    if frame.is_done:
        return "says stop"
    if frame.is_stop:
        return "first command done"
    new = new_objects(frame, before)
    if new:
        return f"discovers {listed([article(scene.type_name(one.object_type)) for one in new])}"
    if before is None:
        return "hears the sentence, sees nothing"
    share = float(frame.num_regrounded) / frame.weight.shape[0]
    if share >= 0.1 and _is_open(before):
        return f"not there: {percent(share)} refuted"
    return "keeps on" if frame.is_kept else "new waypoint"


def closing(scene: Scene, frame: Frame, result: EpisodeResult) -> list[str]:
    """Tell how it ended; the truth is revealed only here.

    Args:
        scene: of the episode.
        frame: the last step.
        result: how the episode is judged.

    Returns:
        Lines.
    """
    off, walked = float(result.goal_distance), float(result.distance)
    way = (
        f"It walked {walked:.1f} m; straight to the goal, with the map known, would have been "
        f"{scene.known_distance:.1f} m."
    )
    if not bool(result.is_stopped):
        verdict = (
            f"Failure: it ran out of time after {int(result.steps)} steps and never said stop."
        )
    elif bool(result.is_success):
        verdict = f"Success: it stands {off:.1f} m from the goal that was meant."
    else:
        verdict = (
            f"Failure: the goal that was meant is {off:.1f} m away "
            f"(within {SUCCESS_RADIUS:g} m counts)."
        )
    notes = []
    if int(result.overflow):
        notes.append(f"{int(result.overflow)} detections found no free slot.")
    if int(result.degenerate):
        notes.append(f"In {int(result.degenerate)} steps all hypotheses had died.")
    return [verdict, way, *notes]


def tell(recording: Recording) -> list[str]:
    """Tell a whole episode, steps without event drawn together.

    Args:
        recording: the episode.

    Returns:
        Lines, each to be printed on its own; steps begin with their number and the metres walked.
    """
    scene, before = recording.scene, None
    lines, quiet = opening(scene), []
    for step in range(recording.num_steps):
        frame = recording.at(step)
        if is_quiet(frame, before):
            quiet.append(step)
        else:
            lines += _drawn_together(quiet, recording)
            quiet = []
            head = _head(str(step), float(frame.distance))
            lines.append(f"{head} {' '.join(tell_step(scene, frame, before))}")
        before = frame
    lines += _drawn_together(quiet, recording)
    return lines + closing(scene, recording.at(-1), recording.result)


def is_quiet(frame: Frame, before: Frame | None) -> bool:
    """Tell whether nothing worth a line of its own happened in a step.

    Args:
        frame: the step.
        before: the step before; None at first.

    Returns:
        True where the robot discovers nothing, is about as sure of the goal as it was, and goes
        for the same kind of place.
    """
    if before is None or bool(frame.is_stop) or bool(frame.is_news):
        return False
    if int(frame.waypoint_kind) != int(before.waypoint_kind):
        return False
    shift = abs(frame.goal_mass - before.goal_mass).max()
    return float(shift) < _SHIFT


def _head(steps: str, distance: float) -> str:
    """Head a line of the story."""
    return f"[{steps:>5} · {distance:4.1f} m]"


def _drawn_together(steps: list[int], recording: Recording) -> list[str]:
    """Say several steps without event in one line."""
    if not steps:
        return []
    last = recording.at(steps[-1])
    number = str(steps[0]) if len(steps) == 1 else f"{steps[0]}-{steps[-1]}"
    head = _head(number, float(last.distance))
    if int(last.waypoint_kind) == OBJECT:
        return [f"{head} Keeps on to the object."]
    refuted = int(recording.frames.num_regrounded[steps].sum())
    share = percent(summary.explored_share(last))
    seen = "Looks on" if last.is_detection.any() else "Searches, finds nothing"
    return [
        f"{head} {seen}: {refuted} hypotheses refuted by what was not there, {share} of the area "
        f"looked at. {_believed(recording.scene, last)}"
    ]


def _place(frame: Frame, x: float, y: float) -> str:
    """Say where a place is, seen from the robot as it believes itself to stand."""
    return whereabouts(x, y, float(frame.robot[0]), float(frame.robot[1]), float(frame.heading))


def _seen(scene: Scene, frame: Frame, before: Frame | None) -> str:
    """Tell the detections of a step, discoveries first."""
    new = new_objects(frame, before)
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
    counted = [
        f"the {name}" if names.count(name) == 1 else f"{names.count(name)} {name}s"
        for name in dict.fromkeys(names)
    ]
    return f"Sees {listed(counted)} again."


def _refuted(frame: Frame, before: Frame | None) -> str:
    """Tell how many hypotheses what was not there has cost."""
    number, total = int(frame.num_regrounded), frame.weight.shape[0]
    if before is None or number < 2:
        return ""
    if bool(frame.is_news) and number == total:
        return "That reopens what the words refer to."
    return f"{number} of {total} hypotheses are refuted and drawn anew." if _is_open(before) else ""


def _is_open(frame: Frame) -> bool:
    """Tell whether much of the belief is still hypothetical.

    With everything seen, what is drawn anew is only a better fit of the same objects.
    """
    return float((frame.weight * frame.is_hypothesised.any(axis=0)).sum()) >= 0.1


def _believed(scene: Scene, frame: Frame) -> str:
    """Tell where the goal is believed to be."""
    fitting = [one for one in summary.seen_objects(frame) if one.goal_mass >= 0.05]
    fitting = sorted(fitting, key=lambda one: -one.goal_mass)
    seen = [
        f"the {scene.type_name(one.object_type)} {_place(frame, one.x, one.y)} "
        f"({percent(one.goal_mass)})"
        for one in fitting
    ]
    verb = "is taken to be" if fitting and fitting[0].goal_mass >= 0.5 else "may be"
    told = [f"The goal {verb} {', or '.join(seen)}."] if seen else []
    unseen = float(frame.hypothesis_goal_mass.sum())
    if unseen >= 0.05:
        spots = [
            f"{_place(frame, x, y)} ({percent(share * unseen)})"
            for x, y, share in summary.peaks(frame)
            if share * unseen >= 0.1
        ]
        where = f"likeliest {', or '.join(spots)}" if spots else "it could be anywhere"
        subject = "It may still be unseen" if seen else "The goal has not been seen yet"
        told.append(f"{subject} ({percent(unseen)}): {where}.")
    return " ".join(told) or "It knows of no place that fits the command."


def _decided(scene: Scene, frame: Frame) -> str:
    """Tell what the robot does next, and why."""
    if bool(frame.is_stop):
        return _stopped(scene, frame)
    x, y = float(frame.waypoint[0]), float(frame.waypoint[1])
    target = f"{node_words(int(frame.waypoint_kind), scene.policy)} {_place(frame, x, y)}"
    if int(frame.waypoint_kind) == OBJECT:
        near = min(
            summary.seen_objects(frame),
            key=lambda one: math.hypot(one.x - x, one.y - y),
            default=None,
        )
        if near is not None:
            target = f"the {scene.type_name(near.object_type)} {_place(frame, x, y)}"
    if bool(frame.is_kept):
        return f"Keeps on to {target}."
    return f"Heads for {target}{_reason(scene, frame)}."


def _reason(scene: Scene, frame: Frame) -> str:
    """Tell why the chosen node is the best."""
    node = summary.chosen_node(frame)
    if node is None:
        return ""
    value, number = float(frame.value[node]), int(np.isfinite(frame.value).sum())
    if scene.policy == "informed":
        if int(frame.node_kind[node]) == OBJECT:
            return ": nothing is left to find out that would matter more"
        tested = percent(summary.tested_share(scene, frame))
        return (
            f": of {number} places it promises most; the way puts {tested} of the maps to the test"
        )
    return f": of {number} places it is on average nearest to the goal (value {value:.2f})"


def _stopped(scene: Scene, frame: Frame) -> str:
    """Tell why it stops."""
    is_find = float(frame.action[1]) > 0.5
    where = "in view" if is_find else f"within {float(scene.planner.reach):g} m"
    said = "Says stop" if bool(frame.is_done) else "This command is done"
    return (
        f"{said}: the goal is {where} with probability {percent(float(frame.stop_mass))} "
        f"(it stops from {percent(float(scene.planner.stop_probability))} on)."
    )
