"""The two robots of the paper, as their motion planners and odometry know them (section 4.3).

Sizes and masses stand in ``husky.xml`` and ``wheelchair.xml``, with their sources. Speeds are those
of the data sheets cut to what is fit among people; accelerations are guesses.
"""

import dataclasses

import numpy as np

from jaxlangnav.robots.motion.steering import BodyLimits, Pursuit, Steering, Window


@dataclasses.dataclass(frozen=True, kw_only=True)
class Machine:
    """A robot: its body, its wheels, and how it steers."""

    body: BodyLimits
    steering: Steering
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
        steering=Pursuit(),
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
        steering=Window(),
        wheel_radius=0.175,
        track=0.56,
        effective_track=1.0,
        camera_ahead=0.36,
    ),
}
"""By name."""
