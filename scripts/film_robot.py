"""Film one run of a robot in physics: from outside, through its camera, and what it believes.

    python scripts/film_robot.py OUT.gif [husky|wheelchair] [SEED]

The environment is that of Table 3's "behind" with one hydrant and one cone. Needs
``jaxlangnav[robot]`` and EGL.
"""

import sys
from pathlib import Path

import jax

from jaxlangnav import Navigator, keep_compiled_programs
from jaxlangnav.robots.film import film
from jaxlangnav.robots.table3 import COMMANDS, ROWS, make_robot


def main() -> None:
    """Drive, and write the film."""
    path = Path(sys.argv[1])
    machine = sys.argv[2] if len(sys.argv) > 2 else "husky"
    seed = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    keep_compiled_programs()
    row = next(one for one in ROWS if one.robot == machine and one.relation == "behind")
    robot = make_robot(row, 0, seed)
    key = jax.random.key(seed)
    text = COMMANDS[row.relation]
    written, why = film(path, robot, text, navigator=Navigator.pretrained(), key=key)
    print(f"{written}: {why}, {robot.travelled:.1f} m in {robot.seconds:.0f} s")


if __name__ == "__main__":
    main()
