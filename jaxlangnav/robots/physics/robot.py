"""MuJoCo robots with wheel slip, a rendered camera and AprilTag detection (section 4.3).

Sizes and masses of the paper's two robots are in ``husky.xml`` and ``wheelchair.xml``. Speeds are
those of the data sheets, reduced for safety among people; accelerations are guesses. Odometry takes
lengths from the wheel encoders, and turns from the gyro while the wheels turn.
"""

import dataclasses

import numpy as np

from jaxlangnav.robots import libraries
from jaxlangnav.robots.kinematic import BEAM_ANGLES, SCAN_RANGE, SimulatedRobot
from jaxlangnav.robots.motion.mover import TICK, MotionPlanner
from jaxlangnav.robots.motion.steering import BodyLimits, WheelCommand
from jaxlangnav.robots.physics.scene import compile_scene
from jaxlangnav.robots.physics.tags import (
    HEIGHT,
    WIDTH,
    Gates,
    Tag,
    add_image_noise,
    find_tags,
    sensor_params,
    to_detections,
)
from jaxlangnav.robots.robot import Detection
from jaxlangnav.world.state import Scenario


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobotModel:
    """Body, wheels and steering parameters of a robot."""

    body: BodyLimits
    wheel_radius: float
    """Metres, effective rolling radius under load: the Husky's soft tires deform."""
    track: float
    """Metres between the wheels of the two sides."""
    effective_track: float
    """Factor on ``track``: the effective track width in turns, because of skid-steer slip."""
    camera_ahead: float
    """Metres from the center to the camera."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SensorErrors:
    """Error model of wheels, gyro and camera: standard deviations, drawn once unless stated.

    Guesses after data sheets of consumer sensors.
    """

    wheel_scale: float = 0.01
    """Relative error of the wheels' radius."""
    gyro_bias: float = 0.0005
    """Radians a second: 1.7 degrees a minute."""
    gyro_noise: float = 0.002
    """Radians a second, of each reading at 100 Hz."""
    grain: float = 4.0
    """Grey levels of 255, of each pixel."""
    blur: float = 0.8
    """Pixels; of every picture."""


ODOMETRY_NOISE = {"husky": 0.11, "wheelchair": 0.022}
"""Standard deviation of each axis, relative to the distance per cycle, that the belief assumes: the
largest that ``scripts/measure_odometry.py`` finds, rounded conservatively."""
ROBOT_MODELS = {
    "husky": RobotModel(
        body=BodyLimits(
            radius=0.5 * float(np.hypot(0.99, 0.67)),
            speed=0.6,
            top_speed=1.0,
            turn_rate=0.9,
            acceleration=0.6,
            turn_acceleration=1.5,
        ),
        wheel_radius=0.1647,
        track=0.555,
        effective_track=1.92,
        camera_ahead=0.05,
    ),
    "wheelchair": RobotModel(
        body=BodyLimits(
            radius=0.59,
            speed=0.5,
            top_speed=0.8,
            turn_rate=0.8,
            acceleration=0.5,
            turn_acceleration=1.2,
        ),
        wheel_radius=0.175,
        track=0.56,
        effective_track=1.0,
        camera_ahead=0.36,
    ),
}
"""By name."""

_GYRO_READINGS = 10  # per tick
_SETTLING_STEPS = 250  # physics steps until the robot rests on its wheels
_MIN_ROLL = 1e-4  # metres per tick below which a wheel is at rest
_SCANNED_GROUPS = np.array([0, 1, 0, 0, 0, 0], np.uint8)


class PhysicsRobot(SimulatedRobot):
    """The Husky or the wheelchair in a MuJoCo scene."""

    def __init__(
        self,
        machine: str,
        scenario: Scenario,
        *,
        seed: int,
        gates: Gates,
        errors: SensorErrors | None = None,
    ) -> None:
        """Put a robot at the start of a scenario.

        Args:
            machine: "husky" or "wheelchair".
            scenario: the true environment.
            seed: of all noise.
            gates: which tags are used; the belief assumes ``sensor_params`` of them.
            errors: sensor errors; the default if None.
        """
        self.robot_model, self._errors = ROBOT_MODELS[machine], errors or SensorErrors()
        super().__init__(
            MotionPlanner(self.robot_model.body),
            scenario,
            sensor=sensor_params(gates),
            seed=seed,
            scale=self._errors.wheel_scale,
            bias=self._errors.gyro_bias,
        )
        self._mujoco = libraries.mujoco()
        self.last_picture: np.ndarray | None = None
        """u8[H, W, 3], last camera image, red, green, blue; for display, as are its tags."""
        self.last_tags: list[Tag] = []
        self._gates = gates
        self.scene = compile_scene(machine, scenario, seed=seed)
        model = self.scene.model
        names = [model.actuator(index).name for index in range(model.nu)]
        self._side = np.array([1.0 if name.startswith("left") else -1.0 for name in names])
        joints = [model.actuator_trnid[index, 0] for index in range(model.nu)]
        self._wheels = np.array([model.jnt_qposadr[joint] for joint in joints])
        self._scanner = int(model.site("scanner").id)
        self._renderer = libraries.renderer(model, HEIGHT, WIDTH)
        self._with_robot = self._mujoco.MjvOption()
        self._with_robot.geomgroup[3] = 1
        self._mujoco.mj_step(model, self.scene.data, nstep=_SETTLING_STEPS)

    def close(self) -> None:
        """Release the renderer's memory."""
        self._renderer.close()

    @property
    def true_pose(self) -> np.ndarray:
        """Ground-truth pose."""
        qpos = self.scene.data.qpos
        w, x, y, z = qpos[3:7]
        heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return np.array([qpos[0], qpos[1], heading])

    def settle(self) -> None:
        """Update the scene after objects were moved, without simulating time."""
        self._mujoco.mj_forward(self.scene.model, self.scene.data)

    def render(self, camera: str | object) -> np.ndarray:
        """Render the image of a camera, by name or ``MjvCamera``: RGB, u8[H, W, 3]."""
        # The robot's front camera must not see the robot.
        option = None if camera == "front" else self._with_robot
        self._renderer.update_scene(self.scene.data, camera, option)
        self._renderer.scene.flags[self._mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        return self._renderer.render()

    def is_used(self, tag: Tag) -> bool:
        """Tell whether a tag is within the gates."""
        return bool(to_detections([tag], self.robot_model.camera_ahead, self._gates))

    def _detect(self) -> list[Detection]:
        self.last_picture = self.render("front")
        cv2 = libraries.opencv()
        grey = cv2.cvtColor(self.last_picture, cv2.COLOR_RGB2GRAY)
        grey = add_image_noise(grey, self._random, noise=self._errors.grain, blur=self._errors.blur)
        self.last_tags = find_tags(grey)
        return to_detections(self.last_tags, self.robot_model.camera_ahead, self._gates)

    def _scan(self) -> np.ndarray:
        bearing = BEAM_ANGLES + self.true_pose[2]
        count, model, data = len(BEAM_ANGLES), self.scene.model, self.scene.data
        rays = np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(count)]).ravel()
        eye, ranges, hit = data.site_xpos[self._scanner], np.empty(count), np.empty(count, np.int32)
        self._mujoco.mj_multiRay(
            model, data, eye, rays, _SCANNED_GROUPS, True, -1, hit, ranges, None, count, SCAN_RANGE
        )
        return np.where((hit >= 0) & (ranges <= SCAN_RANGE), ranges, np.inf)

    def _move(self, command: WheelCommand) -> np.ndarray:
        robot, data = self.robot_model, self.scene.data
        side_speed = 0.5 * robot.track * robot.effective_track * command.turn
        data.ctrl[:] = (command.speed - self._side * side_speed) / robot.wheel_radius
        wheel_start, turn = data.qpos[self._wheels].copy(), 0.0
        steps = round(TICK / _GYRO_READINGS / self.scene.model.opt.timestep)
        for _ in range(_GYRO_READINGS):
            self._mujoco.mj_step(self.scene.model, data, nstep=steps)
            noise = self._errors.gyro_noise * self._random.standard_normal()
            turn += (float(data.sensordata[2]) + self._bias + noise) * TICK / _GYRO_READINGS
        roll = (data.qpos[self._wheels] - wheel_start) * robot.wheel_radius
        is_still = bool((np.abs(roll) < _MIN_ROLL).all())
        forward = 0.5 * (roll[self._side > 0].mean() + roll[self._side < 0].mean())
        return np.array([self._scale * forward, 0.0 if is_still else turn])
