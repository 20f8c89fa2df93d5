"""Words to halt, resume and cancel: whole utterances, however polite, and nothing else."""

import json
import tomllib
from importlib import resources
from pathlib import Path

import pytest
from hand_geometry import SPOKEN

from jaxlangnav import Navigator
from jaxlangnav.language.halting import Act, act_of, alarm_in, halts_alone, opening_of
from jaxlangnav.language.lexicon import find_type, is_reserved, read_lexicon
from jaxlangnav.navigator import NavigatorState

TABLE = tomllib.loads(
    resources.files("jaxlangnav.language").joinpath("data/halting.toml").read_text("utf-8")
)


def test_there_are_many_ways_to_say_halt_and_none_has_two_meanings() -> None:
    assert len(TABLE["halt"]) >= 30
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
        ("Stop. Stop right there!", Act.HALT),
        ("no, stop!", Act.HALT),
        ("Don't move!", Act.HALT),
        ("\uff33\uff34\uff2f\uff30", Act.HALT),
        ("e-stop", Act.HALT),
        ("stop! never mind, go on", Act.HALT),
        ("ok, go on please", Act.RESUME),
        ("forget it. stop.", Act.HALT),
        ("Sotp!", Act.HALT),
        ("STOOOOOP!!!", Act.HALT),
        ("freeeze", Act.HALT),
        ("hold on a second", Act.HALT),
        ("back off!", Act.HALT),
        # Anything else is left to the parser.
        ("", None),
        ("!!!", None),
        ("stop behind the cone", None),
        ("go on to the hydrant", None),
        ("hold the door", None),
        ("forget the cone, go to the car", None),
        ("the robot stopped", None),
        ("stop " * 200, None),
        ("go", None),
        ("stpo behind the cone", None),
    ],
)
def test_as_people_say_it(text: str, act: Act | None) -> None:
    assert act_of(text) is act


def test_no_command_with_an_object_is_taken_for_a_word_to_halt() -> None:
    """Of the thousand labelled sentences, only those without any object."""
    assert len(SPOKEN) > 500
    taken = {text for text, label in SPOKEN if act_of(text) is not None and label != "REFUSED"}
    assert taken == set()


@pytest.mark.parametrize(
    ("text", "opening"),
    [
        ("Stop! The car is on fire", (Act.HALT, "The car is on fire")),
        ("halt, there is a child", (Act.HALT, "there is a child")),
        ("Stpo! There is a child", (Act.HALT, "There is a child")),
        ("stop and come back", (Act.HALT, "come back")),
        ("Never mind, come back.", (Act.CANCEL, "come back.")),
        ("don't bother, go to the bench", (Act.CANCEL, "go to the bench")),
        ("forget it. Stop. Come back", (Act.HALT, "Come back")),
        ("stop behind the cone", None),
        ("go to the cone and stop", None),
        ("forget the cone, go to the car", None),
        ("stop", None),
        ("", None),
        ("stop, " * 200, None),
    ],
)
def test_a_beginning_that_acts_by_itself(text: str, opening: tuple[Act, str] | None) -> None:
    assert opening_of(text) == opening


@pytest.mark.parametrize("other", [None, 5, b"stop", ["stop"]])
def test_what_is_no_text_is_left_to_the_parser_too(other: object) -> None:
    assert act_of(other) is None
    assert opening_of(other) is None
    assert alarm_in(other, _is_object) is None


# ---------------------------------------------------------------- what is not understood under way

UTTERANCES = [
    json.loads(line)
    for line in (Path(__file__).parent / "data/halts.jsonl").read_text("utf-8").splitlines()
]
"""By six sorts of people, labelled before the rule was written (a-…) and by somebody who has not
seen it (b-…); those of b with an even number were not looked at while it was made."""
LABELS = ("hydrant", "cone", "tree", "car", "box", "ball", "barrel", "bench", "crate", "building")


def _is_object(words: str) -> bool:
    return find_type(words) is not None or words in LABELS


@pytest.fixture(scope="module")
def robot() -> Navigator:
    return Navigator.pretrained(labels=LABELS)


@pytest.fixture(scope="module")
def under_way(robot: Navigator) -> NavigatorState:
    """A robot that has set out for a cone, and has not seen any yet."""
    return robot.start("go to the cone")


@pytest.mark.parametrize("author", ["a", "b"])
def test_who_asks_to_halt_halts(author: str) -> None:
    asked = [one["text"] for one in UTTERANCES if one["halts"] and one["id"][0] == author]
    missed = [
        text
        for text in asked
        if act_of(text) not in (Act.HALT, Act.CANCEL)
        and (opening_of(text) or (Act.RESUME,))[0] == Act.RESUME
        and alarm_in(text, _is_object) is None
    ]
    assert len(asked) > 100
    assert len(missed) <= 0.03 * len(asked), missed


def test_what_is_understood_does_not_halt(robot: Navigator, under_way: NavigatorState) -> None:
    """What people want done is done, or refused; where words alarm it may halt only if refused."""
    wanted = [one["text"] for one in UTTERANCES if not one["halts"]][::4]
    halted = []
    for text in wanted:
        try:
            state = robot.hear(under_way, text)
        except ValueError:
            continue
        if bool(state.is_halted):
            with pytest.raises(ValueError, match=r"\w"):
                robot.start(text)
            halted.append(text)
    assert len(halted) <= 0.22 * len(wanted), halted


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("whoa whoa stop there's a kid", "'whoa' may ask to halt"),
        ("stop you'll hit the dog", "'stop' may ask to halt"),
        ("do not move another inch", "'do not' may forbid what is being done"),
        ("negative, your target is the gazebo", "'negative' may begin a correction"),
        ("not the blue one", "'not' may begin a correction"),
        ("wrong pallet mate", "'wrong' may begin a correction"),
    ],
)
def test_it_says_why_it_halts(robot, under_way, text, why):
    after, heard = robot.take(under_way, text)
    assert bool(after.is_halted)
    assert why in heard.notes[0]
    assert "go on" in heard.notes[0]
    assert not bool(robot.hear(after, "go on").is_halted)


@pytest.mark.parametrize("text", ["stop the gazebo dance", "negative, your target is the gazebo"])
def test_who_stands_refuses_as_ever(robot: Navigator, under_way: NavigatorState, text: str) -> None:
    for state in (robot.wait(), robot.hear(under_way, "stop")):
        with pytest.raises(ValueError, match="word"):
            robot.take(state, text)


ALARMING = ("no stop", "dont hit me", "careful, don't go into the car, stop")
PART_OF_A_COMMAND = (
    "never stop", "don't stop until you reach the cone", "keep going don't stop", "go to the pond",
    "stop next to the cone", "do not approach the tree", "drive slowly up to the cone", "",
)  # fmt: skip


@pytest.mark.parametrize("text", ALARMING + PART_OF_A_COMMAND)
def test_what_is_part_of_a_command_alarms_nobody(text: str) -> None:
    assert (alarm_in(text, _is_object) is None) == (text in PART_OF_A_COMMAND)


def test_words_to_halt_have_no_other_meaning() -> None:
    package = (
        resources.files("jaxlangnav.language").joinpath("data/lexicon.toml").read_text("utf-8")
    )
    for own in ('[class.v_to]\n"action:navigate" = ["{}"]', '[types]\n"{}" = []'):
        for word in ("stop", "freeze", "whoa", "hold on", "halt"):
            with pytest.raises(ValueError, match="halts the robot"):
                read_lexicon(package, own.replace("{}", word))
    assert is_reserved("stop")
    assert not halts_alone("park")
    assert not is_reserved("bus stop")
