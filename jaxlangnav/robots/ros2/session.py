"""A conversation with one robot, task after task, as topics carry it: without ROS.

What is not understood is told and changes nothing. A node that is started anew takes the running
task up by the words kept in a file; what had been seen is looked for again.
"""

import json
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from jax import Array

from jaxlangnav.inputs.whole_files import write_text
from jaxlangnav.navigator import NavigatorInfo, NavigatorState
from jaxlangnav.navigator.api import Navigator
from jaxlangnav.robots.driver import drive
from jaxlangnav.robots.robot import NavigationRun, Robot, Step, wrap_heading

DOUBLED = 1.0
"""Seconds within which the same words have been carried twice, not said twice."""
_MOST_BYTES = 100_000  # length of a file of words beyond which it is none
TellStatus = Callable[[dict[str, Any]], None]
"""Is given what the robot is doing, as a JSON object."""


class Session:
    """Takes words, drives, and tells."""

    def __init__(
        self,
        navigator: Navigator,
        robot: Robot,
        tell: TellStatus,
        *,
        key: Array,
        max_seconds: float = 300.0,
        kept: Path | None = None,
    ) -> None:
        """Begin a conversation, or take one up; a ValueError if the file is no list of words.

        Args:
            navigator: what understands and decides.
            robot: what drives and sees.
            tell: is told of every decision, ending and refusal.
            key: random key of all drives, consumed.
            max_seconds: after which a drive is broken off.
            kept: file for the words of the running task; nothing is kept if None.
        """
        self._navigator, self._robot, self._tell, self._key = navigator, robot, tell, key
        self._max_seconds, self._kept = max_seconds, kept
        self._waiting: deque[str] = deque()
        self._last: tuple[str, float] = ("", float("-inf"))
        self._state: NavigatorState | None = None
        self._drives = 0
        self._words = [] if kept is None or not kept.exists() else _read(kept)

    def say(self, text: str, now: float) -> None:
        """Take in words at a time, seconds; the same a moment later are one message."""
        if (text, True) == (self._last[0], now - self._last[1] < DOUBLED):
            return
        self._last = text, now
        self._waiting.append(text)

    def go(self) -> NavigationRun | None:
        """Drive to an ending; None where nothing has been said, or nothing that is a task."""
        taken_up, self._words = self._words, []
        for text in taken_up[:-1]:
            state = self._heard(text)
            if state is not None:
                self._state = state
                self._words.append(text)
        text = taken_up[-1] if taken_up else self._listen()
        if text is None:
            return None
        if self._state is None and self._heard(text) is None:
            return None
        self._note(text)
        ended = drive(
            self._navigator,
            self._robot,
            text,
            key=jax.random.fold_in(self._key, self._drives),
            state=self._state,
            max_seconds=self._max_seconds,
            listen=self._listen_and_note,
            on_step=self._on_step,
        )
        self._drives += 1
        self._state, self._words = ended.state, []
        self._keep()
        self._tell({"status": "ended", "ending": ended.ending.value, "why": ended.why})
        return ended

    def _heard(self, text: str) -> NavigatorState | None:
        """Say what the state is once words have been heard; None if they are refused, and tell."""
        robot = self._robot
        try:
            if self._state is None:
                return self._navigator.start(text, pose=wrap_heading(robot.pose()), area=robot.area)
            return self._navigator.hear(self._state, text)
        except ValueError as error:
            self._tell({"status": "refused", "text": text, "why": " ".join(str(error).split())})
            return None

    def _listen(self) -> str | None:
        """Give the next words that are understood; None for none."""
        while self._waiting:
            text = self._waiting.popleft()
            if self._heard(text) is not None:
                return text
        return None

    def _listen_and_note(self) -> str | None:
        text = self._listen()
        if text is not None:
            self._note(text)
        return text

    def _note(self, text: str) -> None:
        self._words.append(text)
        self._keep()
        self._tell({"status": "heard", "text": text})

    def _keep(self) -> None:
        if self._kept is not None:
            write_text(json.dumps(self._words, ensure_ascii=False), self._kept)

    def _on_step(self, step: Step, state: NavigatorState, info: NavigatorInfo | None) -> None:
        self._state = state
        found = step.detections
        self._tell(
            {
                "status": step.status.word,
                "pose": [round(one, 3) for one in step.pose],
                "target": None if step.target is None else [round(one, 3) for one in step.target],
                "progress": step.progress.value,
                "detections": None if found is None else len(found),
                "fault": step.fault.name,
                "is_halted": bool(state.is_halted),
            }
        )


def _read(path: Path) -> list[str]:
    """Read the words of a task, or raise a ValueError of one line."""
    if path.stat().st_size > _MOST_BYTES:
        raise ValueError(f"{path} is longer than {_MOST_BYTES} bytes: it is no list of words")
    try:
        words = json.loads(path.read_text("utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is no JSON ({error}): remove it to begin anew") from error
    if not isinstance(words, list) or not all(isinstance(one, str) for one in words):
        raise ValueError(f"{path} is no list of words: remove it to begin anew")
    return words
