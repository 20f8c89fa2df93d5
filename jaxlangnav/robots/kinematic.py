"""A robot without physics: a body that does what it is told, but for slip, in a known place.

For tests, and where ``jaxlangnav[robot]`` is not installed. The detector is that of the simulated
worlds (``world.sensor``).
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.messages import SensorParams, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.robots.motion.mover import TICK, Mover
from jaxlangnav.robots.motion.steering import BodyLimits, Pursuit, Steering, WheelCommand
from jaxlangnav.robots.robot import Detection
from jaxlangnav.robots.simulated import BEAMS, SCAN_RANGE, SimulatedRobot
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.state import Scenario, WorldState

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
        body: BodyLimits = BODY,
        steering: Steering | None = None,
        slip: Slip | None = None,
    ) -> None:
        """Put the robot at the start of a place.

        Args:
            scenario: the truth.
            seed: of all noise.
            sensor: specification of the detector; the default one if None.
            body: size and limits.
            steering: how it follows a way; pure pursuit if None.
            slip: of its odometry; the default one if None.
        """
        super().__init__(
            Mover(body, Pursuit() if steering is None else steering),
            sensor=default_sensor() if sensor is None else sensor,
            area=np.asarray(scenario.area).tolist(),
            start=np.asarray(scenario.start, float).tolist(),
        )
        self.scenario = scenario
        self.obstacles: list[tuple[float, float, float]] = []
        """Further discs x, y, radius that the detector knows nothing of: people, posts."""
        self.slippery: list[tuple[float, float, float]] = []
        """Discs on which the wheels turn and the body hardly moves."""
        self._true = np.asarray(scenario.start, float).copy()
        self._random = np.random.default_rng(seed)
        self._key = jax.random.key(seed)
        self._looks = 0
        self._slip = Slip() if slip is None else slip
        self._scale = 1.0 + self._slip.scale * self._random.standard_normal()
        self._bias = self._slip.drift * self._random.standard_normal()

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
        ranges = np.full(len(BEAMS), np.inf)
        x, y, heading = self._true
        for disc_x, disc_y, radius in self.things():
            ahead_x, ahead_y = np.cos(BEAMS + heading), np.sin(BEAMS + heading)
            along = (disc_x - x) * ahead_x + (disc_y - y) * ahead_y
            aside = (disc_y - y) * ahead_x - (disc_x - x) * ahead_y
            is_hit = (along > 0.0) & (np.abs(aside) < radius)
            depth = np.sqrt(np.maximum(radius**2 - aside**2, 0.0))
            ranges = np.where(is_hit, np.minimum(ranges, along - depth), ranges)
        return np.where(ranges <= SCAN_RANGE, ranges, np.inf)

    def _move(self, command: WheelCommand) -> np.ndarray:
        ahead, turned = command.speed * TICK, command.turn * TICK
        x, y, heading = self._true
        grip = 0.2 if any(np.hypot(x - a, y - b) < r for a, b, r in self.slippery) else 1.0
        middle = heading + 0.5 * turned
        self._true += np.array(
            [grip * ahead * np.cos(middle), grip * ahead * np.sin(middle), turned]
        )
        noise = self._slip.noise * np.sqrt(abs(ahead)) * self._random.standard_normal()
        # Wheels that stand still: the gyro is not listened to.
        moves = command.speed != 0.0 or command.turn != 0.0
        return np.array([self._scale * ahead + noise, turned + self._bias * TICK * moves])

    def _look(self) -> list[Detection]:
        self._looks += 1
        x, y, heading = self._true.astype(np.float32)
        state = WorldState(
            position=jnp.array([x, y]),
            heading=jnp.asarray(heading),
            odometry=jnp.asarray(self._odometry, jnp.float32),
            distance=jnp.float32(self.travelled),
        )
        key = jax.random.fold_in(self._key, self._looks)
        seen = jax.device_get(_sense(key, state, self.scenario, self.sensor))
        return [
            Detection(object_type=int(kind), range=float(away), bearing=float(bearing))
            for kind, away, bearing, is_one in zip(
                seen.detection_type,
                seen.detection_range,
                seen.detection_bearing,
                seen.is_detection,
                strict=True,
            )
            if is_one
        ]
