"""Build the MuJoCo scene: ``place.xml``, a robot, and objects with fiducial tags on four faces.

Objects and the person are mocap bodies, which no contact moves. Geom groups select what the scanner
hits: 0 the floor, 1 objects and people, 2 their visual parts, 3 the robot.
"""

import dataclasses
from collections import Counter
from importlib import resources
from typing import Any

import numpy as np

from jaxlangnav.robots import libraries
from jaxlangnav.robots.physics.tags import CUBE_SIDE, TAGS_PER_TYPE, draw_tag
from jaxlangnav.world.state import CONE, HYDRANT, Scenario

CUBE_CENTER_HEIGHT = 0.45  # metres from the floor to the center of a cube
_VISUAL_ONLY = {"contype": 0, "conaffinity": 0, "group": 2}  # geoms without collisions
_COLORS = {HYDRANT: (0.75, 0.1, 0.1, 1.0), CONE: (0.95, 0.45, 0.05, 1.0)}
_SIDES = ("front", "left", "back", "right")


@dataclasses.dataclass(frozen=True, kw_only=True)
class PhysicsScene:
    """A compiled MuJoCo scene."""

    model: Any  # a ``mujoco.MjModel``
    data: Any  # a ``mujoco.MjData``

    def _mocap_id(self, name: str) -> int:
        return int(self.model.body_mocapid[self.model.body(name).id])

    def set_position(self, name: str, x: float, y: float) -> None:
        """Set the map position of a mocap body ("thing3", "person"), metres."""
        self.data.mocap_pos[self._mocap_id(name), :2] = x, y

    def set_heading(self, name: str, heading: float) -> None:
        """Set the heading of a mocap body about its vertical axis, radians, map frame."""
        self.data.mocap_quat[self._mocap_id(name)] = _yaw_quaternion(heading)


def compile_scene(robot: str, scenario: Scenario, *, seed: int) -> PhysicsScene:
    """Compile a scene with "husky" or "wheelchair" at its start; the seed turns the cubes."""
    mujoco = libraries.mujoco()
    folder = resources.files("jaxlangnav.robots.physics")
    scene_xml, robot_xml = (folder / f"{name}.xml" for name in ("place", robot))
    included = {"robot.xml": robot_xml.read_bytes()}
    spec = mujoco.MjSpec.from_string(scene_xml.read_text("utf-8"), include=included)
    rng, counts = np.random.default_rng(seed), Counter[int]()
    for slot in np.flatnonzero(np.asarray(scenario.is_object)).tolist():
        object_type = int(np.asarray(scenario.object_type)[slot])
        position = float(scenario.object_x[slot]), float(scenario.object_y[slot])
        quat, pos = _yaw_quaternion(rng.uniform(0.0, 0.5 * np.pi)), [*position, CUBE_CENTER_HEIGHT]
        body = spec.worldbody.add_body(name=f"thing{slot}", mocap=True, pos=pos, quat=quat)
        _add_cube(mujoco, body, _COLORS.get(object_type, (0.3, 0.4, 0.6, 1.0)))
        tag_id = object_type * TAGS_PER_TYPE + counts[object_type]
        _add_tags(spec, mujoco, body, f"tag{slot}", tag_id)
        counts[object_type] += 1
    model = spec.compile()
    data = mujoco.MjData(model)
    x, y, heading = (float(value) for value in np.asarray(scenario.start))
    data.qpos[:2] = x, y
    data.qpos[3:7] = _yaw_quaternion(heading)
    mujoco.mj_forward(model, data)
    return PhysicsScene(model=model, data=data)


def _yaw_quaternion(heading: float) -> list[float]:
    """Convert a heading to a quaternion w, x, y, z."""
    return [float(np.cos(0.5 * heading)), 0.0, 0.0, float(np.sin(0.5 * heading))]


def _add_cube(mujoco: Any, body: Any, color: tuple[float, ...]) -> None:
    half = 0.5 * CUBE_SIDE
    cylinder, box = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    solid = {"contype": 1, "conaffinity": 2, "group": 1}
    body.add_geom(type=box, size=[half - 0.004] * 3, rgba=[0.9, 0.9, 0.9, 1], **solid)
    leg_half_length = 0.5 * (CUBE_CENTER_HEIGHT - half)
    size, pos = [0.1, leg_half_length, 0], [0, 0, -half - leg_half_length]
    body.add_geom(type=cylinder, size=size, pos=pos, rgba=color, **solid)
    body.add_geom(
        type=cylinder, size=[0.14, 0.05, 0], pos=[0, 0, half + 0.05], rgba=color, **_VISUAL_ONLY
    )


def _add_tags(spec: Any, mujoco: Any, body: Any, name: str, tag_id: int) -> None:
    """Add a tag on each upright side of a cube."""
    half = 0.5 * CUBE_SIDE
    png = libraries.opencv().imencode(".png", draw_tag(tag_id))[1].tobytes()
    spec.assets = {**spec.assets, f"{name}.png": png}
    spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=f"{name}.png")
    material = spec.add_material(name=name, specular=0.0, shininess=0.0, emission=0.1)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    for side, angle in zip(_SIDES, 0.5 * np.pi * np.arange(4), strict=True):
        cos, sin = np.cos(angle), np.sin(angle)
        # The plane faces outwards, x to the viewer's right, y up.
        rotation = np.array([[-sin, 0.0, cos], [cos, 0.0, sin], [0.0, 1.0, 0.0]])
        mujoco.mju_mat2Quat(quat := np.empty(4), rotation.ravel())
        body.add_geom(
            name=f"{name}_{side}",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[half, half, 0.1],
            pos=[half * cos, half * sin, 0.0],
            quat=quat,
            material=name,
            **_VISUAL_ONLY,
        )
