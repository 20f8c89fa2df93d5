"""AprilTags 36h11: drawn by OpenCV, detected by AprilTag, converted to detections of objects.

E. Olson, AprilTag: a robust and flexible visual fiducial system, ICRA 2011. Each object carries one
tag on each of four upright sides of a cube. The orientation of a tag is inaccurate, so no heading
is reported, only the center of the object, half a cube behind the side.

Camera frame: x right, y down, z ahead; robot frame: x ahead, y left. Metres, radians.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxlangnav.messages import SensorParams, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.robots import libraries
from jaxlangnav.robots.robot import Detection
from jaxlangnav.world.state import NUM_TYPES

FAMILY = "tag36h11"
TAG_SIDE = 0.32
"""Metres, edge of the black square of a tag."""
CUBE_SIDE = 0.40
"""Metres, edge of a cube: the tag and its white margin, a cell wide."""
TAGS_PER_TYPE = 16
"""An object's type is its tag ID divided by this; the remainder distinguishes objects of a type."""
RATE, NOISE = 0.95, 0.05
"""Detection probability within the gates, and standard deviation of positions, metres each axis:
``scripts/measure_detector.py`` at ranges of 1.25 to 4 m, rounded conservatively."""
WIDTH, HEIGHT = 1280, 720
"""Pixels of a picture. The camera is a pinhole, level and facing ahead."""
_FOCAL = 0.5 * WIDTH / float(np.tan(0.5 * np.deg2rad(110.0)))  # pixels, by its field of view
# AprilTag counts pixels from their corners.
_INTRINSICS = np.array([[_FOCAL, 0, 0.5 * WIDTH], [0, _FOCAL, 0.5 * HEIGHT], [0, 0, 1]])
_CELLS, _PIXELS_PER_CELL = 10, 16
_TAG_CORNERS = 0.5 * TAG_SIDE * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
"""Corners of a tag, clockwise from the top left one; its z axis points to the viewer."""
_MIN_MARGIN = 25.0  # AprilTag's decision margin below which a tag is rejected
_SAME_OBJECT = 0.6  # metres within which two sides with one tag ID belong to one object


@dataclasses.dataclass(frozen=True, kw_only=True)
class Gates:
    """Gates on tags: the paper's "self-imposed angular and range restrictions"."""

    range: float
    """Metres from the robot's center to that of an object."""
    field_of_view: float = np.deg2rad(84.0)
    """Radians, full angle about straight ahead, as seen from the robot's center."""
    view_angle: float = np.deg2rad(65.0)
    """Radians, maximum angle between the line of sight and the side's normal."""


def sensor_params(gates: Gates) -> SensorParams:
    """Build the sensor model that the belief assumes of the detector within the gates."""
    return replace(
        default_sensor(gates.range),
        field_of_view=jnp.float32(gates.field_of_view),
        detection_probability=jnp.float32(RATE),
        noise=jnp.float32(NOISE),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tag:
    """One tag detected in an image."""

    tag_id: int
    position: np.ndarray
    """f64[3], its center, camera frame."""
    inward: np.ndarray
    """f64[3], unit normal into the object, camera frame."""
    corners: np.ndarray
    """f64[4, 2], pixels."""

    @property
    def view_angle(self) -> float:
        """Radians between the line of sight and the normal."""
        cosine = float(self.inward @ self.position / np.linalg.norm(self.position))
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def draw_tag(tag_id: int) -> np.ndarray:
    """Draw the tag of an ID from 0 to 586 with its white margin, u8[160, 160]."""
    cv2 = libraries.opencv()
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    black = cv2.aruco.generateImageMarker(dictionary, tag_id, (_CELLS - 2) * _PIXELS_PER_CELL)
    return np.pad(black, _PIXELS_PER_CELL, constant_values=255)


@functools.cache
def _detector() -> Any:
    """Create the AprilTag detector, one for the whole process."""
    return libraries.require("pupil_apriltags", extra="robot").Detector(
        families=FAMILY, nthreads=1, quad_decimate=2.0, quad_sigma=0.8, refine_edges=1
    )


def find_tags(image: np.ndarray) -> list[Tag]:
    """Detect the tags in a grey image u8[H, W] that have no bit errors and sufficient contrast."""
    return [
        _tag_pose(int(tag.tag_id), np.asarray(tag.corners, float))
        for tag in _detector().detect(np.ascontiguousarray(image))
        if tag.hamming == 0 and tag.decision_margin >= _MIN_MARGIN
    ]


def _tag_pose(tag_id: int, corners: np.ndarray) -> Tag:
    """Estimate a tag's pose from its corners (IPPE): the better of the two solutions."""
    cv2 = libraries.opencv()
    _, rotations, translations, _ = cv2.solvePnPGeneric(
        _TAG_CORNERS, corners[::-1].copy(), _INTRINSICS, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    inward = -cv2.Rodrigues(rotations[0])[0][:, 2]
    return Tag(tag_id=tag_id, position=translations[0].ravel(), inward=inward, corners=corners)


def object_center(tag: Tag, camera_ahead: float) -> np.ndarray:
    """Compute the center of the object that carries a tag, f64[2], robot frame, metres.

    The sides are upright: only the horizontal component of the normal is used. ``camera_ahead``:
    metres from the robot's center to the camera.
    """
    normal = tag.inward[[0, 2]] / max(float(np.hypot(tag.inward[0], tag.inward[2])), 1e-6)
    right, ahead = tag.position[[0, 2]] + 0.5 * CUBE_SIDE * normal
    return np.array([ahead + camera_ahead, -right])


def to_detections(tags: Sequence[Tag], camera_ahead: float, gates: Gates) -> list[Detection]:
    """Convert the tags of one image to detections within the gates, one per object.

    Each is at the weighted mean of its sides, weight cos² of the view angle. Tags of types beyond
    ``NUM_TYPES`` are ignored.
    """
    sides_by_id: dict[int, list[tuple[np.ndarray, float]]] = {}
    for tag in tags:
        if tag.tag_id // TAGS_PER_TYPE < NUM_TYPES and tag.view_angle <= gates.view_angle:
            side = object_center(tag, camera_ahead), np.cos(tag.view_angle) ** 2
            sides_by_id.setdefault(tag.tag_id, []).append(side)
    detections = []
    for tag_id, sides in sides_by_id.items():
        reference = max(sides, key=lambda side: side[1])[0]
        used = [side for side in sides if np.hypot(*(side[0] - reference)) <= _SAME_OBJECT]
        x, y = np.average([xy for xy, _ in used], axis=0, weights=[weight for _, weight in used])
        distance, bearing = float(np.hypot(x, y)), float(np.arctan2(y, x))
        if distance <= gates.range and abs(bearing) <= 0.5 * gates.field_of_view:
            object_type = tag_id // TAGS_PER_TYPE
            detections.append(Detection(object_type=object_type, range=distance, bearing=bearing))
    return detections


def add_image_noise(
    image: np.ndarray, random: np.random.Generator, *, noise: float, blur: float
) -> np.ndarray:
    """Add camera blur and noise to a rendered grey image u8[H, W].

    Noise is a standard deviation in grey levels of 255, and blur one in pixels.
    """
    if blur > 0.0:
        image = libraries.opencv().GaussianBlur(image, (0, 0), blur)
    if noise > 0.0:
        pixel_noise = random.standard_normal(image.shape, np.float32)
        image = np.clip(image + noise * pixel_noise, 0, 255).astype(np.uint8)
    return image
