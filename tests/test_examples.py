"""The examples run, and do what they say."""

import runpy
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parent.parent / "examples"


@pytest.mark.slow
def test_own_world_ends_at_the_hydrant(capsys: pytest.CaptureFixture[str]) -> None:
    example = runpy.run_path(str(EXAMPLES / "own_world.py"))
    end = example["main"]("go to the hydrant behind the cone")
    assert np.linalg.norm(end - example["THINGS"]["hydrant"]) <= 1.5
    assert "arrived at" in capsys.readouterr().out
    # Other sentences, the same compiled program and the same world.
    end = example["main"]("go to the tree", "go to the bench")
    assert np.linalg.norm(end - example["THINGS"]["tree"]) > 1.5
    told = capsys.readouterr().out
    assert "arrived at" in told
    assert "never seen: bench" in told


def test_own_world_is_short() -> None:
    """The promise is some thirty lines of program."""
    code = (EXAMPLES / "own_world.py").read_text("utf-8").split("def main")[1].splitlines()
    assert len([line for line in code if line.strip()]) <= 30
