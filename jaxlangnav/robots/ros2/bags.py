"""Recorded messages: types that the wheels lack, by their text, and drives over a bag again.

Needs ``rosbags``, not ROS. The texts are those of vision_msgs 4, apriltag_msgs 2 and nav2_msgs.
"""

from pathlib import Path
from typing import Any

import numpy as np

from jaxlangnav.robots.libraries import ros
from jaxlangnav.robots.ros2.conversions import detections_of_cloud, pose_of, seconds_of
from jaxlangnav.robots.ros2.inbox import Inbox

TEXTS = {
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score",
    "vision_msgs/msg/ObjectHypothesisWithPose": (
        "vision_msgs/ObjectHypothesis hypothesis\ngeometry_msgs/PoseWithCovariance pose"
    ),
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "vision_msgs/msg/Detection3D": (
        "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
        "vision_msgs/BoundingBox3D bbox\nstring id"
    ),
    "vision_msgs/msg/Detection3DArray": (
        "std_msgs/Header header\nvision_msgs/Detection3D[] detections"
    ),
    "apriltag_msgs/msg/Point": "float64 x\nfloat64 y",
    "apriltag_msgs/msg/AprilTagDetection": (
        "string family\nint32 id\nint32 hamming\nfloat32 goodness\nfloat32 decision_margin\n"
        "apriltag_msgs/Point centre\napriltag_msgs/Point[4] corners\nfloat64[9] homography"
    ),
    "apriltag_msgs/msg/AprilTagDetectionArray": (
        "std_msgs/Header header\napriltag_msgs/AprilTagDetection[] detections"
    ),
    "nav2_msgs/action/NavigateToPose_Goal": (
        "geometry_msgs/PoseStamped pose\nstring behavior_tree"
    ),
}
"""Names of types and the text of their definitions."""


def typestore() -> Any:
    """Build the types of ROS 2 Kilted with ``TEXTS`` besides; it needs ``rosbags``."""
    systems = ros("rosbags.typesys")
    store = systems.get_typestore(systems.Stores.ROS2_KILTED)
    types: dict[str, Any] = {}
    for name, text in TEXTS.items():
        types.update(systems.get_types_from_msg(text, name))
    store.register(types)
    return store


class ReplayBus:
    """A bus on which a bag is played: ``odom`` and ``detections`` by when they were received.

    Its clock goes on only while it is spun. Where deciding took no time in the recording, as in
    simulation, the same drive makes the same decisions.
    """

    def __init__(self, path: Path, num_types: int) -> None:
        """Read a bag.

        Args:
            path: of the bag, MCAP or SQLite.
            num_types: labels that there are.

        Raises:
            ValueError: it is no bag, or holds no odometry.
            MissingExtraError: rosbags is not installed.
        """
        self.inbox, self.goals = Inbox(), []
        """Goals that were sent, f64[3] each, in the robot's odometry frame."""
        self._num_types, self._next = num_types, 0
        self._messages = _read(path)
        times = [time for time, _ in self.recorded("odom")]
        if not times:
            raise ValueError(f"{path} holds no odometry on the topic odom: nothing can be replayed")
        self._now = times[0]
        self._play()

    def recorded(self, topic: str) -> list[tuple[float, Any]]:
        """List what was recorded on a topic, each with when it came, seconds."""
        return [(time, message) for time, name, message in self._messages if name == topic]

    @property
    def is_over(self) -> bool:
        """Whether all has been played."""
        return self._next == len(self._messages)

    def now(self) -> float:
        """Tell the time of the recording, see ``Bus.now``."""
        return self._now

    def spin(self, seconds: float) -> None:
        """Play on, see ``Bus.spin``."""
        self._now += seconds
        self._play()

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        """Keep where to go: nobody goes there, see ``Bus.send_goal``."""
        del speed, clearance
        self.goals.append(goal)

    def _play(self) -> None:
        """Take in what had been received by now, to a tenth of a millisecond."""
        while not self.is_over and self._messages[self._next][0] <= self._now + 1e-4:
            time, topic, message = self._messages[self._next]
            self._next += 1
            if topic == "odom":
                self.inbox.add_odometry(seconds_of(message.header.stamp), pose_of(message))
            elif topic == "detections":
                found = detections_of_cloud(message, self._num_types)
                self.inbox.add_look(seconds_of(message.header.stamp), found, time)


def _read(path: Path) -> list[tuple[float, str, Any]]:
    """Read all messages of a bag: when each came, its topic, and what it says."""
    bags, store = ros("rosbags.rosbag2"), typestore()
    try:
        with bags.Reader(path) as reader:
            return [
                (1e-9 * time, one.topic.strip("/"), store.deserialize_cdr(raw, one.msgtype))
                for one, time, raw in reader.messages()
            ]
    except (bags.ReaderError, OSError) as error:
        raise ValueError(f"{path} is no bag that can be read: {error}") from error
