"""The node: topics to the inbox and the session, goals and status back (ROS 2, rclpy).

Topics, all of them relative, so that they can be remapped and put in a namespace:

    in   instruction, utterance  std_msgs/String          what is said
    in   odom                    nav_msgs/Odometry        dead reckoning
    in   detections              sensor_msgs/PointCloud2  a look: x, y, z, label in the base frame,
                                                          or vision_msgs/Detection3DArray
                                                          or, beside /tf, what apriltag_ros says:
                                                          apriltag_msgs/AprilTagDetectionArray
    in   /tf                     tf2_msgs/TFMessage       where tags are, with ``look="tf"``
    out  goal_pose               geometry_msgs/PoseStamped  where to go, in the odometry's frame
    out  navigator_status        std_msgs/String          JSON, the last one kept for late listeners
"""

import dataclasses
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from jaxlangnav.inputs.sanitize import sanitize
from jaxlangnav.robots.libraries import ros, ros_message
from jaxlangnav.robots.robot import Detection
from jaxlangnav.robots.ros2.conversions import (
    Scribe,
    detections_of_boxes,
    detections_of_cloud,
    detections_of_tags,
    pose_of,
    seconds_of,
)
from jaxlangnav.robots.ros2.inbox import Inbox

StampedDetections = tuple[float, list[Detection]]
"""When it was taken, seconds of the robot's clock, and what was seen from the base frame."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class TagSetup:
    """What tags mean on one robot, and what of them is used."""

    types: Mapping[str, int]
    """Frame of a tag, such as "tag36h11:7", to an index into the navigator's ``type_names``."""
    range: float
    """Metres beyond which a thing is left out: what the belief is told of the detector."""
    field_of_view: float
    """Radians, full angle about straight ahead, likewise."""
    mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """x, y, heading of the camera in the base frame, metres and radians."""
    depth: float = 0.0
    """Metres from a tag to the middle of the thing behind it."""


def read_tag_types(texts: Sequence[str], type_names: Sequence[str]) -> dict[str, int]:
    """Read what tags are on, frames to indices of types, of texts such as "tag36h11:7=hydrant".

    A ValueError of one line where there is no such type, or no tag at all.
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


class TagLooks:
    """Makes looks of the tags that ``apriltag_ros`` finds, out of two topics.

    Places come as transforms on ``/tf``, among all others of the robot; that there is nothing in a
    picture is told by the list of what was found alone.
    """

    def __init__(self, setup: TagSetup) -> None:
        """Begin with nothing."""
        self._setup = setup
        self._picture: tuple[str, float] | None = None

    def of_transforms(self, message: Any) -> StampedDetections | None:
        """Read a tf2_msgs/TFMessage; None where its transforms are of other things than tags."""
        setup = self._setup
        ours = [one for one in message.transforms if self._is_tag(one)]
        if not ours:
            return None
        used = [
            one
            for one in detections_of_tags(ours, setup.types, mount=setup.mount, depth=setup.depth)
            if one.range <= setup.range and abs(one.bearing) <= 0.5 * setup.field_of_view
        ]
        return seconds_of(ours[0].header.stamp), used

    def of_found(self, message: Any) -> StampedDetections | None:
        """Read an apriltag_msgs/AprilTagDetectionArray: a look at nothing, or None for more."""
        stamp = seconds_of(message.header.stamp)
        self._picture = message.header.frame_id, stamp
        return None if len(message.detections) else (stamp, [])

    def _is_tag(self, one: Any) -> bool:
        """Tell whether a transform is of a tag, one of no type that is known too."""
        header = one.header
        picture = header.frame_id, seconds_of(header.stamp)
        return one.child_frame_id in self._setup.types or picture == self._picture


_TURN = 0.05  # seconds that are waited for a message at most, before it is asked what the time is
_QUIET, _ALIKE = 5.0, 16  # seconds between two warnings that have so many letters in common
LOOKS = ("cloud", "boxes", "tf")
"""Kinds of messages that a look may come in."""


class RosBus:
    """Topics of a robot; messages are taken in while it is spun, in this very thread."""

    def __init__(
        self,
        type_names: Sequence[str],
        say: Callable[[str], None],
        *,
        look: str = "cloud",
        tags: TagSetup | None = None,
    ) -> None:
        """Open the topics, for looks of one of ``LOOKS``; ``rclpy.init`` has been called."""
        if look not in LOOKS:
            raise ValueError(f"looks come as {look!r}, but must be one of {', '.join(LOOKS)}")
        if look == "tf" and tags is None:
            raise ValueError("looks come as 'tf', but what the tags are on has not been said")
        self.inbox = Inbox()
        self.say = say
        """Is given what is said."""
        self._names, self._frame, self._base = tuple(type_names), "", ""
        self._stamp: Any = None
        self._pace: dict[str, float] = {}
        self._kinds: dict[str, str] = {}
        self._warned: dict[str, float] = {}
        self._node = ros("rclpy").create_node("jaxlangnav")
        self._executor = ros("rclpy.executors").SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._scribe, string = Scribe(ros_message), ros_message("std_msgs/msg/String")
        pose_stamped = ros_message("geometry_msgs/msg/PoseStamped")
        qos = ros("rclpy.qos")
        profile = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self._goals = self._node.create_publisher(pose_stamped, "goal_pose", 1)
        self._told = self._node.create_publisher(string, "navigator_status", profile)
        for topic in ("instruction", "utterance"):
            on_words = self._minding(lambda message: self.say(message.data))
            self._node.create_subscription(string, topic, on_words, 10)
        self._subscribe_to_robot(look, tags)

    def _subscribe_to_robot(self, look: str, tags: TagSetup | None) -> None:
        """Take in odometry and looks."""
        qos = ros("rclpy.qos")
        # Best effort: what a robot publishes either way is received. Deep: a decision takes long.
        stream = qos.QoSProfile(depth=100, reliability=qos.ReliabilityPolicy.BEST_EFFORT)
        detections: list[tuple[str, Any, Callable[[Any], None]]]
        if tags is not None and look == "tf":
            looks = TagLooks(tags)
            found = ros_message("apriltag_msgs/msg/AprilTagDetectionArray")
            detections = [
                ("/tf", ros_message("tf2_msgs/msg/TFMessage"), self._taking(looks.of_transforms)),
                ("detections", found, self._taking(looks.of_found)),
            ]
        elif look == "boxes":
            boxes = ros_message("vision_msgs/msg/Detection3DArray")
            detections = [("detections", boxes, self._taking(self._of_boxes))]
        else:
            cloud = ros_message("sensor_msgs/msg/PointCloud2")
            detections = [("detections", cloud, self._taking(self._of_cloud))]
        odometry = ros_message("nav_msgs/msg/Odometry")
        for topic, kind, take in [("odom", odometry, self._on_odometry), *detections]:
            self._node.create_subscription(kind, topic, self._minding(take), stream)
            self._kinds[topic] = f"{kind.__module__.split('.')[0]}/msg/{kind.__name__}"

    def now(self) -> float:
        """Tell the time, see ``Bus.now``."""
        return time.monotonic()

    def spin(self, seconds: float) -> None:
        """Take in what comes within a time, see ``Bus.spin``."""
        end = self.now() + seconds
        while (left := end - self.now()) > 0.0:
            self._executor.spin_once(timeout_sec=min(left, _TURN))

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Send where to go, see ``Bus.send_goal``; speed and clearance go into the status."""
        self._goals.publish(self._scribe.goal(goal, self._frame, self._stamp))
        self._pace = {"speed": round(speed, 3), "clearance": round(clearance, 3)}

    def tell(self, status: dict[str, Any]) -> None:
        """Publish what the robot is doing, a JSON object; counts and the last pace are added."""
        counts = dataclasses.asdict(self.inbox.counts)
        text = json.dumps({**status, **self._pace, "messages": counts}, ensure_ascii=False)
        self._told.publish(self._scribe.words(text))

    def warn(self, text: str) -> None:
        """Say a line on the console; what begins alike is said every few seconds only."""
        kind, now = text[:_ALIKE], self.now()
        if now - self._warned.get(kind, -math.inf) >= _QUIET:
            self._warned[kind] = now
            self._node.get_logger().warning(sanitize(text))

    def why_silent(self, topic: str) -> str:
        """Tell why nothing may be coming on "odom" or "detections", in one line."""
        wanted = self._kinds[topic]
        found = {one.topic_type for one in self._node.get_publishers_info_by_topic(topic)}
        if not found:
            return f"nobody publishes {topic}: start the robot, or remap the topic"
        if wanted in found:
            return f"nothing that can be read comes on {topic}, though it is published"
        return f"{topic} is published as {', '.join(sorted(found))}, but must be {wanted}"

    def close(self) -> None:
        """Close the topics."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _minding(self, take: Callable[[Any], None]) -> Callable[[Any], None]:
        """Take a message in; one that cannot be is counted, told, and left out."""

        def on_message(message: Any) -> None:
            try:
                take(message)
            except ValueError as error:
                self.inbox.counts.malformed += 1
                self.warn(str(error))

        return on_message

    def _on_odometry(self, message: Any) -> None:
        pose, stamp = pose_of(message), message.header.stamp
        self._frame, self._base = message.header.frame_id, message.child_frame_id
        self._stamp = stamp
        self.inbox.add_odometry(seconds_of(stamp), pose)

    def _taking(self, read: Callable[[Any], StampedDetections | None]) -> Callable[[Any], None]:
        """Hand what is read of a message to the inbox."""

        def take(message: Any) -> None:
            look = read(message)
            if look is not None:
                self.inbox.add_look(*look, self.now())

        return take

    def _in_base(self, header: Any) -> float:
        """Tell when a look in the base frame was taken, seconds of the robot's clock."""
        if self._base and header.frame_id != self._base:
            raise ValueError(
                f"detections come in frame {header.frame_id!r}, but odometry is of "
                f"{self._base!r}: transform them to it"
            )
        return seconds_of(header.stamp)

    def _of_cloud(self, message: Any) -> StampedDetections:
        return self._in_base(message.header), detections_of_cloud(message, len(self._names))

    def _of_boxes(self, message: Any) -> StampedDetections:
        results = [guess.hypothesis for one in message.detections for guess in one.results]
        strangers = {guess.class_id for guess in results} - set(self._names)
        if strangers:
            self.warn(
                f"{', '.join(sorted(strangers))}: no type that is known, left out; types are "
                f"{', '.join(self._names)}"
            )
        return self._in_base(message.header), detections_of_boxes(message, self._names)
