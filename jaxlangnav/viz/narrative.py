"""The story of an episode in plain words (what section 4 shows by way of Figures 1 and 4).

What the sentence was taken to mean, what is seen, what is believed now, why this waypoint, why
it stopped. Every number comes from the recording; nothing is made up for the occasion.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.episode.recording import Frame, Moment, Recording, Remark, StaticScene, moments
from jaxlangnav.experiments.table import Table, TableColumns
from jaxlangnav.messages import Status
from jaxlangnav.planner.graph import OBJECT_NODE
from jaxlangnav.terrain.view import Stretch
from jaxlangnav.viz import sentences, summary
from jaxlangnav.viz.sentences import percent
from jaxlangnav.viz.summary import explored_share, pick_moments as pick_moments
from jaxlangnav.world.motion import BODY_RADIUS

_ENDED = {
    int(Status.NOT_FOUND): "gives up",
    int(Status.WHICH_ONE): "asks which one",
    int(Status.BLOCKED): "cannot get on",
    int(Status.HALTED): "stands, told to halt",
    int(Status.IDLE): "has no task",
}
_SHIFT = 0.1  # a change of an object's probability of being the goal that is worth a line


def describe_moments(recording: Recording, steps: Sequence[int]) -> list[dict[str, Any]]:
    """Say in numbers what the panels of a figure show.

    For each step: ``step``, ``distance`` walked (m), ``event``, ``goal_seen`` (probability that the
    goal is an observed object), ``unseen_left`` and ``unseen_right`` (that it is unseen, on either
    side of the line along which the robot began), ``spread`` of the unseen goal (m, root mean
    square from its mean; None where it has been seen), ``explored`` (share of the area).
    """
    x, y, heading = (float(one) for one in recording.scene.scenario.start)
    found = []
    for step in steps:
        frame = recording.moments[step].frame
        mass = np.asarray(frame.hypothesis_goal_mass, float)
        gone_x, gone_y = frame.hypothesis_goal_x - x, frame.hypothesis_goal_y - y
        is_left = np.cos(heading) * gone_y - np.sin(heading) * gone_x > 0.0
        total = mass.sum()
        square = sum((one - (one @ mass) / max(total, 1e-9)) ** 2 for one in (gone_x, gone_y))
        told = {
            "step": step,
            "distance": float(frame.distance),
            "event": headline(recording.moments[step]),
            "goal_seen": float(frame.goal_mass.sum()),
            "unseen_left": float(mass[is_left].sum()),
            "unseen_right": float(mass[~is_left].sum()),
            "spread": None if total < 0.05 else float(np.sqrt((square @ mass) / total)),
            "explored": explored_share(frame),
        }
        found.append(told)
    return found


_MOMENTS: TableColumns = (
    ("step", "{step}"),
    ("walked m", "{distance:.1f}"),
    ("what happens", "{event}"),
    ("goal seen", lambda one: percent(one["goal_seen"])),
    ("unseen, left", lambda one: percent(one["unseen_left"])),
    ("unseen, right", lambda one: percent(one["unseen_right"])),
    ("its spread m", lambda one: "" if one["spread"] is None else f"{one['spread']:.1f}"),
    ("looked at", lambda one: percent(one["explored"])),
)


def moments_table(moments: Sequence[dict[str, Any]]) -> Table:
    """Lay out the moments of a figure, of ``describe_moments``, a line each."""
    return Table.of(moments, _MOMENTS)


def opening(scene: StaticScene) -> list[str]:
    """Tell what was said and how it was understood."""
    x_min, x_max, y_min, y_max = scene.area
    claims = sentences.describe_readings(scene)
    lines = [f"You said: “{scene.text}”."] if scene.text else []
    if claims:
        first, *others = [f"{claim} ({percent(share)})" for claim, share in claims]
        lines.append(f"It takes this to say that there is {first}.")
        if commands := sentences.describe_asked(scene):
            lines.append(f"It is to {'; then to '.join(commands)}.")
        if others:
            lines.append(f"It may also mean {', or '.join(others)}.")
    number = len(scene.walls)
    walls = f"{sentences.counted(['wall'] * number)} " if number else ""
    lines.append(
        f"It knows the edges of its area, {x_max - x_min:.1f} m by {y_max - y_min:.1f} m, "
        f"{walls}and nothing that stands there; it sees "
        f"{float(scene.sensor.range_max):.1f} m far."
    )
    return lines


def tell_step(moment: Moment) -> list[str]:
    """Tell a step, a sentence each: what is heard, seen and believed, what it does and why."""
    scene, frame = moment.scene, moment.frame
    heard = [sentences.heard(frame, one) for one in moment.said]
    if int(frame.status) in (Status.HALTED, Status.IDLE):
        return [*heard, sentences.rests(frame)]
    if int(frame.fault):
        why = [words for bit, words in sentences.FAULT_WORDS.items() if int(frame.fault) & bit]
        return [*heard, f"Stands still: {sentences.listed(why)}."]
    is_same = not moment.said  # what was understood before is nothing to compare with
    turns = moment.before is not None and int(frame.clause) != int(moment.before.clause)
    turned = f"Turns to command {int(frame.clause) + 1} of {scene.num_clauses}."
    told = [
        *heard,
        turned if is_same and turns else "",
        bumped(moment),
        sentences.seen(moment),
        sentences.refuted(moment),
        sentences.reread(moment) if is_same else "",
        sentences.believed(scene, frame),
        sentences.decided(scene, frame),
    ]
    return [sentence for sentence in told if sentence]


def headline(moment: Moment) -> str:
    """Say a step in a few words, for the head of a panel, such as "discovers a cone"."""
    scene, frame, before = moment.scene, moment.frame, moment.before
    if moment.said:
        return f"hears “{moment.said[-1].text}”"
    if int(frame.fault) and int(frame.status) not in _ENDED:
        return "stands still"
    if int(frame.status) in _ENDED:
        return _ENDED[int(frame.status)]
    if frame.is_done:
        return "says stop"
    if frame.is_stop:
        return "first command done"
    if before is not None and int(frame.clause) != int(before.clause):
        return "turns to the next command"
    if new := sentences.new_objects(moment):
        return f"discovers {sentences.counted([scene.type_name(one.object_type) for one in new])}"
    if before is None:
        return "hears the sentence, sees nothing"
    share = float(frame.num_regrounded) / frame.weight.shape[0]
    if share >= 0.1 and sentences.is_open(before):
        return f"not there: {percent(share)} refuted"
    return "keeps on" if frame.is_kept else "new waypoint"


def say_ending(scene: StaticScene, result: EpisodeResult, lack: str = "") -> tuple[str, str]:
    """Say how an episode ended, in a few words and in a sentence; ``lack`` is of ``unseen``."""
    ending, radius = int(result.ending), f"{scene.stop_radius:g} m"
    off = f"{float(result.goal_distance):.1f} m"
    judged = "success" if bool(result.is_success) else "failure"
    judged = judged if scene.is_judged else "cannot be judged"
    verdicts = (
        (ending == Status.HALTED, "halted",
         "Halted: it stands still as it was told, and keeps its task."),
        (ending == Status.IDLE, "cancelled", "Cancelled: it has no task any more."),
        (not bool(result.is_stopped), "failure: out of time",
         f"Failure: it ran out of time after {int(result.steps)} steps and never said stop."),
        (ending == Status.NOT_FOUND, "not found",
         f"Not found: it says that there is {lack or 'nothing that fits the command'}."),
        (ending == Status.WHICH_ONE, judged,
         "Asked: it stands still until it is told which one is meant."),
        (not scene.is_judged, judged, f"Cannot be judged: {scene.unjudged}."),
        (ending == Status.BLOCKED, judged,
         "Blocked: it made no way, and tried other waypoints before it said so."),
        (bool(result.is_success), judged,
         f"Success: it stands {off} from the goal that was meant."),
        (True, judged,
         f"Failure: the goal that was meant is {off} away (within {radius} counts)."),
    )  # fmt: skip
    return next((brief, told) for holds, brief, told in verdicts if holds)


def closing(scene: StaticScene, frame: Frame, result: EpisodeResult) -> list[str]:
    """Tell how it ended, by the last step and the result; the truth is revealed only here."""
    lack = sentences.unseen(scene, frame)
    way = f"It walked {float(result.distance):.1f} m."
    if scene.is_judged:
        way += (
            f" With the map known, straight on until it may stop ({scene.stop_radius:g} m from "
            f"the goal) would have been {scene.straight_distance:.1f} m."
        )
    counts = (
        (int(result.overflow), "{} detections found no free slot."),
        (int(result.degenerate), "In {} steps all hypotheses had died."),
        (int(result.contradictions), "In {} steps it saw what contradicts its map."),
        (int(result.faults),
         "In {} steps it stood still, for what cannot be was reported to it."),
    )  # fmt: skip
    lines = [say_ending(scene, result, lack)[1], way]
    if lack and int(result.ending) == Status.ARRIVED:
        lines.append(f"It has seen {lack}, and took what fits best.")
    return lines + [text.format(number) for number, text in counts if number]


def narrate(recording: Recording) -> list[str]:
    """Tell a whole episode, line by line; steps without event are drawn together."""
    lines, quiet = opening(recording.scene), list[Moment]()
    for moment in recording.moments:
        if not moment.said and _is_quiet(moment):
            quiet.append(moment)
        else:
            lines += _drawn_together(quiet, recording)
            quiet = []
            lines.append(f"{_head(moment)} {' '.join(tell_step(moment))}")
    lines += _drawn_together(quiet, recording)
    return lines + closing(recording.last_scene, recording.at(-1), recording.result)


def tell_on(
    scene: StaticScene,
    steps: Iterable[tuple[Frame, EpisodeResult]],
    said: Sequence[Remark],
    tell: Callable[[list[str]], object],
) -> Iterator[tuple[Frame, EpisodeResult]]:
    """Tell an episode while it runs, and pass its steps on; ``said`` grows meanwhile."""
    for moment in moments(scene, steps, said):
        if moment.said or not _is_quiet(moment):
            tell([f"{_head(moment)} {' '.join(tell_step(moment))}"])
        yield moment.frame, moment.result


def bumped(moment: Moment) -> str:
    """Tell that a wall has halted the robot on its way to where it went last."""
    frame, before = moment.frame, moment.before
    if before is None or not len(moment.scene.walls):
        return ""
    here = np.asarray(frame.position)
    ends = jnp.asarray([*here, *(here + before.waypoint - before.position)])
    way = Stretch(*ends)
    share = moment.scene.scenario.terrain.view.clear_share(way, BODY_RADIUS + 0.01)
    return "A wall has halted it." if share is not None and float(share) == 0.0 else ""


def _is_quiet(moment: Moment) -> bool:
    """Tell whether nothing worth a line of its own happened in a step."""
    frame, before = moment.frame, moment.before
    if before is None:
        return False
    if int(frame.status) in (Status.HALTED, Status.IDLE):
        return int(frame.status) == int(before.status)
    if bool(frame.is_stop) or bool(frame.is_news) or int(frame.fault):
        return False
    if bumped(moment):
        return False
    if bool(frame.is_done):
        return bool(before.is_done) and int(frame.status) == int(before.status)
    if any(getattr(frame, one) != getattr(before, one) for one in ("clause", "waypoint_kind")):
        return False
    return float(abs(frame.goal_mass - before.goal_mass).max()) < _SHIFT


def _head(moment: Moment, steps: str = "") -> str:
    """Head a line of the story, of one step or of several that end with it."""
    return f"[{steps or moment.step:>5} · {float(moment.frame.distance):4.1f} m]"


def _drawn_together(quiet: list[Moment], recording: Recording) -> list[str]:
    """Say several steps without event in one line; of a search at most ten."""
    if not quiet:
        return []
    first, moment = quiet[0].step, quiet[-1]
    scene, last = moment.scene, moment.frame
    head = _head(moment, f"{first}-{moment.step}" if len(quiet) > 1 else "")
    if bool(last.is_done) or int(last.status) in (Status.HALTED, Status.IDLE):
        return [f"{head} {sentences.rests(last)}"]
    if int(last.waypoint_kind) == OBJECT_NODE:
        gone = float(last.distance) - float(recording.frames.distance[max(first - 1, 0)])
        if len(quiet) > 2 and gone < 0.5:
            return [f"{head} Stands still. {sentences.believed(scene, last)}"]
        return [f"{head} Goes on to {sentences.target(scene, last)}."]
    if len(quiet) > 10:
        return [*_drawn_together(quiet[:10], recording), *_drawn_together(quiet[10:], recording)]
    refuted = sum(int(one.frame.num_regrounded) for one in quiet)
    lost = f"{refuted} hypothes{'i' if refuted == 1 else 'e'}s refuted"
    # What is drawn anew may be refuted again.
    lost = lost if refuted <= last.weight.shape[0] else f"hypotheses refuted {refuted} times"
    share = percent(summary.explored_share(last))
    seen = "Looks on" if last.is_detection.any() else "Searches, finds nothing"
    return [
        f"{head} {seen}: {lost} by what was not there, {share} of the area looked at. "
        f"{sentences.believed(scene, last)}"
    ]
