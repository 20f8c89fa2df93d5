"""Drive a world that is not ours: a plain NumPy one, with nothing but the Navigator.

Run it: python examples/own_world.py "go to the hydrant behind the cone"
"""

import sys

import jax
import numpy as np

from jaxlangnav import Navigator, Observation, Status, default_sensor, keep_compiled_programs

THINGS = {"cone": (6.0, 1.0), "hydrant": (8.5, 1.6), "tree": (3.0, -4.0)}  # metres
SLOTS, RANGE = 8, 4.0


def look(position: np.ndarray, heading: float, types: tuple[str, ...]) -> Observation:
    """See everything within range, without noise; empty slots are masked."""
    kind = np.full(SLOTS, -1, np.int32)
    polar = np.zeros((2, SLOTS), np.float32)
    for slot, (name, place) in enumerate(THINGS.items()):
        dx, dy = np.subtract(place, position)
        kind[slot] = types.index(name) if np.hypot(dx, dy) < RANGE else -1
        polar[:, slot] = np.hypot(dx, dy), np.arctan2(dy, dx) - heading
    pose = np.array([*position, heading], np.float32)
    return Observation(
        pose=pose, detection_type=kind, detection_range=polar[0], detection_bearing=polar[1],
        is_detection=kind >= 0, sensor=default_sensor(RANGE),
    )  # fmt: skip


def main(text: str) -> np.ndarray:
    """Follow a sentence; return where the robot has stopped."""
    keep_compiled_programs()  # the second run starts in seconds
    navigator = Navigator.pretrained()
    state = navigator.start(text, pose=(0.0, 0.0, 0.0), area=(0.0, 12.0, -6.0, 6.0))
    position, heading = np.zeros(2), 0.0
    for step, key in enumerate(jax.random.split(jax.random.key(0), 100)):
        observation = look(position, heading, navigator.type_names)
        state, action, _ = navigator.step(key, state, observation)
        if action.is_stop:
            ending = Status(int(action.status)).word  # "arrived" or "not_found"
            print(f"step {step}: {ending} at ({position[0]:.1f}, {position[1]:.1f})")
            return position
        move = np.asarray(action.step)  # at most 1 m, map axes
        position, heading = position + move, float(np.arctan2(move[1], move[0]))
        print(f"step {step}: to ({position[0]:.1f}, {position[1]:.1f})")
    return position


if __name__ == "__main__":
    main(" ".join(sys.argv[1:]) or "go to the hydrant behind the cone")
