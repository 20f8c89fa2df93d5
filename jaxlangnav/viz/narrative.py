"""Generate a natural-language narrative of a recorded episode.

It tells the sentence's interpretation, the detections, the belief, the reason for each waypoint
and how the episode ended; every number comes from the recording.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.episode.recording import Recording, Remark, Snapshot, StaticScene, StepView, replay
from jaxlangnav.experiments.table import TableColumns
from jaxlangnav.messages import Status
from jaxlangnav.planner.graph import OBJECT_NODE
from jaxlangnav.terrain.view import Segment
from jaxlangnav.viz import sentences, summary
from jaxlangnav.viz.sentences import percent
from jaxlangnav.viz.summary import explored_fraction, select_steps as select_steps
from jaxlangnav.world.motion import BODY_RADIUS

_ENDED = {
    int(Status.NOT_FOUND): "gives up",
    int(Status.WHICH_ONE): "asks which one",
    int(Status.BLOCKED): "cannot get on",
    int(Status.HALTED): "stands, told to halt",
    int(Status.IDLE): "has no task",
}
_MIN_SHIFT = 0.1  # smallest change of an object's goal probability that is reported


def describe_moments(recording: Recording, steps: Sequence[int]) -> list[dict[str, Any]]:
    """Compute the quantities that a figure's panels show, one dict for each step.

    For each step: ``step``, ``distance`` walked (m), ``event``, ``goal_seen`` (probability that the
    goal is an observed object), ``unseen_left`` and ``unseen_right`` (that it is unseen, on either
    side of the line along which the robot began), ``spread`` of the unseen goal (m, root mean
    square from its mean; None where it has been seen), ``explored`` (fraction of the area).
    """
    x, y, heading = (float(value) for value in recording.scene.scenario.start)
    rows = []
    for step in steps:
        frame = recording.steps[step].frame
        mass = np.asarray(frame.hypothesis_goal_mass, float)
        dx, dy = frame.hypothesis_goal_x - x, frame.hypothesis_goal_y - y
        is_left = np.cos(heading) * dy - np.sin(heading) * dx > 0.0
        total = mass.sum()
        squared = sum((value - (value @ mass) / max(total, 1e-9)) ** 2 for value in (dx, dy))
        row = {
            "step": step,
            "distance": float(frame.distance),
            "event": headline(recording.steps[step]),
            "goal_seen": float(frame.goal_mass.sum()),
            "unseen_left": float(mass[is_left].sum()),
            "unseen_right": float(mass[~is_left].sum()),
            "spread": None if total < 0.05 else float(np.sqrt((squared @ mass) / total)),
            "explored": explored_fraction(frame),
        }
        rows.append(row)
    return rows


MOMENT_COLUMNS: TableColumns = (
    ("step", "{step}"),
    ("walked m", "{distance:.1f}"),
    ("what happens", "{event}"),
    ("goal seen", lambda row: percent(row["goal_seen"])),
    ("unseen, left", lambda row: percent(row["unseen_left"])),
    ("unseen, right", lambda row: percent(row["unseen_right"])),
    ("its spread m", lambda row: "" if row["spread"] is None else f"{row['spread']:.1f}"),
    ("looked at", lambda row: percent(row["explored"])),
)
"""Columns of a table of the rows of ``describe_moments``."""


def opening(scene: StaticScene) -> list[str]:
    """Describe the command, its interpretation and the prior knowledge of the map."""
    x_min, x_max, y_min, y_max = scene.area
    claims = sentences.describe_readings(scene)
    lines = [f"You said: “{scene.text}”."] if scene.text else []
    if claims:
        first, *alternatives = [f"{claim} ({percent(prob)})" for claim, prob in claims]
        if claims[0][0] != "nothing":
            lines.append(f"It takes this to say that there is {first}.")
        if commands := sentences.describe_commands(scene):
            lines.append(f"It is to {'; then to '.join(commands)}.")
        if alternatives:
            lines.append(f"It may also mean {', or '.join(alternatives)}.")
    num_walls = len(scene.walls)
    walls = f"{sentences.noun_list(['wall'] * num_walls)} " if num_walls else ""
    lines.append(
        f"It knows the edges of its area, {x_max - x_min:.1f} m by {y_max - y_min:.1f} m, "
        f"{walls}and nothing that stands there; it sees "
        f"{float(scene.sensor.range_max):.1f} m far."
    )
    return lines


def narrate_step(moment: StepView) -> list[str]:
    """Describe a step in sentences: utterances, detections, belief and decision."""
    scene, frame = moment.scene, moment.frame
    utterances = [sentences.describe_utterance(frame, remark) for remark in moment.utterances]
    if int(frame.status) in (Status.HALTED, Status.IDLE):
        return [*utterances, sentences.describe_waiting(frame)]
    if int(frame.fault):
        reasons = [words for bit, words in sentences.FAULT_WORDS.items() if int(frame.fault) & bit]
        return [*utterances, f"Stands still: {sentences.join_words(reasons)}."]
    is_silent = not moment.utterances  # what was understood before is nothing to compare with
    is_new_clause = moment.before is not None and int(frame.clause) != int(moment.before.clause)
    switch = f"Turns to command {int(frame.clause) + 1} of {len(scene.commands)}."
    parts = [
        *utterances,
        switch if is_silent and is_new_clause else "",
        describe_collision(moment),
        sentences.describe_detections(moment),
        sentences.describe_refutation(moment),
        sentences.describe_new_reading(moment) if is_silent else "",
        sentences.describe_goal(scene, frame),
        sentences.describe_decision(scene, frame),
    ]
    return [sentence for sentence in parts if sentence]


def headline(moment: StepView) -> str:
    """Summarize a step in a few words, such as "discovers a cone"."""
    scene, frame, before = moment.scene, moment.frame, moment.before
    if moment.utterances:
        return f"hears “{moment.utterances[-1].text}”"
    if int(frame.status) in _ENDED:
        return _ENDED[int(frame.status)]
    if int(frame.fault):
        return "stands still"
    if frame.is_done:
        return "says stop"
    if frame.is_stop:
        return "first command done"
    if before is not None and int(frame.clause) != int(before.clause):
        return "turns to the next command"
    if new := sentences.new_objects(moment):
        return f"discovers {sentences.noun_list([scene.type_name(obj.object_type) for obj in new])}"
    if before is None:
        return "hears the sentence, sees nothing"
    frac = float(frame.num_regrounded) / frame.weight.shape[0]
    if frac >= 0.1 and sentences.is_open(before):
        return f"not there: {percent(frac)} refuted"
    return "keeps on" if frame.is_kept else "new waypoint"


def describe_ending(scene: StaticScene, result: EpisodeResult, lack: str = "") -> tuple[str, str]:
    """Describe the ending in a few words and as a sentence; ``lack``: names of missing types."""
    ending, radius = int(result.ending), f"{scene.stop_radius:g} m"
    goal_distance = f"{float(result.goal_distance):.1f} m"
    outcome = "success" if bool(result.is_success) else "failure"
    outcome = outcome if scene.is_scored else "cannot be judged"
    verdicts = (
        (ending == Status.HALTED, "halted",
         "Halted: it stands still as it was told, and keeps its task."),
        (ending == Status.IDLE, "cancelled", "Cancelled: it has no task any more."),
        (not bool(result.is_stopped), "failure: out of time",
         f"Failure: it ran out of time after {int(result.steps)} steps and never said stop."),
        (ending == Status.NOT_FOUND, "not found",
         f"Not found: it says that there is {lack or 'nothing that fits the command'}."),
        (ending == Status.WHICH_ONE, outcome,
         "Asked: it stands still until it is told which one is meant."),
        (not scene.is_scored, outcome, f"Cannot be judged: {scene.unscored}."),
        (ending == Status.BLOCKED, outcome,
         "Blocked: it made no way, and tried other waypoints before it said so."),
        (bool(result.is_success), outcome,
         f"Success: it stands {goal_distance} from the goal that was meant."),
        (True, outcome,
         f"Failure: the goal that was meant is {goal_distance} away (within {radius} counts)."),
    )  # fmt: skip
    return next((brief, sentence) for applies, brief, sentence in verdicts if applies)


def closing(scene: StaticScene, frame: Snapshot, result: EpisodeResult) -> list[str]:
    """Describe how the episode ended and compare with the ground truth."""
    missing = sentences.describe_missing(scene, frame)
    path = f"It walked {float(result.distance):.1f} m."
    if scene.is_scored:
        path += f" With the map known, the way to the goal itself is {scene.known_distance:.1f} m."
    counts = (
        (int(result.overflow), "{} detections found no free slot."),
        (int(result.degenerate), "In {} steps all hypotheses had died."),
        (int(result.contradictions), "In {} steps it saw what contradicts its map."),
        (int(result.faults),
         "In {} steps it stood still, for what cannot be was reported to it."),
    )  # fmt: skip
    lines = [describe_ending(scene, result, missing)[1], path]
    if missing and int(result.ending) == Status.ARRIVED:
        lines.append(f"It has seen {missing}, and took what fits best.")
    return lines + [text.format(count) for count, text in counts if count]


def narrate(recording: Recording) -> list[str]:
    """Narrate a whole episode line by line; consecutive uneventful steps are merged."""
    lines, quiet = opening(recording.scene), list[StepView]()
    for moment in recording.steps:
        if not moment.utterances and _is_uneventful(moment):
            quiet.append(moment)
        else:
            lines += _merge_steps(quiet, recording)
            quiet = []
            lines.append(f"{_prefix(moment)} {' '.join(narrate_step(moment))}")
    lines += _merge_steps(quiet, recording)
    return lines + closing(recording.last_scene, recording.at(-1), recording.result)


def narrate_live(
    scene: StaticScene,
    steps: Iterable[tuple[Snapshot, EpisodeResult]],
    said: Sequence[Remark],
    write: Callable[[list[str]], object],
) -> Iterator[tuple[Snapshot, EpisodeResult]]:
    """Narrate an episode while it runs, and yield its steps; ``said`` may grow meanwhile."""
    for moment in replay(scene, steps, said):
        if moment.utterances or not _is_uneventful(moment) or sentences.new_objects(moment):
            write([f"{_prefix(moment)} {' '.join(narrate_step(moment))}"])
        yield moment.frame, moment.result


def describe_collision(moment: StepView) -> str:
    """Report whether a wall has stopped the robot on the way to its last waypoint."""
    frame, before = moment.frame, moment.before
    if before is None or not len(moment.scene.walls):
        return ""
    position = np.asarray(frame.position)
    ends = jnp.asarray([*position, *(position + before.waypoint - before.position)])
    clear = moment.scene.scenario.terrain.view.free_fraction(Segment(*ends), BODY_RADIUS + 0.01)
    return "A wall has halted it." if clear is not None and float(clear) == 0.0 else ""


def _is_uneventful(moment: StepView) -> bool:
    """Test whether a step needs no line of its own."""
    frame, before = moment.frame, moment.before
    if before is None:
        return False
    if int(frame.status) in (Status.HALTED, Status.IDLE):
        return int(frame.status) == int(before.status)
    if frame.is_stop or frame.is_news or int(frame.fault) or describe_collision(moment):
        return False
    if bool(frame.is_done):
        return bool(before.is_done) and int(frame.status) == int(before.status)
    if any(getattr(frame, key) != getattr(before, key) for key in ("clause", "waypoint_kind")):
        return False
    return float(abs(frame.goal_mass - before.goal_mass).max()) < _MIN_SHIFT


def _prefix(moment: StepView, steps: str = "") -> str:
    """Format the step number or range and the distance at the start of a line."""
    return f"[{steps or moment.step:>5} · {float(moment.frame.distance):4.1f} m]"


def _merge_steps(quiet: list[StepView], recording: Recording) -> list[str]:
    """Merge uneventful steps into one line; at most ten steps of a search."""
    if not quiet:
        return []
    first, moment = quiet[0].step, quiet[-1]
    scene, last = moment.scene, moment.frame
    head = _prefix(moment, f"{first}-{moment.step}" if len(quiet) > 1 else "")
    if bool(last.is_done) or int(last.status) in (Status.HALTED, Status.IDLE):
        return [f"{head} {sentences.describe_waiting(last)}"]
    new = [obj.object_type for step in quiet for obj in sentences.new_objects(step)]
    passed = f", past {sentences.noun_list([scene.type_name(code) for code in new])}" if new else ""
    if int(last.waypoint_kind) == OBJECT_NODE:
        progress = float(last.distance) - float(recording.frames.distance[max(first - 1, 0)])
        if len(quiet) > 2 and progress < 0.5:
            return [f"{head} Stands still. {sentences.describe_goal(scene, last)}"]
        return [f"{head} Goes on to {sentences.describe_waypoint(scene, last)}{passed}."]
    if len(quiet) > 10:
        return [*_merge_steps(quiet[:10], recording), *_merge_steps(quiet[10:], recording)]
    count = sum(int(step.frame.num_regrounded) for step in quiet)
    lost = f"{count} hypothes{'i' if count == 1 else 'e'}s refuted"
    # A regrounded particle may be refuted again.
    lost = lost if count <= last.weight.shape[0] else f"hypotheses refuted {count} times"
    explored = percent(summary.explored_fraction(last))
    verb = "Looks on" if last.is_detection.any() else "Searches, finds nothing"
    return [
        f"{head} {verb}{passed}: {lost} by what was not there, {explored} of the area looked at. "
        f"{sentences.describe_goal(scene, last)}"
    ]
