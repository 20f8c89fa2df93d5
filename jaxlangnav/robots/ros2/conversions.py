"""Convert ROS 2 messages to the navigator's inputs, and back: pure functions, without ROS.

Messages of ``rclpy`` and of ``rosbags`` work alike. Frames are those of REP 103 and 105: *odometry*
is where the robot started, *base* has x ahead and y to the left, a camera's *optical* frame x to
the right and z ahead.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxlangnav.robots.motion.steering import wrap
from jaxlangnav.robots.robot import Detection

_NORM_TOLERANCE = 0.01  # maximum deviation of a quaternion's norm from one
_SAME_OBJECT = 0.6  # metres within which tags of one type belong to one object
_POINT_FIELDS = (("x", 7), ("y", 7), ("z", 7), ("label", 6))
"""Names and types (float32 7, uint32 6) of the fields of a cloud of PointXYZL."""
MIN_SCORE = 0.5
_MAX_POINT_BYTES = 65_536  # of one point of a cloud
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("label", "<u4")])
"""One point of a cloud as ``to_cloud`` packs it, 16 bytes."""


def yaw_of(quaternion: Any) -> float:
    """Compute the yaw of a geometry_msgs/Quaternion, radians in [-π, π].

    A ValueError if it is no rotation, such as the (0, 0, 0, 0) of a message never filled in.
    """
    x, y, z, w = (float(getattr(quaternion, name)) for name in "xyzw")
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(length - 1.0) <= _NORM_TOLERANCE:
        raise ValueError(
            f"orientation ({x:g}, {y:g}, {z:g}, {w:g}) has length {length:g}, but a rotation has "
            "length 1: fill it in, (0, 0, 0, 1) for none"
        )
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def quaternion_of(yaw: float) -> tuple[float, float, float, float]:
    """Build the quaternion x, y, z, w of a heading, radians."""
    return 0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def seconds_of(stamp: Any) -> float:
    """Convert a builtin_interfaces/Time to seconds."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def pose_of(pose: Any) -> np.ndarray:
    """Read a geometry_msgs/Pose: f64[3], x, y, heading, or raise a ValueError."""
    x, y = float(pose.position.x), float(pose.position.y)
    if not all(map(math.isfinite, (x, y))):
        raise ValueError(f"a pose says ({x:g}, {y:g}), but a place is two finite numbers")
    return np.array([x, y, yaw_of(pose.orientation)])


def _detection_at(object_type: int, x: float, y: float) -> Detection:
    """Build the detection of an object at a position, base frame."""
    return Detection(object_type=object_type, range=math.hypot(x, y), bearing=math.atan2(y, x))


def detections_of_cloud(cloud: Any, num_types: int) -> list[Detection]:
    """Read detections from a sensor_msgs/PointCloud2 of points x, y, z, label, base frame.

    Args:
        cloud: the message; without points there are no detections.
        num_types: number of labels; a label is an index into ``type_names``.

    Raises:
        ValueError: other fields, an inconsistent size, a point that is not finite or an unknown
            label.
    """
    fields = {field.name: field for field in cloud.fields}
    for name, datatype in _POINT_FIELDS:
        if name not in fields or fields[name].datatype != datatype:
            raise ValueError(
                f"the cloud has fields {', '.join(fields) or 'none'}, but a look has float32 x, y "
                "and z and uint32 label"
            )
    end = max(fields[name].offset for name, _ in _POINT_FIELDS) + 4
    if not end <= cloud.point_step <= _MAX_POINT_BYTES:
        raise ValueError(
            f"a point of the cloud has {cloud.point_step} bytes, but its fields end at {end}, and "
            f"{_MAX_POINT_BYTES} are the most"
        )
    byte_order = ">" if cloud.is_bigendian else "<"
    layout = np.dtype(
        {
            "names": [name for name, _ in _POINT_FIELDS],
            "formats": [f"{byte_order}f4"] * 3 + [f"{byte_order}u4"],
            "offsets": [fields[name].offset for name, _ in _POINT_FIELDS],
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
    return [_detection_at(int(p["label"]), float(p["x"]), float(p["y"])) for p in points]


def to_cloud(detections: Sequence[Detection]) -> bytes:
    """Pack detections as the data of a cloud of ``POINT``, base frame, 16 bytes each."""
    return np.array([(*d.offset(), 0.0, d.object_type) for d in detections], POINT).tobytes()


class MessageBuilder:
    """Builder of ROS 2 messages, of ``rclpy`` or of ``rosbags``."""

    def __init__(self, find: Callable[[str], Any]) -> None:
        """Set up; ``find`` returns the class of a name such as "nav_msgs/msg/Odometry"."""
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

    def cloud(self, detections: Sequence[Detection], stamp: Any) -> Any:
        """Build a sensor_msgs/PointCloud2 of detections."""
        field = self._find("sensor_msgs/msg/PointField")
        return self._find("sensor_msgs/msg/PointCloud2")(
            header=self.header("base_link", stamp),
            height=1,
            width=len(detections),
            fields=[
                field(name=name, offset=4 * index, datatype=datatype, count=1)
                for index, (name, datatype) in enumerate(_POINT_FIELDS)
            ],
            is_bigendian=False,
            point_step=POINT.itemsize,
            row_step=POINT.itemsize * len(detections),
            data=np.frombuffer(to_cloud(detections), np.uint8),
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
        position = self._find("geometry_msgs/msg/Point")(x=float(pose[0]), y=float(pose[1]), z=0.0)
        quaternion = dict(zip("xyzw", quaternion_of(float(pose[2])), strict=True))
        orientation = self._find("geometry_msgs/msg/Quaternion")(**quaternion)
        return self._find("geometry_msgs/msg/Pose")(position=position, orientation=orientation)


def detections_of_boxes(boxes: Any, type_names: Sequence[str]) -> list[Detection]:
    """Read detections from a vision_msgs/Detection3DArray, base frame.

    Args:
        boxes: the message. An object has the class of its best hypothesis and its box's center.
        type_names: the navigator's; objects of other classes are left out, as are hypotheses of a
            score below ``MIN_SCORE``.

    Raises:
        ValueError: a box's center is not finite.
    """
    detections = []
    for box in boxes.detections:
        hypotheses = [hypothesis.hypothesis for hypothesis in box.results]
        best = max(hypotheses, key=lambda hypothesis: hypothesis.score, default=None)
        if best is None or not best.score >= MIN_SCORE or best.class_id not in type_names:
            continue
        center = box.bbox.center.position
        if not (math.isfinite(center.x) and math.isfinite(center.y)):
            raise ValueError(f"a {best.class_id} is at {center.x:g}, {center.y:g}: nowhere")
        detections.append(_detection_at(type_names.index(best.class_id), center.x, center.y))
    return detections


def detections_of_tags(
    transforms: Iterable[Any],
    types: Mapping[str, int],
    *,
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0),
    depth: float = 0.0,
) -> list[Detection]:
    """Read detections from the transforms that ``apriltag_ros`` publishes, one for each tag.

    Args:
        transforms: geometry_msgs/TransformStamped from the camera's optical frame.
        types: maps a tag's frame, such as "tag36h11:7", to the index of its object type.
        mount: x, y, heading of the camera in the base frame, metres and radians.
        depth: metres from a tag to the center of the object behind it.

    Returns:
        The detections; nearby tags of one type are sides of one object, at their mean.

    Raises:
        ValueError: a tag's position is not finite.
    """
    objects: list[tuple[int, list[np.ndarray]]] = []
    for transform in transforms:
        object_type = types.get(transform.child_frame_id)
        if object_type is None:
            continue
        position = _object_position(transform, mount, depth)
        for other, sides in objects:
            if other == object_type and np.hypot(*(sides[0] - position)) <= _SAME_OBJECT:
                sides.append(position)
                break
        else:
            objects.append((object_type, [position]))
    return [_detection_at(label, *np.mean(sides, axis=0).tolist()) for label, sides in objects]


def _object_position(tag: Any, mount: tuple[float, float, float], depth: float) -> np.ndarray:
    """Compute the center of the object that carries a tag, f64[2], base frame."""
    position = tag.transform.translation
    center = np.array([position.z, -position.x], float)
    if not np.isfinite(center).all():
        raise ValueError(f"tag {tag.child_frame_id} is at {position.x:g}, {position.z:g}: nowhere")
    if depth:
        rotation = tag.transform.rotation
        yaw_of(rotation)
        x, y, z, w = (float(getattr(rotation, name)) for name in "xyzw")
        normal = np.array([1.0 - 2.0 * (x * x + y * y), -2.0 * (x * z + w * y)])
        # A tag is seen from its front: whatever its z axis, inward is away from the camera.
        inward = normal * np.sign(normal @ center) / max(float(np.hypot(*normal)), 1e-6)
        center += depth * inward
    return compose(np.array(mount), np.array([*center, 0.0]))[:2]


def compose(frame: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Compose the pose of a frame with a pose in that frame (⊕), f64[3] each."""
    cos, sin = math.cos(frame[2]), math.sin(frame[2])
    x = frame[0] + cos * pose[0] - sin * pose[1]
    y = frame[1] + sin * pose[0] + cos * pose[1]
    return np.array([x, y, wrap(float(frame[2] + pose[2]))])


def inverse(frame: np.ndarray) -> np.ndarray:
    """Invert a pose f64[3] (⊖); composed with ``frame`` it is zero."""
    return compose(np.array([0.0, 0.0, -frame[2]]), np.array([-frame[0], -frame[1], 0.0]))


def transformed(seen: Sequence[Detection], then: np.ndarray, now: np.ndarray) -> list[Detection]:
    """Transform detections made at the pose ``then`` to the pose ``now``, f64[3] in one frame."""
    shift = compose(inverse(now), then)
    points = ((d.object_type, shift[:2] + d.offset(shift[2])) for d in seen)
    return [_detection_at(object_type, *point.tolist()) for object_type, point in points]


def pose_between(earlier: np.ndarray, later: np.ndarray, frac: float) -> np.ndarray:
    """Interpolate linearly between two poses; the heading turns the shorter way."""
    turn = wrap(float(later[2] - earlier[2]))
    pose = earlier + frac * (later - earlier)
    pose[2] = wrap(float(earlier[2] + frac * turn))
    return pose
