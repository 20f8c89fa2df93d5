"""The probabilistic grammar against trees counted by hand, and the lexicon's derivations."""

import math

import pytest

from jaxlangnav.language.grammar import Grammar, NoParseError, read_rules
from jaxlangnav.language.lexicon import ing_form, load_lexicon, plural, read_lexicon
from jaxlangnav.language.spelling import edits, repair
from jaxlangnav.messages import ACTIONS, MODES, RELATIONS

LEXICON = read_lexicon(
    """
    [types]
    cone = ["cone", "traffic cone"]
    [class.prep]
    tag = "IN"
    "relation:near" = ["near"]
    [tags]
    [refused]
    path = ["past"]
    """
)
# Weights 3 and 1: a modified phrase has probability 1/4, a plain one 3/4.
RULES = """
start -> np            [1]
np -> type             [3]
np -> np prep np       [1]   # ambiguous on purpose
"""
P_CONE = 1 / 4  # cone, cones, traffic cone, traffic cones


def leaf(count: int) -> float:
    """Probability of the leaves of a tree of ``count`` nouns and ``count - 1`` prepositions."""
    return (3 / 4 * P_CONE) ** count * (1 / 4) ** (count - 1)


@pytest.mark.parametrize(("count", "trees"), [(1, 1), (2, 1), (3, 2), (4, 5), (5, 14)])
def test_all_trees_of_an_ambiguous_phrase_are_counted(count, trees):
    """All binary trees are equally probable here, so the best one's share is 1 / Catalan."""
    grammar = Grammar(RULES, LEXICON)
    tokens = ["cone", *["near", "cone"] * (count - 1)]
    derivation, share = grammar.parse(tokens)
    assert math.isclose(share, 1 / trees, rel_tol=1e-9)
    assert math.isclose(log_probability(derivation), math.log(leaf(count)), rel_tol=1e-9)


def test_a_token_that_is_its_own_node_as_in_the_lark_of_ros_reads_alike(monkeypatch) -> None:
    """The wheels of ROS 2 put lark 0.12 in place of lark 1, where no node is around a token."""
    grammar = Grammar(RULES, LEXICON)
    tokens = ["cone", *["near", "cone"] * 3]
    expected, parse, unwrapped = grammar.parse(tokens), grammar._lark.parse, []

    def parse_as_then(terminals):
        root = parse(terminals)
        waiting, seen = [root], set()
        while waiting:
            node = waiting.pop()
            for packed in node.children if id(node) not in seen else ():
                for side in ("left", "right"):
                    child = getattr(packed, side)
                    if hasattr(child, "token"):
                        unwrapped.append(child)
                        setattr(packed, side, child.token)
                    elif child is not None:
                        waiting.append(child)
            seen.add(id(node))
        return root

    monkeypatch.setattr(grammar._lark, "parse", parse_as_then)
    assert grammar.parse(tokens) == expected
    assert len(unwrapped) >= len(tokens)


def log_probability(derivation) -> float:
    """Sum the log probabilities of all productions of a tree."""
    below = [log_probability(child) for child in derivation.children if not isinstance(child, int)]
    return derivation.production.log_probability + sum(below)


def test_more_probable_rule_wins_and_shares_are_posteriors():
    grammar = Grammar("start -> type [9]\nstart -> other [1]\nother -> type [1]\n", LEXICON)
    derivation, share = grammar.parse(["traffic", "cone"])
    assert derivation.children[0].production.left == "type"
    assert math.isclose(share, 0.9)


@pytest.mark.parametrize(
    ("tokens", "index"),
    [(["near", "cone"], 0), (["cone", "cone"], 1), (["cone", "near"], 2), (["zorbel"], 0)],
)
def test_failure_names_the_first_token_that_fits_no_tree(tokens, index):
    with pytest.raises(NoParseError) as error:
        Grammar(RULES, LEXICON).parse(tokens)
    assert error.value.index == index


def test_optional_symbols_are_written_out():
    rules = read_rules("a -> b? c  [2]  # comment\n\n# only a comment\n")
    assert rules == [("a", ("b", "c"), pytest.approx(0.4)), ("a", ("c",), pytest.approx(1.6))]


def test_bad_rules_and_unknown_symbols_are_named():
    with pytest.raises(ValueError, match="line 2"):
        read_rules("a -> b [1]\na b [1]\n")
    with pytest.raises(ValueError, match="nowhere"):
        Grammar("start -> nowhere [1]", LEXICON)


def test_lexicon_names_faults():
    with pytest.raises(ValueError, match=r"\[types\] is missing"):
        read_lexicon("[class.a]\ntag = 'NN'\n[tags]\n[refused]\n")
    with pytest.raises(ValueError, match="whim"):
        read_lexicon("[types]\n[class]\n[tags]\n[refused]\nwhim = ['x']\n")


def test_eight_types_in_order_and_legal_senses():
    lexicon = load_lexicon()
    assert lexicon.type_names[:8] == (
        "hydrant", "cone", "car", "building", "tree", "bench", "barrel", "box",
    )  # fmt: skip
    legal = {f"type:{name}" for name in lexicon.type_names}
    legal |= {f"relation:{name}" for name in RELATIONS} | {f"action:{name}" for name in ACTIONS}
    legal |= {f"mode:{name}" for name in MODES} | {f"rank:{n}" for n in range(1, 5)}
    legal |= {"superlative", "constraint", "robot", "other", "anaphor", "place", "foreign"}
    legal |= {"pronoun", "any", "between"}
    found = {
        sense
        for entries in lexicon.entries.values()
        for entry in entries.values()
        for word in entry.senses
        for sense in word
    }
    assert found <= legal


def test_a_type_or_synonym_is_one_line():
    lexicon = read_lexicon(
        "[types]\ncone = ['cone']\nlamp = ['lamp', 'street lamp']\n[class]\n[tags]\n[refused]\n"
    )
    assert lexicon.type_names == ("cone", "lamp")
    entry = lexicon.entries["type"]["street", "lamps"]
    assert entry.senses == ((), ("type:lamp",))
    assert entry.lemmas == ("street", "lamp")
    assert entry.tags == ("NN", "NNS")


def test_word_forms():
    assert [plural(w) for w in ("cone", "box", "bench", "body", "bus", "tray")] == [
        "cones", "boxes", "benches", "bodies", "buses", "trays",
    ]  # fmt: skip
    assert [ing_form(w) for w in ("go", "move", "stop", "get", "head", "park", "be", "flee")] == [
        "going", "moving", "stopping", "getting", "heading", "parking", "being", "fleeing",
    ]  # fmt: skip


def test_edits_are_at_distance_one():
    found = edits("cat")
    assert {"at", "act", "cut", "cart", "cats"} <= found
    assert not {"dog", "c", "tac", "carts"} & found


def test_repair_needs_one_meaning():
    assert repair("hydrnat") == "hydrant"
    assert repair("wihtout") == "without"  # a refused word too: negation must not slip through
    assert repair("cnoe") is None
    assert repair("zorbel") is None
