"""AprilTags 36h11: drawn by OpenCV, found by AprilTag, turned into the middles of things.

E. Olson, AprilTag: a robust and flexible visual fiducial system, ICRA 2011. Each thing carries one
tag on each of four upright sides of a cube. A tag tells only roughly which way its side faces, so
no heading is reported, but the thing's middle, half a cube behind the side.

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
from jaxlangnav.world.places import NUM_TYPES

FAMILY = "tag36h11"
TAG_SIDE = 0.32
"""Metres, edge of the black square of a tag."""
CUBE_SIDE = 0.40
"""Metres, edge of a cube: the tag and its white margin, a cell wide."""
TAGS_PER_TYPE = 16
"""A thing's type is its tag's number divided by this; the rest tells one of a type from another."""
RATE, NOISE = 0.95, 0.05
"""Detection rate within the gates, and standard deviation of a thing's place, metres each axis:
``scripts/measure_detector.py`` at ranges of 1.25 to 4 m, rounded to the cautious side."""
_CELLS, _CELL_PIXELS = 10, 16
_SQUARE = 0.5 * TAG_SIDE * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
"""Corners of a tag from the top left one on, clockwise, its z axis towards whoever sees it."""
_LEAST_MARGIN = 25.0  # AprilTag's decision margin below which a tag is not believed
_SAME = 0.6  # metres within which two sides with one number are of one thing


@dataclasses.dataclass(frozen=True, kw_only=True)
class Camera:
    """A camera on a robot, level and looking ahead."""

    width: int = 1280
    height: int = 720
    view: float = np.deg2rad(110.0)
    """Radians, horizontal opening angle."""
    ahead: float = 0.0
    """Metres from the robot's middle."""

    @property
    def focal(self) -> float:
        """Focal length, pixels."""
        return 0.5 * self.width / float(np.tan(0.5 * self.view))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Gates:
    """What of the tags found is used: the paper's "self-imposed angular and range restrictions"."""

    range: float
    """Metres from the robot's middle to that of a thing."""
    field_of_view: float = np.deg2rad(84.0)
    """Radians, full angle about straight ahead, as seen from the robot's middle."""
    view_angle: float = np.deg2rad(65.0)
    """Radians at most between the line of sight and the side's normal."""


def as_told(gates: Gates) -> SensorParams:
    """Tell the belief what the detector within some gates is good for."""
    return replace(
        default_sensor(gates.range),
        field_of_view=jnp.float32(gates.field_of_view),
        detection_probability=jnp.float32(RATE),
        noise=jnp.float32(NOISE),
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tag:
    """One tag found in a picture."""

    number: int
    position: np.ndarray
    """f64[3], its middle, camera frame."""
    inward: np.ndarray
    """f64[3], unit normal into the thing, camera frame."""
    corners: np.ndarray
    """f64[4, 2], pixels."""

    @property
    def view_angle(self) -> float:
        """Radians between the line of sight and the normal."""
        cosine = float(self.inward @ self.position / np.linalg.norm(self.position))
        return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def draw_tag(number: int) -> np.ndarray:
    """Draw a tag of a number from 0 to 586 with its white margin, u8[160, 160]."""
    cv2 = libraries.opencv()
    book = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    picture = np.full((_CELLS * _CELL_PIXELS,) * 2, 255, np.uint8)
    inner = slice(_CELL_PIXELS, -_CELL_PIXELS)
    size = (_CELLS - 2) * _CELL_PIXELS
    picture[inner, inner] = cv2.aruco.generateImageMarker(book, number, size)
    return picture


@functools.cache
def _detector() -> Any:
    """Open the detector; one serves a whole process."""
    return libraries.apriltags().Detector(
        families=FAMILY, nthreads=1, quad_decimate=2.0, quad_sigma=0.8, refine_edges=1
    )


def find_tags(picture: np.ndarray, camera: Camera) -> list[Tag]:
    """Find the tags in a grey picture u8[H, W] of which every bit is right and stands out."""
    return [
        _place(int(one.tag_id), np.asarray(one.corners, float), camera)
        for one in _detector().detect(np.ascontiguousarray(picture))
        if one.hamming == 0 and one.decision_margin >= _LEAST_MARGIN
    ]


def _place(number: int, corners: np.ndarray, camera: Camera) -> Tag:
    """Find where a tag of known size is by its corners: of two poses that would do the better."""
    cv2 = libraries.opencv()
    # AprilTag counts pixels from their corners.
    lens = np.diag([camera.focal, camera.focal, 1.0])
    lens[:2, 2] = 0.5 * camera.width, 0.5 * camera.height
    _, turns, places, _ = cv2.solvePnPGeneric(
        _SQUARE, corners[::-1].copy(), lens, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    inward = -cv2.Rodrigues(turns[0])[0][:, 2]
    return Tag(number=number, position=places[0].ravel(), inward=inward, corners=corners)


def middle_of(tag: Tag, camera: Camera) -> np.ndarray:
    """Find the middle of the thing that a tag is on, f64[2], robot frame, metres.

    The sides stand upright: of the normal only its level part is used.
    """
    level = tag.inward[[0, 2]] / max(float(np.hypot(tag.inward[0], tag.inward[2])), 1e-6)
    right, ahead = tag.position[[0, 2]] + 0.5 * CUBE_SIDE * level
    return np.array([ahead + camera.ahead, -right])


def to_detections(tags: Sequence[Tag], camera: Camera, gates: Gates) -> list[Detection]:
    """Turn tags of one picture into the things within the gates, one for all sides of a thing.

    Each is at the mean of its sides, which weigh by how straight on they are seen. Tags of further
    types than ``NUM_TYPES`` are nobody's.
    """
    things: dict[int, list[tuple[np.ndarray, float]]] = {}
    for tag in tags:
        if tag.number // TAGS_PER_TYPE < NUM_TYPES and tag.view_angle <= gates.view_angle:
            weight = np.cos(tag.view_angle) ** 2
            things.setdefault(tag.number, []).append((middle_of(tag, camera), weight))
    found = []
    for number, sides in things.items():
        best = max(sides, key=lambda side: side[1])[0]
        kept = [side for side in sides if np.hypot(*(side[0] - best)) <= _SAME]
        x, y = np.average([one for one, _ in kept], axis=0, weights=[weight for _, weight in kept])
        away, bearing = float(np.hypot(x, y)), float(np.arctan2(y, x))
        if away <= gates.range and abs(bearing) <= 0.5 * gates.field_of_view:
            kind = number // TAGS_PER_TYPE
            found.append(Detection(object_type=kind, range=away, bearing=bearing))
    return found


def degrade(
    picture: np.ndarray, random: np.random.Generator, *, noise: float, blur: float
) -> np.ndarray:
    """Make a rendered grey picture u8[H, W] as bad as a camera's.

    Noise is a standard deviation in grey levels of 255, and blur one in pixels.
    """
    if blur > 0.0:
        picture = libraries.opencv().GaussianBlur(picture, (0, 0), blur)
    if noise > 0.0:
        grain = random.standard_normal(picture.shape, np.float32)
        picture = np.clip(picture + noise * grain, 0, 255).astype(np.uint8)
    return picture
