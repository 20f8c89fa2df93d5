"""The gist of a refused sentence: what is left out by class of word, and what never is."""

import random

import pytest

from jaxlangnav.language.amends import take_back
from jaxlangnav.language.clauses import gist_words
from jaxlangnav.language.gist import find_gist
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import LanguageError
from jaxlangnav.language.tokens import SpokenToken

LABELS = (
    "bench",
    "tree",
    "statue",
    "barn",
    "silo",
    "kiosk",
    "taxi",
    "gate",
    "flower",
    "post office",
)


def trees(text: str) -> list[str]:
    return [str(clause) for clause in parse(text, LABELS).clauses]


def goals(text: str) -> list[str]:
    """Write what a sentence asks for without its verbs: they differ, and mean the same."""
    return [", ".join(map(str, root.children)) for root in parse(text, LABELS).clauses]


@pytest.mark.parametrize(
    ("said", "plain"),
    [
        # what asks for an order
        ("would it be at all possible for somebody to go to the barn", "go to the barn"),
        ("i was honestly wondering whether you might maybe pootle to the barn", "go to the barn"),
        ("would you mind terribly bringing me round to the statue", "go to the statue"),
        ("i don't suppose you could toddle along to the gate, dear", "go to the gate"),
        # a verb of motion or of rest, whatever its name, and what is taken along
        ("zigzag on down to the barn behind the silo", "go to the barn behind the silo"),
        ("make a rather quick trip over to the gate", "go to the gate"),
        ("lounge about behind the kiosk", "stop behind the kiosk"),
        ("chauffeur my aunt over to the taxi", "go to the taxi"),
        ("deposit the groceries at the gate", "stop at the gate"),
        ("first go barn, then go post office", "go to the barn then go to the post office"),
        # how a thing stands, and how exactly
        ("go to the bench nestled just a tad behind the kiosk", "go to the bench behind the kiosk"),
        # why, for whom, until when
        ("go to the kiosk to buy my sister a newspaper", "go to the kiosk"),
        ("take me to the barn for the big meeting", "go to the barn"),
        ("lurk near the gate till my aunt is done", "stop near the gate"),
        # what else is said, before and behind, with a mark or without
        ("my cousin from lyon has been so angry, go to the gate", "go to the gate"),
        ("we've lost comms with the other team, so go to the silo", "go to the silo"),
        ("visibility is garbage, copy? go to the statue, over", "go to the statue"),
        ("nothing complicated, i am not filling in a form: go to the barn", "go to the barn"),
        ("my feet are killing me go to the bench near the gate", "go to the bench near the gate"),
        ("go to the gate i forgot to turn it off", "go to the gate"),
        ("the kids dropped it, so go to the silo, the barn, then the gate",
         "go to the silo then the barn then the gate"),
        # what is taken back, and said twice
        ("could you zip to the barn, oops, my mistake, to the silo", "go to the silo"),
        ("stop behind the barn, hang on, sorry, in front of the barn", "stop in front of the barn"),
        ("euh, how do you say, go to the, the kiosk, voilà, the kiosk", "go to the kiosk"),
        ("mosey to the kiosk beside the tree, i mean the tree that is left of the barn",
         "go to the kiosk beside the tree that is left of the barn"),
        ("mosey to the bench more far of the barn", "go to the bench farthest from the barn"),
        ("can you go look for it, the statue", "look for the statue"),
    ],
)  # fmt: skip
def test_words_are_left_out_by_their_class(said, plain):
    assert goals(said) == goals(plain)


@pytest.mark.parametrize(
    ("said", "kept"),
    [
        ("honestly, zip to the barn and stay away from the gate", "avoid"),
        ("ugh, zip quickly to the barn, mate", "quickly"),
        ("my legs hurt, mosey over to the second statue on the left", "second"),
    ],
)
def test_what_tells_how_or_which_stays(said, kept):
    words = [word for root in parse(said, LABELS).clauses for word in root.all_words()]
    senses = {sense for word in words for sense in word.senses}
    assert kept in {word.text for word in words} or (kept == "avoid" and "constraint" in senses)


@pytest.mark.parametrize(
    "text",
    [
        # leaving it out would choose another thing
        "the red statue is broken. go to the statue",
        "my dog is under the bench. mosey to the bench",
        "i lost my dog, mosey to the tree and look for it",
        "mosey to the tree closest to me",
        "mosey anywhere but the tree",
        "mosey back to the place where we were this morning",
        # or turn the meaning round
        "do not mosey to the tree",
        "i told him never to go to the tree",
        "if you see a dog, mosey to the tree",
        "unless it rains, mosey to the tree",
        "mosey to the tree or the barn",
        "mosey closer to the barn, but not too close",
        # or leave out an order that the robot cannot follow
        "grab my coat, then mosey to the tree",
        "could you scan the code and mosey to the tree",
        "let's do the statue first and after that the barn",
        "pass the statue on the left and then mosey to the barn",
        "turn left at the tree and mosey to the barn",
        "take the first right after the tree, then mosey to the barn",
        "take the scenic route to the tree",
        "did you mosey to the tree",
        "i moseyed to the tree",
        "be at the tree in five minutes",
        "go forward and turn left",
        "ok now please turn and mosey to the tree",
        "find the barn and bring it to the tree",
        "i will mosey to the tree",
        "if you have it, mosey to the tree",
    ],
)  # fmt: skip
def test_what_could_choose_or_turn_round_is_never_left_out(text):
    with pytest.raises(LanguageError):
        parse(text, LABELS)


def test_what_is_left_out_is_told():
    found = parse("honestly, my legs hurt, would you kindly zip to the barn for lunch", LABELS)
    assert {"honestly", "for lunch"} <= set(found.unread)
    assert ("zip to", "go to") in found.rewrites or "zip" in str(found.clauses[0])


def test_what_can_be_read_is_not_changed():
    assert parse("zip over to the tree", LABELS).rewrites == ()
    assert trees("go to the bench behind the tree") == [
        "VP[go]{PP[to]{NP[]{NP[the bench], PP[behind]{NP[the tree]}}}}"
    ]


def test_a_turn_before_a_goal_is_kept():
    found = parse("uh so like turn around and um go to the gate", LABELS)
    assert len(found.clauses) == 2


def test_any_words_at_all_have_a_gist_or_none():
    lists = gist_words()
    listed = [*lists.words.values(), *lists.verbs.values()]
    words = sorted({",", ".", "barn", "gate", *frozenset().union(*listed)})
    rng = random.Random(5)
    for _ in range(300):
        said = [SpokenToken(text=rng.choice(words), position=i) for i in range(rng.randint(1, 16))]
        mended, _ = take_back(said)
        left, left_out, _ = find_gist(mended, LABELS)
        assert len(left) <= 2 * len(said)
        assert all(left_out)
