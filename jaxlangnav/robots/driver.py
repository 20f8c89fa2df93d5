"""Drive a robot with a navigator, from an instruction to an ending (Figure 2, section 4.3).

The robot's motion planner goes to the waypoint that the navigator chooses. Failures beyond the
navigator's model end the drive: no pictures, a blocked path, invalid observations, a missing goal.
"""

import math
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jax import Array

from jaxlangnav.messages import AT, Fault, Status
from jaxlangnav.navigator import NavigatorInfo, NavigatorState
from jaxlangnav.navigator.api import Navigator
from jaxlangnav.pytree import replace
from jaxlangnav.robots.motion.steering import wrap
from jaxlangnav.robots.robot import (
    Detection,
    Ending,
    NavigationRun,
    OnStep,
    Robot,
    Step,
    WaypointStatus,
    observe,
    wrap_heading,
)

GOAL_TOLERANCE = 0.8
"""Metres from the believed goal within which a detection of its type confirms it."""
GoalPoint = tuple[int, float, float]
"""Index of an object type, and x and y in the map frame, metres."""


def _goal_object(state: NavigatorState, info: NavigatorInfo) -> GoalPoint | None:
    """Find the object that the robot has arrived at; None where its goal is no object."""
    goals = jax.device_get(info.goals)
    mass = np.where(goals.is_object, goals.object_mass, 0.0)[:-1]
    distance = np.hypot(goals.object_x[:-1] - info.robot[0], goals.object_y[:-1] - info.robot[1])
    slot = int(np.argmax(mass * np.exp(-distance)))
    region = int(np.argmax(np.asarray(info.behavior.goal)[:, slot]))
    types = np.asarray(state.belief.particles.object_type)[slot]
    types = types[types >= 0]
    if region != AT or not len(types) or mass[slot] <= 0.0:
        return None
    goal_type = int(np.bincount(types).argmax())
    return goal_type, float(goals.object_x[slot]), float(goals.object_y[slot])


_Detections = Sequence[Detection]


def _is_seen(goal: GoalPoint, info: NavigatorInfo, seen: _Detections, pose: np.ndarray) -> bool:
    """Tell whether any detection of an observation is of the goal."""
    object_type, *position = goal
    to_robot = np.asarray(info.robot, float) - position
    offsets = (d.offset(pose[2]) for d in seen if d.object_type == object_type)
    return any(np.hypot(*(to_robot + offset)) <= GOAL_TOLERANCE for offset in offsets)


DECISION_SECONDS = 1.5
"""Seconds from one decision to the next of a robot under way."""
_POLL_SECONDS = 0.2  # from one query of the robot's progress to the next
_MAX_FAILED_PATHS = 4  # consecutive failures of its motion planner: then the robot is blocked
_MIN_PROGRESS = 0.3  # metres of motion that reset the counts of failures
_MAX_IDLE = 3  # decisions as near to one waypoint as possible: then it turns in place
_MAX_TURNS = 4  # in place for one waypoint: then it tries from its other side, and is then blocked
_TURN_ANGLE = 1.3  # radians by which each turn exceeds the last, to cover all directions
_SAME_WAYPOINT = 0.5  # metres within which a waypoint is still the same
_OVERSHOOT, _OVERSHOOT_SECONDS = 1.2, 15.0  # metres past a waypoint to look back from; time limit
_TURN_SECONDS = 6.0  # time limit of a turn
_MAX_BLIND_SECONDS = 5.0  # without a picture: then the robot is blind
_MAX_FAULTS = 10  # consecutive faulty observations: then the robot is lost
_CONFIRM_OFFSETS = (0.0, 0.5, -0.5, 1.0, -1.0, 1.8, -1.8, 3.0)
"""Radians off the believed goal of the headings from which to detect it again."""


def drive(
    navigator: Navigator,
    robot: Robot,
    text: str,
    *,
    key: Array,
    state: NavigatorState | None = None,
    max_seconds: float = 300.0,
    listen: Callable[[], str | None] | None = None,
    on_step: OnStep | None = None,
) -> NavigationRun:
    """Drive a robot by an instruction until the drive ends, then stop it.

    Args:
        navigator: infers the task and chooses waypoints.
        robot: drives to goals and observes.
        text: the instruction.
        key: random key of the decisions, consumed.
        state: of a former drive, to continue from; by default nothing is known.
        max_seconds: time limit of the drive.
        listen: called before each decision for the next utterance, None for none; "stop" halts the
            robot until "go on".
        on_step: called after each decision.

    Raises:
        ValueError: the instruction is not understood, or contains no command; or an utterance of
            ``listen`` is not understood in the state of the drive.
    """
    if state is None:
        state = navigator.start(text, pose=wrap_heading(robot.pose()), area=robot.area)
    else:
        state = navigator.hear(state, text)
    loop, end = _DriveLoop(navigator, robot, key, on_step), None
    try:
        while end is None:
            if listen is not None and (utterance := listen()) is not None:
                state = navigator.hear(state, utterance)
            state, end = loop.decide(state)
            if end is None and loop.seconds >= max_seconds:
                ending = Ending.HALTED if bool(state.is_halted) else Ending.OUT_OF_TIME
                end = ending, f"no ending within {max_seconds:g} s"
    finally:
        robot.stop()
    robot.wait(DECISION_SECONDS)
    return NavigationRun(ending=end[0], why=end[1], steps=tuple(loop.steps), state=state)


_DriveEnd = tuple[Ending, str]


class _DriveLoop:
    """Decision loop of one drive, with its counts of failures."""

    def __init__(
        self, navigator: Navigator, robot: Robot, key: Array, on_step: OnStep | None
    ) -> None:
        self.navigator, self.robot, self.key, self.on_step = navigator, robot, key, on_step
        self.steps: list[Step] = []
        self.seconds = self.blind_seconds = self.turn_start = 0.0
        self.faults = self.failures = self.idle_steps = self.checks = self.turns = 0
        self.last_position = robot.pose()[:2]
        self.facing: float | None = None
        self.turn_target = np.full(2, np.inf)
        self.overshoot: np.ndarray | None = None

    def decide(self, state: NavigatorState) -> tuple[NavigatorState, _DriveEnd | None]:
        """Observe, decide, and drive for one decision period."""
        detections = self.robot.detections()
        if detections is None:
            return state, self._wait_for_picture(state)
        self.blind_seconds = 0.0
        pose = self.robot.pose()
        observation = observe(pose, detections, self.robot.sensor)
        key = jax.random.fold_in(self.key, len(self.steps))
        next_state, action, info = self.navigator.step(key, state, observation)
        action, status = jax.device_get(action), Status(int(action.status))
        self.faults = self.faults + 1 if int(info.fault) else 0
        if bool(action.is_stop) and status == Status.ARRIVED:
            self.robot.stop()
            self._record(pose, detections, status, info, None, WaypointStatus.STANDING, next_state)
            end = self._confirm_arrival(next_state, pose, detections, info)
            # The belief is updated, but unless the drive ends the task continues.
            return next_state if end is not None else replace(next_state, status=state.status), end
        self.checks = 0
        if bool(action.is_stop) or status == Status.IDLE:
            self._record(pose, detections, status, info, None, WaypointStatus.STANDING, next_state)
            return next_state, self._end_of(status, next_state)
        offset = np.asarray(action.waypoint, float) - np.asarray(info.robot, float)
        if int(info.fault) or status == Status.HALTED or np.hypot(*offset) < 1e-3:
            target = None
            self.robot.stop()
            progress = self._wait(DECISION_SECONDS)
        else:
            goal = pose[:2] + offset if self.overshoot is None else self.overshoot
            target = goal if self.facing is None else pose[:2]
            speed, clearance = float(action.speed), float(action.clearance)
            self.robot.go_to(target, speed=speed, clearance=clearance, facing=self.facing)
            step = max(float(np.hypot(*action.step)), _MIN_PROGRESS)
            progress = self._drive_for(DECISION_SECONDS, step)
        self._record(pose, detections, status, info, target, progress, next_state)
        return next_state, self._check_progress(progress, target, info)

    def _wait_for_picture(self, state: NavigatorState) -> _DriveEnd | None:
        """Stop and wait for a picture; the drive ends after ``_MAX_BLIND_SECONDS``."""
        self.robot.stop()
        status = Status(int(state.status))
        self._record(self.robot.pose(), None, status, None, None, WaypointStatus.STANDING, state)
        self._wait(_POLL_SECONDS)
        self.blind_seconds += _POLL_SECONDS
        if self.blind_seconds < _MAX_BLIND_SECONDS:
            return None
        return Ending.BLIND, f"the camera has delivered no picture for {self.blind_seconds:.0f} s"

    def _confirm_arrival(
        self, state: NavigatorState, pose: np.ndarray, detections: _Detections, info: NavigatorInfo
    ) -> _DriveEnd | None:
        """Confirm an arrival by a detection of the goal; otherwise turn to observe again."""
        goal = _goal_object(state, info)
        if goal is None or _is_seen(goal, info, detections, pose):
            return Ending.ARRIVED, "arrived"
        self.checks += 1
        name = self.navigator.type_names[goal[0]]
        if self.checks > len(_CONFIRM_OFFSETS):
            return Ending.NOT_FOUND, f"the {name} is not where it was seen"
        x, y = np.array(goal[1:]) - np.asarray(info.robot)
        facing = wrap(float(np.arctan2(y, x)) + _CONFIRM_OFFSETS[self.checks - 1])
        self.robot.go_to(pose[:2], speed=1.0, clearance=0.0, facing=facing)
        self._drive_for(_TURN_SECONDS)
        return None

    def _end_of(self, status: Status, state: NavigatorState) -> _DriveEnd | None:
        """Translate the navigator's final status into an ending."""
        if status == Status.NOT_FOUND:
            missing = self.navigator.missing(state)
            return Ending.NOT_FOUND, f"not found: {', '.join(missing) or 'nothing fits'}"
        if status == Status.BLOCKED:
            return Ending.BLOCKED, "it made no way, and has tried other waypoints"
        if status == Status.WHICH_ONE:
            count = len(self.navigator.candidates(state))
            return Ending.WHICH_ONE, f"{count} things may be meant, and nothing more tells"
        return Ending.IDLE, "nothing is left to do"

    def _drive_for(self, seconds: float, max_distance: float = math.inf) -> WaypointStatus:
        """Drive up to a time or distance, or until the waypoint is reached or has failed."""
        start, start_seconds = self.robot.pose()[:2], self.seconds
        progress = self._wait(_POLL_SECONDS)
        while progress is WaypointStatus.UNDER_WAY and self.seconds - start_seconds < seconds:
            if np.hypot(*(self.robot.pose()[:2] - start)) >= max_distance:
                break
            progress = self._wait(_POLL_SECONDS)
        return progress

    def _check_progress(
        self, progress: WaypointStatus, target: np.ndarray | None, info: NavigatorInfo
    ) -> _DriveEnd | None:
        """End the drive where the robot makes no progress any more."""
        if self.faults >= _MAX_FAULTS:
            return Ending.LOST, f"what the robot reports cannot be: {Fault(int(info.fault)).name}"
        if self.facing is not None or self.overshoot is not None:
            limit = _OVERSHOOT_SECONDS if self.facing is None else _TURN_SECONDS
            if self.seconds - self.turn_start > limit or progress is not WaypointStatus.UNDER_WAY:
                self.facing = self.overshoot = None
            return None
        position = self.robot.pose()[:2]
        if np.hypot(*(position - self.last_position)) > _MIN_PROGRESS:
            self.last_position, self.failures, self.idle_steps = position, 0, 0
        self.failures += progress is WaypointStatus.FAILED
        self.idle_steps += progress is WaypointStatus.REACHED
        if self.failures >= _MAX_FAILED_PATHS:
            where = "" if target is None else f" to ({target[0]:.1f}, {target[1]:.1f})"
            return Ending.BLOCKED, f"the motion planner finds no way{where}"
        if self.idle_steps < _MAX_IDLE or target is None:
            return None
        return self._turn_around(target)

    def _turn_around(self, target: np.ndarray) -> _DriveEnd | None:
        """Turn in place, then observe from behind the waypoint; blocked if neither suffices."""
        if np.hypot(*(target - self.turn_target)) > _SAME_WAYPOINT:
            self.turn_target, self.turns = target, 0
        if self.turns == _MAX_TURNS:
            # The last viewpoint to try: the other side of the waypoint.
            offset = target - self.robot.pose()[:2]
            position = target + _OVERSHOOT * offset / max(float(np.hypot(*offset)), 0.1)
            x_min, x_max, y_min, y_max = self.robot.area
            self.overshoot = np.clip(position, (x_min, y_min), (x_max, y_max))
        if self.turns > _MAX_TURNS:
            return Ending.BLOCKED, f"it cannot come nearer to ({target[0]:.1f}, {target[1]:.1f})"
        self.turns += 1
        self.idle_steps, self.turn_start = 0, self.seconds
        if self.overshoot is None:
            self.facing = wrap(float(self.robot.pose()[2]) + _TURN_ANGLE * self.turns)
        return None

    def _wait(self, seconds: float) -> WaypointStatus:
        self.seconds += seconds
        return self.robot.wait(seconds)

    def _record(
        self,
        pose: np.ndarray,
        detections: _Detections | None,
        status: Status,
        info: NavigatorInfo | None,
        target: np.ndarray | None,
        progress: WaypointStatus,
        state: NavigatorState,
    ) -> None:
        step = Step(
            seconds=round(self.seconds, 3),
            pose=(float(pose[0]), float(pose[1]), float(pose[2])),
            detections=None if detections is None else tuple(detections),
            status=status,
            fault=Fault(0 if info is None else int(info.fault)),
            target=None if target is None else (float(target[0]), float(target[1])),
            progress=progress,
        )
        self.steps.append(step)
        if self.on_step is not None:
            self.on_step(step, state, info)
