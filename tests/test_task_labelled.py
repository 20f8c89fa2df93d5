"""Labelled sentences: the format, its refusals, and how readings are scored."""

import json
from collections import Counter
from pathlib import Path

import pytest

from jaxlangnav.cli import main as cli
from jaxlangnav.grounding.weights import load_shipped
from jaxlangnav.task.evaluation import render_scores, score_sentences, summarize_scores
from jaxlangnav.task.labelled import read_sentences

SENTENCES = read_sentences(Path(__file__).with_name("sentences.jsonl"))
"""Of people who had not seen the grammar, set by set (docs/language.md)."""


def thing(name: str, ident: str = "a") -> dict[str, str]:
    return {"id": ident, "type": name}


CONE = {"things": [thing("cone")], "commands": [{"goal": {"thing": "a"}}]}


def write(path: Path, *lines: object) -> Path:
    path.write_text("\n".join(x if isinstance(x, str) else json.dumps(x) for x in lines))
    return path


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("{", "is no valid JSON"),
        ("[]", "the document is [], but must be a table"),
        ({"text": "go"}, "label is missing"),
        ({"label": "refuse"}, "text is missing"),
        ({"text": 3, "label": "refuse"}, "text is 3"),
        ({"text": "go", "label": "refused"}, "must be 'refuse' or an object"),
        ({"text": "go", "label": "refuse", "note": ""}, "note is unknown"),
        ({"text": "go", "label": {"things": [], "probability": 1}}, "probability"),
        ({"text": "go", "label": {"things": [thing("cone", x) for x in "abcde"]}}, "label has 0"),
        ({"text": "go", "label": {**CONE, "commands": [{"goal": {"thing": "b"}}]}}, "goal.thing"),
    ],
)
def test_a_bad_line_is_refused_by_file_and_line(tmp_path, line, expected, capsys):
    file = write(tmp_path / "own.jsonl", {"text": "go", "label": "refuse"}, "", line)
    with pytest.raises(ValueError, match=r"own\.jsonl:3: ") as error:
        read_sentences(file)
    assert expected in str(error.value)
    assert cli.main(["evaluate", "--sentences", str(file)]) == 2
    assert "own.jsonl:3" in capsys.readouterr().err


def test_no_file_and_an_empty_one_are_refused(tmp_path):
    with pytest.raises(ValueError, match="cannot read"):
        read_sentences(tmp_path / "none.jsonl")
    with pytest.raises(ValueError, match="holds no sentence"):
        read_sentences(write(tmp_path / "empty.jsonl", ""))


def test_types_are_named_as_the_lexicon_names_them(tmp_path):
    label = {"things": [thing("house"), thing("gazebo", "b")]}
    (one,) = read_sentences(write(tmp_path / "a.jsonl", {"text": "x", "label": label}))
    assert one.meaning.type_names == ("building", "gazebo")


def near(figure: str, landmark: str, **more: int) -> dict[str, object]:
    return {"figure": figure, "relation": "near", "landmark": landmark, **more}


PAIR = {"things": [thing("cone"), thing("car", "b")], "relations": [near("a", "b")]}
TWICE = {"commands": CONE["commands"] * 2}
SCORED = [
    ("go to the cone", CONE, "right"),
    ("go to the cone by the car", {**PAIR, "commands": [{"goal": {"thing": "a"}}]}, "right"),
    ("go to the car by the cone", {**PAIR, "commands": [{"goal": {"thing": "a"}}]}, "wrong"),
    ("go to the cone", {**PAIR, "commands": [{"goal": {"thing": "a"}}]}, "wrong"),
    ("go to the nearest cone", CONE, "wrong"),
    ("find the cone", CONE, "wrong"),
    ("quickly go to the cone", CONE, "wrong"),
    ("stop behind the cone", CONE, "wrong"),
    ("go to the cone and avoid the car", CONE, "wrong"),
    ("go to the cone then to the cone", CONE, "right"),  # asks for nothing new
    ("go to the cone then to the cone", {**CONE, **TWICE}, "right"),
    ("go to the cone by the car then to the car", {**PAIR, **TWICE}, "wrong"),
    ("the cone is near the car", PAIR, "right"),  # informs, as its label does
    ("the cone is near the car", CONE, "refused"),
    ("go through the cone", CONE, "refused"),
    ("go through the cone", "refuse", "right"),
    ("go to the cone", "refuse", "wrong"),
]


def test_sentences_are_scored_by_what_they_ask_for(tmp_path):
    lines = [{"text": t, "label": m, "construction": o} for t, m, o in SCORED]
    scores = score_sentences(read_sentences(write(tmp_path / "a.jsonl", *lines)), load_shipped())
    assert [(one.sentence.text, one.outcome) for one in scores] == [(t, o) for t, _, o in SCORED]
    document = summarize_scores(scores)
    assert document["sentences"] == len(SCORED)
    assert [document["by_construction"][name][name] for name in ("right", "refused")] == [6, 2]
    kinds = [one["outcome"] for one in document["worst"]]
    assert kinds == sorted(kinds, reverse=True)  # wrong before refused
    table, listed = render_scores(document)
    assert table.row_count == 4
    assert len(listed) == len(document["worst"])


def test_the_detector_knows_the_types_that_labels_name(tmp_path):
    gazebo = {"things": [thing("gazebo")], "commands": [{"goal": {"thing": "a"}}]}
    lines = [
        {"text": "go to the gazebo", "label": gazebo},
        {"text": "go to the zorbel", "label": "refuse"},
        {"text": "go to the cone near the zorbel", "label": CONE},
    ]
    sentences = read_sentences(write(tmp_path / "a.jsonl", *lines))
    scores = score_sentences(sentences, load_shipped())
    assert [one.outcome for one in scores] == ["right", "right", "wrong"]
    assert "zorbel" in scores[2].reason


PART_OF = {"spoken": "spoken"} | {f"twenty-{n}": "new" for n in ("fourth", "fifth", "sixth")}
PARTS = {"learned": (4026, 75), "new": (495, 10), "spoken": (510, 2)}
"""How many are right, at least, and wrong, at most: of sets that training sentences were written
from or against, of unseen ones, and of templates' sentences."""


def outcomes(part: str, every: int = 1) -> Counter[str]:
    """Count the outcomes of a part; each set has a detector of its own labels."""
    names = {s.set for s in SENTENCES if PART_OF.get(s.set, "learned") == part}
    sets = [[s for s in SENTENCES if s.set == name][::every] for name in sorted(names)]
    return Counter(one.outcome for some in sets for one in score_sentences(some, load_shipped()))


def test_every_ninth_of_the_shipped_sentences_stays_as_well_read():
    counts = sum((outcomes(part, every=9) for part in PARTS), Counter())
    assert counts["right"] >= 580
    assert counts["wrong"] <= 9


@pytest.mark.slow
@pytest.mark.parametrize("part", PARTS)
def test_shipped_sentences_stay_as_well_read(part):
    counts, (least, most_wrong) = outcomes(part), PARTS[part]
    assert counts["right"] >= least
    assert counts["wrong"] <= most_wrong
