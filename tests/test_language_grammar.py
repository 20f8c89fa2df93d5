"""The grammar, built in and exported, against trees counted by hand; derivations of the lexicon."""

import itertools
import json
import math
import os
import random
import re
import subprocess
import sys
from graphlib import TopologicalSorter
from importlib import resources
from pathlib import Path

import pytest
from lark import Lark

from jaxlangnav.cli import main as cli
from jaxlangnav.language.exported import Rules, export_grammar, exported_rules
from jaxlangnav.language.grammar import Grammar, NoParseError, load_grammar, read_rules
from jaxlangnav.language.lexicon import USER_LEXICON, ing_form, load_lexicon, plural, read_lexicon
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import LanguageError
from jaxlangnav.messages import ACTIONS, MODES, RELATIONS
from jaxlangnav.relations import REGISTRY

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


@pytest.mark.parametrize(("count", "trees"), [(1, 1), (2, 1), (3, 2), (4, 5), (5, 14)])
def test_all_trees_of_an_ambiguous_phrase_are_counted(count, trees):
    """All binary trees are equally probable here, so the best one's share is 1 / Catalan."""
    grammar = Grammar(RULES, LEXICON)
    tokens = ["cone", *["near", "cone"] * (count - 1)]
    derivation, share = grammar.parse(tokens)
    assert math.isclose(share, 1 / trees, rel_tol=1e-9)
    one = (3 / 4 * P_CONE) ** count * (1 / 4) ** (count - 1)  # nouns, and prepositions between
    assert math.isclose(log_probability(derivation), math.log(one), rel_tol=1e-9)


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
    assert " ".join(lexicon.type_names[:8]) == "hydrant cone car building tree bench barrel box"
    legal = {f"type:{name}" for name in lexicon.type_names}
    legal |= {f"relation:{name}" for name in RELATIONS} | {f"action:{name}" for name in ACTIONS}
    legal |= {f"mode:{name}" for name in MODES} | {f"rank:{n}" for n in range(1, 5)}
    legal |= {"superlative", "constraint", "robot", "other", "anaphor", "place", "foreign"}
    legal |= {"pronoun", "any"} | {one.name for one in REGISTRY}
    entries = [entry for of in lexicon.entries.values() for entry in of.values()]
    found = {sense for entry in entries for word in entry for sense in word.senses}
    assert found <= legal


def test_word_forms():
    plurals = map(plural, ["cone", "box", "bench", "body", "bus", "tray"])
    assert " ".join(plurals) == "cones boxes benches bodies buses trays"
    forms = map(ing_form, ["go", "move", "stop", "get", "head", "park", "be", "flee", "trot"])
    assert " ".join(forms) == "going moving stopping getting heading parking being fleeing trotting"


# ---------------------------------------------------------------- the exported grammar

NOUNS = ("gazebo", "fire hydrant")
MOST_WORDS = 40
OF_MEANING = re.compile(r"stands? for|contradicts|twice|name the object|is it the")
"""Refusals of sentences that the grammar makes: what points back, and what contradicts itself."""


@pytest.fixture(scope="module")
def lark() -> Lark:
    return Lark(export_grammar("lark", NOUNS), parser="earley", lexer="dynamic")


def test_lark_accepts_what_the_parser_reads(lark: Lark) -> None:
    corpus = resources.files("jaxlangnav.language").joinpath("data/corpus.jsonl").read_text("utf-8")
    texts = [json.loads(line)["text"] for line in corpus.splitlines()]
    read = 0
    texts = [*random.Random(0).sample(texts, 12), "go to the white gazebo near the fire hydrant"]
    for text in texts:
        found = parse(text, NOUNS)
        if not (found.repairs or found.rewrites or found.unread):
            lark.parse(f" {text.lower()}".rstrip(" .!"))
            read += 1
    assert read > 8


@pytest.mark.parametrize("text", ["go through the cone", "go to the zorbel", "goto thecone"])
def test_lark_refuses_what_is_no_controlled_language(lark: Lark, text: str) -> None:
    with pytest.raises(Exception, match=r"No terminal|Unexpected"):
        lark.parse(f" {text}")


def make(rules: Rules, weights: dict, rng: random.Random) -> list[str]:
    """Draw a sentence by the weights that the parser has."""
    waiting, words = ["start"], []
    while waiting:
        if (part := waiting.pop())[0] == '"':
            words.append(part.strip('"'))
        else:
            shares = [weights.get((part, way), 0.01) for way in rules[part]]
            waiting += reversed(rng.choices(rules[part], shares)[0])
    return words


def test_the_parser_reads_what_the_grammar_makes() -> None:
    grammar, rng = load_grammar(), random.Random(6)
    rules = exported_rules(grammar, NOUNS)
    weights = {(one.left, one.right): math.exp(one.log_probability) for one in grammar.productions}
    sentences = (make(rules, weights, rng) for _ in itertools.count())
    short, refused = (words for words in sentences if len(words) <= MOST_WORDS), []
    for words in itertools.islice(short, 60):
        try:
            parse(" ".join(words), NOUNS, is_rewritten=False)
        except LanguageError as error:
            refused.append(f"{words}: {error}")
    assert [one for one in refused if not OF_MEANING.search(one)] == []
    assert len(refused) <= 15


def test_nothing_calls_itself_first() -> None:
    rules = exported_rules(load_grammar(), NOUNS)  # llama.cpp takes no left recursion
    first = {left: {way[0] for way in ways if way[0][0] != '"'} for left, ways in rules.items()}
    TopologicalSorter(first).prepare()  # raises CycleError


def test_gbnf_defines_all_that_it_uses() -> None:
    text = export_grammar("gbnf", NOUNS)
    lines = [line.split(" ::= ") for line in text.splitlines()[1:]]
    names = [name for name, _ in lines]
    assert names[0] == "root"
    assert len(set(names)) == len(names)
    for _, right in lines:
        assert set(re.sub(r'"[^"]*"', "", right).split()) - {"|"} <= set(names)
    assert '" fire" " hydrant"' in text
    assert '","' in text
    with pytest.raises(ValueError, match="'ebnf' is no notation"):
        export_grammar("ebnf")


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["parse", "--grammar", "gbnf", "--nouns", *NOUNS]) == 0
    assert capsys.readouterr().out == export_grammar("gbnf", NOUNS)
    for noun in ("4x4!", "the"):
        assert cli.main(["parse", "--grammar", "lark", "--nouns", noun]) == 2
        assert f"'{noun}' is no noun" in capsys.readouterr().err
    assert cli.main(["parse", "go to the cone", "--nouns", "gazebo"]) == 2
    assert cli.main(["parse", "go to the cone", "--grammar", "lark"]) == 2
    assert cli.main(["parse"]) == 2


# ---------------------------------------------------------------- a lexicon file of one's own

OWN = """
[types]
lamp = ["lamp post", "street lamp", "lantern"]
car = ["truck", "lorry"]
[class.adj]
plain = ["teal"]
"""


def test_a_new_type_and_a_synonym_are_grounded_without_training(tmp_path: Path) -> None:
    path = tmp_path / "words.toml"
    path.write_text(OWN, "utf-8")
    assert not {"lorry", "teal", "lamp"} & load_lexicon().vocabulary
    said = "find the teal lorry behind the nearest lamp posts"
    done = subprocess.run(
        [sys.executable, "-m", "jaxlangnav", "ground", said, "--json"],
        env={**os.environ, USER_LEXICON: str(path), "JAX_PLATFORMS": "cpu"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["unknown_words"] == []
    said = {(a["figure"], a["relation"], a["landmark"], a["superlative"]): a["probability"]
            for a in document["annotations"]}  # fmt: skip
    assert said.keys() == {("car", "behind", "lamp", False), ("lamp", "near", "robot", True)}
    assert min(said.values()) > 0.95


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[types]\nlamp = 'lamp'", r"\[types\] lamp must be a list"),
        ("[types]\nlamp = ['']", r"\[types\] lamp must be a list"),
        ("types = 3", "must be tables"),
        ("[types]\nlamp = ['pylon']", "'pylon' is a name of cone already"),
        ("[class.zork]\nplain = ['x']", r"\[class.zork\]: no such class"),
        ("[refused]\npath = ['x']", r"only \[types\] and \[class.X\]"),
        ("[types", "is no valid TOML"),
        ("[types]\nlamp = ['the']", "'the' has a meaning of its own"),
        ("[types]\nlamp = ['behind']", "'behind' has a meaning of its own"),
        ("[types]\nlamp = ['the cone']", "'the' has a meaning .* an end of a name"),
        ("[types]\nlamp = ['cones']", "'cones' is a name of cone already"),
        ("[types]\nlamp = ['a=b']", "'a=b' could not be read as a word"),
        ('[types]\nlamp = ["cone\'s"]', "could not be read as a word"),
        ('[types]\nlamp = ["a\\u001b[31m"]', r"control character U\+001B"),
        (f"[types]\nlamp = ['{'x' * 5000}']", "has 5000 characters"),
        (f"[types]\nlamp = ['{'x ' * 9}']", "has more than 8 words"),
        ("[class.adj]\nplain = ['the']", "'the' has another meaning already"),
        ('[class.rel]\n"relation:left" = ["behind"]', "'behind' has another meaning"),
        ('[class.rel]\n"relation:sideways" = ["athwart"]', "no such sense"),
        ('[class.rel]\n"relation:left" = ["*a *b"]', "more than one word marked"),
        (f"[types]\nlamp = {[f'w{i}' for i in range(2000)]}", "at most 1000 may be added"),
    ],
)
def test_a_faulty_file_is_named(text, says, tmp_path, monkeypatch):
    path = tmp_path / "words.toml"
    path.write_text(text, "utf-8")
    monkeypatch.setenv(USER_LEXICON, str(path))
    with pytest.raises(ValueError, match=says) as error:
        load_lexicon.__wrapped__()
    assert str(error.value).startswith(str(path))
    assert "\n" not in str(error.value)


def test_own_lines_come_after_those_of_the_package() -> None:
    base = "[types]\ncone = ['cone']\n[class.adj]\ntag = 'JJ'\nplain = ['red']\n[tags]\n[refused]\n"
    lexicon = read_lexicon(
        base, "[types]\nLamp = ['Lamp']\ncone = ['Pylon']\n[class.adj]\nplain = ['teal']\n"
    )
    assert lexicon.type_names == ("cone", "lamp")
    assert lexicon.entries["type"]["pylons",][0].senses == ("type:cone",)
    assert lexicon.entries["adj"]["teal",][0].tag == "JJ"


@pytest.mark.parametrize(
    "text",
    [
        "[types]\nsign = ['stop sign', 'road sign']",
        "[types]\npark = []",
        "[types]\nlamp = ['light', 'ﬂoor lamp', 'Straßenlaterne', 'лампа']",
        "[types]\ndoor = ['front door', 'fire exit']",
        '[class.rel]\n"relation:behind" = ["in the *lee of", "overlooking"]',
    ],
)
def test_honest_words_are_taken(text: str) -> None:
    shipped = resources.files("jaxlangnav.language").joinpath("data/lexicon.toml")
    assert read_lexicon(shipped.read_text("utf-8"), text).type_names[0] == "hydrant"


def test_what_is_no_file_is_refused_by_name_and_not_waited_for(tmp_path, monkeypatch):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "large").write_bytes(b"#" * 300_000)
    for path, says in (
        (tmp_path / "pipe", "is a pipe, not a regular file"),
        (tmp_path, "is a folder, not a regular file"),
        (tmp_path / "large", "more than 262,144 bytes"),
        (tmp_path / "nowhere.toml", r"nowhere\.toml"),
    ):
        monkeypatch.setenv(USER_LEXICON, str(path))
        with pytest.raises(ValueError, match=says):
            load_lexicon.__wrapped__()
