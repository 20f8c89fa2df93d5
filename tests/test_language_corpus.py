"""Corpora: format, validator, labels against labels made by hand, and what design.md asks."""

import json
import re
from collections import Counter
from importlib import resources

import pytest
from corpus_labels import annotate, behave

from jaxlangnav.language import corpus
from jaxlangnav.language.corpus import PlacedWorld, load_corpus, read_corpus, read_example
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.parser import parse
from jaxlangnav.messages import MODES, RELATIONS

EVALUATED = {
    "go to the hydrant",
    "go to the hydrant behind the cone",
    "go to the hydrant nearest to the cone",
}
# Robot at the origin facing +x; hydrant 0 is 2 m behind the cone, hydrant 2 stands to its left.
WORLD = PlacedWorld(
    objects=(
        ("hydrant", 8.0, 0.0), ("cone", 6.0, 0.0), ("hydrant", 6.0, 3.0), ("car", 5.0, 6.0),
    ),
    robot=(0.0, 0.0, 0.0),
)  # fmt: skip


def behavior(text: str, world: PlacedWorld = WORLD) -> list[set[str]]:
    """Behavior labels of a sentence of one clause, children first."""
    return [set(symbols) for symbols in behave(parse(text).clauses[0], world)]


def test_annotation_of_the_papers_sentence():
    stated = {"relation(hydrant,behind,cone)"}
    labels, _ = annotate(parse("go to the hydrant behind the cone").clauses[0])
    assert list(map(set, labels)) == [
        {"object(hydrant)"}, {"object(cone)"}, {"region(behind,cone)"}, stated, stated, stated,
    ]  # fmt: skip


def test_behavior_of_the_papers_sentence():
    assert behavior("go to the hydrant behind the cone") == [
        {"object(0)", "object(2)"},
        {"object(1)"},
        {"region(behind,1)"},
        {"object(0)"},
        {"region(at,0)"},
        {"action(navigate)", "mode(normal)", "goal(at,0)"},
    ]


def test_the_other_is_not_the_previous_goal():
    world = PlacedWorld(objects=WORLD.objects, robot=WORLD.robot, previous=2)
    for text in ("go to the other hydrant", "go to the other one"):
        assert behavior(text, world)[-1] == {"action(navigate)", "mode(normal)", "goal(at,0)"}


@pytest.mark.parametrize(
    ("name", "every"),
    [("corpus39", 1), ("corpus", 20), pytest.param("corpus", 1, marks=pytest.mark.slow)],
)
def test_labels_agree_with_the_rules_in_every_world(name, every):
    """The files hold explicit labels; here they are composed anew."""
    for example in load_corpus(name)[::every]:
        for root, labels in zip(example.parse.clauses, example.clauses, strict=True):
            assert annotate(root) == (labels.annotation, labels.rank)
        assert example.parse.unknown_words == ()
        if len(example.clauses) > 1:
            continue
        for placed in example.worlds:
            assert behave(example.parse.clauses[0], placed.world) == placed.behavior[0]
            goals = [s for s in placed.behavior[0][-1] if s.startswith(("goal", "constraint"))]
            assert goals, example.text


def words_of(text: str) -> list[str]:
    return text.replace(",", "").split()


def test_the_39_are_no_easier_than_the_papers():
    examples = load_corpus("corpus39")
    assert len(examples) == 39
    roots = [example.parse.clauses[0] for example in examples]
    phrases = [len(list(root.walk())) for root in roots]
    assert abs(sum(phrases) / 39 - 6.5) < 0.05
    senses = {s for root in roots for w in root.all_words() for s in w.senses}
    assert {f"type:{name}" for name in load_lexicon().type_names[:8]} <= senses
    assert {f"relation:{name}" for name in RELATIONS} <= senses
    behaviors = {s for e in examples for w in e.worlds for s in w.behavior[0][-1]}
    assert {f"mode({mode})" for mode in MODES} <= behaviors
    assert {"action(navigate)", "action(find)"} <= behaviors
    counts = Counter(word for example in examples for word in words_of(example.text))
    with_hapax = [e for e in examples if any(counts[w] == 1 for w in words_of(e.text))]
    assert len(with_hapax) >= 13
    assert max(Counter(e.template for e in examples).values()) <= 39 // 5
    assert not EVALUATED & {example.text for example in examples}


def test_the_large_corpus_is_split_by_template():
    examples = load_corpus("corpus")
    assert len(examples) >= 300
    train = [e for e in examples if e.split == "train"]
    test = [e for e in examples if e.split == "test"]
    assert min(len(train), len(test)) > 100
    assert not {e.template for e in train} & {e.template for e in test}
    assert len({e.text for e in examples}) == len(examples)
    assert not EVALUATED & {e.text for e in examples}
    for part in (train, test):
        senses = {s for e in part for c in e.parse.clauses for w in c.all_words() for s in w.senses}
        assert {f"relation:{name}" for name in RELATIONS} <= senses
        assert {"constraint", "superlative", "other", "mode:quickly", "action:find"} <= senses
        assert {kind for e in part for kind in e.parse.kinds} == {"command", "statement"}
        assert any(len(e.clauses) > 1 for e in part)


def test_relations_matter_in_the_worlds():
    """In most worlds of a figure and landmark a rival of the figure's type is the wrong goal."""
    examples = [e for e in load_corpus("corpus") if e.template.startswith("rel-")]
    rivals = [
        len(placed.behavior[0][0]) > sum(s.startswith("goal") for s in placed.behavior[0][-1])
        for example in examples
        for placed in example.worlds
    ]
    assert sum(rivals) / len(rivals) > 0.5


FILE = resources.files("jaxlangnav.language") / "data/corpus39.jsonl"
LINES = (json.loads(line) for line in FILE.read_text("utf-8").splitlines() if line[0] == "{")
SOUND = next(line for line in LINES if line["text"] == "go to the nearest tree")


def changed(*path, value):
    """Copy the sound record with one place changed."""
    record = json.loads(json.dumps(SOUND))
    place = record
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    return json.dumps(record)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("{", "is no valid JSON"),
        ("{}", "text is missing: add it"),
        (changed("split", value="dev"), "must be one of: test, train"),
        (changed("text", value="do not go"), "refused: 'not'"),
        (changed("text", value="go to the car"), "the parser finds the phrases"),
        (changed("clauses", 0, "kind", value="statement"), "kind is 'command'"),
        (changed("clauses", 0, "rank", value=[0]), "1 rank for 5 phrases"),
        (changed("clauses", 0, "annotation", 0, value=["object(sofa)"]), "'sofa' is none of"),
        (changed("clauses", 0, "annotation", 0, value=["a\nb"]), r"'a\nb' is no symbol"),
        (changed("worlds", 0, "behavior", 0, 0, value=["object(9)"]), "'9' is none of 0"),
        (changed("worlds", 0, "behavior", 0, value=[[]]), "1 labels for 5 phrases"),
        (changed("worlds", 0, "objects", value=[["sofa", 0, 0]]), "object type 'sofa'"),
        (changed("worlds", 0, "previous", value=7), "below 4, not 7"),
        ("[" * 100_000, "nested more than 32 deep"),
        (changed("template", value="a\x1b[31m"), "template has the control character U+001B"),
        (changed("worlds", 0, "objects", 0, 1, value=1e39), "objects[0][1] is 1e+39, but must"),
        (changed("worlds", 0, "objects", 0, 0, value=["cone"]), "[0][0] is ['cone'], but must"),
    ],
)
def test_faults_are_named(line, message):
    with pytest.raises(ValueError, match=re.escape(message)) as error:
        read_example(line)
    assert "\n" not in str(error.value)


def test_files_are_checked_with_line_numbers(tmp_path, capsys):
    path = tmp_path / "own.jsonl"
    path.write_text(json.dumps(SOUND) + "\n\n# a comment\n" + changed("split", value="test"))
    with pytest.raises(ValueError, match=r"own.jsonl line 4: template 'robot' is in both splits"):
        read_corpus(path)
    assert corpus.main([str(path)]) == 2
    path.write_text(json.dumps(SOUND))
    assert corpus.main([str(path)]) == 0
    assert "1 instructions, 5 phrases" in capsys.readouterr().out
    path.write_text("")
    with pytest.raises(ValueError, match="no instruction"):
        read_corpus(path)
    with pytest.raises(ValueError, match="cannot read"):
        read_corpus(tmp_path / "missing.jsonl")
