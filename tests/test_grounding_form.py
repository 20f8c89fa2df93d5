"""Annotations from a form: what is refused and how, and what the readings hold."""

import copy
import itertools
import json
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from jaxlangnav.grounding import AnnotationGrounder, Context
from jaxlangnav.grounding.form import annotation_schema, read_form, validate
from jaxlangnav.grounding.instruction import NUM_CLAUSES
from jaxlangnav.grounding.readings import NUM_EDGES, NUM_MENTIONS, NUM_READINGS
from jaxlangnav.messages import ACTIONS, BETWEEN, LEFT, MODES, NEAR, NONE, REGIONS, RELATIONS, ROBOT
from jaxlangnav.relations.table import NUM_RANKS

TYPES = ("hydrant", "cone", "car")
FORM = {
    "readings": [
        {
            "probability": 0.8,
            "things": [{"id": "a", "type": "hydrant"}, {"id": "b", "type": "cone"}],
            "relations": [{"figure": "a", "relation": "behind", "landmark": "b"}],
            "commands": [
                {
                    "action": "navigate",
                    "mode": "quickly",
                    "goal": {"region": "at", "thing": "a"},
                    "avoid": ["b"],
                }
            ],
        },
        {
            "probability": 0.2,
            "things": [{"id": "x", "type": "car"}],
            "relations": [{"figure": "x", "relation": "near", "landmark": "robot", "rank": 1}],
            "commands": [{"goal": {"thing": "x"}}],
        },
    ],
    "notes": ["'pylon' was taken for a cone"],
}
START = Context(is_under_way=False)
FIRST, SECOND = ("readings", 0), ("readings", 1)
COMMAND, RELATION = (*FIRST, "commands", 0), (*FIRST, "relations", 0)


def changed(*path: str | int, to: object = ...) -> dict:
    """Set one field of the form, at the end of a path, or take it out."""
    document = copy.deepcopy(FORM)
    place: Any = document
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = to
    if to is ...:
        del place[path[-1]]
    return document


def things(count: int) -> list[dict]:
    return [{"id": f"t{i}", "type": "cone"} for i in range(count)]


def between(landmarks: Iterable[str]) -> list[dict]:
    """Say that the hydrant lies between things."""
    return [{"figure": "a", "relation": "between", "landmark": one} for one in landmarks]


def refused(document: object) -> str:
    """Hold a document against the schema: the refusal, one short line; nothing if it fits."""
    said = ""
    try:
        validate(document)
    except ValueError as error:
        said = str(error)
    assert not said or re.search("but (may|must|at most)|is missing", said)
    assert "\n" not in said
    assert len(said) < 300
    return said


def paths(document: object, path: tuple = ()) -> Iterator[tuple]:
    """Yield the path of every field and entry."""
    parts = document.items() if isinstance(document, dict) else enumerate(document)
    for name, own in parts:
        yield (*path, name)
        if isinstance(own, dict | list):
            yield from paths(own, (*path, name))


ANYTHING = (
    ..., None, True, -1, 0, 1, 2.0, 2.5, 1e9, "", "a", "robot", "near", "x" * 33, "x" * 201, [],
    ["a"], ["b"] * 4, [FORM["readings"][0]] * 6, things(7), [{}], {}, {"a": 1},
)  # fmt: skip


def test_any_value_in_any_place_is_taken_or_refused_as_the_schema_says() -> None:
    """The refusal names a field that does not fit."""
    Draft202012Validator.check_schema(annotation_schema())
    schema, num_taken, num_refused = Draft202012Validator(annotation_schema()), 0, 0
    for path, value in itertools.product(paths(FORM), ANYTHING):
        document = changed(*path, to=value)
        wrong = [error.json_path for error in schema.iter_errors(document)]
        field = refused(document).partition(" ")[0]
        assert bool(field) == bool(wrong), (path, value)
        assert not field or any(field.startswith(one) for one in wrong), (field, wrong)
        num_taken, num_refused = num_taken + (not field), num_refused + bool(field)
    assert 50 < num_taken < num_refused


def test_the_schema_names_what_the_engine_knows() -> None:
    """The published file is read by others too, so it holds the names and sizes itself."""
    parts = annotation_schema()["$defs"]
    reading, relation, command = (
        parts[name]["properties"] for name in ("reading", "relation", "command")
    )
    assert relation["relation"]["enum"] == [*RELATIONS, "between"]
    assert relation["rank"]["maximum"] == NUM_RANKS
    assert command["goal"]["properties"]["region"]["enum"] == list(REGIONS)
    assert command["action"]["enum"] == list(ACTIONS)
    assert command["mode"]["enum"] == list(MODES)
    sizes = {name: reading[name]["maxItems"] for name in ("things", "relations", "commands")}
    assert sizes == {
        "things": NUM_MENTIONS, "relations": NUM_EDGES, "commands": NUM_CLAUSES,
    }  # fmt: skip
    assert annotation_schema()["properties"]["readings"]["maxItems"] == NUM_READINGS


# Text or document → what the refusal says. None of this can be said by a schema.
MEANINGLESS: list[tuple[object, str]] = [
    ("go to the hydrant", "annotations: is no valid JSON: Expecting value: line 1 column 1"),
    ('{"readings": NaN}', "NaN, which is no number"),
    ('{"notes": [], "notes": []}', "'notes' twice"),
    ("[" * 20_000, "is nested more than"),
    ('{"readings": [{"probability": 1%s, "things": []}]}' % ("0" * 5000), "too many digits"),
    (" " * 70_000, "70,000 characters; at most 65,536"),
    (changed(*FIRST, "probability", to=0.5), "sum to 0.7, but must sum to 1"),
    (changed(*FIRST, "things", 1, "type", to="gazebo"),
     r"\$.readings\[0\].things\[1\].type is 'gazebo', but must be one of hydrant, cone, car"),
    (changed(*FIRST, "things", 1, "id", to="a"),
     r"things\[1\].id is 'a', which an earlier thing has"),
    (
        changed(*SECOND, "commands", 0, "goal", "thing", to="a"),
        r"\$.readings\[1\].commands\[0\].goal.thing is 'a', but this reading has no such thing: "
        "use one of robot, x",
    ),
    (changed(*RELATION, "landmark", to="a"), "landmark is 'a', as the figure is"),
    (changed(*RELATION, "figure", to="robot"), "figure is 'robot', but must be a thing"),
    (changed(*RELATION, "rank", to=1), "nothing is ordered by behind"),
    (changed(*RELATION, "relation", to="between"),
     r"\$.readings\[0\].relations has 'a' between 'b', but a thing lies between two"),
    (changed(*FIRST, "relations", to=between("bb")), "'a' between 'b', but"),
    (changed(*FIRST, "relations", to=between(["b", "robot"])),
     r"relations\[1\].landmark is 'robot', but what lies between the robot"),
    (changed(*COMMAND, "avoid", to=["a"]), "'a', which is the goal"),
    (changed(*COMMAND, "avoid", to=["robot"]), "must be a thing"),
    (changed(*COMMAND, "goal", "thing", to="robot"), "the robot is always at itself"),
    (changed(*SECOND, "commands"), r"\$.readings\[1\].commands has 0 entries"),
    (changed(*SECOND, "things", to=[{"id": "x", "type": "car"}, *things(5)]),
     r"\$.readings\[1\] speaks of 7 things, with the robot; at most 6"),
    (changed(*FIRST, "things", to=[*FORM["readings"][0]["things"], *things(4)]),
     r"\$.readings\[0\] has 1 relations and 4 things in none; at most 4"),
]  # fmt: skip


@pytest.mark.parametrize(("form", "reason"), MEANINGLESS)
def test_what_cannot_be_is_refused_in_one_line(form: object, reason: str) -> None:
    text = form if isinstance(form, str) else json.dumps(form)
    with pytest.raises(ValueError, match=reason) as refused:
        AnnotationGrounder(TYPES).ground(text, START)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


def test_a_form_that_only_informs_is_for_a_robot_under_way() -> None:
    document = copy.deepcopy(FORM)
    for reading in document["readings"]:
        del reading["commands"]
    grounder = AnnotationGrounder(TYPES)
    with pytest.raises(ValueError, match="inform, but ask for nothing"):
        grounder.ground(json.dumps(document), START)
    told = grounder.ground(json.dumps(document), Context(is_under_way=True))
    assert int(told.instruction.num_clauses) == 0
    assert int(told.instruction.readings.mention_type[0, 0]) == TYPES.index("cone")


def test_readings_are_those_of_the_form() -> None:
    grounded = AnnotationGrounder(TYPES).ground(json.dumps(FORM), START)
    readings = grounded.instruction.readings
    np.testing.assert_array_equal(readings.mention_type[:2, :2], [[1, 0], [ROBOT, 2]])
    np.testing.assert_array_equal(readings.figure[:2, 0], [1, 1])
    np.testing.assert_array_equal(readings.landmark[:2, 0], [0, 0])
    np.testing.assert_array_equal(readings.relation[:2, :2], [[1, NONE], [NEAR, NONE]])
    np.testing.assert_array_equal(readings.rank[:2, 0], [0, 1])
    np.testing.assert_allclose(np.exp(readings.log_probability), [0.8, 0.2, 0, 0], atol=1e-6)
    assert grounded.notes == ("'pylon' was taken for a cone",)
    assert grounded.annotations[0] == {
        "figure": "hydrant", "relation": "behind", "landmark": "cone", "superlative": False,
        "probability": 0.8,
    }  # fmt: skip
    assert grounded.annotations[1]["landmark"] == "robot"
    assert grounded.annotations[1]["superlative"]


def test_probabilities_that_people_round_are_made_to_sum_to_one() -> None:
    document = changed(*FIRST, "probability", to=0.795)
    form = read_form(json.dumps(document), TYPES)
    assert sum(one.probability for one in form.readings) == pytest.approx(1.0)


def test_landmarks_come_before_the_figures_beside_them() -> None:
    """Each relation is grounded given the earlier ones, in whatever order the form has them."""
    document = copy.deepcopy(FORM)
    document["readings"][0]["things"].append({"id": "c", "type": "car"})
    document["readings"][0]["relations"] = [
        {"figure": "a", "relation": "near", "landmark": "b"},
        {"figure": "b", "relation": "left", "landmark": "c"},
    ]
    readings = AnnotationGrounder(TYPES).ground(json.dumps(document), START).instruction.readings
    np.testing.assert_array_equal(readings.relation[0, :2], [LEFT, NEAR])
    np.testing.assert_array_equal(readings.mention_type[0, :3], [2, 1, 0])


def test_what_lies_between_two_things_has_a_relation_with_each() -> None:
    more = [{"id": name, "type": "cone"} for name in "cd"]
    document = changed(*FIRST, "things", to=[*FORM["readings"][0]["things"], *more])
    document["readings"][0]["relations"] = between("bcd")
    with pytest.raises(ValueError, match="'a' between 'b', 'c', 'd', but a thing lies between two"):
        AnnotationGrounder(TYPES).ground(json.dumps(document), START)
    document["readings"][0]["relations"] = between("bc")
    grounded = AnnotationGrounder(TYPES).ground(json.dumps(document), START)
    readings = grounded.instruction.readings
    np.testing.assert_array_equal(readings.mention_type[0, :4], [1, 0, 1, 1])
    np.testing.assert_array_equal(readings.figure[0, :3], [1, 1, 3])
    np.testing.assert_array_equal(readings.landmark[0, :3], [0, 2, NONE])
    np.testing.assert_array_equal(readings.relation[0, :3], [BETWEEN, BETWEEN, NONE])
    np.testing.assert_array_equal(readings.rank[0, :3], 0)
    assert grounded.annotations[0]["relation"] == "between"


@pytest.mark.parametrize(
    "build", [lambda: (), lambda: ("cone", "cone"), lambda: tuple(map(str, range(8193)))]
)
def test_types_that_cannot_be_told_apart_are_refused(build: Callable[[], tuple]) -> None:
    with pytest.raises(ValueError, match="1 to 8191 are held, each once"):
        AnnotationGrounder(build())


def test_the_form_in_the_documentation_is_taken() -> None:
    """And so is the grounder that is written there around a model."""
    page = (Path(__file__).parent.parent / "docs" / "extend.md").read_text("utf-8")
    section = page.split("## Annotations from a form")[1].split("\n## ")[0]
    document = section.split("```json\n")[1].split("```")[0]
    names: dict = {}
    exec(section.split("```python\n")[2].split("```")[0], names)
    asked: list[str] = []

    def ask(prompt: str) -> str:
        asked.append(prompt)
        return document

    grounded = names["Asked"](ask, ("gazebo", "bridge")).ground("go there", START)
    assert int(grounded.instruction.num_clauses) == 2
    assert "go there" in asked[0]
    assert "gazebo, bridge" in asked[0]
    assert "exclusiveMinimum" in asked[0]
    refusal = section.split("`$.")[1].split("`")[0]
    wrong = changed(*RELATION, "relation", to="above")
    with pytest.raises(ValueError, match="above") as refused:
        AnnotationGrounder(TYPES).ground(json.dumps(wrong), START)
    assert str(refused.value) == f"$.{refusal}"
