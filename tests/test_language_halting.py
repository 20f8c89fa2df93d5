"""Words to halt, resume and cancel: whole utterances, however polite, and nothing else."""

import tomllib
from importlib import resources
from pathlib import Path

import pytest

from jaxlangnav.language.halting import Act, act_of, begins_with_halt

TABLE = tomllib.loads(
    resources.files("jaxlangnav.language").joinpath("data/halting.toml").read_text("utf-8")
)
SPOKEN = Path(__file__).parent / "spoken.txt"


def test_there_are_many_ways_to_say_halt() -> None:
    assert len(TABLE["halt"]) >= 30
    for act in Act:
        assert len(TABLE[act]) == len(set(TABLE[act]))


def test_no_wording_has_two_meanings() -> None:
    wordings = [wording for act in Act for wording in TABLE[act]]
    assert len(wordings) == len(set(wordings))


@pytest.mark.parametrize("act", list(Act))
@pytest.mark.parametrize("form", ["{}", "{}!", "Please {}.", "robot, {} now", "{} {}!!", "OK {}"])
def test_each_wording_however_said(act: Act, form: str) -> None:
    for wording in TABLE[act]:
        text = form.replace("{}", wording)
        assert act_of(text) is act, text
        assert act_of(text.upper()) is act, text


@pytest.mark.parametrize(
    ("text", "act"),
    [
        ("STOP!!!", Act.HALT),
        ("stop stop stop", Act.HALT),
        ("Stop. Stop right there!", Act.HALT),
        ("no, stop!", Act.HALT),
        ("hey robot, could you please stop now?", Act.HALT),
        ("Don't move!", Act.HALT),
        ("don’t move", Act.HALT),
        ("\uff33\uff34\uff2f\uff30", Act.HALT),
        ("e-stop", Act.HALT),
        ("stop! never mind, go on", Act.HALT),
        ("ok, go on please", Act.RESUME),
        ("you can go on now", Act.RESUME),
        ("never mind, thanks", Act.CANCEL),
        ("forget it. stop.", Act.HALT),
    ],
)
def test_as_people_say_it(text: str, act: Act) -> None:
    assert act_of(text) is act


@pytest.mark.parametrize(
    "text",
    [
        "",
        "please",
        "!!!",
        "stop behind the cone",
        "stop at the hydrant",
        "wait behind the barrel",
        "go on to the hydrant",
        "continue to the cone",
        "proceed to the bench",
        "hold the door",
        "forget the cone, go to the car",
        "stay away from the cone",
        "the robot stopped",
        "park to the right of the cone",
        "stop " * 200,
        "go",
        "no",
        "the other one",
    ],
)
def test_anything_else_is_left_to_the_parser(text: str) -> None:
    assert act_of(text) is None


def test_no_command_with_an_object_is_taken_for_a_word_to_halt() -> None:
    """Of the thousand labelled sentences, only those without any object."""
    lines = [
        line.split(" => ") for line in SPOKEN.read_text("utf-8").splitlines() if " => " in line
    ]
    assert len(lines) > 500
    taken = {text for text, label in lines if act_of(text) is not None and label != "REFUSED"}
    assert taken == set()


@pytest.mark.parametrize(
    ("text", "begins"),
    [
        ("Stop! The car is on fire", True),
        ("halt, there is a child", True),
        ("stop behind the cone", False),
        ("go to the cone and stop", False),
        ("", False),
    ],
)
def test_a_sentence_of_its_own_at_the_beginning(text: str, begins: bool) -> None:
    assert begins_with_halt(text) is begins


@pytest.mark.parametrize("other", [None, 5, b"stop", ["stop"]])
def test_what_is_no_text_is_left_to_the_parser_too(other: object) -> None:
    assert act_of(other) is None
    assert begins_with_halt(other) is False
