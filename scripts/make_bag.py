"""Record a bag of the Husky driving to a hydrant behind a cone, which replays deterministically.

    python scripts/make_bag.py OUT

OUT is a folder that is not there yet; tests/data/husky_bag was made by this. Needs rosbags (of
``jaxlangnav[ros2]``), ``jaxlangnav[robot]`` and EGL, not ROS.
"""

import sys
from pathlib import Path

import jax

from jaxlangnav import Navigator, keep_compiled_programs
from jaxlangnav.robots.ros2.bags import write_bag
from jaxlangnav.robots.ros2.simulation import RobotOptions, draw_start, open_robot

TEXT = "go to the hydrant behind the cone"


def main() -> None:
    """Run the simulation, and write the bag."""
    path = Path(sys.argv[1])
    options = RobotOptions(robot="husky", seed=8)  # a short drive: the bag ships
    keep_compiled_programs()
    with open_robot(options, draw_start(options)) as robot:
        key = jax.random.key(options.seed)
        ended = write_bag(path, robot, TEXT, navigator=Navigator.pretrained(), key=key)
        size = sum(file.stat().st_size for file in path.iterdir())
        summary = f"{robot.travelled:.1f} m in {robot.seconds:.0f} s, {size / 1000:.0f} kB"
    print(f"{path}: {ended.ending.value}, {len(ended.steps)} decisions, {summary}")


if __name__ == "__main__":
    main()
