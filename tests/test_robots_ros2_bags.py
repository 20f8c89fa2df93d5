"""Messages by their bytes: CDR round trips, and a drive replayed from an MCAP bag."""

import importlib.util

import jax
import numpy as np
import pytest
from test_navigator_step import robot as navigator
from test_robots_drive import TEXT, goal_distance, put
from test_robots_ros2 import Loop

from jaxlangnav.robots.driver import drive
from jaxlangnav.robots.record import Ending
from jaxlangnav.robots.robot import Detection
from jaxlangnav.robots.ros2 import conversions
from jaxlangnav.robots.ros2.robot import RosRobot

__all__ = ["navigator"]
pytest.importorskip("rosbags")


@pytest.fixture(scope="module")
def store():
    from jaxlangnav.robots.ros2 import bags

    return bags.typestore()


def header(store, frame: str, seconds: float = 0.0):
    nanoseconds = round(seconds * 1e9)
    stamp = store.types["builtin_interfaces/msg/Time"](
        sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9
    )
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def pose(store, x: float, y: float, yaw: float):
    types = store.types
    turn = types["geometry_msgs/msg/Quaternion"](*conversions.quaternion_of(yaw))
    place = types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0)
    return types["geometry_msgs/msg/Pose"](position=place, orientation=turn)


def odometry(store, place, seconds: float):
    types = store.types
    there, nothing = pose(store, *map(float, place)), np.zeros(36)
    zero = types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
    twist = types["geometry_msgs/msg/Twist"](linear=zero, angular=zero)
    return types["nav_msgs/msg/Odometry"](
        header=header(store, "odom", seconds),
        child_frame_id="base_link",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=there, covariance=nothing),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=nothing),
    )


def cloud(store, found, seconds: float):
    field = store.types["sensor_msgs/msg/PointField"]
    data = np.frombuffer(conversions.to_cloud(found), np.uint8)
    fields = [
        field(name=name, offset=4 * at, datatype=6 if name == "label" else 7, count=1)
        for at, name in enumerate(("x", "y", "z", "label"))
    ]
    return store.types["sensor_msgs/msg/PointCloud2"](
        header=header(store, "base_link", seconds), height=1, width=len(found), fields=fields,
        is_bigendian=False, point_step=16, row_step=16 * len(found), data=data, is_dense=True,
    )  # fmt: skip


def there_and_back(store, message):
    name = message.__msgtype__
    return store.deserialize_cdr(store.serialize_cdr(message, name), name)


def test_odometry_and_looks_survive_their_bytes(store) -> None:
    read = there_and_back(store, odometry(store, (1.0, -2.0, 0.5), 12.25))
    np.testing.assert_allclose(conversions.pose_of(read), [1.0, -2.0, 0.5], atol=1e-12)
    assert conversions.seconds_of(read.header.stamp) == 12.25
    found = [Detection(object_type=3, range=2.0, bearing=-0.4)]
    (one,) = conversions.detections_of_cloud(there_and_back(store, cloud(store, found, 0.0)), 4)
    assert one.object_type == 3
    assert (one.range, one.bearing) == pytest.approx((2.0, -0.4), abs=1e-6)
    assert conversions.detections_of_cloud(there_and_back(store, cloud(store, [], 0.0)), 4) == []


def test_boxes_tags_and_goals_of_registered_texts_survive_their_bytes(store) -> None:
    types = store.types
    middle = pose(store, 3.0, 4.0, 0.0)
    guess = types["vision_msgs/msg/ObjectHypothesisWithPose"](
        hypothesis=types["vision_msgs/msg/ObjectHypothesis"](class_id="cone", score=0.9),
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose=middle, covariance=np.zeros(36)),
    )
    size = types["geometry_msgs/msg/Vector3"](x=0.4, y=0.4, z=0.4)
    box = types["vision_msgs/msg/Detection3D"](
        header=header(store, "base_link"), results=[guess], id="7",
        bbox=types["vision_msgs/msg/BoundingBox3D"](center=middle, size=size),
    )  # fmt: skip
    boxes = types["vision_msgs/msg/Detection3DArray"](
        header=header(store, "base_link"), detections=[box]
    )
    (one,) = conversions.detections_of_boxes(there_and_back(store, boxes), ("hydrant", "cone"))
    assert (one.object_type, one.range) == (1, 5.0)

    corner = types["apriltag_msgs/msg/Point"](x=1.0, y=2.0)
    tag = types["apriltag_msgs/msg/AprilTagDetection"](
        family="tag36h11", id=7, hamming=0, goodness=0.0, decision_margin=60.0, centre=corner,
        corners=[corner] * 4, homography=np.eye(3).reshape(-1),
    )  # fmt: skip
    tags = types["apriltag_msgs/msg/AprilTagDetectionArray"](
        header=header(store, "camera"), detections=[tag]
    )
    assert there_and_back(store, tags).detections[0].id == 7

    transform = types["geometry_msgs/msg/TransformStamped"](
        header=header(store, "camera"), child_frame_id="tag36h11:7",
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=-1.0, y=0.0, z=2.0),
            rotation=middle.orientation,
        ),
    )  # fmt: skip
    moved = there_and_back(store, types["tf2_msgs/msg/TFMessage"](transforms=[transform]))
    (one,) = conversions.detections_of_tags(moved.transforms, {"tag36h11:7": 0})
    assert one.range == pytest.approx(np.sqrt(5.0))

    stamped = types["geometry_msgs/msg/PoseStamped"](header=header(store, "odom"), pose=middle)
    goal = types["nav2_msgs/action/NavigateToPose_Goal"](pose=stamped, behavior_tree="")
    assert there_and_back(store, goal).pose.pose.position.y == 4.0


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="needs rclpy")
def test_the_bytes_are_those_of_rclpy(store) -> None:
    from nav_msgs.msg import Odometry
    from rclpy.serialization import deserialize_message, serialize_message

    ours = odometry(store, (1.0, -2.0, 0.5), 12.25)
    theirs = deserialize_message(bytes(store.serialize_cdr(ours, ours.__msgtype__)), Odometry)
    np.testing.assert_allclose(conversions.pose_of(theirs), [1.0, -2.0, 0.5], atol=1e-12)
    back = store.deserialize_cdr(serialize_message(theirs), ours.__msgtype__)
    np.testing.assert_allclose(conversions.pose_of(back), [1.0, -2.0, 0.5], atol=1e-12)


class Recording(Loop):
    """Writes down what comes in, when it comes."""

    def __init__(self, simulated, store) -> None:
        self.store, self.written = store, []
        super().__init__(simulated)

    def receive(self, topic: str, stamp: float, what) -> None:
        message = (
            odometry(self.store, what, stamp)
            if topic == "odom"
            else cloud(self.store, conversions.detections_of_cloud(what, 15), stamp)
        )
        self.written.append((topic, round(self.simulated.seconds * 1e9), message))
        super().receive(topic, stamp, what)

    def save(self, path) -> None:
        from rosbags.rosbag2 import StoragePlugin, Writer

        store = self.store
        with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            lines = {}
            for topic, time, message in self.written:
                name = message.__msgtype__
                if topic not in lines:
                    lines[topic] = writer.add_connection(topic, name, typestore=store)
                writer.write(lines[topic], time, store.serialize_cdr(message, name))


def test_a_drive_replayed_from_a_bag_makes_the_same_decisions(navigator, store, tmp_path) -> None:
    from jaxlangnav.robots.ros2.bags import ReplayBus

    simulated = put()
    bus = Recording(simulated, store)

    def go(bus):
        robot = RosRobot(bus, sensor=simulated.sensor, area=simulated.area)
        return drive(navigator, robot, TEXT, key=jax.random.key(1))

    # The same ticks before the first decision as in the replay, which begins with the odometry.
    first = go(bus)
    assert first.ending is Ending.ARRIVED, first.why
    assert goal_distance(simulated) < 1.5
    bus.save(tmp_path / "drive")
    replay = ReplayBus(tmp_path / "drive", len(navigator.type_names))
    replay.spin(bus.began - replay.now())
    second = go(replay)
    assert second.ending is Ending.ARRIVED, second.why
    assert [one.status for one in second.steps] == [one.status for one in first.steps]
    np.testing.assert_allclose(replay.goals, bus.goals, atol=1e-4)


def test_a_bag_without_odometry_is_refused(store, tmp_path) -> None:
    from jaxlangnav.robots.ros2.bags import ReplayBus

    bus = Recording(put(), store)
    bus.written = [("detections", 0, cloud(store, [], 0.0))]
    bus.save(tmp_path / "empty")
    with pytest.raises(ValueError, match="no odometry"):
        ReplayBus(tmp_path / "empty", 15)
