"""What "it", "there" and a repeated noun stand for, and what is refused because it is not clear."""

import pytest

from jaxlangnav.experiments.tasks import ground_sentences
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.language.labels import Geometry, PlacedWorld, behave
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import LanguageError, Phrase

SAME_CONE = ("type:cone", "same")
CLEAR = {
    "go to the cone then stop behind it": ("it", SAME_CONE),
    "find the cone behind the car, then go there": ("there", SAME_CONE),
    "move behind the cone, then go to it": ("it", SAME_CONE),
    "go to the second cone and then park behind the cone": ("cone", SAME_CONE),
    "there is a cone near the car. go to it": ("it", ("type:cone",)),
    "go to the car then go to the nearest one": ("one", ("type:car",)),
    "go to the cone then go to the cone near the car": ("cone", ("type:cone",)),
    "go to the cone then go to the other cone": ("cone", ("type:cone",)),
}


def last(root: Phrase, text: str) -> tuple[str, ...]:
    """Find the senses of the first word of that text in a clause."""
    return next(word.senses for word in root.all_words() if word.text == text)


@pytest.mark.parametrize("text", CLEAR)
def test_what_refers_back_has_its_type(text):
    word, senses = CLEAR[text]
    assert last(parse(text).clauses[-1], word) == senses


STATED = "the hydrant is behind the cone. "
RESTRICTED = "NP[]{NP[the hydrant], PP[behind]{NP[the cone]}}"


@pytest.mark.parametrize(
    ("text", "goal"),
    [
        (f"{STATED}go to the hydrant", RESTRICTED),
        ("go to the hydrant. it is behind the cone", RESTRICTED),
        ("there is a hydrant behind the cone. find the hydrant", RESTRICTED),
        (f"{STATED}park near it", "NP[]{NP[it], PP[behind]{NP[the cone]}}"),
        # Another thing of the kind, and a thing told apart already, are left alone.
        (f"{STATED}go to the other hydrant", "NP[the other hydrant]"),
        (f"{STATED}go to the hydrant near the car", "NP[]{NP[the hydrant], PP[near]{NP[the car]}}"),
        (f"{STATED}go to the cone", "NP[the cone]"),
        (f"{STATED}go to a hydrant", "NP[a hydrant]"),
    ],
)
def test_what_a_statement_says_holds_for_the_thing_named_again(text, goal):
    (command,) = (str(one) for one in parse(text).clauses if one.label == "VP")
    assert f"{{{goal}}}" in command


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("go to it", "'it' (word 3): nothing said before"),
        ("it is behind the cone", "'it' (word 1): nothing said before"),
        ("go there", "'there' (word 2): nothing said before"),
        ("go to the cone near the car then stop behind it", "is it the cone or the car?"),
        ("go to the cones then stop behind it", "not clear"),
        ("go to the cone behind it", "'it' (word 6): nothing said before"),
        ("go to the nearest one", "of what kind?"),
    ],
)
def test_what_is_not_clear_is_refused_with_a_remedy(text, says):
    with pytest.raises(LanguageError, match="name the object") as error:
        parse(text)
    assert says in str(error.value)


def test_it_is_the_very_thing():
    """Two cones: "it" is the one that the command before led to."""
    objects = (("cone", 3.0, 1.0), ("cone", 6.0, -2.0))
    world = PlacedWorld(objects=objects, robot=(0.0, 0.0, 0.0), previous=1)
    second = parse("go to the cone then stop behind it").clauses[1]
    assert "goal(behind,1)" in behave(second, Geometry(world))[-1]
    assert "goal(behind,0)" not in behave(second, Geometry(world))[-1]


def test_a_rank_counts_among_those_meant():
    """The nearest cone is on the right: the nearest on the left is the second of all."""
    objects = (("cone", 1.0, -2.0), ("cone", 1.0, 3.0), ("cone", 0.5, 4.5))
    geometry = Geometry(PlacedWorld(objects=objects, robot=(0.0, 0.0, 0.0)))

    def goal(text: str) -> set[str]:
        symbols = behave(parse(text).clauses[0], geometry)[-1]
        return {symbol for symbol in symbols if symbol.startswith("goal")}

    assert goal("go to the nearest cone on your left") == {"goal(at,1)"}
    assert goal("go to the second cone on your left") == {"goal(at,2)"}
    assert goal("go to the nearest cone") == {"goal(at,0)"}


# ---------------------------------------------------------------- what only says what to avoid


def test_a_constraint_after_a_command_is_part_of_it() -> None:
    (clause,) = parse("go to the car. then avoid the cone").clauses
    assert str(clause) == "VP[go]{PP[to]{NP[the car]}, VP[then avoid]{NP[the cone]}}"
    assert len(parse("avoid the cone. then avoid the car").clauses) == 2


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("avoid the cone", "not where to go"),
        ("watch out for the hydrant behind the cone", "not where to go"),
        ("avoid the cone then stay away from the car", "not where to go"),
        ("go to the car then stay away from it", "'then stay away from it' asks to keep away"),
        ("the hydrant is behind the cone", "asks for nothing to be done"),
    ],
)
def test_what_asks_for_nothing_is_no_task(text: str, why: str) -> None:
    with pytest.raises(ValueError, match=why) as caught:
        understand(text, load_shipped()).check_task()
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match=why):
        ground_sentences(["go to the car", text])


@pytest.mark.parametrize(
    "text", ["go to the bench but avoid the cone", "avoid the car and find the cone"]
)
def test_a_constraint_with_a_command_is_a_task(text: str) -> None:
    understand(text, load_shipped()).check_task()
