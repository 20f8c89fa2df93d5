"""What "it", "there" and a repeated noun stand for; wordings read as other wordings; refusals."""

import pytest
from corpus_labels import behave

from jaxlangnav.experiments.tasks import ground_sentences
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.language.corpus import PlacedWorld
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import LanguageError
from jaxlangnav.language.reference import Antecedent

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


@pytest.mark.parametrize("text", CLEAR)
def test_what_refers_back_has_its_type(text):
    word, senses = CLEAR[text]
    words = parse(text).clauses[-1].all_words()
    assert next(one.senses for one in words if one.text == word) == senses


STATED = "the hydrant is behind the cone. "
RESTRICTED = "NP[]{NP[the hydrant], PP[behind]{NP[the cone]}}"


@pytest.mark.parametrize(
    ("text", "goal"),
    [
        (f"{STATED}go to the hydrant", RESTRICTED),
        ("go to the hydrant. it is behind the cone", RESTRICTED),
        (
            "hydrant is behind the cone. go to hydrant",
            "NP[]{NP[hydrant], PP[behind]{NP[the cone]}}",
        ),
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
    assert {s for s in behave(second, world)[-1] if s.startswith("goal")} == {"goal(behind,1)"}


def test_a_rank_counts_among_those_meant():
    """The nearest cone is on the right: the nearest on the left is the second of all."""
    objects = (("cone", 1.0, -2.0), ("cone", 1.0, 3.0), ("cone", 0.5, 4.5))
    world = PlacedWorld(objects=objects, robot=(0.0, 0.0, 0.0))

    def goal(text: str) -> set[str]:
        symbols = behave(parse(text).clauses[0], world)[-1]
        return {symbol for symbol in symbols if symbol.startswith("goal")}

    assert goal("go to the nearest cone on your left") == {"goal(at,1)"}
    assert goal("go to the second cone on your left") == {"goal(at,2)"}
    assert goal("go to the nearest cone") == {"goal(at,0)"}


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


def tree(text: str) -> list[str]:
    return [str(clause) for clause in parse(text).clauses]


@pytest.mark.parametrize(
    ("said", "plain"),
    [
        ("keep going until you reach the cone", "go to the cone"),
        ("drop us off behind the car", "stop behind the car"),
        ("go to the bench, no, the tree", "go to the tree"),
        ("go to the tree but don't go near the car", "go to the tree but avoid the car"),
        ("let 's go to teh cone", "let's go to the cone"),
        ("go to the car beside which a cone stands", "go to the car near a cone"),
        ("the cone. stop behind it", "stop behind the cone"),
        # What is refused as it stands is read in plainer words.
        ("in front of the cone is where you should be", "stop in front of the cone"),
        ("steer for the hydrant over by the tree", "go to the hydrant near the tree"),
    ],
)
def test_one_meaning_has_one_tree(said, plain):
    assert tree(said) == tree(plain)


def test_what_is_read_as_something_else_is_told():
    found = parse("keep going until you reach the cone, my friend is waiting")
    assert found.rewrites == (("keep going until you reach", "go to"),)
    assert found.unread == ("my friend is waiting",)
    assert found.to_dict()["unread"] == ["my friend is waiting"]
    assert parse("go to the cone").rewrites == ()


def test_words_keep_the_places_where_they_were_said():
    assert len(tree("the cone, then go behind it")) == len(tree("find the cone. go to it")) == 2
    words = parse("keep going until you reach the cone").clauses[0].all_words()
    assert {word.text: word.position for word in words} == {"go": 1, "to": 2, "the": 6, "cone": 7}


def test_a_name_of_the_detector_is_a_thing_whatever_else_it_says():
    assert tree("well, saunter to the bench") == [
        str(one) for one in parse("well, saunter to the bench", ["well"]).clauses
    ]


def test_a_refusal_blames_no_noun_that_was_read():
    for text in ("go to the box on the workbench", "go to the box in the pen"):
        with pytest.raises(LanguageError, match=r"'(on|in)' \(word 5\)"):
            parse(text, ["workbench"])


def test_who_asks_to_bring_what_was_found_is_refused():
    for earlier in (None, Antecedent(kind="barrel", is_at=True)):
        with pytest.raises(LanguageError, match="'it'"):
            parse("bring it to the tree", earlier=earlier)


def test_a_place_named_before_its_command_may_refer_to_what_was_said_before():
    found = parse("the cone behind it: go there", earlier=Antecedent(kind="barrel", is_at=True))
    assert str(found.clauses[0]) == "VP[go]{NP[]{NP[the cone], PP[behind]{NP[it]}}}"


def test_plainer_words_are_told():
    found = parse("mosey on over behind the cone. the inspection is at noon")
    assert ("mosey on over", "go") in found.rewrites
    assert found.unread == ("the inspection is at noon",)
    with pytest.raises(LanguageError):
        parse("mosey on over behind the cone", is_rewritten=False)


@pytest.mark.parametrize("name", ["exit", "well", "crossing"])
def test_a_word_of_another_class_is_a_noun_where_only_one_can_stand(name):
    (clause,) = parse(f"go to the box left of the car, close to the {name}").clauses
    assert any(f"type:{name}" in word.senses for word in clause.all_words())


@pytest.mark.parametrize(
    ("text", "begins"),
    [
        ("go to the box on the bench", "'on' (word 5)"),
        ("go past the hydrant to the tree", "'past' (word 2)"),
        ("park opposite the house", "'opposite' (word 2)"),
        ("go forward a bit", "'a bit' (word 3): distances"),
        ("turn left at the cone", "'turn left' (word 1): turns"),
        ("go anywhere but the car", "'but' (word 3)"),
        ("take the box to the car", "'take' (word 1): this action"),
        ("keep going straight", "'keep going straight' (word 1): how far"),
    ],
)
def test_a_refusal_names_the_cause(text, begins):
    with pytest.raises(LanguageError) as error:
        parse(text)
    assert str(error.value).startswith(begins)


@pytest.mark.parametrize("slip", sorted(load_lexicon().typos))
def test_a_slip_is_no_word(slip):
    assert slip not in load_lexicon().vocabulary
    assert load_lexicon().typos[slip] in load_lexicon().vocabulary


def test_a_verb_after_that_is_no_noun() -> None:
    for said in ("stands by the building", "stands alone near the building", "sits next to a ramp"):
        assert parse(f"go to the tree that {said}").clauses
