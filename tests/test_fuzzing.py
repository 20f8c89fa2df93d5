"""A short round of fuzzing, the same inputs each time; ``make fuzz`` is the long one."""

import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent.parent / "scripts"))

from fuzz import Count, Target, run_once, throw, write_failures
from fuzz_targets import TARGETS

RUNS = 30  # of each target; a few seconds in all


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_a_short_round_finds_nothing(target: Target) -> None:
    count = throw(target, seed=0, runs=RUNS)
    assert not count.failures, "\n\n".join(f"{text!r}\n{why}" for text, why in count.failures[:3])
    assert count.runs == RUNS
    assert count.accepted
    assert count.refused


def _broken(error: BaseException | None) -> Target:
    def call(_text: bytes, _folder: Path) -> None:
        if error is not None:
            raise error

    return Target(name="broken", seeds=lambda: [b"x"], call=call, refusals=(OSError,))


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (None, "accepted"),
        (OSError("no such thing"), "refused"),
        (OSError("two\nlines"), "failed"),
        (OSError("x" * 10_000), "failed"),
        (OSError(""), "failed"),
        (KeyError("x"), "failed"),
        (SystemExit(2), "failed"),
        (RecursionError(), "failed"),
    ],
)
def test_what_falls_through_is_told_from_a_refusal(error, outcome, tmp_path):
    count, target = Count(), _broken(error)
    run_once(target, b"input", count)
    assert (count.runs, getattr(count, outcome)) == (1, 1)
    write_failures(target, count, tmp_path / "fuzz")
    written = sorted(path.suffix for path in (tmp_path / "fuzz").glob("*"))
    assert written == ([".input", ".txt"] if outcome == "failed" else [])


def test_an_error_of_a_library_is_no_refusal() -> None:
    def call(text: bytes, _folder: Path) -> None:
        int(text)

    count = Count()
    target = Target(name="x", seeds=lambda: [], call=call, refusals=(ValueError,))
    run_once(target, b"x", count)
    assert count.failed == 1


@pytest.mark.parametrize(
    ("limit", "is_busy"), [("MAX_CPU_SECONDS", True), ("MAX_WALL_SECONDS", False)]
)
def test_a_run_that_hangs_is_a_failure(limit, is_busy, monkeypatch):
    monkeypatch.setattr(f"fuzz.{limit}", 0.05)
    count = Count()

    def call(_text: bytes, _folder: Path) -> None:
        try:
            while True:
                time.sleep(0.0 if is_busy else 60.0)
        except Exception:
            return

    run_once(Target(name="x", seeds=lambda: [], call=call, refusals=()), b"", count)
    assert count.failed == 1
    assert "Overtime" in count.failures[0][1]
