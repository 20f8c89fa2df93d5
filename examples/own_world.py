"""Drive a world that is not ours: a plain NumPy one, with nothing but the Navigator.

Run it: python examples/own_world.py "go to the hydrant behind the cone" "go to the bench"
The second command is heard where the first one has ended. There is no bench: the robot says so.
"""

import math
import sys

import jax
import numpy as np

from jaxlangnav import Fault, Navigator, Observation, Status, default_sensor, keep_compiled_programs

THINGS = {"cone": (6.0, 1.0), "hydrant": (8.5, 1.6), "tree": (3.0, -4.0)}  # metres
SENSOR = default_sensor(4.0, field_of_view=math.radians(120), noise=0.05)


def look(position: np.ndarray, heading: float) -> Observation:
    """See what is within range and in the field of view."""
    seen = []
    for name, place in THINGS.items():
        dx, dy = np.subtract(place, position)
        bearing = math.remainder(math.atan2(dy, dx) - heading, math.tau)
        if math.hypot(dx, dy) < 4.0 and abs(bearing) < math.radians(60):
            seen.append((name, math.hypot(dx, dy), bearing))
    return Observation.of((*position, heading), seen, SENSOR)


def main(*sentences: str) -> np.ndarray:
    """Follow one sentence after the other; return where the robot has ended."""
    keep_compiled_programs()  # the second run starts in seconds
    navigator = Navigator.pretrained(odometry_noise=0.02)
    print(f"compiled in {navigator.warm_up():.0f} s")
    state = navigator.start(sentences[0], pose=(0.0, 0.0, 0.0), area=(0.0, 12.0, -6.0, 6.0))
    position, heading, waiting = np.zeros(2), 0.0, list(sentences[1:])
    for step, key in enumerate(jax.random.split(jax.random.key(0), 200)):
        state, action, info = navigator.step(key, state, look(position, heading))
        if int(info.fault):
            print(f"step {step}: the look was left out: {Fault(int(info.fault))!r}")
        if action.is_stop:
            ending, missing = Status(int(action.status)).word, navigator.missing(state)
            why = f"; never seen: {', '.join(missing)}" if missing else ""
            print(f"step {step}: {ending} at ({position[0]:.1f}, {position[1]:.1f}){why}")
            if not waiting:
                return position
            state = navigator.hear(state, waiting.pop(0))
            continue
        dx, dy = move = np.asarray(action.step)  # at most 1 m, map axes
        position, heading = position + move, math.atan2(dy, dx) if dx or dy else heading
    return position


if __name__ == "__main__":
    main(*(sys.argv[1:] or ("go to the hydrant behind the cone", "go to the bench")))
