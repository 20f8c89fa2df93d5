"""A simulated robot behind topics, for trying the node.

It publishes ``odom`` and ``detections`` and takes ``goal_pose``, in real time. Like any robot that
is told where to go from elsewhere it halts by itself when no goal has come for a while. What it
sends can be lost, doubled and late on purpose.
"""

import heapq
import itertools
import math
import time
from array import array
from typing import Any, Generic, TypeVar

import numpy as np

from jaxlangnav.robots.libraries import ros
from jaxlangnav.robots.motion.mover import TICK
from jaxlangnav.robots.ros2.conversions import (
    POINT,
    compose,
    inverse,
    quaternion_of,
    to_cloud,
    yaw_of,
)
from jaxlangnav.robots.simulated import SimulatedRobot

Message = TypeVar("Message")
_LONGEST = 1.0
"""Seconds by which a message may be late."""


class UnrulyChannel(Generic[Message]):
    """Hands on messages as a bad network does."""

    def __init__(self, share: float, seed: int) -> None:
        """Begin with nothing under way.

        Args:
            share: of messages that are lost, and of those doubled, and of those late; each.
            seed: of what becomes of which.

        Raises:
            ValueError: no such share.
        """
        if not 0.0 <= share <= 0.3:
            raise ValueError(f"a share of {share:g} of messages cannot be lost: give 0 to 0.3")
        self._share = share
        self._random = np.random.default_rng(seed)
        self._count = itertools.count()
        self._under_way: list[tuple[float, int, Message]] = []

    def put(self, message: Message, now: float) -> None:
        """Send a message.

        Args:
            message: anything.
            now: seconds.
        """
        draw = self._random.uniform() / max(self._share, 1e-9)
        if draw < 1.0:
            return
        late = self._random.uniform(0.0, _LONGEST) if draw > 2.0 and draw < 3.0 else 0.0
        for delay in (0.0, 0.1) if draw < 2.0 else (late,):
            heapq.heappush(self._under_way, (now + delay, next(self._count), message))

    def take(self, now: float) -> list[Message]:
        """Receive what has come by now, in the order in which it comes."""
        come = []
        while self._under_way and self._under_way[0][0] <= now:
            come.append(heapq.heappop(self._under_way)[2])
        return come


LOOK_EVERY = 4
"""Ticks of 0.1 s from one look to the next."""
_ALONE = 5.0
"""Seconds without a goal after which the robot halts: whoever sent it may have ended."""
_HERE, _CLEARANCE = 0.1, 0.3
"""Metres within which a goal is where the robot is, which is to halt; and metres kept."""


class RobotServer:
    """Publishes what a simulated robot reports, and sends it where it is told."""

    def __init__(self, robot: SimulatedRobot, *, share: float = 0.0, seed: int = 0) -> None:
        """Open the topics; ``rclpy.init`` has been called.

        Args:
            robot: the robot; its odometry begins at zero where it now stands.
            share: of messages that are lost, doubled and late, each, see ``UnrulyChannel``.
            seed: of the faults.
        """
        self.robot, self._origin, self._ticks = robot, robot.pose(), 0
        self._channel: UnrulyChannel[tuple[Any, Any]] = UnrulyChannel(share, seed)
        self._last_goal = -math.inf
        self._node = ros("rclpy").create_node("simulated_robot")
        self._executor = ros("rclpy.executors").SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._odometry = ros("nav_msgs.msg").Odometry
        self._cloud = ros("sensor_msgs.msg").PointCloud2
        self._field = ros("sensor_msgs.msg").PointField
        self._to_odometry = self._node.create_publisher(self._odometry, "odom", 10)
        self._to_looks = self._node.create_publisher(self._cloud, "detections", 10)
        pose_stamped = ros("geometry_msgs.msg").PoseStamped
        self._node.create_subscription(pose_stamped, "goal_pose", self._on_goal, 1)

    def run(self, seconds: float) -> None:
        """Let real time pass.

        Args:
            seconds: how long; infinity for as long as the process lives.
        """
        began, before = time.monotonic(), self.robot.seconds
        while (gone := self.robot.seconds - before) < seconds:
            self._tick()
            # A machine that is too slow for real time goes on as fast as it can.
            end = began + gone + TICK
            self._executor.spin_once(timeout_sec=0.0)
            while (left := end - time.monotonic()) > 0.0:
                self._executor.spin_once(timeout_sec=left)

    def close(self) -> None:
        """Close the topics."""
        self._executor.shutdown()
        self._node.destroy_node()

    def _tick(self) -> None:
        if self.robot.seconds - self._last_goal > _ALONE:
            self.robot.stop()
        self.robot.wait(TICK)
        self._ticks += 1
        now, stamp = self.robot.seconds, self._node.get_clock().now().to_msg()
        self._channel.put((self._to_odometry, self._odometry_message(stamp)), now)
        found = self.robot.detections() if self._ticks % LOOK_EVERY == 0 else None
        if found is not None:
            self._channel.put((self._to_looks, self._look_message(found, stamp)), now)
        for publisher, message in self._channel.take(now):
            publisher.publish(message)

    def _on_goal(self, message: Any) -> None:
        pose = message.pose
        turn = yaw_of(pose.orientation)
        goal = compose(self._origin, np.array([pose.position.x, pose.position.y, turn]))
        self._last_goal = self.robot.seconds
        here = self.robot.pose()
        if np.hypot(*(goal - here)[:2]) < _HERE and abs(goal[2] - here[2]) < _HERE:
            self.robot.stop()
            return
        self.robot.go_to(goal[None, :2], speed=1.0, clearance=_CLEARANCE, facing=float(goal[2]))

    def _odometry_message(self, stamp: Any) -> Any:
        pose, message = compose(inverse(self._origin), self.robot.pose()), self._odometry()
        message.header.frame_id, message.child_frame_id = "odom", "base_link"
        message.header.stamp = stamp
        position, turn = message.pose.pose.position, message.pose.pose.orientation
        position.x, position.y = float(pose[0]), float(pose[1])
        turn.x, turn.y, turn.z, turn.w = quaternion_of(float(pose[2]))
        return message

    def _look_message(self, found: Any, stamp: Any) -> Any:
        message = self._cloud(height=1, width=len(found), point_step=POINT.itemsize, is_dense=True)
        message.header.frame_id, message.header.stamp = "base_link", stamp
        message.row_step = message.point_step * message.width
        kinds = {name: 6 if name == "label" else 7 for name in POINT.names or ()}
        message.fields = [
            self._field(name=name, offset=4 * place, datatype=kind, count=1)
            for place, (name, kind) in enumerate(kinds.items())
        ]
        message.data = array("B", to_cloud(found))
        return message
