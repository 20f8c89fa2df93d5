"""Record a video of one simulated run: external view, robot camera and belief.

    python scripts/film_robot.py OUT.gif [husky|wheelchair] [--trial N]

OUT.gif or OUT.mp4 is a film; OUT.html a page with a slider over the steps: both views, map, numbers
and story. The environment is that of Table 3's "behind" with one hydrant and one cone. Needs
``jaxlangnav[robot,viz]`` and EGL.
"""

import argparse
import sys
from pathlib import Path

import jax

from jaxlangnav import keep_compiled_programs
from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.robots.libraries import check_libraries
from jaxlangnav.robots.physics.robot import ROBOT_MODELS
from jaxlangnav.robots.recorded import record_drive
from jaxlangnav.robots.table3 import TABLE3, make_robot, navigator_of
from jaxlangnav.viz.film import check_format, write_film
from jaxlangnav.viz.html import write_html

_PAGE = ".html"


def main() -> int:
    """Run the simulation, and write the video or the page."""
    parser = argparse.ArgumentParser(description="Film one run of a robot in physics.")
    parser.add_argument("out", type=Path, help="file ending in .gif, .mp4 or .html")
    parser.add_argument("robot", nargs="?", choices=sorted(ROBOT_MODELS), default="husky")
    parser.add_argument("--trial", type=int, default=0, help="of which noise; 0 or more")
    args = parser.parse_args()
    if args.trial < 0:
        parser.error(f"--trial is {args.trial}, but must be at least 0")
    try:
        if args.out.suffix != _PAGE:
            check_format(args.out)
        check_libraries()
        print(_run(args.out, args.robot, args.trial))
    except (ValueError, OSError) as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def _run(out: Path, name: str, trial: int) -> str:
    """Run one episode; returns a one-line summary."""
    keep_compiled_programs()
    row = next(row for row in TABLE3 if row.robot == name and row.relation == "behind")
    robot, text, key = make_robot(row, 0, trial), SENTENCES[row.relation], jax.random.key(trial)
    navigator = navigator_of(name)
    ended, recording = record_drive(robot, text, navigator=navigator, key=key)
    path = (write_html if out.suffix == _PAGE else write_film)(recording, out)
    robot.close()
    return f"{path}: {ended.why}, {robot.travelled:.1f} m in {robot.seconds:.0f} s"


if __name__ == "__main__":
    sys.exit(main())
