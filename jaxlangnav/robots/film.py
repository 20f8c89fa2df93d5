"""A film of one run: the robot from outside, what its camera sees, and what it believes.

The belief is drawn from above, straight ahead of the start upwards: dark ground has been looked at,
dots are hypotheses, squares things seen, a ring the place it is sent to, a cross where it is.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from jaxlangnav.agent import Navigator
from jaxlangnav.files.whole import replacing
from jaxlangnav.messages import Status
from jaxlangnav.navigator import NavigatorInfo, NavigatorState
from jaxlangnav.robots import libraries
from jaxlangnav.robots.driver import drive
from jaxlangnav.robots.physics.robot import PhysicsRobot
from jaxlangnav.robots.record import Step
from jaxlangnav.robots.views import DARK, PANEL, Views

FORMATS = (".gif", ".mp4")
_CAPTION = 36
_TICKS = 5
"""Ticks of the robot's clock between two frames."""
_MILLISECONDS = 200
_COLOURS = ((40, 40, 220), (30, 140, 250), (200, 120, 40), (120, 120, 120))
"""Blue, green, red, of hydrant, cone and further types in turn."""
_LIGHT = (235, 235, 235)


class Film:
    """Frames of a run, taken as it goes."""

    def __init__(self, robot: PhysicsRobot, text: str, type_names: tuple[str, ...] = ()) -> None:
        """Begin a film; ``robot.on_tick`` and ``film.on_step`` take its frames.

        Args:
            robot: that is filmed.
            text: what it has been told.
            type_names: by which tags are named.
        """
        self.frames: list[np.ndarray] = []
        self._robot, self._text = robot, text
        self._cv2, self._views = libraries.opencv(), Views(robot, type_names)
        self._belief = np.full((*PANEL[::-1], 3), DARK, np.uint8)
        self._status, self._ticks = Status.SEARCHING, 0
        robot.on_tick = lambda _: self._tick()

    def on_step(self, step: Step, state: NavigatorState, info: NavigatorInfo | None) -> None:
        """Draw what is believed after a decision."""
        self._status = step.status
        self._belief = self._draw_belief(step, state, info)
        self._take()

    def _tick(self) -> None:
        self._ticks += 1
        if self._ticks % _TICKS == 0:
            self._take()

    def _take(self) -> None:
        """Put a frame together."""
        views = self._views
        panels = np.hstack([views.from_outside(), views.through_the_camera(), self._belief])
        caption = np.full((_CAPTION, panels.shape[1], 3), 255, np.uint8)
        words = f'"{self._text}"   {self._status.word}   {self._robot.seconds:.0f} s'
        words += f"   {self._robot.travelled:.1f} m"
        cv2 = self._cv2
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(caption, words, (10, 24), font, 0.5, DARK, 1, cv2.LINE_AA)
        self.frames.append(np.vstack([caption, panels]))

    def _draw_belief(
        self, step: Step, state: NavigatorState, info: NavigatorInfo | None
    ) -> np.ndarray:
        """Draw the belief from above."""
        cv2, belief = self._cv2, state.belief
        coverage = belief.coverage
        x_min, x_max, y_min, y_max = (float(edge) for edge in coverage.area)
        scale = min(PANEL[0] / (y_max - y_min), PANEL[1] / (x_max - x_min))
        size = int(scale * (y_max - y_min)), int(scale * (x_max - x_min))
        unseen = np.exp(np.asarray(coverage.log_miss))
        # [y, x] to rows from far to near, columns from left to right
        ground = (90 + 120 * unseen.T[::-1, ::-1]).clip(0, 255).astype(np.uint8)
        ground = cv2.resize(ground, size, interpolation=cv2.INTER_NEAREST)
        map_ = cv2.cvtColor(ground, cv2.COLOR_GRAY2BGR)

        def at(x: float, y: float) -> tuple[int, int]:
            return int(scale * (y_max - y)), int(scale * (x_max - x))

        self._draw_things(map_, state, at)
        here = np.asarray(step.pose[:2]) if info is None else np.asarray(info.robot)
        cv2.drawMarker(map_, at(*here), (0, 0, 0), cv2.MARKER_CROSS, 14, 2)
        ahead = here + 0.6 * np.array([np.cos(step.pose[2]), np.sin(step.pose[2])])
        cv2.line(map_, at(*here), at(*ahead), (0, 0, 0), 2)
        if step.target is not None:
            offset = np.asarray(step.target) - np.asarray(step.pose[:2])
            cv2.circle(map_, at(*(here + offset)), 8, _LIGHT, 2)
        panel = np.full((*PANEL[::-1], 3), 255, np.uint8)
        top, left = (PANEL[1] - size[1]) // 2, (PANEL[0] - size[0]) // 2
        panel[top : top + size[1], left : left + size[0]] = map_
        return panel

    def _draw_things(
        self, map_: np.ndarray, state: NavigatorState, at: Callable[[float, float], tuple[int, int]]
    ) -> None:
        """Draw hypotheses of all particles, and what the likeliest one has seen."""
        cv2, belief = self._cv2, state.belief
        particles = belief.particles
        mention = np.asarray(state.instruction.readings.mention_type)[
            np.asarray(particles.reading)
        ].T
        hypothesised = np.asarray(particles.is_hypothesised)
        for x, y, kind in zip(
            np.asarray(particles.hypothesis_x)[hypothesised],
            np.asarray(particles.hypothesis_y)[hypothesised],
            mention[hypothesised],
            strict=True,
        ):
            cv2.circle(map_, at(x, y), 3, _COLOURS[min(int(kind), 3)], -1)
        best = int(np.argmax(np.asarray(belief.log_weight)))
        types = np.asarray(particles.object_type)[:, best]
        for slot in np.flatnonzero(types >= 0):
            x, y = particles.mean_x[slot, best], particles.mean_y[slot, best]
            column, row = at(float(x), float(y))
            corners = (column - 7, row - 7), (column + 7, row + 7)
            cv2.rectangle(map_, *corners, _COLOURS[min(int(types[slot]), 3)], -1)
            cv2.rectangle(map_, *corners, (0, 0, 0), 1)

    def write(self, path: Path) -> Path:
        """Write the film, all or nothing.

        Args:
            path: its ending says what it is: .gif or .mp4.

        Returns:
            The path.

        Raises:
            ValueError: another ending, or OpenCV cannot write it here.
        """
        check_format(path)
        cv2 = self._cv2
        frames = [*self.frames, *[self.frames[-1]] * 5]
        with replacing(path) as temporary:
            if path.suffix == ".gif":
                film = cv2.Animation()
                film.frames, film.durations = frames, [_MILLISECONDS] * len(frames)
                is_written = bool(cv2.imwriteanimation(str(temporary), film))
            else:
                height, width = frames[0].shape[:2]
                code = cv2.VideoWriter_fourcc(*"mp4v")
                rate = 1000.0 / _MILLISECONDS
                writer = cv2.VideoWriter(str(temporary), code, rate, (width, height))
                is_written = bool(writer.isOpened())
                for frame in frames:
                    writer.write(frame)
                writer.release()
            if not is_written:
                raise ValueError(f"OpenCV cannot write {path.suffix} films here: take another")
        return path


def check_format(path: Path) -> None:
    """Refuse a file that would be no film."""
    if path.suffix not in FORMATS:
        raise ValueError(f"{path.name} is no film: its name must end in {' or '.join(FORMATS)}")


def film(
    path: Path, robot: PhysicsRobot, text: str, *, navigator: Navigator, key: Any
) -> tuple[Path, str]:
    """Let a robot follow a sentence and film it.

    Args:
        path: file to write, .gif or .mp4.
        robot: at its start.
        text: the sentence.
        navigator: what decides.
        key: random key of the decisions.

    Returns:
        The path, and how the run ended, in one line.

    Raises:
        ValueError: no such format, or the sentence is refused.
    """
    check_format(path)
    reel = Film(robot, text, navigator.type_names)
    ended = drive(navigator, robot, text, key=key, on_step=reel.on_step)
    return reel.write(path), ended.why
