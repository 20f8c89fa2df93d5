"""Words to halt, resume and cancel: whole utterances, however polite, and nothing else."""

import tomllib
from importlib import resources
from pathlib import Path

import pytest

from jaxlangnav.language.halting import Act, act_of, opening_of

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
        ("stpo", Act.HALT),
        ("Sotp!", Act.HALT),
        ("stooop", Act.HALT),
        ("STOOOOOP!!!", Act.HALT),
        ("robot, stpo now please", Act.HALT),
        ("hlat", Act.HALT),
        ("freeeze", Act.HALT),
        ("hold on a second", Act.HALT),
        ("hang on a minute, please", Act.HALT),
        ("back off!", Act.HALT),
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
        "stpo behind the cone",
        "a second",
        "soap",
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
    ("text", "act", "rest"),
    [
        ("Stop! The car is on fire", Act.HALT, "The car is on fire"),
        ("halt, there is a child", Act.HALT, "there is a child"),
        ("Stpo! There is a child", Act.HALT, "There is a child"),
        ("stop and come back", Act.HALT, "come back"),
        ("please stop now, and then go to the bench", Act.HALT, "go to the bench"),
        ("Never mind, come back.", Act.CANCEL, "come back."),
        ("don't bother, go to the bench", Act.CANCEL, "go to the bench"),
        ("cancel that and then come back", Act.CANCEL, "come back"),
        ("nevermind come back", Act.CANCEL, "come back"),
        ("forget it. Stop. Come back", Act.HALT, "Come back"),
    ],
)
def test_a_beginning_that_acts_by_itself(text: str, act: Act, rest: str) -> None:
    assert opening_of(text) == (act, rest)


@pytest.mark.parametrize(
    "text",
    [
        "stop behind the cone",
        "go to the cone and stop",
        "never mind the gazebo",
        "forget the cone, go to the car",
        "stop",
        "go on, the hydrant is red",
        "please, go to the cone",
        "",
        "stop, " * 200,
    ],
)
def test_other_beginnings(text: str) -> None:
    assert opening_of(text) is None


@pytest.mark.parametrize("other", [None, 5, b"stop", ["stop"]])
def test_what_is_no_text_is_left_to_the_parser_too(other: object) -> None:
    assert act_of(other) is None
    assert opening_of(other) is None
