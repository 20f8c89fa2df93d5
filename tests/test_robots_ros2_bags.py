"""Messages by their bytes: CDR round trips, and a drive replayed from an MCAP bag."""

import importlib.util
import json
import math
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from test_robots_drive import TEXT, goal_distance, put

from jaxlangnav.robots.physics.tags import Gates, sensor_params
from jaxlangnav.robots.robot import Detection, Ending
from jaxlangnav.robots.ros2 import conversions
from jaxlangnav.robots.ros2.bags import typestore, write_bag
from jaxlangnav.robots.ros2.inbox import Inbox
from jaxlangnav.robots.ros2.robot import RosRobot
from jaxlangnav.robots.ros2.session import Session
from jaxlangnav.robots.ros2.simulation import RobotOptions, draw_start

Reader = pytest.importorskip("rosbags.rosbag2").Reader
BAG = Path(__file__).parent / "data" / "husky_bag"
HERE = np.array([1.0, -2.0, 0.5])


@pytest.fixture(scope="module")
def store():
    return typestore()


@pytest.fixture(scope="module")
def scribe(store):
    return conversions.MessageBuilder(store.types.__getitem__)


def there_and_back(store, message):
    name = message.__msgtype__
    return store.deserialize_cdr(store.serialize_cdr(message, name), name)


def test_odometry_and_looks_survive_their_bytes(scribe, store) -> None:
    read = there_and_back(store, scribe.odometry(HERE, scribe.time(12.25)))
    np.testing.assert_allclose(conversions.pose_of(read.pose.pose), [1.0, -2.0, 0.5], atol=1e-12)
    assert conversions.seconds_of(read.header.stamp) == 12.25
    found = [Detection(object_type=3, range=2.0, bearing=-0.4)]
    (one,) = conversions.detections_of_cloud(
        there_and_back(store, scribe.cloud(found, scribe.time(0.0))), 4
    )
    assert one.object_type == 3
    assert (one.range, one.bearing) == pytest.approx((2.0, -0.4), abs=1e-6)
    empty = there_and_back(store, scribe.cloud([], scribe.time(0.0)))
    assert conversions.detections_of_cloud(empty, 4) == []


def test_transforms_of_tags_survive_their_bytes(scribe, store) -> None:
    types, never = store.types, scribe.time(0.0)
    here = scribe.goal(np.array([3.0, 4.0, 0.0]), "odom", never).pose
    transform = types["geometry_msgs/msg/TransformStamped"](
        header=scribe.header("camera", never), child_frame_id="tag36h11:7",
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=-1.0, y=0.0, z=2.0),
            rotation=here.orientation,
        ),
    )  # fmt: skip
    moved = there_and_back(store, types["tf2_msgs/msg/TFMessage"](transforms=[transform]))
    (one,) = conversions.detections_of_tags(moved.transforms, {"tag36h11:7": 0})
    assert one.range == pytest.approx(np.sqrt(5.0))


@pytest.mark.skipif(importlib.util.find_spec("rclpy") is None, reason="needs rclpy")
def test_the_bytes_are_those_of_rclpy(scribe, store) -> None:
    from nav_msgs.msg import Odometry
    from rclpy.serialization import deserialize_message, serialize_message

    ours = scribe.odometry(HERE, scribe.time(12.25))
    theirs = deserialize_message(bytes(store.serialize_cdr(ours, ours.__msgtype__)), Odometry)
    np.testing.assert_allclose(conversions.pose_of(theirs.pose.pose), [1.0, -2.0, 0.5], atol=1e-12)
    back = store.deserialize_cdr(serialize_message(theirs), ours.__msgtype__)
    np.testing.assert_allclose(conversions.pose_of(back.pose.pose), [1.0, -2.0, 0.5], atol=1e-12)


class ReplayBus:
    """A bus on which a bag is played; its clock goes on only while it is spun."""

    def __init__(self, path: Path, store: Any) -> None:
        self.inbox, self.goals, self.played = Inbox(), [], 0
        with Reader(path) as reader:
            self.messages = [
                (1e-9 * time, one.topic.strip("/"), store.deserialize_cdr(raw, one.msgtype))
                for one, time, raw in reader.messages()
            ]
        self.time = next(time for time, topic, _ in self.messages if topic == "odom")
        self.spin(0.0)

    def recorded(self, topic: str) -> list[tuple[float, Any]]:
        return [(time, message) for time, name, message in self.messages if name == topic]

    def now(self) -> float:
        return self.time

    def spin(self, seconds: float) -> None:
        self.time += seconds
        while self.played < len(self.messages) and self.messages[self.played][0] < self.time + 1e-4:
            time, topic, message = self.messages[self.played]
            self.played += 1
            if topic == "odom":
                stamp = conversions.seconds_of(message.header.stamp)
                self.inbox.add_odometry(stamp, conversions.pose_of(message.pose.pose))
            elif topic == "detections":
                stamp = conversions.seconds_of(message.header.stamp)
                self.inbox.add_detections(stamp, conversions.detections_of_cloud(message, 15), time)

    def send_goal(self, goal: np.ndarray, *, speed: float, clearance: float) -> None:
        self.goals.append(goal)


def replay(navigator, path, store, *, sensor, area, key) -> list[dict]:
    """Play a bag to a node that has not heard of it; what was told is what had been."""
    bus, told = ReplayBus(path, store), []
    ((when, words),) = bus.recorded("instruction")
    bus.spin(when - bus.now())
    talk = Session(navigator, RosRobot(bus, sensor=sensor, area=area), told.append, key=key)
    talk.say(words.data, bus.now())
    talk.go()
    assert told == [json.loads(one.data) for _, one in bus.recorded("navigator_status")]
    poses = [message.pose for _, message in bus.recorded("goal_pose")]
    goals = [(one.position.x, one.position.y, conversions.yaw_of(one.orientation)) for one in poses]
    # Programs compiled apart round differently: twenty ulps of f32 at 8 m.
    np.testing.assert_allclose(bus.goals, goals, rtol=0.0, atol=1e-5)
    return told


def test_the_bag_that_ships_replays_to_the_same_decisions(navigator, store) -> None:
    """Where decisions have changed since, ``python scripts/make_bag.py`` makes it anew."""
    options = RobotOptions(robot="husky", seed=8)
    gates = Gates(range=options.range, field_of_view=math.radians(options.field_of_view))
    area = np.asarray(draw_start(options).area).tolist()
    sensor, key = sensor_params(gates), jax.random.key(options.seed)
    told = replay(navigator, BAG, store, sensor=sensor, area=area, key=key)
    assert [one["ending"] for one in told[9:] if one["status"] == "ended"] == ["arrived"]
    assert sum(one.stat().st_size for one in BAG.iterdir()) < 500_000


def test_a_drive_that_is_recorded_replays_to_the_same_decisions(navigator, store, tmp_path) -> None:
    simulated, path, key = put(), tmp_path / "drive", jax.random.key(1)
    first = write_bag(path, simulated, TEXT, navigator=navigator, key=key)
    assert first.ending is Ending.ARRIVED, first.why
    assert goal_distance(simulated) < 1.5
    told = replay(navigator, path, store, sensor=simulated.sensor, area=simulated.area, key=key)
    assert len(told) == len(first.steps) + 2
    with pytest.raises(ValueError, match="is there already"):
        write_bag(path, put(), TEXT, navigator=navigator, key=key)
