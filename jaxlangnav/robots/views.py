"""Rendered images of a physics robot: a chase view, and its camera image with detected tags."""

from typing import Any

import numpy as np

from jaxlangnav.robots import libraries
from jaxlangnav.robots.physics.robot import PhysicsRobot
from jaxlangnav.robots.physics.tags import TAGS_PER_TYPE, object_center

PANEL_SIZE = (400, 300)
"""Pixels, width and height of an image."""
BACKGROUND = (45, 45, 45)
"""Blue, green, red: fill color of a missing image, and background of labels."""
_GREEN, _ORANGE = (60, 220, 60), (40, 160, 250)
_CAMERA_TITLE = "Through its camera: tags used (green), tags outside its gates (orange)"
_QUALITY = 75  # of a JPEG, in percent


class Views:
    """Renders images of a robot; each is u8[H, W, 3], blue, green, red, as in OpenCV."""

    def __init__(self, robot: PhysicsRobot, type_names: tuple[str, ...] = ()) -> None:
        """Set up a chase camera; tags of types without a name are not labelled."""
        self._robot, self._type_names = robot, type_names
        self._cv2 = libraries.opencv()
        self._view = libraries.mujoco().MjvCamera()

    def chase_view(self) -> np.ndarray:
        """Render the robot from behind and above."""
        x, y, heading = self._robot.true_pose
        self._view.lookat[:] = x + 0.8 * np.cos(heading), y + 0.8 * np.sin(heading), 0.3
        self._view.distance, self._view.elevation = 4.5, -28.0
        self._view.azimuth = 35.0
        return self._to_panel(self._robot.render(self._view)[..., ::-1])

    def camera_view(self) -> np.ndarray:
        """Draw the last camera image with its tags, see ``_CAMERA_TITLE``; blank without one."""
        robot = self._robot
        if robot.last_picture is None or not robot.camera_works:
            return np.full((*PANEL_SIZE[::-1], 3), BACKGROUND, np.uint8)
        image = np.ascontiguousarray(robot.last_picture[..., ::-1])
        labelled: set[int] = set()
        for tag in sorted(robot.last_tags, key=lambda it: np.hypot(*it.position[[0, 2]])):
            corners = tag.corners.round().astype(np.int32)
            color = _GREEN if robot.is_used(tag) else _ORANGE
            self._cv2.polylines(image, [corners[:, None]], True, color, 5)
            index, names = tag.tag_id // TAGS_PER_TYPE, self._type_names
            if index < len(names) and tag.tag_id not in labelled:
                labelled.add(tag.tag_id)
                dist = np.hypot(*object_center(tag, robot.camera))
                self._draw_label(image, f"{names[index]} {dist:.1f} m", corners.min(axis=0), color)
        return self._to_panel(image)

    def jpegs(self) -> dict[str, bytes]:
        """Render both images, as JPEG by their titles."""
        images = {"From outside": self.chase_view(), _CAMERA_TITLE: self.camera_view()}
        options = [self._cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
        return {
            title: self._cv2.imencode(".jpg", image, options)[1].tobytes()
            for title, image in images.items()
        }

    def _draw_label(self, image: np.ndarray, label: str, corner: np.ndarray, color: Any) -> None:
        """Draw a label on a dark background above a tag."""
        cv2, font = self._cv2, self._cv2.FONT_HERSHEY_SIMPLEX
        (width, height), baseline = cv2.getTextSize(label, font, 1.3, 3)
        bottom, columns = max(int(corner[1]) - 14, height + baseline), _panel_columns(image)
        left = min(max(int(corner[0]), columns.start), columns.stop - width)
        end = left + width, bottom + baseline
        cv2.rectangle(image, (left, bottom - height - baseline), end, BACKGROUND, -1)
        cv2.putText(image, label, (left, bottom), font, 1.3, color, 3, cv2.LINE_AA)

    def _to_panel(self, image: np.ndarray) -> Any:
        """Crop an image to the aspect ratio of a panel, and resize it."""
        cropped = image[:, _panel_columns(image)]
        return self._cv2.resize(cropped, PANEL_SIZE, interpolation=self._cv2.INTER_AREA)


def _panel_columns(image: np.ndarray) -> slice:
    """Find the central columns of an image that have the aspect ratio of a panel."""
    height, width = image.shape[:2]
    panel_width = height * PANEL_SIZE[0] // PANEL_SIZE[1]
    left = (width - panel_width) // 2
    return slice(left, left + panel_width)
