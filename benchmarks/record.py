"""What every script here prints: the record of ``jaxlangnav bench --json``, or a table."""

import argparse
import json
from collections.abc import Callable

from rich.console import Console

from jaxlangnav.speed.measuring import Measurement, describe_machine, render


def main(entries: Callable[..., list[Measurement]], about: str | None, core: int | None) -> None:
    """Run one comparison as a script.

    Args:
        entries: measures; takes ``is_quick``.
        about: the module's docstring.
        core: on which everything is pinned; None where that cannot be.
    """
    parser = argparse.ArgumentParser(description=(about or "").split("\n")[0])
    parser.add_argument("--quick", action="store_true", help="smaller sizes, fewer repetitions")
    parser.add_argument("--json", action="store_true", help="one JSON document: machine, entries")
    options = parser.parse_args()
    machine = describe_machine() | {"core": core}
    document = {"machine": machine, "entries": entries(is_quick=options.quick)}
    if options.json:
        print(json.dumps(document, indent=2, ensure_ascii=False))
    else:
        Console(width=140).print(render(document))
