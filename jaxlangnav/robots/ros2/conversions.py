"""Messages of ROS 2 to what the navigator is told, and back: pure functions, without ROS.

Messages of ``rclpy`` and of ``rosbags`` do alike. Frames are those of REP 103 and 105: *odometry*
is where the robot started, *base* has x ahead and y to the left, a camera's *optical* frame x to
the right and z ahead.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxlangnav.robots.motion.steering import wrap
from jaxlangnav.robots.robot import Detection

_UNIT = 0.01  # by how much the length of a quaternion may differ from one
_ONE_THING = 0.6  # metres within which tags of one type are on one thing
_LABELLED = (("x", 7), ("y", 7), ("z", 7), ("label", 6))
"""Names and types (float32 7, uint32 6) of the fields of a cloud of PointXYZL."""
LEAST_SCORE = 0.5
_LONGEST_POINT = 65_536  # bytes of one point of a cloud, beyond which it is none
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("label", "<u4")])
"""One point of a cloud as ``to_cloud`` packs it, 16 bytes."""


def yaw_of(quaternion: Any) -> float:
    """Tell the heading of a geometry_msgs/Quaternion, radians in [-π, π], without roll and pitch.

    A ValueError if it is no rotation, such as the (0, 0, 0, 0) of a message never filled in.
    """
    x, y, z, w = (float(getattr(quaternion, name)) for name in "xyzw")
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(length - 1.0) <= _UNIT:
        raise ValueError(
            f"orientation ({x:g}, {y:g}, {z:g}, {w:g}) has length {length:g}, but a rotation has "
            "length 1: fill it in, (0, 0, 0, 1) for none"
        )
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def quaternion_of(yaw: float) -> tuple[float, float, float, float]:
    """Build the orientation x, y, z, w of a heading, radians."""
    return 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def seconds_of(stamp: Any) -> float:
    """Tell the time of a builtin_interfaces/Time, seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def pose_of(odometry: Any) -> np.ndarray:
    """Read a nav_msgs/Odometry: f64[3], x, y, heading, odometry frame, or raise a ValueError."""
    pose = odometry.pose.pose
    place = float(pose.position.x), float(pose.position.y)
    if not all(map(math.isfinite, place)):
        raise ValueError(f"odometry says ({place[0]:g}, {place[1]:g}), but a place is two numbers")
    return np.array([*place, yaw_of(pose.orientation)])


def _detection_at(kind: int, x: float, y: float) -> Detection:
    """Build the detection of a thing by where it is."""
    return Detection(object_type=kind, range=math.hypot(x, y), bearing=math.atan2(y, x))


def detections_of_cloud(cloud: Any, num_types: int) -> list[Detection]:
    """Read a look from a sensor_msgs/PointCloud2 of points x, y, z, label, base frame.

    Args:
        cloud: the message; one without points is a look at nothing.
        num_types: labels that there are; a label is an index into ``type_names``.

    Raises:
        ValueError: other fields, a size that does not fit, a point that is nowhere or a label
            that there is not.
    """
    fields = {one.name: one for one in cloud.fields}
    for name, kind in _LABELLED:
        if name not in fields or fields[name].datatype != kind:
            raise ValueError(
                f"the cloud has fields {', '.join(fields) or 'none'}, but a look has float32 x, y "
                "and z and uint32 label"
            )
    ends = max(fields[name].offset for name, _ in _LABELLED) + 4
    if not ends <= cloud.point_step <= _LONGEST_POINT:
        raise ValueError(
            f"a point of the cloud has {cloud.point_step} bytes, but its fields end at {ends}, and "
            f"{_LONGEST_POINT} are the most"
        )
    order = ">" if cloud.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": [name for name, _ in _LABELLED],
            "formats": [f"{order}f4"] * 3 + [f"{order}u4"],
            "offsets": [fields[name].offset for name, _ in _LABELLED],
            "itemsize": cloud.point_step,
        }
    )
    count, data = cloud.width * cloud.height, bytes(cloud.data)
    if len(data) != count * cloud.point_step:
        raise ValueError(
            f"the cloud holds {len(data)} bytes, but {count} points of {cloud.point_step} bytes "
            "are announced"
        )
    points = np.frombuffer(data, layout)
    if not (np.isfinite(points["x"]) & np.isfinite(points["y"])).all():
        raise ValueError("the cloud has a point that is nowhere: leave out what is not finite")
    if (points["label"] >= num_types).any():
        raise ValueError(
            f"the cloud has label {points['label'].max()}, but the last of the navigator's "
            f"type_names is {num_types - 1}"
        )
    return [_detection_at(int(one["label"]), float(one["x"]), float(one["y"])) for one in points]


def to_cloud(found: Sequence[Detection]) -> bytes:
    """Pack detections as the data of a cloud of ``POINT``, base frame, 16 bytes each."""
    return np.array([(*one.offset(), 0.0, one.object_type) for one in found], POINT).tobytes()


class Scribe:
    """Builds messages, of ``rclpy`` as of ``rosbags``."""

    def __init__(self, find: Callable[[str], Any]) -> None:
        """Begin; ``find`` gives the class of a name such as "nav_msgs/msg/Odometry"."""
        self._find = find

    def odometry(self, pose: np.ndarray, stamp: Any) -> Any:
        """Build a nav_msgs/Odometry of a pose f64[3], odometry frame."""
        find, unknown = self._find, np.zeros(36)
        zero = find("geometry_msgs/msg/Vector3")(x=0.0, y=0.0, z=0.0)
        twist = find("geometry_msgs/msg/Twist")(linear=zero, angular=zero)
        posed, twisted = (
            find(f"geometry_msgs/msg/{name}WithCovariance") for name in ("Pose", "Twist")
        )
        return find("nav_msgs/msg/Odometry")(
            header=self.header("odom", stamp),
            child_frame_id="base_link",
            pose=posed(pose=self._pose(pose), covariance=unknown),
            twist=twisted(twist=twist, covariance=unknown),
        )

    def cloud(self, found: Sequence[Detection], stamp: Any) -> Any:
        """Build a sensor_msgs/PointCloud2 of detections."""
        field = self._find("sensor_msgs/msg/PointField")
        return self._find("sensor_msgs/msg/PointCloud2")(
            header=self.header("base_link", stamp),
            height=1,
            width=len(found),
            fields=[
                field(name=name, offset=4 * place, datatype=kind, count=1)
                for place, (name, kind) in enumerate(_LABELLED)
            ],
            is_bigendian=False,
            point_step=POINT.itemsize,
            row_step=POINT.itemsize * len(found),
            data=np.frombuffer(to_cloud(found), np.uint8),
            is_dense=True,
        )

    def goal(self, goal: np.ndarray, frame: str, stamp: Any) -> Any:
        """Build a geometry_msgs/PoseStamped of a pose f64[3], odometry frame."""
        stamped = self._find("geometry_msgs/msg/PoseStamped")
        return stamped(header=self.header(frame, stamp), pose=self._pose(goal))

    def words(self, text: str) -> Any:
        """Build a std_msgs/String."""
        return self._find("std_msgs/msg/String")(data=text)

    def time(self, seconds: float) -> Any:
        """Build a builtin_interfaces/Time."""
        whole, rest = divmod(round(1e9 * seconds), 10**9)
        return self._find("builtin_interfaces/msg/Time")(sec=whole, nanosec=rest)

    def header(self, frame: str, stamp: Any) -> Any:
        """Build a std_msgs/Header."""
        return self._find("std_msgs/msg/Header")(stamp=stamp, frame_id=frame)

    def _pose(self, pose: np.ndarray) -> Any:
        place = self._find("geometry_msgs/msg/Point")(x=float(pose[0]), y=float(pose[1]), z=0.0)
        turn = dict(zip("xyzw", quaternion_of(float(pose[2])), strict=True))
        turned = self._find("geometry_msgs/msg/Quaternion")(**turn)
        return self._find("geometry_msgs/msg/Pose")(position=place, orientation=turned)


def detections_of_boxes(boxes: Any, type_names: Sequence[str]) -> list[Detection]:
    """Read a look from a vision_msgs/Detection3DArray, base frame.

    Args:
        boxes: the message. A thing is what its best hypothesis says, where its box has its middle.
        type_names: the navigator's; a thing of another class is left out, as are hypotheses of a
            score below ``LEAST_SCORE``.
    """
    found = []
    for one in boxes.detections:
        guesses = [guess.hypothesis for guess in one.results]
        best = max(guesses, key=lambda guess: guess.score, default=None)
        if best is None or best.score < LEAST_SCORE or best.class_id not in type_names:
            continue
        middle = one.bbox.center.position
        found.append(_detection_at(type_names.index(best.class_id), middle.x, middle.y))
    return found


def detections_of_tags(
    transforms: Iterable[Any],
    types: Mapping[str, int],
    *,
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0),
    depth: float = 0.0,
) -> list[Detection]:
    """Read a look from the transforms that ``apriltag_ros`` publishes, one for each tag.

    Args:
        transforms: geometry_msgs/TransformStamped from the camera's optical frame.
        types: frame of a tag, such as "tag36h11:7", to the index of the type it is fixed to.
        mount: x, y, heading of the camera in the base frame, metres and radians.
        depth: metres from a tag to the middle of the thing behind it.

    Returns:
        The detections; tags of one type that are near to each other are sides of one thing, at
        their mean.

    Raises:
        ValueError: a tag is nowhere.
    """
    things: list[tuple[int, list[np.ndarray]]] = []
    for one in transforms:
        kind = types.get(one.child_frame_id)
        if kind is None:
            continue
        place = _place_of_tag(one, mount, depth)
        for other, sides in things:
            if other == kind and np.hypot(*(sides[0] - place)) <= _ONE_THING:
                sides.append(place)
                break
        else:
            things.append((kind, [place]))
    return [_detection_at(kind, *np.mean(sides, axis=0).tolist()) for kind, sides in things]


def _place_of_tag(one: Any, mount: tuple[float, float, float], depth: float) -> np.ndarray:
    """Place the middle of what a tag is on, f64[2], base frame."""
    place = one.transform.translation
    level = np.array([place.z, -place.x], float)
    if not np.isfinite(level).all():
        raise ValueError(f"tag {one.child_frame_id} is at {place.x:g}, {place.z:g}: nowhere")
    if depth:
        turn = one.transform.rotation
        yaw_of(turn)
        x, y, z, w = (float(getattr(turn, name)) for name in "xyzw")
        normal = np.array([1.0 - 2.0 * (x * x + y * y), -2.0 * (x * z + w * y)])
        # A tag is seen from its front: whichever way its z axis points, inwards is away.
        inwards = normal * np.sign(normal @ level) / max(float(np.hypot(*normal)), 1e-6)
        level += depth * inwards
    return compose(np.array(mount), np.array([*level, 0.0]))[:2]


def compose(frame: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Express a pose of one frame in the frame that this is placed in, f64[3] each."""
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    x = frame[0] + cos * pose[0] - sin * pose[1]
    y = frame[1] + sin * pose[0] + cos * pose[1]
    return np.array([x, y, wrap(float(frame[2] + pose[2]))])


def inverse(frame: np.ndarray) -> np.ndarray:
    """Place the outer frame in the inner one, f64[3]; composed with ``frame`` it is zero."""
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    x, y = frame[0], frame[1]
    return np.array([-cos * x - sin * y, sin * x - cos * y, -frame[2]])


def carried(found: Sequence[Detection], then: np.ndarray, now: np.ndarray) -> list[Detection]:
    """Express what was seen from the pose ``then`` as seen from ``now``, f64[3] in one frame."""
    moved = compose(inverse(now), then)
    places = [(moved[:2] + one.offset(moved[2])).tolist() for one in found]
    return [_detection_at(one.object_type, *at) for one, at in zip(found, places, strict=True)]


def pose_between(earlier: np.ndarray, later: np.ndarray, share: float) -> np.ndarray:
    """Give the pose a share of the way from one to another; the heading turns the shorter way."""
    turned = wrap(float(later[2] - earlier[2]))
    middle = earlier + share * (later - earlier)
    middle[2] = wrap(float(earlier[2] + share * turned))
    return middle
