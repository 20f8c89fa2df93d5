"""Use the Navigator in a custom world: a plain NumPy simulation.

Run it: python examples/own_world.py "go to the hydrant behind the cone" "go to the bench"
The second command is given when the first has ended. There is no bench, so it ends with not found.
"""

import math
import sys

import jax
import numpy as np

from jaxlangnav import Fault, Navigator, Observation, Status, default_sensor, keep_compiled_programs

OBJECTS = {"cone": (6.0, 1.0), "hydrant": (8.5, 1.6), "tree": (3.0, -4.0)}  # metres
SENSOR = default_sensor(4.0, field_of_view=math.radians(120), noise=0.05)


def observe(position: np.ndarray, heading: float) -> Observation:
    """Simulate the detector: objects within range and in the field of view."""
    detections = []
    for name, object_position in OBJECTS.items():
        dx, dy = np.subtract(object_position, position)
        bearing = math.remainder(math.atan2(dy, dx) - heading, math.tau)
        if math.hypot(dx, dy) < 4.0 and abs(bearing) < math.radians(60):
            detections.append((name, math.hypot(dx, dy), bearing))
    return Observation.of((*position, heading), detections, SENSOR)


def main(*sentences: str) -> np.ndarray:
    """Follow the sentences one after the other; returns the final position."""
    keep_compiled_programs()  # the second run starts in seconds
    navigator = Navigator.pretrained(odometry_noise=0.02)
    print(f"compiled in {navigator.warm_up():.0f} s")
    state = navigator.start(sentences[0], pose=(0.0, 0.0, 0.0), area=(0.0, 12.0, -6.0, 6.0))
    position, heading, remaining = np.zeros(2), 0.0, list(sentences[1:])
    for step, key in enumerate(jax.random.split(jax.random.key(0), 200)):
        state, action, info = navigator.step(key, state, observe(position, heading))
        if int(info.fault):
            print(f"step {step}: the look was left out: {Fault(int(info.fault))!r}")
        if action.is_stop:
            status, missing = Status(int(action.status)).word, navigator.missing(state)
            details = f"; never seen: {', '.join(missing)}" if missing else ""
            print(f"step {step}: {status} at ({position[0]:.1f}, {position[1]:.1f}){details}")
            if not remaining:
                return position
            state = navigator.hear(state, remaining.pop(0))
            continue
        dx, dy = move = np.asarray(action.step)  # at most 1 m, map axes
        position, heading = position + move, math.atan2(dy, dx) if dx or dy else heading
    return position


if __name__ == "__main__":
    main(*(sys.argv[1:] or ("go to the hydrant behind the cone", "go to the bench")))
