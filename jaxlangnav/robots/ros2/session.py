"""Session with one robot: a queue of utterances, one drive after the other; without ROS.

An utterance that is refused is reported and changes nothing. A restarted node resumes the running
task from the utterances stored in a file; its observations are lost.
"""

import json
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from jax import Array

from jaxlangnav.inputs.atomic_files import write_text
from jaxlangnav.inputs.documents import parse_json, read_text
from jaxlangnav.navigator import NavigatorInfo, NavigatorState
from jaxlangnav.navigator.api import Navigator
from jaxlangnav.robots.driver import drive
from jaxlangnav.robots.robot import NavigationRun, Robot, Step, wrap_heading

DUPLICATE_SECONDS = 1.0
"""Seconds within which the same text is a duplicate message."""
_MAX_BYTES = 100_000  # of a file of utterances
TellStatus = Callable[[dict[str, Any]], None]
"""Callback that publishes the robot's status, a JSON object."""


class Session:
    """Session that takes utterances, drives the robot, and publishes its status."""

    def __init__(
        self,
        navigator: Navigator,
        robot: Robot,
        tell: TellStatus,
        *,
        key: Array,
        max_seconds: float = 300.0,
        path: Path | None = None,
    ) -> None:
        """Start a session, or resume one; a ValueError if the file is no list of texts.

        Args:
            navigator: infers tasks and chooses waypoints.
            robot: drives to goals and observes.
            tell: called after every decision, ending and refusal.
            key: random key of all drives, consumed.
            max_seconds: time limit of a drive.
            path: file for the utterances of the running task; None: nothing is stored.
        """
        self._navigator, self._robot, self._tell, self._key = navigator, robot, tell, key
        self._max_seconds, self._path = max_seconds, path
        self._queue: deque[str] = deque()
        self._last_text: tuple[str, float] = ("", float("-inf"))
        self._state: NavigatorState | None = None
        self._num_drives = 0
        self._texts = [] if path is None or not path.exists() else _read_texts(path)

    def say(self, text: str, now: float) -> None:
        """Queue an utterance received at a time, seconds, unless it is a duplicate message."""
        last_text, last_time = self._last_text
        if text != last_text or now - last_time >= DUPLICATE_SECONDS:
            self._last_text = text, now
            self._queue.append(text)

    def go(self) -> NavigationRun | None:
        """Drive to an ending; None without an utterance that gives a task."""
        resumed, self._texts, before = self._texts, [], self._state
        for text in resumed:
            if (state := self._apply(text)) is not None:
                before, self._state = self._state, state
                self._texts.append(text)
        # The last text that is understood begins the drive.
        self._state = before
        text = self._texts.pop() if self._texts else self._listen()
        if text is None:
            return None
        self._record(text)
        run = drive(
            self._navigator,
            self._robot,
            text,
            key=jax.random.fold_in(self._key, self._num_drives),
            state=self._state,
            max_seconds=self._max_seconds,
            listen=self._listen_and_record,
            on_step=self._on_step,
        )
        self._num_drives += 1
        self._state, self._texts = run.state, []
        self._save()
        self._tell({"status": "ended", "ending": run.ending.value, "why": run.why})
        return run

    def _apply(self, text: str) -> NavigatorState | None:
        """Return the state after an utterance; None if it is refused, which is reported."""
        robot = self._robot
        try:
            if self._state is None:
                return self._navigator.start(text, pose=wrap_heading(robot.pose()), area=robot.area)
            return self._navigator.hear(self._state, text)
        except ValueError as error:
            self._tell({"status": "refused", "text": text, "why": " ".join(str(error).split())})
            return None

    def _listen(self) -> str | None:
        """Return the next utterance that is understood; None for none."""
        while self._queue:
            text = self._queue.popleft()
            if self._apply(text) is not None:
                return text
        return None

    def _listen_and_record(self) -> str | None:
        if (text := self._listen()) is not None:
            self._record(text)
        return text

    def _record(self, text: str) -> None:
        self._texts.append(text)
        self._save()
        self._tell({"status": "heard", "text": text})

    def _save(self) -> None:
        if self._path is not None:
            write_text(json.dumps(self._texts, ensure_ascii=False), self._path)

    def _on_step(self, step: Step, state: NavigatorState, info: NavigatorInfo | None) -> None:
        self._state = state
        self._tell(
            {
                "status": step.status.word,
                "pose": [round(value, 3) for value in step.pose],
                "target": step.target and [round(value, 3) for value in step.target],
                "progress": step.progress.value,
                "detections": None if step.detections is None else len(step.detections),
                "fault": step.fault.name,
                "is_halted": bool(state.is_halted),
            }
        )


def _read_texts(path: Path) -> list[str]:
    """Read the utterances of a task, or raise a ValueError of one line."""
    try:
        texts = parse_json(read_text(path, max_bytes=_MAX_BYTES))
    except ValueError as error:
        raise ValueError(f"{path} is no JSON ({error}): remove it to begin anew") from error
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        raise ValueError(f"{path} is no list of words: remove it to begin anew")
    return texts
