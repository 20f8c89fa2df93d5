"""Who sits at a real terminal (a pseudo one): reads the question, answers, and leaves cleanly."""

import subprocess
import sys

import pytest

TYPIST = """
import sys
from types import SimpleNamespace as Made
from jaxlangnav.cli.output import Output
from jaxlangnav.cli.speech import Typist
is_talking = sys.argv[1] == "talk"
things = [Made(type_name="hydrant", x=x, y=1.0, probability=0.5) for x in (3.0, 5.0)]
typist = Typist(Output(is_json=False), is_talking=is_talking)
episode = Made(navigator=Made(is_resting=is_talking))
try:
    for step in range(3):
        said = typist.say(step, episode, [] if is_talking else things)
        print("heard", said, flush=True)
        if said is None:
            break
except KeyboardInterrupt:
    sys.exit(130)
"""
# Who runs the tests in the background may have had Ctrl-C ignored, which children inherit.
TERMINAL = """
import os, pty, signal, sys
signal.signal(signal.SIGINT, signal.SIG_DFL)
sys.exit(os.waitstatus_to_exitcode(pty.spawn([sys.executable, "-c", *sys.argv[1:]])))
"""
FOLLOW = TERMINAL.replace('"-c", ', "")


@pytest.mark.parametrize(
    ("way", "keys", "code", "heard"),
    [
        ("ask", b"the left one\n\n", 0, "heard the left one|heard None"),
        ("ask", b"\x04", 0, "heard None"),
        ("ask", b"\x03", 130, ""),
        ("talk", b"stop\n\x04", 0, "heard stop|heard None"),
        ("talk", b"\x03", 130, ""),
    ],
)
def test_one_answers_and_leaves_at_a_terminal(way: str, keys: bytes, code: int, heard: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", TERMINAL, TYPIST, way],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as terminal:
        assert terminal.stdin is not None
        assert terminal.stdout is not None
        shown = b""
        while b"Answer" not in shown and b"Say something" not in shown:
            piece = terminal.stdout.read1(4096)
            assert piece, shown
            shown += piece
        terminal.stdin.write(keys)
        terminal.stdin.flush()
        shown += terminal.stdout.read()
        assert terminal.stderr is not None
        assert terminal.stderr.read() == b""
        assert terminal.wait() == code
    lines = shown.decode().splitlines()
    assert "|".join(line for line in lines if line.startswith("heard")) == heard
    assert "Traceback" not in shown.decode()
    if way == "ask":
        assert "  2. the hydrant at (5.0, 1.0) m, 50 %" in lines


@pytest.mark.slow
def test_one_talks_to_a_whole_episode_and_leaves() -> None:
    """Halted, sent on, sent to the other one, and left alone: the story tells all of it."""
    follow = ["follow", "go to the hydrant", "--world", "2H1C", "--talk"]
    call = [sys.executable, "-c", FOLLOW, "-m", "jaxlangnav", *follow]
    pipe = subprocess.PIPE
    with subprocess.Popen(call, stdin=pipe, stdout=pipe, stderr=pipe) as terminal:
        assert terminal.stdin is not None
        assert terminal.stdout is not None
        assert terminal.stderr is not None
        told = shown = b""
        # An episode that has ended waits, too: whatever is typed finds the robot standing still.
        for typed in (b"stop\n", b"resume\n", b"go to the other hydrant\n", b"\x04"):
            while typed != b"stop\n" and b"stands still" not in shown:
                piece = terminal.stdout.read1(4096)
                assert piece, shown
                shown += piece
            before, _, shown = shown.partition(b"stands still")
            told += before
            terminal.stdin.write(typed)
            terminal.stdin.flush()
        told += shown + terminal.stdout.read()
        errors = terminal.stderr.read()
        assert terminal.wait() == 0, errors
    story = b" ".join(told.split()).decode()
    for part in ("“stop”, a halt", "“resume”, a resume", "other hydrant”, a command. Rules out"):
        assert part in story
    assert story.endswith(" m.")
    assert "Traceback" not in story
    assert errors == b""
