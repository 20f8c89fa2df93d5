"""The ROS 2 node (rclpy): topics to the inbox and the session, goals and status back.

``docs/robot.md`` lists the topics. Names are relative, so that they can be remapped and put
in a namespace.
"""

import dataclasses
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from jaxlangnav.inputs.sanitize import sanitize
from jaxlangnav.robots.libraries import load_ros, ros_class
from jaxlangnav.robots.robot import Detection
from jaxlangnav.robots.ros2.conversions import (
    MessageBuilder,
    detections_of_boxes,
    detections_of_cloud,
    detections_of_tags,
    pose_of,
    seconds_of,
)
from jaxlangnav.robots.ros2.inbox import Inbox

StampedDetections = tuple[float, list[Detection]]
"""Stamp, seconds of the robot's clock, and detections in the base frame."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TagSetup:
    """Object types of tags, the camera's mount, and gates on detections."""

    types: Mapping[str, int]  # frame of a tag, such as "tag36h11:7", to an index of an object type
    range: float  # metres beyond which objects are left out: the range that the belief assumes
    field_of_view: float  # radians, full angle about straight ahead, likewise
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the camera: x, y, heading, base frame
    depth: float = 0.0  # metres from a tag to the center of the object behind it


def read_tag_types(texts: Sequence[str], type_names: Sequence[str]) -> dict[str, int]:
    """Parse the types of tags, frames to type indices, from texts such as "tag36h11:7=hydrant".

    A ValueError of one line for an unknown type, or without any tag.
    """
    types = {}
    for text in texts:
        frame, _, name = text.rpartition("=")
        if not frame or name not in type_names:
            raise ValueError(
                f"tag {text!r} is none: give a frame and a type such as tag36h11:7=hydrant; types "
                f"are {', '.join(type_names)}"
            )
        types[frame] = type_names.index(name)
    if not types:
        raise ValueError("no tag is known: say what they are on by --tags tag36h11:7=hydrant")
    return types


class TagReader:
    """Converts the two topics of ``apriltag_ros`` to detections.

    Positions are transforms on ``/tf``, among all others of the robot; an image without tags is
    reported by an empty list of tags only.
    """

    def __init__(self, setup: TagSetup) -> None:
        """Start without messages."""
        self._setup = setup
        self._image: tuple[str, float] | None = None

    def of_transforms(self, message: Any) -> StampedDetections | None:
        """Read a tf2_msgs/TFMessage; None where none of its transforms is of a tag."""
        setup = self._setup
        tags = [tag for tag in message.transforms if self._is_tag(tag)]
        if not tags:
            return None
        detections = [
            d
            for d in detections_of_tags(tags, setup.types, mount=setup.mount, depth=setup.depth)
            if d.range <= setup.range and abs(d.bearing) <= 0.5 * setup.field_of_view
        ]
        return seconds_of(tags[0].header.stamp), detections

    def of_tag_array(self, message: Any) -> StampedDetections | None:
        """Read an apriltag_msgs/AprilTagDetectionArray: an empty image, or None if it has tags."""
        stamp = seconds_of(message.header.stamp)
        self._image = message.header.frame_id, stamp
        return None if len(message.detections) else (stamp, [])

    def _is_tag(self, transform: Any) -> bool:
        """Tell whether a transform is of a tag, possibly one without a known type."""
        header = transform.header
        image = header.frame_id, seconds_of(header.stamp)
        return transform.child_frame_id in self._setup.types or image == self._image


def guarded(handle: Callable[[Any], None], refuse: Callable[[str], Any]) -> Callable[[Any], None]:
    """Wrap a handler: an invalid message is dropped, and ``refuse`` is handed the reason."""

    def on_message(message: Any) -> None:
        try:
            handle(message)
        except ValueError as error:
            refuse(sanitize(str(error)))

    return on_message


_SPIN_SECONDS = 0.05  # maximum wait for a message before the time is checked
_WARNING_SECONDS, _WARNING_PREFIX = 5.0, 16  # between warnings with so long a common prefix


class RosBus:
    """Bus over a robot's ROS topics; messages are received during ``spin``, in its thread."""

    def __init__(
        self,
        type_names: Sequence[str],
        say: Callable[[str], None],
        *,
        look: Literal["cloud", "boxes"] | TagSetup,
    ) -> None:
        """Open the topics after ``rclpy.init``; ``look`` is the format of detections."""
        self.inbox = Inbox()
        self.say = say
        """Callback for each utterance."""
        self._labels, self._frame, self._base_frame = tuple(type_names), "", ""
        self._stamp: Any = None
        self._limits: dict[str, float] = {}
        self._topic_types: dict[str, str] = {}
        self._last_warning: dict[str, float] = {}
        self._node = load_ros("rclpy").create_node("jaxlangnav")
        self._executor = load_ros("rclpy.executors").SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._builder, string = MessageBuilder(ros_class), ros_class("std_msgs/msg/String")
        pose_stamped = ros_class("geometry_msgs/msg/PoseStamped")
        qos = load_ros("rclpy.qos")
        profile = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self._goal_topic = self._node.create_publisher(pose_stamped, "goal_pose", 1)
        self._status_topic = self._node.create_publisher(string, "navigator_status", profile)
        for topic in ("instruction", "utterance"):
            on_text = guarded(lambda message: self.say(message.data), self._refuse)
            self._node.create_subscription(string, topic, on_text, 10)
        self._subscribe_to_robot(look)

    def _subscribe_to_robot(self, look: Literal["cloud", "boxes"] | TagSetup) -> None:
        qos = load_ros("rclpy.qos")
        # Best effort matches publishers of either reliability. Deep, as a decision takes long.
        stream = qos.QoSProfile(depth=100, reliability=qos.ReliabilityPolicy.BEST_EFFORT)
        readers: list[tuple[str, str, Callable[[Any], StampedDetections | None]]]
        if isinstance(look, TagSetup):
            reader = TagReader(look)
            readers = [
                ("/tf", "tf2_msgs/msg/TFMessage", reader.of_transforms),
                ("detections", "apriltag_msgs/msg/AprilTagDetectionArray", reader.of_tag_array),
            ]
        elif look == "boxes":
            readers = [("detections", "vision_msgs/msg/Detection3DArray", self._of_boxes)]
        else:
            readers = [("detections", "sensor_msgs/msg/PointCloud2", self._of_cloud)]
        handlers = [("odom", "nav_msgs/msg/Odometry", self._on_odometry)]
        handlers += [(topic, name, self._to_inbox(read)) for topic, name, read in readers]
        for topic, name, handle in handlers:
            self._topic_types[topic] = name
            self._node.create_subscription(
                ros_class(name), topic, guarded(handle, self._refuse), stream
            )

    def now(self) -> float:
        """Return the time, see ``Bus.now``."""
        return time.monotonic()

    def spin(self, seconds: float) -> None:
        """Receive messages for some seconds, see ``Bus.spin``."""
        end = self.now() + seconds
        while (left := end - self.now()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, _SPIN_SECONDS))

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Publish a goal, see ``Bus.send_goal``; speed and clearance go into the status."""
        self._goal_topic.publish(self._builder.goal(goal, self._frame, self._stamp))
        self._limits = {"speed": round(speed, 3), "clearance": round(clearance, 3)}

    def tell(self, status: dict[str, Any]) -> None:
        """Publish the status, a JSON object; message counts, speed and clearance are added."""
        counts = dataclasses.asdict(self.inbox.counts)
        text = json.dumps({**status, **self._limits, "messages": counts}, ensure_ascii=False)
        self._status_topic.publish(self._builder.words(text))

    def warn(self, text: str) -> None:
        """Log a warning; those with a common prefix only every few seconds."""
        prefix, now = text[:_WARNING_PREFIX], self.now()
        if now - self._last_warning.get(prefix, -math.inf) >= _WARNING_SECONDS:
            self._last_warning[prefix] = now
            self._node.get_logger().warning(sanitize(text))

    def why_silent(self, topic: str) -> str:
        """Diagnose in one line why nothing arrives on "odom" or "detections"."""
        expected = self._topic_types[topic]
        types = {info.topic_type for info in self._node.get_publishers_info_by_topic(topic)}
        if not types:
            return f"nobody publishes {topic}: start the robot, or remap the topic"
        if expected in types:
            return f"nothing that can be read comes on {topic}, though it is published"
        return f"{topic} is published as {', '.join(sorted(types))}, but must be {expected}"

    def close(self) -> None:
        """Close the topics."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _refuse(self, reason: str) -> None:
        self.inbox.counts.malformed += 1
        self.warn(reason)

    def _on_odometry(self, message: Any) -> None:
        pose, stamp = pose_of(message.pose.pose), message.header.stamp
        self._frame, self._base_frame = message.header.frame_id, message.child_frame_id
        self._stamp = stamp
        self.inbox.add_odometry(seconds_of(stamp), pose)

    def _to_inbox(self, read: Callable[[Any], StampedDetections | None]) -> Callable[[Any], None]:
        """Wrap a reader of messages: its detections go to the inbox."""

        def take(message: Any) -> None:
            if (detections := read(message)) is not None:
                self.inbox.add_detections(*detections, self.now())

        return take

    def _base_stamp(self, header: Any) -> float:
        """Return the stamp of detections in the base frame, seconds of the robot's clock."""
        if self._base_frame and header.frame_id != self._base_frame:
            raise ValueError(
                f"detections come in frame {header.frame_id!r}, but odometry is of "
                f"{self._base_frame!r}: transform them to it"
            )
        return seconds_of(header.stamp)

    def _of_cloud(self, message: Any) -> StampedDetections:
        return self._base_stamp(message.header), detections_of_cloud(message, len(self._labels))

    def _of_boxes(self, message: Any) -> StampedDetections:
        hypotheses = [result.hypothesis for box in message.detections for result in box.results]
        unknown = {hypothesis.class_id for hypothesis in hypotheses} - set(self._labels)
        if unknown:
            self.warn(
                f"{', '.join(sorted(unknown))}: no type that is known, left out; types are "
                f"{', '.join(self._labels)}"
            )
        return self._base_stamp(message.header), detections_of_boxes(message, self._labels)
