"""Run every benchmark in its own process, and merge the results.

    python benchmarks [--quick] [--json]

``jaxlangnav bench`` comes first, then every script of this folder that measures. A script that
fails, for want of a library say, is named on standard error and the rest goes on; the exit code
is then 1.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from record import render
from rich.console import Console

FOLDER = Path(__file__).parent
BENCH = [sys.executable, "-m", "jaxlangnav", "bench"]


def commands() -> list[list[str]]:
    """List the commands: the package's bench, and the scripts of this folder."""
    scripts = [
        path
        for path in sorted(FOLDER.glob("*.py"))
        if path.name != "__main__.py" and 'if __name__ == "__main__"' in path.read_text("utf-8")
    ]
    return [BENCH, *([sys.executable, str(path)] for path in scripts)]


def main() -> int:
    """Run all benchmarks, and print one table or one JSON document.

    Returns:
        The exit code.
    """
    parser = argparse.ArgumentParser(description="Run every comparison and join the records.")
    parser.add_argument("--quick", action="store_true", help="smaller sizes, fewer repetitions")
    parser.add_argument("--json", action="store_true", help="one JSON document: machine, entries")
    options = parser.parse_args()
    merged: dict[str, Any] = {"machine": {}, "entries": []}
    failed = []
    for command in commands():
        name = "jaxlangnav bench" if command is BENCH else Path(command[-1]).name
        print(f"running {name}", file=sys.stderr, flush=True)
        quick = ["--quick"] if options.quick else []
        result = subprocess.run([*command, "--json", *quick], stdout=subprocess.PIPE, check=False)
        if result.returncode:
            failed.append(name)
            continue
        document = json.loads(result.stdout)
        merged["machine"] = document["machine"] | merged["machine"]
        merged["entries"] += document["entries"]
    if options.json:
        print(json.dumps(merged, indent=2, ensure_ascii=False))
    elif merged["entries"]:
        Console(width=140).print(render(merged))
    for name in failed:
        print(f"{name} failed", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
