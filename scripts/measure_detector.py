"""Measure what the robots' camera and tags are good for: rate, error, false tags.

    python scripts/measure_detector.py [LOOKS]

Prints a Markdown table; docs/robot.md shows it, ``robots/perception/figures.py`` holds what the
belief is told of it. Needs ``jaxlangnav[robot]`` and EGL.
"""

import argparse
import sys

import numpy as np

from jaxlangnav.inputs.sanitize import markdown_table
from jaxlangnav.robots.perception import figures


def main() -> int:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description="Measure the robots' camera and tags.")
    parser.add_argument("looks", nargs="?", type=int, default=6, help="of each kind; 6")
    looks = parser.parse_args().looks
    if looks < 1:
        parser.error(f"looks is {looks}, but must be at least 1")
    try:
        found = figures.measure_detector(looks=looks)
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    print(markdown_table(*figures.tabulate(found)))
    near = [one for one in found if one.picture == "as told" and one.range <= 4.0]
    rate = np.mean([one.rate for one in near])
    error = np.sqrt(np.nanmean([one.error**2 for one in near]))
    false = sum(one.false for one in found)
    print(f"As told, to 4 m: found {100 * rate:.1f} %, error {100 * error:.1f} cm each axis;")
    print(f"{false} false tags in {sum(one.looks for one in found)} looks.")
    return 0


if __name__ == "__main__":
    sys.exit(main())
