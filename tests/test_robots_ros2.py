"""Words, odometry and looks over messages: conversions, bookkeeping, whole drives, without ROS."""

import functools
import importlib.util
import json
import math
from pathlib import Path
from types import SimpleNamespace as Message
from unittest.mock import Mock

import jax
import numpy as np
import pytest
from refusals import assert_refused
from test_robots_drive import TEXT, goal_distance, put

from jaxlangnav.navigator.api import Navigator
from jaxlangnav.robots.libraries import load_ros
from jaxlangnav.robots.robot import Detection, Ending, NavigationRun, WaypointStatus
from jaxlangnav.robots.ros2 import conversions, node, simulation
from jaxlangnav.robots.ros2.__main__ import NavigatorOptions, navigate
from jaxlangnav.robots.ros2.bags import Loopback
from jaxlangnav.robots.ros2.inbox import Inbox
from jaxlangnav.robots.ros2.robot import GoalMonitor, RosRobot
from jaxlangnav.robots.ros2.session import Session
from jaxlangnav.robots.ros2.simulation import LossyChannel, RobotOptions, simulate


def quaternion(x: float, y: float, z: float, w: float) -> Message:
    return Message(x=x, y=y, z=z, w=w)


def pose(x: float, y: float, yaw: float) -> Message:
    turn = quaternion(*conversions.quaternion_of(yaw))
    return Message(position=Message(x=x, y=y), orientation=turn)


def cloud(found, **other) -> Message:
    fields = [
        Message(name=name, offset=4 * place, datatype=6 if name == "label" else 7)
        for place, name in enumerate(("x", "y", "z", "label"))
    ]
    data = conversions.to_cloud(found)
    values = {
        "fields": fields, "is_bigendian": False, "point_step": 16,
        "width": len(found), "height": 1, "data": data,
    }  # fmt: skip
    return Message(**{**values, **other})


@pytest.mark.parametrize("yaw", [0.0, 0.3, -2.9, math.pi - 1e-6, math.pi / 2])
def test_a_heading_survives_a_quaternion(yaw) -> None:
    x, y, z, w = conversions.quaternion_of(yaw)
    assert conversions.yaw_of(quaternion(x, y, z, w)) == pytest.approx(yaw, abs=1e-12)
    # The same rotation, the other sign.
    assert conversions.yaw_of(quaternion(-x, -y, -z, -w)) == pytest.approx(yaw, abs=1e-12)
    np.testing.assert_allclose(conversions.pose_of(pose(1.0, -2.0, yaw)), [1.0, -2.0, yaw])


def test_a_cloud_holds_a_look_and_an_empty_one_too() -> None:
    found = [Detection(object_type=1, range=2.0, bearing=math.pi / 2)]
    (one,) = conversions.detections_of_cloud(cloud(found), 2)
    assert one.object_type == 1
    assert (one.range, one.bearing) == pytest.approx((2.0, math.pi / 2), abs=1e-6)
    assert conversions.detections_of_cloud(cloud([]), 2) == []


def test_boxes_are_their_best_guess_and_strangers_are_left_out() -> None:
    def box(x: float, y: float, **scores: float) -> Message:
        guesses = [Message(class_id=name, score=score) for name, score in scores.items()]
        center = Message(position=Message(x=x, y=y, z=0.3))
        results = [Message(hypothesis=guess) for guess in guesses]
        return Message(results=results, bbox=Message(center=center))

    look = Message(
        detections=[
            box(3.0, 4.0, cone=0.2, hydrant=0.7), box(1.0, 0.0, dragon=0.9),
            box(1.0, 0.0, cone=0.4), box(1.0, 0.0),
        ]
    )  # fmt: skip
    (one,) = conversions.detections_of_boxes(look, ("hydrant", "cone"))
    assert (one.object_type, one.range) == (0, 5.0)
    assert one.bearing == pytest.approx(math.atan2(4.0, 3.0))
    nowhere = Message(detections=[box(1.0, 0.0, cone=math.nan), box(math.nan, 1.0, cone=0.9)])
    with pytest.raises(ValueError, match="a cone is at nan, 1: nowhere"):
        conversions.detections_of_boxes(nowhere, ("hydrant", "cone"))


def tag(x: float, z: float, turn: Message | None = None, name: str = "tag36h11:7") -> Message:
    place = Message(x=x, y=0.2, z=z)
    return Message(child_frame_id=name, transform=Message(translation=place, rotation=turn))


def test_a_tag_is_turned_from_the_optical_frame_to_the_base() -> None:
    there = tag(-1.0, 2.0)
    types, other = {"tag36h11:7": 1}, Message(child_frame_id="tag36h11:8")
    (one,) = conversions.detections_of_tags([there, other], types)
    assert (one.range, one.bearing) == pytest.approx((math.sqrt(5.0), math.atan2(1.0, 2.0)))
    # A camera half a metre ahead that looks to the left.
    (one,) = conversions.detections_of_tags([there], types, mount=(0.5, 0.0, math.pi / 2))
    place = one.range * np.array([math.cos(one.bearing), math.sin(one.bearing)])
    np.testing.assert_allclose(place, [-0.5, 2.0], atol=1e-12)


def test_the_middle_of_a_thing_is_behind_its_tag_and_its_sides_are_one_thing() -> None:
    types, straight = {"tag36h11:7": 1, "tag36h11:8": 1}, quaternion(0.0, 0.0, 0.0, 1.0)
    (one,) = conversions.detections_of_tags([tag(0.0, 2.0, straight)], types, depth=0.2)
    assert (one.range, one.bearing) == pytest.approx((2.2, 0.0))
    # Its z axis to the viewer, as some detectors have it: the same.
    over = quaternion(0.0, 1.0, 0.0, 0.0)
    (one,) = conversions.detections_of_tags([tag(0.0, 2.0, over)], types, depth=0.2)
    assert (one.range, one.bearing) == pytest.approx((2.2, 0.0))
    half = math.radians(30.0) / 2.0
    turned = quaternion(0.0, math.sin(half), 0.0, math.cos(half))
    (one,) = conversions.detections_of_tags([tag(0.0, 2.0, turned)], types, depth=0.2)
    assert one.range * math.sin(one.bearing) == pytest.approx(-0.1)
    # Two sides of one thing, and another thing of the type.
    seen = [tag(0.0, 2.0, straight), tag(0.2, 2.2, straight, "tag36h11:8"), tag(-1.0, 2.0, over)]
    near, other = conversions.detections_of_tags(seen, types)
    assert near.range == pytest.approx(math.hypot(2.1, 0.1))
    assert other.bearing > 0.4


def header(frame: str, seconds: float) -> Message:
    stamp = Message(sec=int(seconds), nanosec=round(1e9 * (seconds % 1.0)))
    return Message(frame_id=frame, stamp=stamp)


def transforms(*tags: tuple[str, float, float], seconds: float, frame: str = "camera") -> Message:
    found = [tag(-left, ahead, name=name) for name, ahead, left in tags]
    for one in found:
        one.header = header(frame, seconds)
    return Message(transforms=found)


def test_looks_by_tags_come_of_transforms_and_of_pictures_of_nothing() -> None:
    types = node.read_tag_types(["tag36h11:7=cone", "a=b=hydrant"], ("hydrant", "cone"))
    assert types == {"tag36h11:7": 1, "a=b": 0}
    looks = node.TagReader(node.TagSetup(types=types, range=3.0, field_of_view=math.pi / 2))
    stamp, (one,) = looks.of_transforms(transforms(("tag36h11:7", 2.0, 0.5), seconds=4.5))
    assert (stamp, one.object_type) == (4.5, 1)
    assert one.bearing == pytest.approx(math.atan2(0.5, 2.0))
    # The robot's own transforms are no look; a tag too far, or aside, is one at nothing.
    assert looks.of_transforms(transforms(("base_link", 1.0, 0.0), seconds=5.0)) is None
    assert looks.of_transforms(transforms(seconds=5.0)) is None
    far = ("tag36h11:7", 3.1, 0.0), ("a=b", 1.0, 1.1)
    assert looks.of_transforms(transforms(*far, seconds=5.0)) == (5.0, [])
    # What tags of no known type are seen in is a look at nothing, once the picture is known.
    stranger = transforms(("tag36h11:99", 1.0, 0.0), seconds=6.0)
    assert looks.of_transforms(stranger) is None
    assert looks.of_tag_array(Message(header=header("camera", 6.0), detections=[1])) is None
    assert looks.of_transforms(stranger) == (6.0, [])
    assert looks.of_tag_array(Message(header=header("camera", 7.0), detections=[])) == (7.0, [])


def test_a_look_is_carried_to_where_the_robot_is_now() -> None:
    seen = [Detection(object_type=0, range=2.0, bearing=0.0)]
    (one,) = conversions.transformed(seen, np.zeros(3), np.array([1.0, 0.0, math.pi / 2]))
    assert (one.range, one.bearing) == pytest.approx((1.0, -math.pi / 2))
    frame = np.array([3.0, -1.0, 2.0])
    np.testing.assert_allclose(
        conversions.compose(frame, conversions.inverse(frame)), np.zeros(3), atol=1e-12
    )
    middle = conversions.pose_between(np.array([0, 0, 3.0]), np.array([2.0, 0, -3.0]), 0.5)
    np.testing.assert_allclose(middle, [1.0, 0.0, math.pi], atol=1e-12)


SEEN = [Detection(object_type=0, range=2.0, bearing=0.0)]


def filled(seconds: float = 1.0, speed: float = 1.0) -> Inbox:
    inbox = Inbox()
    for stamp in np.arange(0.0, seconds + 1e-9, 0.1).round(3).tolist():
        inbox.add_odometry(stamp, np.array([speed * stamp, 0.0, 0.0]))
    return inbox


def test_a_look_is_used_once_from_where_it_was_taken() -> None:
    inbox = filled()
    inbox.add_detections(0.45, SEEN, now=7.0)
    (one,) = inbox.take() or []
    assert one.range == pytest.approx(2.0 - 0.55)
    assert inbox.take() is None
    assert inbox.counts.used == 1
    assert (inbox.silent_for(7.5), Inbox().silent_for(7.5)) == (0.5, math.inf)


def test_doubled_overtaken_and_late_looks_are_counted_and_left_out() -> None:
    inbox = filled(4.0)
    inbox.add_detections(4.0, SEEN, now=0.0)
    inbox.add_detections(4.0, [], now=0.0)
    inbox.add_detections(3.9, [], now=0.0)
    assert len(inbox.take() or []) == 1
    inbox.add_detections(4.0, SEEN, now=0.0)
    assert inbox.take() is None
    assert (inbox.counts.doubled, inbox.counts.late) == (2, 1)
    late = filled(4.0)
    late.add_detections(1.9, SEEN, now=0.0)
    assert late.take() is None
    assert late.counts.late == 1


def test_odometry_in_any_order_doubled_or_with_gaps_places_the_same_look() -> None:
    order = [*reversed(np.arange(0.0, 1.01, 0.1).round(3).tolist()), 0.3, 0.3, 1.0]
    del order[5]
    inbox = Inbox()
    for stamp in order:
        inbox.add_odometry(stamp, np.array([stamp, 0.0, 0.0]))
    inbox.add_detections(0.45, SEEN, now=0.0)
    (one,) = inbox.take() or []
    assert one.range == pytest.approx(2.0 - 0.55)
    assert inbox.counts.doubled == 3
    assert inbox.counts.restarts == 0


def test_a_look_without_odometry_waits_for_it_and_is_dropped_if_it_is_missing() -> None:
    inbox = filled()
    inbox.add_detections(1.8, SEEN, now=0.0)
    assert inbox.take() is None
    inbox.add_odometry(1.8, np.array([1.8, 0.0, 0.0]))
    assert len(inbox.take() or []) == 1
    gap = filled()
    gap.add_odometry(2.8, np.array([2.8, 0.0, 0.0]))
    gap.add_detections(1.9, SEEN, now=0.0)
    assert gap.take() is None
    assert gap.counts.unplaced == 1
    assert Inbox().take() is None


def test_a_clock_that_begins_anew_is_a_restart_and_late_odometry_is_none() -> None:
    inbox = filled(30.0, speed=0.5)
    inbox.add_odometry(12.0, np.array([6.0, 0.0, 0.0]))
    assert (inbox.counts.late, inbox.counts.restarts) == (1, 0)
    inbox.add_detections(30.0, SEEN, now=0.0)
    for tick in range(12):
        inbox.add_odometry(0.1 * tick, np.array([0.02 * tick, 0.0, 0.0]))
    assert (inbox.counts.late, inbox.counts.restarts) == (1, 1)
    np.testing.assert_allclose(inbox.track.pose, [15.22, 0.0, 0.0], atol=1e-9)
    # The look was of its former life.
    assert inbox.take() is None
    inbox.add_detections(1.1, SEEN, now=0.0)
    assert len(inbox.take() or []) == 1


def test_odometry_at_zero_after_a_silence_begins_anew_and_any_other_goes_on() -> None:
    inbox = filled(10.0, speed=0.5)
    # Twenty seconds would do to drive back, but a robot that has just been switched on is at zero.
    inbox.add_odometry(30.0, np.array([0.05, 0.0, 0.0]))
    np.testing.assert_allclose(inbox.track.pose, [5.0, 0.0, 0.0], atol=1e-9)
    assert inbox.counts.restarts == 1
    went_on = filled(10.0, speed=0.5)
    went_on.add_odometry(30.0, np.array([1.0, 2.0, 0.5]))
    np.testing.assert_allclose(went_on.track.pose, [1.0, 2.0, 0.5], atol=1e-9)
    assert went_on.counts.restarts == 0
    # It had only turned: the heading is kept, too.
    turned = Inbox()
    turned.add_odometry(0.0, np.array([0.1, 0.0, 2.0]))
    turned.add_odometry(20.0, np.zeros(3))
    np.testing.assert_allclose(turned.track.pose, [0.1, 0.0, 2.0], atol=1e-9)


def test_headway_is_told_from_odometry_alone() -> None:
    goal, headway = np.array([2.0, 0.0, 0.0]), GoalMonitor()
    assert headway.progress(np.zeros(3), 0.0) is WaypointStatus.STANDING
    headway.set(goal, 0.0)
    assert headway.progress(np.array([0.5, 0.0, 0.0]), 2.0) is WaypointStatus.UNDER_WAY
    # The same goal once more does not begin its time anew.
    headway.set(goal + 0.01, 4.0)
    assert headway.progress(np.array([0.5, 0.0, 0.0]), 5.5) is WaypointStatus.FAILED
    assert headway.progress(np.array([1.0, 0.0, 0.0]), 6.0) is WaypointStatus.UNDER_WAY
    assert headway.progress(np.array([1.0, 0.0, 0.0]), 9.5) is WaypointStatus.REACHED
    headway.set(goal, 9.5)
    assert headway.progress(np.array([1.9, 0.0, 0.1]), 9.6) is WaypointStatus.REACHED
    headway.set(None, 9.6)
    assert headway.progress(np.array([1.9, 0.0, 0.1]), 9.7) is WaypointStatus.STANDING


class Loop(Loopback):
    """A bus to a kinematic robot whose messages pass a bad network."""

    def __init__(self, simulated, *, share: float = 0.0) -> None:
        super().__init__(simulated)
        self.channel: LossyChannel = LossyChannel(share, seed=3)
        self.away_until = 0.0
        self.spin(0.3)

    def publish(self, topic: str, stamp: float, what) -> None:
        self.channel.put((topic, stamp, what), stamp)
        for one in self.channel.take(stamp):
            if stamp >= self.away_until:
                super().publish(*one)

    def send_goal(self, goal, *, speed, clearance) -> None:
        if self.simulated.seconds >= self.away_until:
            super().send_goal(goal, speed=speed, clearance=clearance)

    def vanish(self, seconds: float) -> None:
        """It is switched off and on again, when it has come to rest."""
        self.away_until = self.simulated.seconds + seconds
        self.simulated.stop()
        self.simulated.at(self.away_until - 0.2, lambda one: self.restart())

    def restart(self) -> None:
        """Odometry begins anew where the robot is, and the goal is forgotten."""
        self.origin = self.simulated.pose()
        self.simulated.stop()


@pytest.fixture(scope="module")
def navigator() -> Navigator:
    """That of ``Navigator.pretrained``; what it is told of is there."""
    return Navigator.pretrained(absent=0.0)


def session(navigator, bus: Loopback, **options) -> tuple[Session, list]:
    told: list = []
    simulated = bus.simulated
    robot = RosRobot(bus, sensor=simulated.sensor, area=simulated.area)
    return Session(navigator, robot, told.append, key=jax.random.key(1), **options), told


def driven(talk: Session, simulated=None, *, ending: Ending = Ending.ARRIVED) -> NavigationRun:
    """Carry out what was said; the drive ends so, and beside the goal."""
    ended = talk.go()
    assert ended.ending is ending, ended.why
    assert simulated is None or goal_distance(simulated) < 1.5
    return ended


@pytest.mark.parametrize("share", [0.0, 0.2])
def test_a_sentence_is_carried_out_over_messages(navigator, share) -> None:
    simulated = put()
    bus = Loop(simulated, share=share)
    talk, told = session(navigator, bus)
    for text in (TEXT, TEXT):
        talk.say(text, now=0.0)
    ended = driven(talk, simulated)
    # The words came twice and were heard once.
    assert [one["status"] for one in told].count("heard") == 1
    assert told[-1]["ending"] == "arrived"
    assert talk.go() is None
    counts = bus.inbox.counts
    assert counts.used >= (1.0 - share) * len(ended.steps) - 3  # so many looks are lost
    assert (counts.doubled > 0, counts.late > 0) == (share > 0.0, share > 0.0)
    assert counts.restarts == 0
    json.dumps(told)


class Tagged(Loopback):
    """A bus on which looks come as apriltag_ros publishes them, by a camera 0.2 m ahead."""

    def __init__(self, simulated) -> None:
        super().__init__(simulated)
        types, view = {f"tag36h11:{kind}": kind for kind in range(15)}, math.pi / 2
        setup = node.TagSetup(types=types, range=3.0, field_of_view=view, mount=(0.2, 0.0, 0.0))
        self.looks = node.TagReader(setup)
        self.spin(0.3)

    def publish(self, topic: str, stamp: float, what) -> None:
        if topic == "odom":
            super().publish(topic, stamp, what)
            return
        places = [
            (f"tag36h11:{one.object_type}", one.range * math.cos(one.bearing) - 0.2,
             one.range * math.sin(one.bearing))
            for one in what
        ]  # fmt: skip
        found = Message(header=header("camera", stamp), detections=places)
        moved = transforms(*places, seconds=stamp)
        own = transforms(("base_link", 1.0, 0.0), seconds=stamp, frame="odom")
        looks = [self.looks.of_tag_array(found), *map(self.looks.of_transforms, (own, moved))]
        for look in looks:
            if look is not None:
                self.inbox.add_detections(*look, stamp)


def test_a_sentence_is_carried_out_by_what_apriltag_ros_publishes(navigator) -> None:
    simulated = put()
    bus = Tagged(simulated)
    talk, _ = session(navigator, bus)
    talk.say(TEXT, now=0.0)
    ended = driven(talk, simulated)
    assert bus.inbox.counts.used >= len(ended.steps) - 3


def test_a_robot_that_is_away_for_a_while_is_waited_for_and_told_of_once(navigator) -> None:
    simulated, silences = put(), []
    bus = Loop(simulated)
    simulated.at(8.0, lambda one: bus.vanish(20.0))
    talk, _ = session(navigator, bus)
    robot = talk._robot
    robot._patience, robot._on_silence = 60.0, lambda: silences.append(bus.now())
    talk.say(TEXT, now=0.0)
    driven(talk, simulated)
    assert bus.inbox.counts.restarts == 1
    # Goals are sent in the frame that the robot has by then.
    assert np.hypot(*bus.origin[:2]) > 0.5
    assert len(silences) == 1
    # One that does not come back leaves it blind after its patience.
    bus.vanish(500.0)
    talk.say("go to the cone", now=100.0)
    driven(talk, ending=Ending.BLIND)
    assert bus.now() - silences[-1] < 90.0


def test_a_node_that_starts_anew_takes_up_its_task_and_a_silent_robot_makes_it_blind(
    navigator, tmp_path
) -> None:
    kept = tmp_path / "words.json"
    simulated = put()
    simulated.at(4.0, lambda one: setattr(one, "camera_works", False))
    talk, told = session(navigator, Loop(simulated), path=kept)

    def fall(told_now) -> None:
        told.append(told_now)
        if told_now.get("detections") is None and told_now["status"] == "searching":
            raise KeyboardInterrupt

    talk._tell = fall
    talk.say("dance a tango on the moon", now=0.0)
    talk.say(TEXT, now=0.0)
    with pytest.raises(KeyboardInterrupt):
        talk.go()
    assert [one["status"] for one in told[:2]] == ["refused", "heard"]
    assert json.loads(kept.read_text("utf-8")) == [TEXT]
    # Another node, while the camera still delivers nothing: told, and no crash.
    driven(session(navigator, Loop(simulated), path=kept)[0], ending=Ending.BLIND)
    assert json.loads(kept.read_text("utf-8")) == []
    # What is understood no more, as nothing is approached now, is refused: the rest is taken up.
    kept.write_text(json.dumps([TEXT, "no, the other one"]), "utf-8")
    simulated.camera_works = True
    talk, told = session(navigator, Loop(simulated), path=kept)
    driven(talk, simulated)
    assert [one["status"] for one in told[:2]] == ["refused", "heard"]


def test_words_under_way_and_after_the_end(navigator) -> None:
    simulated = put()
    talk, told = session(navigator, Loop(simulated), max_seconds=40.0)
    talk.say("stop", now=0.0)
    assert talk.go() is None
    assert told[0]["status"] == "refused"
    talk.say(TEXT, now=1.0)
    simulated.at(3.0, lambda one: talk.say("stop", now=3.0))
    simulated.at(8.0, lambda one: talk.say("go on", now=8.0))
    driven(talk)
    assert [one["text"] for one in told if one["status"] == "heard"] == [TEXT, "stop", "go on"]
    # The map is kept: the cone has been seen, and is gone to without a search.
    talk.say("go to the cone", now=100.0)
    driven(talk)
    assert goal_distance(simulated, (4.0, 0.5)) < 1.5


@pytest.mark.skipif(importlib.util.find_spec("tf2_msgs") is not None, reason="tf2_msgs is there")
def test_messages_that_no_wheel_has_are_said_to_be_of_an_installation() -> None:
    with pytest.raises(ValueError, match=r"tf2_msgs is not installed, and no wheel: .*tf2-msgs"):
        load_ros("tf2_msgs.msg")


def test_a_goal_that_is_none_is_refused_and_the_next_one_is_taken(monkeypatch) -> None:
    said, ros, robot = [], Mock(), Mock(seconds=1.0, pose=lambda: np.zeros(3))
    for name in ("load_ros", "ros_class"):
        monkeypatch.setattr(simulation, name, lambda _: ros)
    ros.create_node().get_logger().warning = said.append
    simulation.RobotServer(robot)
    take, unfilled = ros.create_node().create_subscription.call_args.args[2], pose(1.0, 0.0, 0.0)
    unfilled.orientation.w = 0.0
    for one in (unfilled, pose(math.nan, 0.0, 0.0), pose(2.0, 1.0, 0.0)):
        take(Message(pose=one))
    assert [text[:11] for text in said] == ["orientation", "a pose says"]
    np.testing.assert_allclose([one.args[0] for one in robot.go_to.call_args_list], [[2.0, 1.0]])


CLOUDS = [
    ({"fields": []}, "has fields none"),
    ({"width": 2}, "16 bytes, but 2 points"),
    ({"point_step": 8}, "has 8 bytes, but its fields end at 16"),
    ({"point_step": 2**31}, "65536 are the most"),
    ({"data": conversions.to_cloud([Detection(object_type=0, range=math.inf, bearing=0.0)])},
     "nowhere"),
    ({"data": conversions.to_cloud([Detection(object_type=2, range=1.0, bearing=0.0)])},
     "label 2, but the last of the navigator's type_names is 1"),
]  # fmt: skip
"""Changes that make no look of a cloud, and what is said of them."""
OPTIONS = [
    ({"area": (1.0, 0.0, 0.0, 1.0)}, "area is 1 0 0 1, but must be x_min x_max"),
    ({"patience": -1.0}, "patience is -1, but must be more than 0 s"),
    ({"max_seconds": 0.0}, "max-seconds is 0, but must be"),
    ({"camera": (0.1, 0.0, 0.0)}, "--camera is used with --look tf only"),
    ({"tasks": 0}, "tasks is 0, but must be at least 1"),
    ({"field_of_view": 9000.0}, "field"),
]


def refusals(kept: Path):
    """What cannot be, and what is said of it in one line, before anything is compiled."""
    found = [Detection(object_type=1, range=2.0, bearing=0.0)]
    for one, said in CLOUDS:
        yield lambda one=one: conversions.detections_of_cloud(cloud(found, **one), 2), said
    for last, said in ((0.0, "length 0"), (math.nan, "nan")):
        yield lambda last=last: conversions.yaw_of(quaternion(0.0, 0.0, 0.0, last)), said
    yield lambda: conversions.pose_of(pose(math.inf, 0.0, 0.0)), "a place is two finite numbers"
    read = functools.partial(conversions.detections_of_tags, types={"tag36h11:7": 1}, depth=0.1)
    for one, said in ((math.nan, 1.0), "is at nan, 2: nowhere"), ((0.0, 0.0), "length 0"):
        yield lambda x=one[0], w=one[1]: read([tag(x, 2.0, quaternion(0, 0, 0, w))]), said
    bus = Loop(put())
    robot = RosRobot(bus, sensor=bus.simulated.sensor, area=bus.simulated.area)
    bus.inbox = Inbox()
    yield robot.pose, "no odometry has come from the robot"
    for one in ([], ["tag36h11:7"], ["=cone"], ["tag36h11:7=dragon"]):
        told = "tag36h11:7=hydrant"
        yield lambda one=one: node.read_tag_types(one, ("hydrant", "cone")), told
    for one, said in OPTIONS:
        yield lambda one=one: navigate(NavigatorOptions(**one)), said
    outside = r"start 99 0 0 is not in the place, x 0\.0 to"
    yield lambda: simulate(RobotOptions(start=(99.0, 0.0, 0.0))), outside
    for text in ("{", "[1]", "{}", "[" * 5000):
        kept.write_text(text, "utf-8")
        yield lambda: Session(None, None, print, key=None, path=kept), "remove it to begin anew"
    yield lambda: Session(None, None, print, key=None, path=kept.parent), "is a folder"
    yield lambda: LossyChannel(0.5, 0), r"between 0 and 0\.3"


def test_what_cannot_be_is_refused_in_one_line(tmp_path) -> None:
    assert_refused(refusals(tmp_path / "words.json"))
