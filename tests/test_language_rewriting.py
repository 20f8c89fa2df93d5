"""Wordings read as other wordings, small talk left out, and what a refusal offers."""

import pytest

from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import LanguageError
from jaxlangnav.language.reference import Antecedent


def tree(text: str) -> list[str]:
    return [str(clause) for clause in parse(text).clauses]


@pytest.mark.parametrize(
    ("said", "plain"),
    [
        ("keep going until you reach the cone", "go to the cone"),
        ("drop us off behind the car", "stop behind the car"),
        ("go to the bench, no, the tree", "go to the tree"),
        ("go to the cone and the tree", "go to the cone then the tree"),
        ("i am tired. go to the bench", "go to the bench"),
        ("go to the tree but don't go near the car", "go to the tree but avoid the car"),
        ("let 's go to teh cone", "let's go to the cone"),
        ("go to the car beside which a cone stands", "go to the car near a cone"),
        # What is refused as it stands is read in plainer words.
        ("in front of the cone is where you should be", "stop in front of the cone"),
        ("steer for the hydrant over by the tree", "go to the hydrant near the tree"),
        ("unit four, go to the cone", "go to the cone"),
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
    words = parse("keep going until you reach the cone").clauses[0].all_words()
    assert [(word.text, word.position) for word in words] == [
        ("go", 1), ("to", 2), ("the", 6), ("cone", 7),
    ]  # fmt: skip


def test_a_name_of_the_detector_is_a_thing_whatever_else_it_says():
    assert tree("well, saunter to the bench") == [
        str(one) for one in parse("well, saunter to the bench", ["well"]).clauses
    ]


def test_a_refusal_blames_no_noun_that_was_read():
    for text in ("go to the box on the workbench", "go to the box in the pen"):
        with pytest.raises(LanguageError, match=r"'(on|in)' \(word 5\)"):
            parse(text, ["workbench"])


def test_who_asks_to_bring_what_was_found_is_refused():
    earlier = Antecedent(kind="barrel", is_at=True)
    assert tree("bring it to the tree") == tree("go to the tree")
    with pytest.raises(LanguageError, match="'it'"):
        parse("bring it to the tree", earlier=earlier)


def test_plainer_words_are_told_and_never_offered():
    found = parse("tuck yourself in behind the cone. the inspection is at noon")
    assert ("tuck yourself in", "stop") in found.rewrites
    assert found.unread == ("the inspection is at noon",)
    with pytest.raises(LanguageError):
        parse("tuck yourself in behind the cone", is_rewritten=False)


def test_an_open_end_asks_how_far():
    with pytest.raises(LanguageError, match="how far"):
        parse("keep going straight")


@pytest.mark.parametrize("name", ["exit", "well", "crossing"])
def test_a_word_of_another_class_is_a_noun_where_only_one_can_stand(name):
    (clause,) = parse(f"go to the box left of the car, close to the {name}").clauses
    assert any(f"type:{name}" in word.senses for word in clause.all_words())


@pytest.mark.parametrize(
    ("text", "begins", "offered"),
    [
        ("go to the box on the bench", "'on' (word 5)", "go to the box"),
        ("go past the hydrant to the tree", "'past' (word 2)", "go to the tree"),
        ("park opposite the house", "'opposite' (word 2)", "park near the house"),
        ("go forward a bit", "'a bit' (word 3): distances", None),
        ("turn left at the cone", "'turn left' (word 1): turns", None),
        ("go anywhere but the car", "'but' (word 3)", None),
    ],
)
def test_a_refusal_names_the_cause_and_offers_what_can_be_read(text, begins, offered):
    with pytest.raises(LanguageError) as error:
        parse(text)
    line = str(error.value)
    assert line.startswith(begins)
    assert line.endswith(f"I can read '{offered}'") == (offered is not None)
    assert ("I can read" in line) == (offered is not None)
    if offered is not None:
        assert parse(offered).clauses


@pytest.mark.parametrize("slip", sorted(load_lexicon().slips))
def test_a_slip_is_no_word(slip):
    assert slip not in load_lexicon().vocabulary
    assert load_lexicon().slips[slip] in load_lexicon().vocabulary


def test_a_verb_after_that_is_no_noun() -> None:
    for said in ("stands by the building", "stands alone near the building", "sits next to a ramp"):
        assert parse(f"go to the tree that {said}").clauses
