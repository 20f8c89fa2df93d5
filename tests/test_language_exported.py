"""The exported grammar: what the parser reads it accepts, and what it makes the parser reads."""

import json
import math
import random
import re
from importlib import resources

import pytest
from lark import Lark

from jaxlangnav.cli import main as cli
from jaxlangnav.language.exported import Rules, export_grammar, exported_rules, spaced
from jaxlangnav.language.grammar import load_grammar
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import LanguageError

NOUNS = ("gazebo", "fire hydrant")
MOST_WORDS = 40
OF_MEANING = re.compile(r"stands? for|contradicts|name the object|is it the")
"""Refusals of sentences that the grammar makes: what points back, and what contradicts itself."""


@pytest.fixture(scope="module")
def lark() -> Lark:
    return Lark(export_grammar("lark", NOUNS), parser="earley", lexer="dynamic")


def test_lark_accepts_what_the_parser_reads(lark: Lark) -> None:
    corpus = resources.files("jaxlangnav.language").joinpath("data/corpus.jsonl").read_text("utf-8")
    texts = [json.loads(line)["text"] for line in corpus.splitlines()]
    read = 0
    for text in [
        *random.Random(0).sample(texts, 12),
        "go to the white gazebo near the fire hydrant",
    ]:
        found = parse(text, NOUNS)
        if not (found.repairs or found.rewrites or found.unread):
            lark.parse(spaced(text).rstrip(" .!"))
            read += 1
    assert read > 8


@pytest.mark.parametrize("text", ["go through the cone", "go to the zorbel", "goto thecone"])
def test_lark_refuses_what_is_no_controlled_language(lark: Lark, text: str) -> None:
    with pytest.raises(Exception, match=r"No terminal|Unexpected"):
        lark.parse(spaced(text))


def make(rules: Rules, weights: dict, rng: random.Random) -> list[str]:
    """Draw a sentence by the weights that the parser has."""
    waiting, words = ["start"], []
    while waiting:
        part = waiting.pop()
        if part[0] == '"':
            words.append(part.strip('"'))
            continue
        ways = rules[part]
        shares = [weights.get((part, way), 0.01) for way in ways]
        waiting += reversed(rng.choices(ways, shares)[0])
    return words


def test_the_parser_reads_what_the_grammar_makes() -> None:
    grammar, rng = load_grammar(), random.Random(0)
    rules = exported_rules(grammar, NOUNS)
    weights = {(one.left, one.right): math.exp(one.log_probability) for one in grammar.productions}
    read, refused = 0, []
    while read + len(refused) < 60:
        words = make(rules, weights, rng)
        if len(words) > MOST_WORDS:
            continue
        text = " ".join({"comma": ",", "fullstop": "."}.get(one, one) for one in words)
        try:
            parse(text, NOUNS, is_nearest_offered=False)
            read += 1
        except LanguageError as error:
            refused.append((text, str(error)))
    assert [one for one in refused if not OF_MEANING.search(one[1])] == []
    assert read >= 48


def test_nothing_calls_itself_first() -> None:
    rules = exported_rules(load_grammar(), NOUNS)  # llama.cpp takes no left recursion
    first = {left: {way[0] for way in ways if way[0][0] != '"'} for left, ways in rules.items()}
    for left in rules:
        found, waiting = set(), set(first[left])
        while waiting:
            one = waiting.pop()
            found.add(one)
            waiting |= first[one] - found
        assert left not in found


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


def test_the_command_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["parse", "--grammar", "gbnf", "--nouns", *NOUNS]) == 0
    assert capsys.readouterr().out == export_grammar("gbnf", NOUNS)
    assert cli.main(["parse", "--grammar", "lark", "--nouns", "4x4!"]) == 2
    assert "'4x4!' is no noun" in capsys.readouterr().err
    assert cli.main(["parse", "go to the cone", "--nouns", "gazebo"]) == 2
    assert cli.main(["parse", "go to the cone", "--grammar", "lark"]) == 2
    assert cli.main(["parse"]) == 2
