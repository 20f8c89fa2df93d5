"""Rewritings: verified by the parser, mixed by weight, calibrated; and who picks among readings."""

import json
import math
import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from jaxlangnav.cli import main as cli
from jaxlangnav.grounding import (
    ChoosingGrounder,
    Context,
    FirstGrounder,
    GraphGrounder,
    Grounded,
    RecordedRewrites,
    RewriteGrounder,
)
from jaxlangnav.grounding.readings import unpad_readings
from jaxlangnav.grounding.rewrites import MAX_REWRITES, check_temperature
from jaxlangnav.grounding.weights import load_shipped
from jaxlangnav.messages import BEHIND, FRONT, NONE
from jaxlangnav.training.shipped import MIN_TEMP, Judged, fit_source_temperature, log_likelihood

START = Context(is_under_way=False)
TYPES = load_shipped().type_names
BEHIND_CAR, BEFORE_CAR = "go to the cone behind the car", "go to the cone in front of the car"


@pytest.fixture(scope="module")
def graph() -> GraphGrounder:
    return GraphGrounder(load_shipped())


def rewriting(graph, *rewrites, temperature=1.0):
    return RewriteGrounder(graph, lambda text: rewrites if text else (), temperature=temperature)


def relations(grounded) -> dict[int, float]:
    """Probability of each first relation over the readings."""
    found: dict[int, float] = {}
    for reading, score in unpad_readings(grounded.instruction.readings):
        relation = reading.relations[0][1] if reading.relations else NONE
        found[relation] = found.get(relation, 0.0) + math.exp(score)
    return found


def goals_of(grounded: Grounded) -> tuple[int, ...]:
    assert grounded.spoken is not None
    return grounded.spoken.goals


def test_readings_are_mixed_by_weight(graph) -> None:
    rewrites = (BEFORE_CAR, math.log(0.2)), (BEHIND_CAR, math.log(0.6))
    grounded = rewriting(graph, *rewrites).ground("cone car", START)
    mixed = relations(grounded)
    before, behind = (relations(graph.ground(t, START)) for t in (BEFORE_CAR, BEHIND_CAR))
    for relation in (FRONT, BEHIND):
        expected = 0.25 * before.get(relation, 0) + 0.75 * behind.get(relation, 0)
        assert mixed[relation] == pytest.approx(expected, abs=1e-3)
    said = {one["relation"]: one["probability"] for one in grounded.annotations}
    assert said["behind"] == pytest.approx(0.75, abs=0.01)


def test_a_temperature_flattens_the_weights(graph) -> None:
    rewrites = ((BEHIND_CAR, math.log(0.9)), (BEFORE_CAR, math.log(0.1)))
    warm = rewriting(graph, *rewrites, temperature=2.0).ground("x", START)
    assert relations(warm)[BEHIND] == pytest.approx(0.75, abs=0.01)  # √0.9 : √0.1 is 3 : 1


def test_the_weightiest_meaning_commands_not_the_likeliest_wording(graph) -> None:
    grounded = rewriting(
        graph,
        ("go to the car", math.log(0.4)),
        (BEHIND_CAR, math.log(0.35)),
        ("move to the cone behind the car", math.log(0.25)),
    ).ground("x", START)
    own = graph.ground(BEHIND_CAR, START).instruction.clauses
    assert np.array_equal(grounded.instruction.clauses.named_types, own.named_types)
    assert [one.says for one in grounded.alternatives] == [BEHIND_CAR, "go to the car"]
    assert [one.probability for one in grounded.alternatives] == pytest.approx([0.6, 0.4])
    assert goals_of(grounded) == (TYPES.index("cone"),)
    best = unpad_readings(grounded.instruction.readings)[0][0]
    assert set(best.mentions) == {TYPES.index("cone"), TYPES.index("car")}


def test_what_cannot_be_read_is_dropped_and_counted(graph) -> None:
    grounded = rewriting(
        graph, ("go through the cone", math.log(0.5)), (BEHIND_CAR, math.log(0.5))
    ).ground("x", START)
    assert "1 of 2 rewritings cannot be read and are left out, 50% of the weight" in grounded.notes
    assert relations(grounded)[BEHIND] == pytest.approx(1.0, abs=0.01)


def test_where_none_is_left_one_line_says_so(graph) -> None:
    bad = ("go through the cone", -1.0), ("the cone is here", -2.0)
    with pytest.raises(ValueError, match="none of the 2 rewritings of 'x' can be read") as error:
        rewriting(graph, *bad).ground("x", START)
    assert "go through the cone" in str(error.value)
    assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match="has no rewriting of 'x'"):
        rewriting(graph).ground("x", START)
    with pytest.raises(ValueError, match="log-probability nan"):
        rewriting(graph, (BEHIND_CAR, math.nan)).ground("x", START)
    with pytest.raises(ValueError, match=r"temperature is 0\.0"):
        check_temperature(0.0)


def test_equal_rewritings_add_up_and_too_many_are_noted(graph) -> None:
    many = [("go to the car", math.log(0.3)), ("go to the car", math.log(0.3))]
    many += [(f"zzz {i}", -9.0 - i) for i in range(MAX_REWRITES)]
    grounded = rewriting(graph, *many, (BEHIND_CAR, math.log(0.4))).ground("x", START)
    assert "2 less likely rewritings are not read" in grounded.notes
    assert [one.probability for one in grounded.alternatives] == pytest.approx([0.6, 0.4])


def test_the_graph_is_asked_first(graph) -> None:
    both = FirstGrounder(graph, rewriting(graph, ("go to the car", 0.0)))
    assert both.type_names == graph.type_names
    read = both.ground("go to the cone", START)
    assert goals_of(read) == (TYPES.index("cone"),)
    rescued = both.ground("go through the zorbel", START)
    assert goals_of(rescued) == (TYPES.index("car"),)
    assert rescued.notes[0].startswith("not read as it stands: 'through'")
    with pytest.raises(ValueError, match="'through'"):
        FirstGrounder(graph, rewriting(graph)).ground("go through the zorbel", START)
    with pytest.raises(ValueError, match="type_names"):
        FirstGrounder(graph, GraphGrounder(load_shipped(), ["cone"]))


def test_a_person_picks_among_rewritings(graph) -> None:
    asked = []

    def pick(text, ways):
        asked.append((text, [one.says for one in ways]))
        return 1

    rewrites = ((BEHIND_CAR, math.log(0.7)), (BEFORE_CAR, math.log(0.29)))
    source = rewriting(graph, *rewrites, ("go to the tree", math.log(0.01)))
    grounded = ChoosingGrounder(source, pick).ground("x", START)
    assert asked == [("x", [BEHIND_CAR, BEFORE_CAR])]
    assert relations(grounded)[FRONT] == pytest.approx(1.0, abs=0.01)
    assert grounded.notes[0] == f"chosen: '{BEFORE_CAR}'"
    with pytest.raises(ValueError, match="none of the 2 ways"):
        ChoosingGrounder(source, lambda *_: None).ground("x", START)
    with pytest.raises(ValueError, match="the answer is 2"):
        ChoosingGrounder(source, lambda *_: 2).ground("x", START)


def test_nouns_without_a_label_keep_their_names() -> None:
    graph = GraphGrounder(load_shipped(), ["cone"])
    source = rewriting(graph, ("go to the cone near the zorbel", 0.0))
    asking = ChoosingGrounder(source, lambda *_: 0)
    asking.ground("x", START)
    assert FirstGrounder(asking, graph).names == ("cone", "zorbel")


def test_a_person_picks_among_readings() -> None:
    signs = GraphGrounder(load_shipped(), ["stop sign", "yield sign", "cone"])
    ways = []

    def pick(_, told):
        ways.extend(told)
        return next(i for i, one in enumerate(told) if "yield sign" in one.says)

    grounded = ChoosingGrounder(signs, pick).ground("go to the sign", START)
    assert [one.says for one in ways] == ["there is a stop sign", "there is a yield sign"]
    (reading, score), *others = unpad_readings(grounded.instruction.readings)
    assert reading.mentions == (1,)
    assert score == 0.0
    assert not others


def test_nobody_is_asked_where_one_way_is_left(graph) -> None:
    def never(*_):
        raise AssertionError

    assert ChoosingGrounder(graph, never).ground("go to the cone", START).instruction is not None


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("{", "is no valid JSON"),
        ({"text": 1, "rewrites": []}, "text is 1"),
        ({"text": "go", "rewrites": "x"}, "rewrites is 'x'"),
        ({"text": "go", "rewrites": [["x"]]}, r"rewrites\[0\] has 1 entries, but must have 2"),
        ({"text": "go", "rewrites": [["x", True]]}, r"rewrites\[0\]\[1\] is True, but must be a"),
        ({"text": "go", "rewrites": [["x", float("nan")]]}, "holds NaN"),
        ({"text": "a", "rewrites": []}, "earlier line"),
    ],
)
def test_a_bad_recording_is_refused_by_file_and_line(tmp_path, line, expected) -> None:
    path = tmp_path / "own.jsonl"
    first = json.dumps({"text": "a", "rewrites": [["go to the cone", -1]]})
    path.write_text(f"{first}\n{line if isinstance(line, str) else json.dumps(line)}\n")
    with pytest.raises(ValueError, match=rf"own\.jsonl:2: .*{expected}"):
        RecordedRewrites(path)


def test_a_recording_answers(tmp_path) -> None:
    path = tmp_path / "own.jsonl"
    path.write_text(json.dumps({"text": "a", "rewrites": [["go to the cone", -1]]}))
    assert RecordedRewrites(path)("a") == (("go to the cone", -1.0),)
    assert RecordedRewrites(path)("b") == ()
    path.write_text("\n")
    with pytest.raises(ValueError, match="holds no rewriting"):
        RecordedRewrites(path)
    with pytest.raises(ValueError, match="cannot read"):
        RecordedRewrites(tmp_path / "none.jsonl")


def test_the_temperature_that_labels_were_drawn_at_is_found() -> None:
    rng = np.random.default_rng(0)
    scores = rng.normal(scale=3.0, size=(4000, 3))
    weights = np.exp(scores / 2.5)
    weights /= weights.sum(axis=1, keepdims=True)
    drawn = (weights.cumsum(axis=1) > rng.random((4000, 1))).argmax(axis=1)
    judged = [
        Judged(tuple(map(float, row)), tuple(k == right for k in range(3)))
        for row, right in zip(scores, drawn, strict=True)
    ]
    fit = fit_source_temperature([*judged, Judged((-1.0,), (True,)), Judged((-1.0,), (False,))])
    step = 0.05  # the curvature gives the standard error of the estimate
    curvature = sum(
        weight * log_likelihood(judged, fit.temperature + shift)
        for weight, shift in ((1, step), (-2, 0), (1, -step))
    ) / (step**2)
    assert abs(fit.temperature - 2.5) < 5 / math.sqrt(-curvature * len(judged))
    assert (fit.used, fit.left_out, fit.is_at_bound) == (4000, 2, False)
    assert fit.log_likelihood > fit.log_likelihood_at_one


def test_a_source_that_is_always_right_is_believed_to_the_bound() -> None:
    fit = fit_source_temperature([Judged((-1.0, -2.0), (True, False))])
    assert fit.is_at_bound
    assert fit.temperature == pytest.approx(MIN_TEMP)
    with pytest.raises(ValueError, match="none of the 1 sentences"):
        fit_source_temperature([Judged((-1.0,), (True,))])


def test_arms_are_compared(tmp_path, capsys) -> None:
    label = {"things": [{"id": "a", "type": "cone"}], "commands": [{"goal": {"thing": "a"}}]}
    texts = ["go to the cone", "hit the cone", "never recorded"]
    sentences, recorded = tmp_path / "said.jsonl", tmp_path / "rewritten.jsonl"
    lines = [{"text": text, "label": label} for text in texts]
    sentences.write_text("\n".join(map(json.dumps, lines)))
    answers = [["go to the car", -0.5], ["go to the cone", -1.0]], [["go to the cone", -0.1]]
    lines = [
        {"text": text, "rewrites": rewrites} for text, rewrites in zip(texts, answers, strict=False)
    ]
    recorded.write_text("\n".join(map(json.dumps, lines)))
    run = ["evaluate", "--sentences", str(sentences), "--rewrites", str(recorded)]
    assert cli.main([*run, "--fit-temperature", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    counts = {name: (row["right"], row["wrong"]) for name, row in document["arms"].items()}
    assert counts == {"graph alone": (1, 0), "rewrites alone": (1, 1), "both": (2, 0)}
    assert document["fit"]["used"] == 1
    assert document["fit"]["is_at_bound"]
    assert cli.main([*run[:1], *run[3:]]) == 2
    assert cli.main([*run[:3], "--fit-temperature"]) == 2
    assert document["arms"]["both"]["meant"]["right"] == 2
    assert cli.main([*run, "--temperature", "-1"]) == 2
    assert "temperature is -1.0" in capsys.readouterr().err


def test_the_local_model_of_the_how_to_is_plugged_in_as_shown(monkeypatch) -> None:
    """The page's code runs as it stands, around a model that answers from a list."""
    answers = [" go to the gazebo"] * 15 + [" go to the bench"] * 4 + [" go through the gazebo"]

    class Llama:
        def __init__(self, *_, **__):
            self.left = list(answers)

        def create_completion(self, prompt, *, grammar, **_):
            assert "root ::=" in grammar
            assert "zigzag" in prompt
            return {"choices": [{"text": self.left.pop()}]}

    grammar = types.SimpleNamespace(from_string=lambda text: text)
    module = types.SimpleNamespace(Llama=Llama, LlamaGrammar=grammar)
    monkeypatch.setitem(sys.modules, "llama_cpp", module)
    page = (Path(__file__).parent.parent / "docs" / "extend.md").read_text("utf-8")
    (block,) = [one for one in re.findall(r"(?ms)^```python\n(.*?)^```", page) if "llama" in one]
    space: dict = {}
    exec(block, space)
    grounded = space["both"].ground("zigzag through the gazebo", START)
    assert goals_of(grounded) == (0,)
    assert any("1 of 3 rewritings cannot be read" in note for note in grounded.notes)
    assert grounded.alternatives[0].probability == pytest.approx(15 / 19)
