"""A navigator drives a robot: from a sentence to an ending (Figure 2 of the paper, section 4.3).

The robot's own motion planner goes to the waypoint that the navigator chooses. What the navigator
cannot know of is judged here and has an ending: a camera without pictures, a blocked way, an
impossible report, a goal that is not where it was seen.
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

SAME_THING = 0.8
"""Metres within which a detection is of the goal that is believed to be there."""
GoalPoint = tuple[int, float, float]
"""Index of an object type, and x and y in the map frame, metres."""


def _goal_object(state: NavigatorState, info: NavigatorInfo) -> GoalPoint | None:
    """Find the thing that a robot has arrived at."""
    goals = jax.device_get(info.goals)
    mass = np.where(goals.is_object, goals.object_mass, 0.0)[:-1]
    away = np.hypot(goals.object_x[:-1] - info.robot[0], goals.object_y[:-1] - info.robot[1])
    slot = int(np.argmax(mass * np.exp(-away)))
    region = int(np.argmax(np.asarray(info.behavior.goal)[:, slot]))
    types = np.asarray(state.belief.particles.object_type)[slot]
    types = types[types >= 0]
    if region != AT or not len(types) or mass[slot] <= 0.0:
        return None
    kind = int(np.bincount(types).argmax())
    return kind, float(goals.object_x[slot]), float(goals.object_y[slot])


_Found = Sequence[Detection]


def _is_seen(goal: GoalPoint, info: NavigatorInfo, found: _Found, pose: np.ndarray) -> bool:
    """Tell whether one of the detections of a look is of the goal."""
    kind, *place = goal
    here = np.asarray(info.robot, float) - place
    alike = (one for one in found if one.object_type == kind)
    return any(np.hypot(*(here + one.offset(pose[2]))) <= SAME_THING for one in alike)


CYCLE = 1.5
"""Seconds after which a robot under way looks and decides again."""
_WAIT = 0.2  # seconds between two questions whether the robot is there
_GIVE_UPS = 4  # ways given up, one after the other, after which the robot is blocked
_MOVED = 0.3  # metres from where it last gave up that count as a new place
_IDLE_LOOKS = 3  # looks from as near to a waypoint as can be after which it looks about
_TURNS = 4  # on the spot for one waypoint, before it tries from its other side and is then blocked
_TURNED = 1.3  # radians by which each turns farther than the last, so that they go all round
_SAME_WAYPOINT = 0.5  # metres within which a waypoint is still the same
_BEYOND, _BEYOND_SECONDS = 1.2, 15.0  # metres past a waypoint to look back from; to get there
_TURN_SECONDS = 6.0  # seconds that a turn takes at most
_BLIND = 5.0  # seconds without a picture after which the robot is blind
_FAULTY = 10  # looks at fault, one after the other, after which the robot is lost
_CONFIRM = (0.0, 0.5, -0.5, 1.0, -1.0, 1.8, -1.8, 3.0)
"""Radians off the believed goal of the looks within which it must be seen once more."""


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
    """Let a robot follow a sentence until the drive ends; then it stands.

    Args:
        navigator: what understands and decides.
        robot: what drives and sees.
        text: the sentence.
        key: random key of the decisions, consumed.
        state: of a former drive, to hear the sentence in; by default nothing is known.
        max_seconds: after which the drive is broken off.
        listen: asked before each decision for what has been said since, None for nothing; "stop"
            makes it stand until "go on".
        on_step: told each decision.

    Raises:
        ValueError: the sentence is not understood, or asks for nothing.
    """
    if state is None:
        state = navigator.start(text, pose=wrap_heading(robot.pose()), area=robot.area)
    else:
        state = navigator.hear(state, text)
    journey, end = _Journey(navigator, robot, key, on_step), None
    try:
        while end is None:
            said = listen() if listen is not None else None
            if said is not None:
                state = navigator.hear(state, said)
            state, end = journey.decide(state)
            if end is None and journey.seconds >= max_seconds:
                ending = Ending.HALTED if bool(state.is_halted) else Ending.OUT_OF_TIME
                end = ending, f"no ending within {max_seconds:g} s"
    finally:
        robot.stop()
    robot.wait(CYCLE)
    return NavigationRun(ending=end[0], why=end[1], steps=tuple(journey.steps), state=state)


_End = tuple[Ending, str]


class _Journey:
    """What the driver keeps count of on the way."""

    def __init__(
        self, navigator: Navigator, robot: Robot, key: Array, on_step: OnStep | None
    ) -> None:
        self.navigator, self.robot, self.key, self.on_step = navigator, robot, key, on_step
        self.steps: list[Step] = []
        self.seconds = self.blind_for = self.turning_since = 0.0
        self.faulty = self.gave_up = self.idle = self.unconfirmed = self.turns = 0
        self.last_place = robot.pose()[:2]
        self.facing: float | None = None
        self.turns_for = np.full(2, np.inf)
        self.beyond: np.ndarray | None = None

    def decide(self, state: NavigatorState) -> tuple[NavigatorState, _End | None]:
        """Look, decide, and go for a while."""
        found = self.robot.detections()
        if found is None:
            return state, self._be_blind(state)
        self.blind_for = 0.0
        pose = self.robot.pose()
        observation = observe(pose, found, self.robot.sensor)
        key = jax.random.fold_in(self.key, len(self.steps))
        after, action, info = self.navigator.step(key, state, observation)
        action, status = jax.device_get(action), Status(int(action.status))
        self.faulty = self.faulty + 1 if int(info.fault) else 0
        if bool(action.is_stop) and status == Status.ARRIVED:
            self.robot.stop()
            self._note(pose, found, status, info, None, WaypointStatus.STANDING, after)
            end = self._arrive(after, pose, found, info)
            # What has been seen is kept, but unless it ends the task goes on.
            return after if end is not None else replace(after, status=state.status), end
        self.unconfirmed = 0
        if bool(action.is_stop) or status == Status.IDLE:
            self._note(pose, found, status, info, None, WaypointStatus.STANDING, after)
            return after, self._name_the_end(status, after)
        offset = np.asarray(action.waypoint, float) - np.asarray(info.robot, float)
        if int(info.fault) or status == Status.HALTED or np.hypot(*offset) < 1e-3:
            target = None
            self.robot.stop()
            progress = self._wait(CYCLE)
        else:
            beyond = pose[:2] + offset if self.beyond is None else self.beyond
            target = beyond if self.facing is None else pose[:2]
            speed, clearance = float(action.speed), float(action.clearance)
            self.robot.go_to(target[None], speed=speed, clearance=clearance, facing=self.facing)
            progress = self._go_on(CYCLE, max(float(np.hypot(*action.step)), _MOVED))
        self._note(pose, found, status, info, target, progress, after)
        return after, self._judge(progress, target, info)

    def _be_blind(self, state: NavigatorState) -> _End | None:
        """Stand without a picture, for a while."""
        self.robot.stop()
        status = Status(int(state.status))
        self._note(self.robot.pose(), None, status, None, None, WaypointStatus.STANDING, state)
        self._wait(_WAIT)
        self.blind_for += _WAIT
        if self.blind_for < _BLIND:
            return None
        return Ending.BLIND, f"the camera has delivered no picture for {self.blind_for:.0f} s"

    def _arrive(
        self, state: NavigatorState, pose: np.ndarray, found: _Found, info: NavigatorInfo
    ) -> _End | None:
        """Believe an arrival once the goal has been seen from there; look again if it has not."""
        goal = _goal_object(state, info)
        if goal is None or _is_seen(goal, info, found, pose):
            return Ending.ARRIVED, "arrived"
        self.unconfirmed += 1
        name = self.navigator.type_names[goal[0]]
        if self.unconfirmed > len(_CONFIRM):
            return Ending.NOT_FOUND, f"the {name} is not where it was seen"
        x, y = np.array(goal[1:]) - np.asarray(info.robot)
        facing = wrap(float(np.arctan2(y, x)) + _CONFIRM[self.unconfirmed - 1])
        self.robot.go_to(pose[None, :2], speed=1.0, clearance=0.0, facing=facing)
        self._go_on(_TURN_SECONDS)
        return None

    def _name_the_end(self, status: Status, state: NavigatorState) -> _End | None:
        """Say how the task ended by the navigator's own account."""
        if status == Status.NOT_FOUND:
            missing = self.navigator.missing(state)
            return Ending.NOT_FOUND, f"not found: {', '.join(missing) or 'nothing fits'}"
        if status == Status.BLOCKED:
            return Ending.BLOCKED, "it made no way, and has tried other waypoints"
        if status == Status.WHICH_ONE:
            number = len(self.navigator.candidates(state))
            return Ending.WHICH_ONE, f"{number} things may be meant, and nothing more tells"
        return Ending.IDLE, "nothing is left to do"

    def _go_on(self, seconds: float, metres: float = math.inf) -> WaypointStatus:
        """Go for so long or so far, or until the robot is there or cannot go on."""
        start, begin = self.robot.pose()[:2], self.seconds
        progress = self._wait(_WAIT)
        while progress is WaypointStatus.UNDER_WAY and self.seconds - begin < seconds:
            if np.hypot(*(self.robot.pose()[:2] - start)) >= metres:
                break
            progress = self._wait(_WAIT)
        return progress

    def _judge(
        self, progress: WaypointStatus, target: np.ndarray | None, info: NavigatorInfo
    ) -> _End | None:
        """Judge whether it is of any use to go on."""
        if self.faulty >= _FAULTY:
            names = Fault(int(info.fault)).name
            return Ending.LOST, f"what the robot reports cannot be: {names}"
        if self.facing is not None or self.beyond is not None:
            most = _BEYOND_SECONDS if self.facing is None else _TURN_SECONDS
            is_over = self.seconds - self.turning_since > most
            if is_over or progress is not WaypointStatus.UNDER_WAY:
                self.facing = self.beyond = None
            return None
        place = self.robot.pose()[:2]
        if np.hypot(*(place - self.last_place)) > _MOVED:
            self.last_place, self.gave_up, self.idle = place, 0, 0
        self.gave_up += progress is WaypointStatus.GAVE_UP
        self.idle += progress is WaypointStatus.THERE
        if self.gave_up >= _GIVE_UPS:
            where = "" if target is None else f" to ({target[0]:.1f}, {target[1]:.1f})"
            return Ending.BLOCKED, f"the motion planner finds no way{where}"
        if self.idle < _IDLE_LOOKS or target is None:
            return None
        return self._look_about(target)

    def _look_about(self, target: np.ndarray) -> _End | None:
        """Turn on the spot: a waypoint that cannot be stood on may be waiting for a look."""
        if np.hypot(*(target - self.turns_for)) > _SAME_WAYPOINT:
            self.turns_for, self.turns = target, 0
        if self.turns == _TURNS:
            # The last way to see more of it: from its other side.
            way = target - self.robot.pose()[:2]
            place = target + _BEYOND * way / max(float(np.hypot(*way)), 0.1)
            x_min, x_max, y_min, y_max = self.robot.area
            self.beyond = np.clip(place, (x_min, y_min), (x_max, y_max))
        if self.turns > _TURNS:
            return Ending.BLOCKED, f"it cannot come nearer to ({target[0]:.1f}, {target[1]:.1f})"
        self.turns += 1
        self.idle, self.turning_since = 0, self.seconds
        if self.beyond is None:
            self.facing = wrap(float(self.robot.pose()[2]) + _TURNED * self.turns)
        return None

    def _wait(self, seconds: float) -> WaypointStatus:
        self.seconds += seconds
        return self.robot.wait(seconds)

    def _note(
        self,
        pose: np.ndarray,
        found: _Found | None,
        status: Status,
        info: NavigatorInfo | None,
        target: np.ndarray | None,
        progress: WaypointStatus,
        state: NavigatorState,
    ) -> None:
        """Keep a decision, and tell it."""
        step = Step(
            seconds=round(self.seconds, 3),
            pose=(float(pose[0]), float(pose[1]), float(pose[2])),
            detections=None if found is None else tuple(found),
            status=status,
            fault=Fault(0 if info is None else int(info.fault)),
            target=None if target is None else (float(target[0]), float(target[1])),
            progress=progress,
        )
        self.steps.append(step)
        if self.on_step is not None:
            self.on_step(step, state, info)
