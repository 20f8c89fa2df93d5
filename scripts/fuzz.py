"""Mutation fuzzer for all inputs of the package, with a time limit.

    python scripts/fuzz.py --minutes 60
    python scripts/fuzz.py --minutes 5 --seed 7 --target world --target corpus

Each target has valid seed inputs. A run takes one, mutates it in a few places and passes it to the
package, which must accept it or refuse it in one line; anything else is a failure, and its input is
written to a folder with the traceback. The same seed gives the same inputs.
"""

import argparse
import hashlib
import random
import re
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxlangnav.cli.output import is_user_error
from jaxlangnav.inputs.sanitize import is_printable

SECONDS_PER_TURN = 2.0
"""Duration of a target's turn."""
MAX_CPU_SECONDS, MAX_WALL_SECONDS = 30.0, 600.0
"""Limits of CPU time and wall time, seconds; a run that exceeds one is a failure."""
MAX_MESSAGE_LENGTH = 2000
"""Maximum characters of an error message."""
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
_TEXT = re.compile(rb'"[^"\n]*"')
NUMBERS = (
    b"0", b"-0.0", b"-1", b"1e-46", b"1e39", b"-1e39", b"1e308", b"1e400", b"nan", b"inf", b"-inf",
    b"NaN", b"Infinity", b"true", b"null", b"9" * 25, b"9" * 400, b"9" * 5000, b"0x" + b"f" * 4000,
    b"0.1", b"255", b"256", b"65536", b"4294967296", b"1_0", b"1979-05-27", b"[]", b"{}", b'"1"',
)  # fmt: skip
TEXTS = (
    "", " ", "\x00", "\x1b[31mred", "\x1b]0;title\x07", "\x9b2J", "\u202eright", "\u2066x\u2069",
    "a\nb", "a\rb", "\u2028", "[red]x[/red]", "[link=https://example.org]x[/link]", "a|b",
    "<script>alert(1)</script>", "__DATA__", "$\\frac$", "{}", "%s", "the", "behind", "not",
    "robot", "hydrant", "cone's", "*", "a" * 31, "a" * 5000, "/dev/zero", "../../etc/passwd",
    "\ufb01re", "\ud800", "é" * 40, "𝄞", "\uff11", "null", "-", "--help",
    "object(hydrant)", "region(behind,robot)",
)  # fmt: skip
_FRAGMENTS = (
    b"[", b"]", b"{", b"}", b"[[", b"]]", b'"', b"'", b'"""', b"=", b",", b".", b"\n", b"\x00",
    b"\xff", b"\xed\xa0\x80", b"\\", b"\\u0000", b"#", b"a.b.c", b"\xef\xbb\xbf", b"\r\n",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Target:
    """An entry point of the package that reads input."""

    name: str
    seeds: Callable[[], Sequence[bytes]]
    """Returns valid inputs; called once."""
    call: Callable[[bytes, Path], Any]
    """Passes an input to the package; may write into the private folder."""
    refusals: tuple[type[Exception], ...]
    """Exceptions that may be raised, with a one-line message."""


@dataclass
class Count:
    """Outcome counts of the runs of a target."""

    runs: int = 0
    accepted: int = 0
    refused: int = 0
    failed: int = 0
    seconds: float = 0.0
    failures: list[tuple[bytes, str]] = field(default_factory=list)


class Overtime(BaseException):
    """Raised on a time-out; no handler of the package may catch it."""


def mutate(rng: random.Random, seeds: Sequence[bytes]) -> bytes:
    """Mutate a random seed input.

    Args:
        rng: random generator.
        seeds: valid inputs.

    Returns:
        One of them, changed in one to six places.
    """
    text = rng.choice(seeds)
    for _ in range(min(6, 1 + int(rng.expovariate(0.7)))):
        text = rng.choice(_MUTATIONS)(rng, text, seeds)
    return text[: 1 << 20]


def _number(rng: random.Random, text: bytes, _: Sequence[bytes]) -> bytes:
    """Replace a number."""
    return _replace(rng, text, _NUMBER, rng.choice(NUMBERS))


def _string(rng: random.Random, text: bytes, _: Sequence[bytes]) -> bytes:
    """Replace a quoted string, by a raw or an escaped one."""
    other = rng.choice(TEXTS)
    raw = other.encode("utf-8", "surrogatepass")
    escaped = "".join(
        c if is_printable(c) and c not in '"\\' and ord(c) < 65536 else f"\\u{ord(c):04x}"
        for c in other
        if ord(c) < 65536
    ).encode("utf-8", "surrogatepass")
    return _replace(rng, text, _TEXT, b'"' + rng.choice((raw, escaped)) + b'"')


def _swap(rng: random.Random, text: bytes, seeds: Sequence[bytes]) -> bytes:
    """Replace a quoted string by one of another input."""
    matches = _TEXT.findall(rng.choice(seeds))
    return _replace(rng, text, _TEXT, rng.choice(matches)) if matches else text


def _replace(rng: random.Random, text: bytes, pattern: re.Pattern[bytes], new: bytes) -> bytes:
    """Replace a random match of a pattern."""
    matches = list(pattern.finditer(text))
    if not matches:
        return text
    start, end = rng.choice(matches).span()
    return text[:start] + new + text[end:]


def _line(rng: random.Random, text: bytes, seeds: Sequence[bytes]) -> bytes:
    """Delete a line, duplicate it, move it, or insert one of another input."""
    lines = text.split(b"\n")
    line = lines.pop(rng.randrange(len(lines)))
    other = rng.choice(rng.choice(seeds).split(b"\n"))
    for new in rng.choice(((), (line, line), (line,), (other,), (line,) * 100)):
        lines.insert(rng.randrange(len(lines) + 1), new)
    return b"\n".join(lines)


def _insert(rng: random.Random, text: bytes, _: Sequence[bytes]) -> bytes:
    """Insert a fragment at a random position, repeated once or many times."""
    position = rng.randrange(len(text) + 1)
    repeats = rng.choice((1, 1, 1, 3, 50, 5000))
    return text[:position] + rng.choice(_FRAGMENTS) * repeats + text[position:]


def _span(rng: random.Random, text: bytes, _: Sequence[bytes]) -> bytes:
    """Delete a span, or repeat it."""
    start, end = sorted(rng.randrange(len(text) + 1) for _ in range(2))
    end = min(end, start + rng.choice((1, 8, 64, len(text))))
    return text[:start] + text[start:end] * rng.choice((0, 0, 2, 20)) + text[end:]


def _flip(rng: random.Random, text: bytes, _: Sequence[bytes]) -> bytes:
    """Flip a bit."""
    if not text:
        return text
    position = rng.randrange(len(text))
    return text[:position] + bytes([text[position] ^ 1 << rng.randrange(8)]) + text[position + 1 :]


_MUTATIONS = (_number, _number, _string, _string, _swap, _line, _insert, _span, _flip)


def run_once(target: Target, text: bytes, count: Count) -> None:
    """Run a target on one input and count the outcome.

    Args:
        target: the entry point.
        text: the input.
        count: where the outcome is counted.
    """
    begin = time.perf_counter()
    count.runs += 1
    try:
        with tempfile.TemporaryDirectory() as folder, _limited():
            target.call(text, Path(folder))
        count.accepted += 1
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        fault = _fault(target, error)
        count.refused += fault is None
        count.failed += fault is not None
        if fault is not None:
            count.failures.append((text, fault))
    count.seconds += time.perf_counter() - begin


def _fault(target: Target, error: BaseException) -> str | None:
    """Describe why an exception is not a proper refusal; None if it is one."""
    if not isinstance(error, target.refusals):
        return "".join(traceback.format_exception(error))
    if isinstance(error, ValueError) and not is_user_error(error):
        return "raised in the depth of a library:\n" + "".join(traceback.format_exception(error))
    line = str(error)
    if "\n" in line or not line or len(line) > MAX_MESSAGE_LENGTH:
        return f"the refusal is no line:\n{line[:MAX_MESSAGE_LENGTH]!r}"
    return None


@contextmanager
def _limited() -> Iterator[None]:
    """Raise Overtime inside the block if it exceeds the CPU or the wall time."""
    timers = (
        (signal.ITIMER_PROF, signal.SIGPROF, MAX_CPU_SECONDS),
        (signal.ITIMER_REAL, signal.SIGALRM, MAX_WALL_SECONDS),
    )

    def ring(number: int, _frame: Any) -> None:
        limits = {sign: seconds for _, sign, seconds in timers}
        raise Overtime(f"more than {limits[signal.Signals(number)]:g} s")

    before = [signal.signal(sign, ring) for _, sign, _ in timers]
    for timer, _, seconds in timers:
        signal.setitimer(timer, seconds)
    try:
        yield
    finally:
        for (timer, sign, _), handler in zip(timers, before, strict=True):
            signal.setitimer(timer, 0.0)
            signal.signal(sign, handler)


def throw(
    target: Target,
    *,
    seed: int,
    runs: int | None = None,
    seconds: float = 0.0,
    with_honest: bool = True,
) -> Count:
    """Run one target on its seed inputs, then on mutated ones.

    Args:
        target: the entry point.
        seed: of the damage.
        runs: how many; None for as many as the time allows.
        seconds: how long, if ``runs`` is None.
        with_honest: whether the honest ones are among them.

    Returns:
        What came of them.
    """
    count, seeds = Count(), list(target.seeds())
    rng = random.Random(f"{target.name} {seed}")
    end = time.monotonic() + seconds
    for text in seeds[:runs] if with_honest else ():
        run_once(target, text, count)
    while count.runs < runs if runs is not None else time.monotonic() < end:
        run_once(target, mutate(rng, seeds), count)
    return count


def write_failures(target: Target, count: Count, folder: Path) -> None:
    """Write the failed inputs, each with its traceback.

    Args:
        target: the entry point.
        count: its failures.
        folder: made if it is not there.
    """
    for text, fault in count.failures:
        folder.mkdir(parents=True, exist_ok=True)
        name = f"{target.name}-{hashlib.sha256(text).hexdigest()[:12]}"
        (folder / f"{name}.input").write_bytes(text)
        (folder / f"{name}.txt").write_text(fault, "utf-8", "backslashreplace")
    count.failures.clear()


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz all targets in turn; returns 0 without failures, else 1."""
    from fuzz_targets import TARGETS

    names = [target.name for target in TARGETS]
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0, help="how long (10)")
    parser.add_argument("--seed", type=int, default=0, help="of the damage (0)")
    parser.add_argument("--target", action="append", choices=names, help="only these; repeatable")
    parser.add_argument("--out", type=Path, default=Path("fuzz"), help="folder for what failed")
    options = parser.parse_args(arguments)
    chosen = [target for target in TARGETS if target.name in (options.target or names)]
    counts = {target.name: Count() for target in chosen}
    end, turn = time.monotonic() + 60.0 * options.minutes, 0
    while time.monotonic() < end:
        for target in chosen:
            seed = options.seed * 1_000_000 + turn
            result = throw(target, seed=seed, seconds=SECONDS_PER_TURN, with_honest=turn == 0)
            write_failures(target, result, options.out)
            for name in ("runs", "accepted", "refused", "failed", "seconds"):
                total = counts[target.name]
                setattr(total, name, getattr(total, name) + getattr(result, name))
        turn += 1
    print(f"{'target':<12} {'runs':>9} {'accepted':>9} {'refused':>9} {'failed':>7} {'seconds':>8}")
    for name, count in counts.items():
        print(
            f"{name:<12} {count.runs:>9} {count.accepted:>9} {count.refused:>9} {count.failed:>7} "
            f"{count.seconds:>8.0f}"
        )
    failed = sum(count.failed for count in counts.values())
    print(f"seed {options.seed}; {failed} failed" + (f", see {options.out}" if failed else ""))
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
