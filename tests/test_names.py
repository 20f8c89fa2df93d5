"""A name means one thing: what the outer floors define for others, no second module defines."""

import importlib.util
from pathlib import Path

SCRIPT = Path(__file__).parent.parent / "scripts" / "names.py"
SPEC = importlib.util.spec_from_file_location("names", SCRIPT)
assert SPEC is not None
assert SPEC.loader is not None
names = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(names)

FLOORS = ("cli", "experiments", "speed", "studies", "viz")
KNOWN = {
    "BLOCK", "Entry", "LANES", "MAX_STEPS", "Parse", "Part", "Place", "Table", "World", "change",
    "counted", "describe", "did_you_mean", "main", "pack", "render", "save", "start", "step",
}  # fmt: skip
"""Names that still mean two things; take away what has become one."""


def test_no_new_name_means_two_things() -> None:
    found = {
        name
        for name, modules in names.twice().items()
        if any(one.split("/")[0] in FLOORS for one in modules)
    }
    assert found <= KNOWN


def test_what_counts_as_a_name() -> None:
    source = "A = 1\n_B = 2\nC: int = 3\ndef d(): ...\nclass E: ...\nfrom x import f\n"
    assert names.defined(source) == {"A", "C", "d", "E"}
