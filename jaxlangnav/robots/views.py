"""Pictures of a robot in physics: from outside, and what its camera sees."""

from typing import Any

import numpy as np

from jaxlangnav.robots import libraries
from jaxlangnav.robots.physics.robot import PhysicsRobot
from jaxlangnav.robots.physics.tags import TAGS_PER_TYPE, middle_of

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
