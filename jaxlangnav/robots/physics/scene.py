"""The place in MuJoCo: ``place.xml``, a robot, and things with tags on four sides.

Things and the person are moved, not pushed: they stand where they are put. Geometry groups tell
the scanner what to see: 1 things and people, 2 their looks, 3 the robot, 0 the floor.
"""

import dataclasses
from collections import Counter
from importlib import resources
from typing import Any

import numpy as np

from jaxlangnav.robots import libraries
from jaxlangnav.robots.physics.tags import CUBE_SIDE, TAGS_PER_TYPE, draw_tag
from jaxlangnav.world.state import CONE, HYDRANT, Scenario

MIDDLE_HEIGHT = 0.45
"""Metres from the floor to the middle of a cube."""
OUT_OF_SIGHT = (500.0, 500.0)
_LOOKS = {"contype": 0, "conaffinity": 0, "group": 2}  # of what is seen and touches nothing
_COLOURS = {HYDRANT: (0.75, 0.1, 0.1, 1.0), CONE: (0.95, 0.45, 0.05, 1.0)}
_COVERED = (0.45, 0.45, 0.45, 1.0)
_SIDES = ("front", "left", "back", "right")


@dataclasses.dataclass(frozen=True, kw_only=True)
class PhysicsScene:
    """A compiled place."""

    model: Any
    """A ``mujoco.MjModel``."""
    data: Any
    """A ``mujoco.MjData``."""

    def _moved(self, name: str) -> int:
        """Look up the number of what can be put elsewhere."""
        return int(self.model.body_mocapid[self.model.body(name).id])

    def put(self, name: str, x: float, y: float) -> None:
        """Put a thing, "thing3" for the slot 3, or the "person" somewhere, metres, map frame."""
        self.data.mocap_pos[self._moved(name), :2] = x, y

    def turn(self, name: str, heading: float) -> None:
        """Turn a thing about its upright axis to a heading, radians, map frame."""
        self.data.mocap_quat[self._moved(name)] = _upright(heading)

    def cover(self, slot: int) -> None:
        """Hang something grey over the tags of a thing."""
        for side in _SIDES:
            geom = int(self.model.geom(f"tag{slot}_{side}").id)
            self.model.geom_matid[geom] = -1
            self.model.geom_rgba[geom] = _COVERED


def compile_scene(robot: str, scenario: Scenario, *, seed: int) -> PhysicsScene:
    """Build a place with "husky" or "wheelchair" at its start, cubes turned by the seed."""
    mujoco = libraries.mujoco()
    folder = resources.files("jaxlangnav.robots.physics")
    place, body = (folder / f"{name}.xml" for name in ("place", robot))
    included = {"robot.xml": body.read_bytes()}
    spec = mujoco.MjSpec.from_string(place.read_text("utf-8"), include=included)
    random, counts = np.random.default_rng(seed), Counter[int]()
    for slot in np.flatnonzero(np.asarray(scenario.is_object)).tolist():
        kind = int(np.asarray(scenario.object_type)[slot])
        place = float(scenario.object_x[slot]), float(scenario.object_y[slot])
        turned, pos = _upright(random.uniform(0.0, 0.5 * np.pi)), [*place, MIDDLE_HEIGHT]
        body = spec.worldbody.add_body(name=f"thing{slot}", mocap=True, pos=pos, quat=turned)
        _add_cube(mujoco, body, _COLOURS.get(kind, (0.3, 0.4, 0.6, 1.0)))
        _add_tags(spec, mujoco, body, f"tag{slot}", kind * TAGS_PER_TYPE + counts[kind])
        counts[kind] += 1
    model = spec.compile()
    data = mujoco.MjData(model)
    x, y, heading = (float(one) for one in np.asarray(scenario.start))
    data.qpos[:2] = x, y
    data.qpos[3:7] = _upright(heading)
    mujoco.mj_forward(model, data)
    return PhysicsScene(model=model, data=data)


def _upright(heading: float) -> list[float]:
    """Build the quaternion w, x, y, z of a heading."""
    return [float(np.cos(0.5 * heading)), 0.0, 0.0, float(np.sin(0.5 * heading))]


def _add_cube(mujoco: Any, body: Any, colour: tuple[float, ...]) -> None:
    """Add a cube on a foot."""
    half = 0.5 * CUBE_SIDE
    cylinder, box = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_BOX
    solid = {"contype": 1, "conaffinity": 2, "group": 1}
    body.add_geom(type=box, size=[half - 0.004] * 3, rgba=[0.9, 0.9, 0.9, 1], **solid)
    foot = 0.5 * (MIDDLE_HEIGHT - half)
    body.add_geom(
        type=cylinder, size=[0.1, foot, 0], pos=[0, 0, -half - foot], rgba=colour, **solid
    )
    body.add_geom(
        type=cylinder, size=[0.14, 0.05, 0], pos=[0, 0, half + 0.05], rgba=colour, **_LOOKS
    )


def _add_tags(spec: Any, mujoco: Any, body: Any, name: str, number: int) -> None:
    """Add a tag on each upright side of a cube."""
    half = 0.5 * CUBE_SIDE
    png = libraries.opencv().imencode(".png", draw_tag(number))[1].tobytes()
    spec.assets = {**spec.assets, f"{name}.png": png}
    spec.add_texture(name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, file=f"{name}.png")
    material = spec.add_material(name=name, specular=0.0, shininess=0.0, emission=0.1)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    for side, angle in zip(_SIDES, 0.5 * np.pi * np.arange(4), strict=True):
        cosine, sine = np.cos(angle), np.sin(angle)
        # It faces outwards, x to the viewer's right, y up.
        columns = np.array([[-sine, 0.0, cosine], [cosine, 0.0, sine], [0.0, 1.0, 0.0]])
        mujoco.mju_mat2Quat(turned := np.empty(4), columns.ravel())
        body.add_geom(
            name=f"{name}_{side}",
            type=mujoco.mjtGeom.mjGEOM_PLANE,
            size=[half, half, 0.1],
            pos=[half * cosine, half * sine, 0.0],
            quat=turned,
            material=name,
            **_LOOKS,
        )
