"""What is said while an episode runs, by step or typed, and what is kept of it."""

import dataclasses
import json
import re
import subprocess
import sys

import jax.numpy as jnp
import pytest
from recording_fixture import make_recording, make_scene
from test_navigator_step import AREA, HYDRANT

from jaxlangnav.cli import main as cli, speech
from jaxlangnav.cli.output import Output
from jaxlangnav.episode.recording import Remark
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import Status
from jaxlangnav.navigator.candidates import Candidate
from jaxlangnav.pytree import replace
from jaxlangnav.task import talk
from jaxlangnav.viz import html
from jaxlangnav.viz.narrative import narrate

NULL = "go to the hydrant"
OTHER = Candidate(slot=1, type_name="hydrant", x=9.0, y=1.0, probability=0.5)


@dataclasses.dataclass
class Episode:
    """As much of ``episode.EpisodeState`` as an ear reads."""

    navigator: object


def ear_of(robot, **fields) -> tuple[talk.Dialogue, Episode]:
    first = talk.padded(understand(NULL, load_shipped()))
    ear = talk.Dialogue(grounder=robot.grounder, first=first, scene=make_scene(text=NULL), **fields)
    return ear, ear.begin(Episode(robot.start(NULL, area=AREA)))


def at_a_hydrant(episode: Episode) -> Episode:
    state = episode.navigator
    kinds = state.belief.particles.object_type
    particles = replace(state.belief.particles, object_type=kinds.at[0].set(HYDRANT))
    state = replace(
        state,
        belief=replace(state.belief, particles=particles),
        talk=replace(state.talk, approached=jnp.int32(0)),
    )
    return Episode(state)


def test_what_was_said_is_kept_with_what_it_changed(robot) -> None:
    ear, episode = ear_of(robot, script={3: ["no, the other one", "stop"], 5: ["go on"]})
    assert ear.hear(2, episode) is episode
    after = ear.hear(3, at_a_hydrant(episode))
    assert [(one.step, one.kind) for one in ear.utterances] == [(3, "correction"), (3, "halt")]
    assert [(one.slot, one.type_name) for one in ear.utterances[0].ruled_out] == [(0, "hydrant")]
    assert int(after.navigator.talk.ruled_out) == 1
    assert bool(after.navigator.is_halted)
    assert ear.expects(after)  # "go on" is still to come
    assert not bool(ear.hear(5, after).navigator.is_halted)
    assert not ear.expects(after)


def test_what_the_state_refuses_changes_nothing(robot) -> None:
    ear, episode = ear_of(robot, script={0: ["no, the other one"]})
    assert ear.hear(0, episode) is episode
    assert ear.utterances[0].kind == ""
    assert "nothing is being approached yet" in ear.utterances[0].refusal


def test_a_statement_sets_the_scene_anew(robot) -> None:
    ear, episode = ear_of(robot, script={0: ["the hydrant is behind the car"]})
    ear.hear(0, episode)
    scene = ear.utterances[0].scene
    assert scene is not None
    assert (scene.readings.relation >= 0).any()
    assert ear.scene.readings is not scene.readings


def test_a_question_is_answered_by_who_sits_there(robot, capsys) -> None:
    typist = speech.TerminalUser(Output(is_json=True), is_talking=False, lines=["the first\n"])
    ear, episode = ear_of(robot, speakers={"you": typist.say}, is_present=typist.is_present)
    episode = at_a_hydrant(episode)
    state = episode.navigator
    share = state.talk.candidate.at[0].set(0.5).at[1].set(0.5)
    kinds = state.belief.particles.object_type.at[1].set(HYDRANT)
    particles = replace(state.belief.particles, object_type=kinds)
    state = replace(
        state,
        status=jnp.int32(Status.WHICH_ONE),
        belief=replace(state.belief, particles=particles),
        talk=replace(state.talk, candidate=share),
    )
    assert ear.expects(Episode(state))
    assert len(ear.candidates) == 2
    after = ear.hear(0, Episode(state))
    assert [one.kind for one in ear.utterances] == ["answer"]
    assert int(after.navigator.talk.ruled_out) != 0
    assert (
        "Which one? The nearest first:\n  1. the hydrant right here, 50 %"
        in capsys.readouterr().err
    )


def test_who_talks_is_heard_at_any_step_and_may_leave(robot) -> None:
    lines = ["stop\n", "go on\n"]
    typist = speech.TerminalUser(Output(is_json=True), is_talking=True, lines=lines)
    ear, episode = ear_of(robot, speakers={"you": typist.say}, is_present=typist.is_present)
    after = ear.hear(0, episode)
    assert [one.kind for one in ear.utterances][:1] == ["halt"]
    assert not bool(ear.hear(1, after).navigator.is_halted)
    assert not ear.expects(after)


def test_story_page_and_document_tell_what_was_said() -> None:
    said = (
        Remark(step=2, text="the other one", refusal="nothing is being approached yet"),
        Remark(step=5, text="no, the other one", kind="correction", ruled_out=(OTHER,)),
    )
    recording = dataclasses.replace(make_recording(), utterances=said, candidates=(OTHER,))
    story = "\n".join(narrate(recording))
    assert "Hears “the other one”, and keeps to its task: nothing is being approached" in story
    assert "Hears “no, the other one”, a correction. Rules out the hydrant" in story
    page = html.page_data(recording)
    assert "Rules out the hydrant" in " ".join(page["story"][5])
    document = speech.describe_talk(recording)
    assert [one["kind"] for one in document["utterances"]] == [None, "correction"]
    assert document["utterances"][1]["ruled_out"][0]["slot"] == 1
    assert document["candidates"][0]["probability"] == 0.5


def test_what_may_mean_another_goal_is_not_judged(robot) -> None:
    ear, episode = ear_of(robot, script={0: ["go to the cone"]})
    ear.hear(0, episode)
    recording = talk.add_talk(make_recording(), ear)
    assert not recording.scene.is_scored
    assert not bool(recording.result.is_success)
    ear, episode = ear_of(robot, script={0: ["avoid the cone"]})
    ear.hear(0, episode)
    assert talk.add_talk(make_recording(), ear).scene.is_scored


@pytest.mark.slow
def test_an_episode_hears_by_step(capsys) -> None:
    words = ["--world", "2H1C", "--hear", "2: the other one", "--hear", "9: stop"]
    assert cli.main(["follow", NULL, *words, "--hear", "12: never mind", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    kinds = [one["kind"] for one in document["utterances"]]
    assert kinds == [None, "halt", "cancel"]
    assert document["ending"] == "idle"
    assert document["success"] is None
    assert document["steps"] == 13


@pytest.mark.slow
def test_a_simulated_person_corrects_and_answers(capsys) -> None:
    """Between them these seeds hold a wrong hydrant that is gone up to, and a question."""
    kinds = []
    for seed in ("0", "1", "2"):
        words = ["--world", "2H1C", "--seed", seed, "--person", "attentive", "--json"]
        for more in ([], ["--ask"]):
            assert cli.main(["follow", NULL, *words, *more]) == 0
            document = json.loads(capsys.readouterr().out)
            kinds += [one["kind"] for one in document["utterances"]]
            assert all(one["speaker"] == "attentive" for one in document["utterances"])
            assert document["success"] is not None
    assert {"correction", "answer"} <= set(kinds)


# ------------ who sits at a real terminal (a pseudo one)

TYPIST = """
import gc, sys
from types import SimpleNamespace as Made
import numpy as np
from jaxlangnav.cli.output import Output
from jaxlangnav.cli.speech import TerminalUser
from jaxlangnav.navigator import candidates
candidates.believed_pose = lambda state: np.zeros(3)
gc.disable()  # JAX's callback of it may swallow the one Ctrl-C
is_talking = sys.argv[1] == "talk"
things = [Made(type_name="hydrant", x=x, y=1.0, probability=0.5) for x in (3.0, 5.0)]
typist = TerminalUser(Output(is_json=False), is_talking=is_talking)
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
sys.exit(os.waitstatus_to_exitcode(pty.spawn([sys.executable, *sys.argv[1:]])))
"""


def at_a_terminal(words: list[str], *typed: tuple[bytes, bytes]) -> tuple[int, str]:
    """Type keys, each once what is awaited is shown: the exit code, and all that was shown."""
    call, pipe = [sys.executable, "-c", TERMINAL, *words], subprocess.PIPE
    with subprocess.Popen(call, stdin=pipe, stdout=pipe, stderr=pipe) as terminal:
        assert terminal.stdin is not None
        assert terminal.stdout is not None
        assert terminal.stderr is not None
        told = shown = b""
        for awaited, keys in typed:
            while not (found := re.search(awaited, shown)):
                piece = terminal.stdout.read1(4096)
                assert piece, shown
                shown += piece
            told, shown = told + shown[: found.end()], shown[found.end() :]
            terminal.stdin.write(keys)
            terminal.stdin.flush()
        told += shown + terminal.stdout.read()
        assert terminal.stderr.read() == b""
        assert b"Traceback" not in told
        return terminal.wait(), told.decode()


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
    ended, shown = at_a_terminal(["-c", TYPIST, way], (b"Answer|Say something", keys))
    assert ended == code
    lines = shown.splitlines()
    assert "|".join(line for line in lines if line.startswith("heard")) == heard
    if way == "ask":
        assert "  2. the hydrant 5.1 m ahead, 50 %" in lines


@pytest.mark.slow
def test_one_talks_to_a_whole_episode_and_leaves() -> None:
    """Halted, sent on, sent to the other one, and left alone: the story tells all of it."""
    words = ["-m", "jaxlangnav", "follow", NULL, "--world", "2H1C", "--talk"]
    # An episode that has ended waits, too: whatever is typed finds the robot standing still.
    still = b"stands still"
    typed = (b"", b"stop\n"), (still, b"resume\n"), (still, b"go to the other hydrant\n")
    code, told = at_a_terminal(words, *typed, (still, b"\x04"))
    assert code == 0, told
    story = " ".join(told.split())
    for part in ("“stop”, a halt", "“resume”, a resume", "other hydrant”, a command. Rules out"):
        assert part in story
    assert story.endswith(" m.")
