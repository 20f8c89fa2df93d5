"""The node live: processes on loopback that know each other by topics only. Needs rclpy."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
rclpy = pytest.importorskip("rclpy")
TEXT = "go to the hydrant behind the cone"
AREA = ("--area", "0", "13", "-9.2", "9.2")
"""That of the robot's world, seed 0."""
LIMIT = 1200.0  # seconds for a whole episode, compilation and a busy machine included


class Person:
    """Says things and reads the status, as a process of its own kind: a third participant."""

    def __init__(self) -> None:
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from std_msgs.msg import String

        self.string, self.told = String, []
        self.node = rclpy.create_node("person")
        kept = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.node.create_subscription(String, "navigator_status", self.on_status, kept)
        self.words = self.node.create_publisher(String, "instruction", 10)

    def on_status(self, message) -> None:
        self.told.append(json.loads(message.data))

    def say(self, text: str) -> None:
        self.words.publish(self.string(data=text))

    def wait_for(self, is_it, processes) -> dict:
        end, seen = time.monotonic() + LIMIT, len(self.told)
        while time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.2)
            for one in self.told[seen:]:
                if is_it(one):
                    return one
            seen = len(self.told)
            for process in processes:
                assert process.poll() is None, process.args
        raise AssertionError(f"nothing of the kind within {LIMIT:g} s; last told: {self.told[-3:]}")


def status(name: str):
    return lambda one: one["status"] == name


def is_on_its_way(one: dict) -> bool:
    """Whether it drives, some way from where its odometry began."""
    return one.get("progress") == "under way" and abs(one["pose"][0]) + abs(one["pose"][1]) > 0.8


@pytest.fixture
def begin(tmp_path, monkeypatch):
    """Start either side as a process; all are ended at the end."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(os.getpid() % 90 + 10))
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    # A node that is started anew does not compile again.
    programs = os.environ.get("JAX_COMPILATION_CACHE_DIR", str(tmp_path / "programs"))
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", programs)
    monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.1")
    running = []

    def start(side: str, *options: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "jaxlangnav.robots.ros2", side, *options]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        running.append(process)
        return process

    rclpy.init()
    yield start
    rclpy.try_shutdown()
    for process in running:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


def ended(robot: subprocess.Popen) -> tuple[float, list[str]]:
    """End the robot: metres between where it truly is and the goal, and where that is."""
    robot.terminate()
    said, _ = robot.communicate(timeout=30)
    words = said.replace(",", "").split()
    return float(words[1]), words[7:10]


def test_an_episode_over_bad_loopback_with_the_node_started_anew(begin, tmp_path) -> None:
    kept = tmp_path / "words.json"
    person = Person()
    robot = begin("robot", "--faults", "0.1")
    node = begin("navigator", "--kept", str(kept), *AREA)
    person.wait_for(status("ready"), [robot, node])
    person.say(TEXT)
    person.wait_for(status("heard"), [robot, node])
    person.wait_for(is_on_its_way, [robot, node])
    node.kill()
    node.wait()
    assert json.loads(Path(kept).read_text("utf-8")) == [TEXT]
    node = begin("navigator", "--kept", str(kept), *AREA)
    end = person.wait_for(status("ended"), [robot, node])
    assert end["ending"] == "arrived", end
    messages = end["messages"]
    assert messages["used"] > 3
    assert messages["doubled"] > 0
    assert messages["late"] > 0
    assert messages["malformed"] == 0
    assert json.loads(Path(kept).read_text("utf-8")) == []
    assert ended(robot)[0] < 1.5


def test_the_husky_behind_topics_with_either_side_started_anew(begin, tmp_path) -> None:
    for module in ("mujoco", "cv2", "pupil_apriltags"):
        pytest.importorskip(module)
    person, kept = Person(), tmp_path / "words.json"
    options = ("--kept", str(kept), "--patience", str(LIMIT), *AREA)
    robot, node = begin("robot", "--robot", "husky"), begin("navigator", *options)
    person.wait_for(status("ready"), [robot, node])
    person.say(TEXT)
    person.wait_for(is_on_its_way, [robot, node])
    node.kill()
    node.wait()
    node = begin("navigator", *options)
    person.wait_for(is_on_its_way, [robot, node])
    # The robot is switched off where it is, and on again: its odometry begins at zero.
    _, place = ended(robot)
    person.wait_for(status("waiting_for_odometry"), [node])
    robot = begin("robot", "--robot", "husky", "--start", *place)
    end = person.wait_for(status("ended"), [robot, node])
    assert end["ending"] == "arrived", end
    assert end["messages"]["malformed"] == 0
    assert end["messages"]["restarts"] == 1
    assert ended(robot)[0] < 1.5


def test_bad_options_end_with_one_line(begin) -> None:
    process = begin("robot", "--faults", "0.9")
    process.communicate(timeout=120)
    assert process.returncode == 2
