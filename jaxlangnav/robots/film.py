"""Pictures and a film of one run: the robot from outside, what its camera sees, its belief.

The belief is drawn from above, straight ahead of the start upwards: dark ground has been looked at,
dots are hypotheses, squares things seen, a ring the place it is sent to, a cross where it is.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxlangnav.inputs.whole_files import replacing
from jaxlangnav.messages import Status
from jaxlangnav.navigator import NavigatorInfo, NavigatorState
from jaxlangnav.navigator.api import Navigator
from jaxlangnav.robots import libraries
from jaxlangnav.robots.driver import drive
from jaxlangnav.robots.perception.tags import TAGS_PER_TYPE, middle_of
from jaxlangnav.robots.physics.robot import PhysicsRobot
from jaxlangnav.robots.robot import Step

PANEL = (400, 300)
"""Pixels, width and height of a picture."""
DARK = (45, 45, 45)
"""Blue, green, red, of a picture that there is none of."""
_GREEN, _ORANGE = (60, 220, 60), (40, 160, 250)
_CAMERA = "Through its camera: tags used (green), tags outside its gates (orange)"
_QUALITY = 75  # of a JPEG, in percent


class Views:
    """Takes pictures of a robot; each is u8[H, W, 3], blue, green, red, as OpenCV has them."""

    def __init__(self, robot: PhysicsRobot, type_names: tuple[str, ...] = ()) -> None:
        """Set up a camera that follows a robot; tags of types without a name are not named."""
        self._robot, self._type_names = robot, type_names
        self._cv2 = libraries.opencv()
        self._view = libraries.mujoco().MjvCamera()

    def from_outside(self) -> np.ndarray:
        """Look at the robot from behind and above."""
        x, y, heading = self._robot.true_pose
        self._view.lookat[:] = x + 0.8 * np.cos(heading), y + 0.8 * np.sin(heading), 0.3
        self._view.distance, self._view.elevation = 4.5, -28.0
        self._view.azimuth = 35.0
        return self._shrunk(self._robot.render(self._view)[..., ::-1])

    def through_the_camera(self) -> np.ndarray:
        """Show the last look and its tags, see ``_CAMERA``; dark without a picture."""
        robot = self._robot
        if robot.last_picture is None or not robot.camera_works:
            return np.full((*PANEL[::-1], 3), DARK, np.uint8)
        picture = np.ascontiguousarray(robot.last_picture[..., ::-1])
        named: set[int] = set()
        for tag in sorted(robot.last_tags, key=lambda one: np.hypot(*one.position[[0, 2]])):
            corners = tag.corners.round().astype(np.int32)
            colour = _GREEN if robot.is_used(tag) else _ORANGE
            self._cv2.polylines(picture, [corners[:, None]], True, colour, 5)
            kind = tag.number // TAGS_PER_TYPE
            if kind < len(self._type_names) and tag.number not in named:
                named.add(tag.number)
                away = float(np.hypot(*middle_of(tag, robot.camera)))
                left, top = corners.min(axis=0)
                self._name(picture, f"{self._type_names[kind]} {away:.1f} m", left, top, colour)
        return self._shrunk(picture)

    def jpegs(self) -> dict[str, bytes]:
        """Take both pictures, as JPEG by their titles."""
        pictures = {"From outside": self.from_outside(), _CAMERA: self.through_the_camera()}
        how = [self._cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
        return {
            title: self._cv2.imencode(".jpg", one, how)[1].tobytes()
            for title, one in pictures.items()
        }

    def _name(self, picture: np.ndarray, words: str, left: int, top: int, colour: Any) -> None:
        """Write a name on dark ground above a tag."""
        cv2, font = self._cv2, self._cv2.FONT_HERSHEY_SIMPLEX
        (wide, high), low = cv2.getTextSize(words, font, 1.3, 3)
        bottom, cut = max(int(top) - 14, high + low), _cut(picture)
        left = min(max(int(left), cut.start), cut.stop - wide)
        place, corner = (left, bottom), (left + wide, bottom + low)
        cv2.rectangle(picture, (left, bottom - high - low), corner, DARK, -1)
        cv2.putText(picture, words, place, font, 1.3, colour, 3, cv2.LINE_AA)

    def _shrunk(self, picture: np.ndarray) -> Any:
        """Cut a picture to a panel's shape, and shrink it."""
        cut = picture[:, _cut(picture)]
        return self._cv2.resize(cut, PANEL, interpolation=self._cv2.INTER_AREA)


def _cut(picture: np.ndarray) -> slice:
    """Find the columns of a picture that have a panel's shape."""
    height, width = picture.shape[:2]
    wide = height * PANEL[0] // PANEL[1]
    left = (width - wide) // 2
    return slice(left, left + wide)


FORMATS = (".gif", ".mp4")
_CAPTION = 36
_TICKS = 5  # ticks of the robot's clock between two frames
_MILLISECONDS = 200
_COLOURS = ((40, 40, 220), (30, 140, 250), (200, 120, 40), (120, 120, 120))
"""Blue, green, red, of hydrant, cone and further types in turn."""
_LIGHT = (235, 235, 235)


class Film:
    """Frames of a run, taken as it goes."""

    def __init__(self, robot: PhysicsRobot, text: str, type_names: tuple[str, ...] = ()) -> None:
        """Begin a film of what was told; ``robot.on_tick`` and ``film.on_step`` take its frames."""
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
        cv2, coverage = self._cv2, state.belief.coverage
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

        # Hypotheses of all particles, and what the likeliest one has seen.
        particles = state.belief.particles
        types_of_reading = np.asarray(state.instruction.readings.mention_type)
        mention = types_of_reading[np.asarray(particles.reading)].T
        places = np.nonzero(np.asarray(particles.is_hypothesised))
        thought = np.stack([particles.hypothesis_x, particles.hypothesis_y])[:, *places]
        for x, y, kind in zip(*thought, mention[places], strict=True):
            cv2.circle(map_, at(x, y), 3, _COLOURS[min(int(kind), 3)], -1)
        best = int(np.argmax(np.asarray(state.belief.log_weight)))
        types = np.asarray(particles.object_type)[:, best]
        for slot in np.flatnonzero(types >= 0):
            x, y = particles.mean_x[slot, best], particles.mean_y[slot, best]
            column, row = at(float(x), float(y))
            corners = (column - 7, row - 7), (column + 7, row + 7)
            cv2.rectangle(map_, *corners, _COLOURS[min(int(types[slot]), 3)], -1)
            cv2.rectangle(map_, *corners, (0, 0, 0), 1)
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

    def write(self, path: Path) -> Path:
        """Write the film, all or nothing, as .gif or .mp4, and return its path.

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
                code, rate = cv2.VideoWriter_fourcc(*"mp4v"), 1000.0 / _MILLISECONDS
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
    """Let a robot, at its start, follow a sentence, see ``drive``, and film it as .gif or .mp4.

    Returns:
        The path, and how the run ended, in one line.

    Raises:
        ValueError: no such format, or the sentence is refused.
    """
    check_format(path)
    reel = Film(robot, text, navigator.type_names)
    ended = drive(navigator, robot, text, key=key, on_step=reel.on_step)
    return reel.write(path), ended.why
