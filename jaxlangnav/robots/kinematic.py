"""Simulated robots: what they have in common, and one without physics.

A backend tells how the body answers a command and what scanner and camera see. ``true_pose`` and
``travelled`` are for whoever judges a run, never for the navigator. The robot without physics does
what it is told, but for slip; its detector is that of the worlds (``world.sensor``).
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
from jaxlangnav.pytree import replace
from jaxlangnav.robots.motion.mover import TICK, Mover
from jaxlangnav.robots.motion.path import to_discs
from jaxlangnav.robots.motion.steering import BodyLimits, WheelCommand
from jaxlangnav.robots.robot import Detection, WaypointStatus
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.state import Scenario, WorldState

BEAMS = np.linspace(-np.pi, np.pi, 181)[:-1]
"""Radians, directions of the scanner's beams in the robot frame."""
SCAN_RANGE = 6.0
"""Metres that the scanner sees."""


class SimulatedRobot(abc.ABC):
    """A robot whose time passes only in ``wait``."""

    def __init__(
        self,
        mover: Mover,
        scenario: Scenario,
        *,
        sensor: SensorParams,
        seed: int,
        scale: float,
        bias: float,
    ) -> None:
        """Put the robot at the start of a place, which is known to it as the place's area is.

        Its noise is drawn by the seed: once the share by which all its lengths are out and its
        gyro's bias, radians a second, with standard deviations ``scale`` and ``bias``.
        """
        self.mover, self.scenario = mover, scenario
        self.go_to, self.stop = mover.go_to, mover.stop
        self.seconds = self.travelled = 0.0
        self.camera_works = True
        self.on_tick: Callable[[Self], None] | None = None
        self.on_look: Callable[[Self], None] | None = None
        """Is told each look just after it was taken, one without a picture too."""
        self.sensor = sensor
        """What the belief is told of the detector."""
        x_min, x_max, y_min, y_max = (float(edge) for edge in scenario.area)
        self.area = (x_min, x_max, y_min, y_max)
        self.slippery: list[tuple[float, float, float]] = []
        """Discs x, y, radius, metres, on which wheels turn and the body hardly moves."""
        self._odometry = np.array(scenario.start, float)
        self._random = np.random.default_rng(seed)
        self._scale = 1.0 + scale * self._random.standard_normal()
        self._bias = bias * self._random.standard_normal()
        self._events: list[tuple[float, Callable[[Self], None]]] = []

    @property
    @abc.abstractmethod
    def true_pose(self) -> np.ndarray:
        """Where it truly is: x, y, heading, f64[3], map frame."""

    @abc.abstractmethod
    def _scan(self) -> np.ndarray:
        """Measure how far the nearest thing is along each of ``BEAMS``, f64[B], metres."""

    @abc.abstractmethod
    def _move(self, command: WheelCommand) -> np.ndarray:
        """Carry out a command for a tick: f64[2], metres and radians as wheels and gyro have it."""

    @abc.abstractmethod
    def _look(self) -> list[Detection]:
        """Find things in a picture taken now."""

    def at(self, seconds: float, event: Callable[[Self], None]) -> None:
        """Let something happen to the robot, a fault or a person, at seconds of its clock."""
        bisect.insort(self._events, (seconds, event), key=operator.itemgetter(0))

    @property
    def world_state(self) -> WorldState:
        """Where it truly is, where its odometry has it, and how far it has driven."""
        true = self.true_pose
        return WorldState(
            position=jnp.asarray(true[:2], jnp.float32),
            heading=jnp.float32(true[2]),
            odometry=jnp.asarray(self._odometry, jnp.float32),
            distance=jnp.float32(self.travelled),
        )

    def _slips(self) -> bool:
        """Tell whether it stands where it is slippery."""
        x, y, _ = self.true_pose
        return any(np.hypot(x - a, y - b) < radius for a, b, radius in self.slippery)

    def pose(self) -> np.ndarray:
        """Tell x, y, heading by dead reckoning, see ``Robot.pose``."""
        return self._odometry.copy()

    def detections(self) -> list[Detection] | None:
        """Look, see ``Robot.detections``."""
        found = self._look() if self.camera_works else None
        if self.on_look is not None:
            self.on_look(self)
        return found

    def wait(self, seconds: float) -> WaypointStatus:
        """Let time pass, see ``Robot.wait``."""
        for _ in range(max(1, round(seconds / TICK))):
            while self._events and self._events[0][0] <= self.seconds:
                self._events.pop(0)[1](self)
            discs = to_discs(self._scan(), BEAMS, self._odometry)
            before = self.true_pose
            ahead, turned = self._move(self.mover.tick(self._odometry, discs))
            self.travelled += float(np.hypot(*(self.true_pose - before)[:2]))
            self._odometry += _arc(self._odometry[2], ahead, turned)
            self.seconds += TICK
            if self.on_tick is not None:
                self.on_tick(self)
        return self.mover.progress


def _arc(heading: float, ahead: float, turned: float) -> np.ndarray:
    """Tell by how much a pose changes on an arc, f64[3]: along the chord, half turned."""
    middle = heading + 0.5 * turned
    return np.array([ahead * np.cos(middle), ahead * np.sin(middle), turned])


OBJECT_RADIUS = 0.28
"""Metres, of the disc that a thing is to a scanner: a cube of 0.4 m and its corners."""
BODY = BodyLimits(
    name="cart",
    radius=0.4,
    speed=0.6,
    top_speed=1.0,
    turn_rate=1.2,
    acceleration=0.8,
    turn_acceleration=2.0,
)
"""A small cart; a guess."""
_sense = jax.jit(sense)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Slip:
    """How odometry goes wrong, as a robot of wheels and a gyro has it."""

    scale: float = 0.01
    """Standard deviation of the share by which all lengths are out, drawn once."""
    noise: float = 0.02
    """Standard deviation of a metre's length, metres; grows with the root of the way."""
    drift: float = 0.0003
    """Standard deviation of the gyro's bias, radians a second, drawn once."""


class KinematicRobot(SimulatedRobot):
    """A unicycle among discs."""

    def __init__(
        self,
        scenario: Scenario,
        *,
        seed: int,
        sensor: SensorParams | None = None,
        slip: Slip | None = None,
    ) -> None:
        """Put the robot at the start of a place; ``seed`` is of all noise."""
        self._slip = Slip() if slip is None else slip
        super().__init__(
            Mover(BODY),
            scenario,
            sensor=default_sensor() if sensor is None else sensor,
            seed=seed,
            scale=self._slip.scale,
            bias=self._slip.drift,
        )
        self.obstacles: list[tuple[float, float, float]] = []
        """Further discs x, y, radius that the detector knows nothing of: people, posts."""
        self._true = self._odometry.copy()
        self._key = jax.random.key(seed)
        self._looks = 0

    @property
    def true_pose(self) -> np.ndarray:
        """Where it truly is."""
        return self._true.copy()

    def things(self) -> np.ndarray:
        """List all that can be run into, f64[K, 3], x, y, radius, metres, map frame."""
        scenario, there = self.scenario, np.asarray(self.scenario.is_object)
        x, y = np.asarray(scenario.object_x)[there], np.asarray(scenario.object_y)[there]
        discs = [*zip(x, y, [OBJECT_RADIUS] * len(x), strict=True), *self.obstacles]
        return np.array(discs, float).reshape(-1, 3)

    def move_object(self, index: int, x: float, y: float) -> None:
        """Put the thing of a slot elsewhere, metres; out of the world where not finite."""
        scenario = self.scenario
        is_there = bool(np.isfinite([x, y]).all())
        self.scenario = replace(
            scenario,
            object_x=jnp.asarray(scenario.object_x).at[index].set(x if is_there else 0.0),
            object_y=jnp.asarray(scenario.object_y).at[index].set(y if is_there else 0.0),
            is_object=jnp.asarray(scenario.is_object).at[index].set(is_there),
        )

    def _scan(self) -> np.ndarray:
        ahead_x, ahead_y = np.cos(BEAMS + self._true[2]), np.sin(BEAMS + self._true[2])
        disc_x, disc_y, radius = self.things().T[..., None]
        off_x, off_y = disc_x - self._true[0], disc_y - self._true[1]
        along, aside = off_x * ahead_x + off_y * ahead_y, off_y * ahead_x - off_x * ahead_y
        near = along - np.sqrt(np.maximum(radius**2 - aside**2, 0.0))
        is_hit = (along > 0.0) & (np.abs(aside) < radius) & (near <= SCAN_RANGE)
        return np.where(is_hit, near, np.inf).min(axis=0, initial=np.inf)

    def _move(self, command: WheelCommand) -> np.ndarray:
        ahead, turned = command.speed * TICK, command.turn * TICK
        grip = 0.2 if self._slips() else 1.0
        self._true += _arc(self._true[2], grip * ahead, turned)
        noise = self._slip.noise * np.sqrt(abs(ahead)) * self._random.standard_normal()
        # Wheels that stand still: the gyro is not listened to.
        moves = command.speed != 0.0 or command.turn != 0.0
        return np.array([self._scale * ahead + noise, turned + self._bias * TICK * moves])

    def _look(self) -> list[Detection]:
        self._looks += 1
        key = jax.random.fold_in(self._key, self._looks)
        seen = jax.device_get(_sense(key, self.world_state, self.scenario, self.sensor))
        return [
            Detection(
                object_type=int(seen.detection_type[slot]),
                range=float(seen.detection_range[slot]),
                bearing=float(seen.detection_bearing[slot]),
            )
            for slot in np.flatnonzero(seen.is_detection)
        ]
