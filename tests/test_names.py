"""A name means one thing in the whole package, but for a few that doors of several floors share."""

import importlib.util
from pathlib import Path

SCRIPT = Path(__file__).parent.parent / "scripts" / "names.py"
SPEC = importlib.util.spec_from_file_location("names", SCRIPT)
assert SPEC is not None
assert SPEC.loader is not None
names = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(names)

MOST_SHARED = 11
"""Names that several modules may define: those of doors that stand on several floors (``step``)."""


def test_few_names_mean_two_things() -> None:
    found = names.twice()
    assert len(found) <= MOST_SHARED, f"find one of its own for each new one: {sorted(found)}"


def test_what_counts_as_a_name() -> None:
    source = "A = 1\nB, _b = 2, 2\nC: int = 3\ndef d(): ...\nclass E: ...\nfrom x import f\n"
    assert names.defined(source) == {"A", "B", "C", "d", "E"}
