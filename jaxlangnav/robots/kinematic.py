"""Simulated robots: the base class, and a kinematic unicycle robot.

A backend simulates motion, range scanner and detector. ``true_pose`` and ``travelled`` serve to
evaluate a run, never the navigator. The kinematic robot executes commands exactly; its detector is
that of the simulated worlds (``world.sensor``).
"""

import abc
import bisect
import dataclasses
import operator
from collections.abc import Callable
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.messages import SensorParams, default_sensor
from jaxlangnav.robots.motion.mover import TICK, MotionPlanner
from jaxlangnav.robots.motion.path import to_discs
from jaxlangnav.robots.motion.steering import BodyLimits, WheelCommand
from jaxlangnav.robots.robot import Detection, WaypointStatus
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.state import Scenario, WorldState

BEAM_ANGLES = np.linspace(-np.pi, np.pi, 181)[:-1]
"""Radians, directions of the range scanner's beams in the robot frame."""
SCAN_RANGE = 6.0
"""Metres, maximum range of the scanner."""


class SimulatedRobot(abc.ABC):
    """Base class of simulated robots; simulated time passes only in ``wait``."""

    def __init__(
        self,
        mover: MotionPlanner,
        scenario: Scenario,
        *,
        sensor: SensorParams,
        seed: int,
        scale: float,
        bias: float,
    ) -> None:
        """Put the robot at the start of a scenario, whose area it knows.

        The seed draws its noise: once the relative error of all its lengths and its gyro's bias,
        radians a second, with standard deviations ``scale`` and ``bias``.
        """
        self.mover, self.scenario = mover, scenario
        self.go_to, self.stop = mover.go_to, mover.stop
        self.seconds = self.travelled = 0.0
        self.camera_works = True
        self.on_detection: Callable[[Self], None] | None = None
        """Called after each query of the detector, one without a picture too."""
        self.sensor = sensor
        """Sensor model that the belief assumes."""
        x_min, x_max, y_min, y_max = (float(edge) for edge in scenario.area)
        self.area = (x_min, x_max, y_min, y_max)
        self._odometry = np.array(scenario.start, float)
        self._random = np.random.default_rng(seed)
        self._scale = 1.0 + scale * self._random.standard_normal()
        self._bias = bias * self._random.standard_normal()
        self._events: list[tuple[float, Callable[[Self], None]]] = []

    @property
    @abc.abstractmethod
    def true_pose(self) -> np.ndarray:
        """Ground-truth pose x, y, heading, f64[3], map frame."""

    @abc.abstractmethod
    def _scan(self) -> np.ndarray:
        """Simulate the range scanner: distance along each of ``BEAM_ANGLES``, f64[B], metres."""

    @abc.abstractmethod
    def _move(self, command: WheelCommand) -> np.ndarray:
        """Execute a command for a tick; return measured odometry f64[2], metres and radians."""

    @abc.abstractmethod
    def _detect(self) -> list[Detection]:
        """Run the detector on a picture taken now."""

    def at(self, seconds: float, event: Callable[[Self], None]) -> None:
        """Schedule an event, such as a fault or a person, at seconds of the robot's clock."""
        bisect.insort(self._events, (seconds, event), key=operator.itemgetter(0))

    @property
    def world_state(self) -> WorldState:
        """Ground-truth pose, odometry pose and distance driven."""
        true = self.true_pose
        return WorldState(
            position=jnp.asarray(true[:2], jnp.float32),
            heading=jnp.float32(true[2]),
            odometry=jnp.asarray(self._odometry, jnp.float32),
            distance=jnp.float32(self.travelled),
        )

    def pose(self) -> np.ndarray:
        """Return x, y, heading by dead reckoning, see ``Robot.pose``."""
        return self._odometry.copy()

    def detections(self) -> list[Detection] | None:
        """Run the detector, see ``Robot.detections``."""
        detections = self._detect() if self.camera_works else None
        if self.on_detection is not None:
            self.on_detection(self)
        return detections

    def wait(self, seconds: float) -> WaypointStatus:
        """Simulate for a time, see ``Robot.wait``."""
        for _ in range(max(1, round(seconds / TICK))):
            while self._events and self._events[0][0] <= self.seconds:
                self._events.pop(0)[1](self)
            discs = to_discs(self._scan(), BEAM_ANGLES, self._odometry)
            last_pose = self.true_pose
            forward, turn = self._move(self.mover.tick(self._odometry, discs))
            self.travelled += float(np.hypot(*(self.true_pose - last_pose)[:2]))
            self._odometry += _arc(self._odometry[2], forward, turn)
            self.seconds += TICK
        return self.mover.progress


def _arc(heading: float, forward: float, turn: float) -> np.ndarray:
    """Pose change along an arc, f64[3]: its chord at half the turn (midpoint approximation)."""
    direction = heading + 0.5 * turn
    return np.array([forward * np.cos(direction), forward * np.sin(direction), turn])


OBJECT_RADIUS = 0.28
"""Metres, radius of an object's disc for the scanner: a cube of 0.4 m including its corners."""
CART_BODY = BodyLimits(
    radius=0.4, speed=0.6, top_speed=1.0, turn_rate=1.2, acceleration=0.8, turn_acceleration=2.0
)
"""Limits of a small cart; guesses."""
_sense = jax.jit(sense)


@dataclasses.dataclass(frozen=True, kw_only=True)
class OdometryErrors:
    """Error model of odometry by wheel encoders and a gyro."""

    scale: float = 0.01
    """Standard deviation of the relative error of all lengths, drawn once."""
    noise: float = 0.02
    """Standard deviation after one metre, metres; grows with the root of the distance."""
    drift: float = 0.0003
    """Standard deviation of the gyro's bias, radians a second, drawn once."""


class KinematicRobot(SimulatedRobot):
    """A kinematic unicycle among disc obstacles."""

    def __init__(
        self,
        scenario: Scenario,
        *,
        seed: int,
        sensor: SensorParams | None = None,
        errors: OdometryErrors | None = None,
    ) -> None:
        """Put the robot at the start of a scenario; ``seed`` determines all noise."""
        self._errors = OdometryErrors() if errors is None else errors
        super().__init__(
            MotionPlanner(CART_BODY),
            scenario,
            sensor=default_sensor() if sensor is None else sensor,
            seed=seed,
            scale=self._errors.scale,
            bias=self._errors.drift,
        )
        self.obstacles: list[tuple[float, float, float]] = []
        """Further discs x, y, radius that the detector does not report: people, posts."""
        self._true = self._odometry.copy()
        self._key = jax.random.key(seed)
        self._num_detections = 0

    @property
    def true_pose(self) -> np.ndarray:
        """Ground-truth pose."""
        return self._true.copy()

    def disc_obstacles(self) -> np.ndarray:
        """List all obstacles as discs f64[K, 3], x, y, radius, metres, map frame."""
        scenario, present = self.scenario, np.asarray(self.scenario.is_object)
        x, y = np.asarray(scenario.object_x)[present], np.asarray(scenario.object_y)[present]
        discs = [*zip(x, y, [OBJECT_RADIUS] * len(x), strict=True), *self.obstacles]
        return np.array(discs, float).reshape(-1, 3)

    def _scan(self) -> np.ndarray:
        cos, sin = np.cos(BEAM_ANGLES + self._true[2]), np.sin(BEAM_ANGLES + self._true[2])
        disc_x, disc_y, radius = self.disc_obstacles().T[..., None]
        to_disc_x, to_disc_y = disc_x - self._true[0], disc_y - self._true[1]
        along, across = to_disc_x * cos + to_disc_y * sin, to_disc_y * cos - to_disc_x * sin
        distance = along - np.sqrt(np.maximum(radius**2 - across**2, 0.0))
        is_hit = (along > 0.0) & (np.abs(across) < radius) & (distance <= SCAN_RANGE)
        return np.where(is_hit, distance, np.inf).min(axis=0, initial=np.inf)

    def _move(self, command: WheelCommand) -> np.ndarray:
        forward, turn = command.speed * TICK, command.turn * TICK
        self._true += _arc(self._true[2], forward, turn)
        noise = self._errors.noise * np.sqrt(abs(forward)) * self._random.standard_normal()
        # While the wheels stand still, the gyro is ignored.
        moves = command.speed != 0.0 or command.turn != 0.0
        return np.array([self._scale * forward + noise, turn + self._bias * TICK * moves])

    def _detect(self) -> list[Detection]:
        self._num_detections += 1
        key = jax.random.fold_in(self._key, self._num_detections)
        sensed = jax.device_get(_sense(key, self.world_state, self.scenario, self.sensor))
        return [
            Detection(
                object_type=int(sensed.detection_type[slot]),
                range=float(sensed.detection_range[slot]),
                bearing=float(sensed.detection_bearing[slot]),
            )
            for slot in np.flatnonzero(sensed.is_detection)
        ]
