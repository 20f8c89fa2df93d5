"""A robot of MuJoCo: wheels turn, tyres slip, a camera renders, tags are found (section 4.3).

Sizes and masses of the paper's two robots stand in ``husky.xml`` and ``wheelchair.xml``. Speeds are
those of the data sheets cut to what is fit among people; accelerations are guesses. Odometry has
lengths from the wheels' encoders, and turns from the gyro while the wheels turn.
"""

import dataclasses

import numpy as np

from jaxlangnav.robots import libraries
from jaxlangnav.robots.kinematic import BEAMS, SCAN_RANGE, SimulatedRobot
from jaxlangnav.robots.motion.mover import TICK, Mover
from jaxlangnav.robots.motion.steering import BodyLimits, WheelCommand
from jaxlangnav.robots.physics.scene import OUT_OF_SIGHT, compile_scene
from jaxlangnav.robots.physics.tags import (
    Camera,
    Gates,
    Tag,
    as_told,
    degrade,
    find_tags,
    to_detections,
)
from jaxlangnav.robots.robot import Detection
from jaxlangnav.world.state import Scenario


@dataclasses.dataclass(frozen=True, kw_only=True)
class Machine:
    """A robot: its body, its wheels, and how it steers."""

    body: BodyLimits
    wheel_radius: float
    """Metres, as the loaded wheel rolls: the Husky's soft tyres sink in a little."""
    track: float
    """Metres between the wheels of the two sides."""
    effective_track: float
    """Times ``track``: how far apart its wheels seem to be as it turns; a skid-steer's slip."""
    camera_ahead: float
    """Metres from the middle to the camera."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Wear:
    """How wheels, gyro and camera err: standard deviations, drawn once where nothing else is said.

    Guesses after data sheets of consumer sensors.
    """

    wheel_scale: float = 0.01
    """Share by which the wheels' radius is out."""
    gyro_bias: float = 0.0005
    """Radians a second: 1.7 degrees a minute."""
    gyro_noise: float = 0.002
    """Radians a second, of each reading at 100 Hz."""
    grain: float = 4.0
    """Grey levels of 255, of each pixel."""
    blur: float = 0.8
    """Pixels; of every picture."""


ODOMETRY_NOISE = {"husky": 0.11, "wheelchair": 0.022}
"""Standard deviation of each axis as a share of a cycle's way, which the belief is told: the
largest that ``scripts/measure_odometry.py`` finds, rounded to the cautious side."""
MACHINES = {
    "husky": Machine(
        body=BodyLimits(
            name="husky",
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
    "wheelchair": Machine(
        body=BodyLimits(
            name="wheelchair",
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

_READINGS = 10  # readings of the gyro in a tick
_SETTLE = 250  # steps of physics in which it comes to rest on its wheels
_STANDS = 1e-4  # metres that a wheel turns in a tick below which it stands
_ICE = 0.02  # friction of a tyre on a slippery patch
_SEEN_BY_SCANNER = np.array([0, 1, 0, 0, 0, 0], np.uint8)


class PhysicsRobot(SimulatedRobot):
    """The Husky or the wheelchair in a place of its own."""

    def __init__(
        self,
        machine: str,
        scenario: Scenario,
        *,
        seed: int,
        gates: Gates,
        wear: Wear | None = None,
    ) -> None:
        """Put a robot at the start of a place.

        Args:
            machine: "husky" or "wheelchair".
            scenario: the truth.
            seed: of all noise.
            gates: which tags are used; the belief is told of them ``as_told``.
            wear: how its sensors err; the default if None.
        """
        self.machine, self._wear = MACHINES[machine], wear or Wear()
        super().__init__(
            Mover(self.machine.body),
            scenario,
            sensor=as_told(gates),
            seed=seed,
            scale=self._wear.wheel_scale,
            bias=self._wear.gyro_bias,
        )
        self._mujoco = libraries.mujoco()
        self.camera = Camera(ahead=self.machine.camera_ahead)
        self.last_picture: np.ndarray | None = None
        """u8[H, W, 3] of the last look, red, green, blue, and its tags: to be shown."""
        self.last_tags: list[Tag] = []
        self._gates = gates
        self.scene = compile_scene(machine, scenario, seed=seed)
        model = self.scene.model
        names = [model.actuator(index).name for index in range(model.nu)]
        self._side = np.array([1.0 if name.startswith("left") else -1.0 for name in names])
        joints = [model.actuator_trnid[index, 0] for index in range(model.nu)]
        self._wheels = np.array([model.jnt_qposadr[joint] for joint in joints])
        bodies = [model.jnt_bodyid[joint] for joint in joints]
        self._tyres = np.array(
            [geom for geom in range(model.ngeom) if model.geom_bodyid[geom] in bodies]
        )
        self._grip = model.geom_friction[self._tyres, 0].copy()
        self._scanner = int(model.site("scanner").id)
        self._renderer = libraries.renderer(model, self.camera.height, self.camera.width)
        self._with_robot = self._mujoco.MjvOption()
        self._with_robot.geomgroup[3] = 1
        self._mujoco.mj_step(model, self.scene.data, nstep=_SETTLE)

    def close(self) -> None:
        """Give the renderer's memory back."""
        self._renderer.close()

    @property
    def true_pose(self) -> np.ndarray:
        """Where it truly is."""
        qpos = self.scene.data.qpos
        w, x, y, z = qpos[3:7]
        heading = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        return np.array([qpos[0], qpos[1], heading])

    def settle(self) -> None:
        """Let what has been put elsewhere be there, for a look without any time passing."""
        self._mujoco.mj_forward(self.scene.model, self.scene.data)

    def put_person(self, x: float, y: float) -> None:
        """Let a person stand at a place, metres, map frame."""
        self.scene.put("person", x, y)

    def move_object(self, slot: int, x: float, y: float) -> None:
        """Put the thing of a slot elsewhere, metres; out of sight where x or y is not finite."""
        place = (x, y) if np.isfinite([x, y]).all() else OUT_OF_SIGHT
        self.scene.put(f"thing{slot}", *place)

    def picture(self) -> np.ndarray:
        """Render what the camera sees, u8[H, W, 3], red, green, blue, without noise."""
        return self.render("front")

    def render(self, camera: str | object) -> np.ndarray:
        """Render what a camera sees, by name or ``MjvCamera``: RGB, u8[H, W, 3]."""
        # Its own camera is mounted so that it does not see itself.
        option = None if camera == "front" else self._with_robot
        self._renderer.update_scene(self.scene.data, camera, option)
        self._renderer.scene.flags[self._mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        return self._renderer.render()

    def is_used(self, tag: Tag) -> bool:
        """Tell whether a tag is within what the navigator is told of."""
        return bool(to_detections([tag], self.camera, self._gates))

    def _look(self) -> list[Detection]:
        self.last_picture = self.picture()
        cv2 = libraries.opencv()
        grey = cv2.cvtColor(self.last_picture, cv2.COLOR_RGB2GRAY)
        grey = degrade(grey, self._random, noise=self._wear.grain, blur=self._wear.blur)
        self.last_tags = find_tags(grey, self.camera)
        return to_detections(self.last_tags, self.camera, self._gates)

    def _scan(self) -> np.ndarray:
        bearing = BEAMS + self.true_pose[2]
        ways = np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(len(BEAMS))])
        ranges, hit = np.empty(len(BEAMS)), np.empty(len(BEAMS), np.int32)
        self._mujoco.mj_multiRay(
            self.scene.model,
            self.scene.data,
            self.scene.data.site_xpos[self._scanner],
            ways.ravel(),
            _SEEN_BY_SCANNER,
            True,
            -1,
            hit,
            ranges,
            None,
            len(BEAMS),
            SCAN_RANGE,
        )
        return np.where((hit >= 0) & (ranges <= SCAN_RANGE), ranges, np.inf)

    def _move(self, command: WheelCommand) -> np.ndarray:
        machine, data = self.machine, self.scene.data
        spread = 0.5 * machine.track * machine.effective_track * command.turn
        data.ctrl[:] = (command.speed - self._side * spread) / machine.wheel_radius
        if self.slippery:
            grip = _ICE if self._slips() else self._grip
            self.scene.model.geom_friction[self._tyres, 0] = grip
        before, turned = data.qpos[self._wheels].copy(), 0.0
        steps = round(TICK / _READINGS / self.scene.model.opt.timestep)
        for _ in range(_READINGS):
            self._mujoco.mj_step(self.scene.model, data, nstep=steps)
            noise = self._wear.gyro_noise * self._random.standard_normal()
            turned += (float(data.sensordata[2]) + self._bias + noise) * TICK / _READINGS
        rolled = (data.qpos[self._wheels] - before) * machine.wheel_radius
        is_still = bool((np.abs(rolled) < _STANDS).all())
        ahead = 0.5 * (rolled[self._side > 0].mean() + rolled[self._side < 0].mean())
        return np.array([self._scale * ahead, 0.0 if is_still else turned])
