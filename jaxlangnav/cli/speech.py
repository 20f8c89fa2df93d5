"""Utterances during an episode of ``follow``: scripted, simulated or typed."""

import queue
import re
import sys
import threading
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from jaxlangnav.cli.output import Output, UsageError
from jaxlangnav.inputs.sanitize import sanitize, shorten
from jaxlangnav.inputs.schema import bad_choice

if TYPE_CHECKING:
    from jaxlangnav.episode import EpisodeState
    from jaxlangnav.episode.recording import Recording, Remark
    from jaxlangnav.grounding import Grounder
    from jaxlangnav.grounding.instruction import Understanding
    from jaxlangnav.navigator.candidates import Candidate
    from jaxlangnav.task.talk import Dialogue

_STEP_SECONDS = 0.4  # minimum duration of a step while the user may type


def read_script(hear: Iterable[str], max_steps: float) -> dict[int, list[str]]:
    """Parse scripted utterances such as "5: go to the other hydrant" into lists by step."""
    script: dict[int, list[str]] = {}
    for text in hear:
        match = re.fullmatch(r"\s*([0-9]+)\s*:\s*(\S.*?)\s*", text, re.DOTALL)
        if match is None:
            raise UsageError(
                f'--hear is "{shorten(text)}", but must name a step and what is said: '
                '--hear "5: go to the other hydrant"'
            )
        digits = match[1].lstrip("0") or "0"
        step = int(digits[:18])
        if step >= max_steps:
            raise UsageError(
                f"--hear is for step {shorten(digits)}, but the last one is {max_steps - 1}: name "
                "an earlier step, or raise --max-steps"
            )
        script.setdefault(step, []).append(match[2])
    return script


def check_speakers(*, ask: bool, talk: bool, person: str | None) -> None:
    """Raise UsageError for an unknown person, or if input is needed without a terminal."""
    from jaxlangnav.world.person import PERSONS

    if person is not None and person not in PERSONS:
        raise UsageError(bad_choice("--person", person, PERSONS))
    if person is not None and talk:
        raise UsageError("--person speaks for you: leave out --talk")
    for option, is_given in (("--ask", ask and person is None), ("--talk", talk)):
        if is_given and not sys.stdin.isatty():
            raise UsageError(
                f"{option} needs a terminal at which somebody answers: run it in one, or say "
                'by step what is heard, as in --hear "5: the left one"'
            )


def check_script(
    script: dict[int, list[str]], grounder: "Grounder", first: "Understanding"
) -> None:
    """Raise UsageError for utterances that could not be interpreted in any state."""
    from jaxlangnav.task.talk import check_utterance

    for step, texts in script.items():
        for text in texts:
            try:
                check_utterance(grounder, first, text)
            except ValueError as refusal:
                raise UsageError(f'--hear "{step}: {shorten(text)}": {refusal}') from refusal


def listener(output: Output, *, person: str | None, ask: bool, talk: bool, **kw: Any) -> "Dialogue":
    """Build the utterance source of ``recorder.play``; ``kw``: its other fields."""
    from jaxlangnav.task.talk import YOU, Dialogue, SimulatedPerson
    from jaxlangnav.world.person import PERSONS, params_of

    if person is not None:
        watcher = SimulatedPerson(params_of(**PERSONS[person]))
        return Dialogue(**kw, speakers={person: watcher.speak}, is_present=watcher.is_present)
    if not (ask or talk):
        return Dialogue(**kw)
    user = TerminalUser(output, is_talking=talk)
    return Dialogue(**kw, speakers={YOU: user.say}, is_present=user.is_present, on_heard=user.reply)


class TerminalUser:
    """User at the terminal, who answers questions and, if talking, types at any time."""

    def __init__(self, output: Output, *, is_talking: bool, lines: Iterable[str] | None = None):
        """Start a thread that reads lines, of standard input by default."""
        self._output, self._is_talking = output, is_talking
        self._lines = sys.stdin if lines is None else lines
        self._typed: queue.Queue[str | None] = queue.Queue()
        self._has_left = False
        self._step = -1
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        """Put the typed lines into the queue, and None at the end of the input."""
        for line in self._lines:
            self._typed.put(line)
        self._typed.put(None)

    def is_present(self, progress: "EpisodeState") -> bool:
        """Test whether the user may still speak to a waiting robot."""
        from jaxlangnav.messages import Status

        is_asked = int(progress.navigator.status) == Status.WHICH_ONE
        return not self._has_left and (self._is_talking or is_asked)

    def say(self, step: int, progress: "EpisodeState", asked: "Sequence[Candidate]") -> str | None:
        """Return the next line: waits for an answer to a question, else only briefly."""
        is_waiting = bool(asked) or (self._is_talking and bool(progress.navigator.is_resting))
        if self._has_left or not (is_waiting or self._is_talking):
            return None
        if asked:
            from jaxlangnav.navigator.candidates import believed_pose
            from jaxlangnav.viz.sentences import describe_offset

            self._output.note("Which one? The nearest first:")
            pose = believed_pose(progress.navigator).tolist()
            for rank, candidate in enumerate(asked, start=1):
                where = describe_offset(candidate.x, candidate.y, *pose)
                share = f"{100 * candidate.probability:.0f} %"
                self._output.note(f"  {rank}. the {candidate.type_name} {where}, {share}")
            self._output.note('Answer "the first", "the left one", "either" …; empty line: none.')
        elif is_waiting:
            self._output.note("It stands still. Say something, or end the input (Ctrl-D).")
        is_new, self._step = step != self._step, step
        try:
            line = self._typed.get(timeout=None if is_waiting else _STEP_SECONDS if is_new else 0.0)
        except queue.Empty:
            return None
        if line is None or (is_waiting and not line.strip()):
            self._has_left = True
            return None
        return line.strip() or None

    def reply(self, said: "Remark") -> None:
        """Report an utterance that was not understood."""
        if said.refusal:
            self._output.note(f"not understood now: {said.refusal}")


def describe_talk(recording: "Recording") -> dict[str, Any]:
    """Build the JSON of the utterances and candidates of a recording."""

    def to_dict(item: "Candidate") -> dict[str, Any]:
        return {"slot": item.slot, "type": item.type_name, "x": item.x, "y": item.y}

    return {
        "utterances": [
            {
                "step": remark.step,
                "speaker": remark.speaker,
                "text": sanitize(remark.text),
                "kind": remark.kind or None,
                "ruled_out": [to_dict(item) for item in remark.ruled_out],
                "notes": list(remark.notes),
                "refusal": remark.refusal or None,
            }
            for remark in recording.utterances
        ],
        "candidates": [
            {**to_dict(candidate), "probability": candidate.probability}
            for candidate in recording.candidates
        ],
    }
