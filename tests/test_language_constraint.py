"""Clauses that only say what to keep away from: joined to commands, and never a goal."""

import pytest

from jaxlangnav.experiments.tasks import ground_sentences
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.language.parser import parse

ALONE = (
    "avoid the cone",
    "stay away from the red car please",
    "steer clear of the barrels",
    "keep your distance from the building",
    "watch out for the hydrant behind the cone",
    "avoid the cone then stay away from the car",
)


@pytest.mark.parametrize(
    ("text", "trees"),
    [
        (
            "go to the car. then avoid the cone",
            ["VP[go]{PP[to]{NP[the car]}, VP[then avoid]{NP[the cone]}}"],
        ),
        ("avoid the cone. then avoid the car", None),
    ],
)
def test_a_constraint_after_a_command_is_part_of_it(text: str, trees: list[str] | None) -> None:
    parsed = parse(text)
    if trees is None:
        assert len(parsed.clauses) == 2
    else:
        assert [str(clause) for clause in parsed.clauses] == trees
    assert len(parsed.kinds) == len(parsed.clauses)


@pytest.mark.parametrize("text", ALONE)
def test_a_constraint_alone_is_no_task(text: str) -> None:
    understood = understand(text, load_shipped())
    with pytest.raises(ValueError, match="not where to go") as caught:
        understood.check_task()
    assert "\n" not in str(caught.value)
    with pytest.raises(ValueError, match="not where to go"):
        ground_sentences(["go to the car", text])


def test_to_go_somewhere_and_keep_away_from_it_is_refused() -> None:
    understood = understand("go to the car then stay away from it", load_shipped())
    with pytest.raises(ValueError, match="'then stay away from it' asks to keep away"):
        understood.check_task()


def test_a_statement_alone_is_no_task() -> None:
    with pytest.raises(ValueError, match="asks for nothing to be done"):
        understand("the hydrant is behind the cone", load_shipped()).check_task()


@pytest.mark.parametrize(
    "text", ["go to the bench but avoid the cone", "avoid the car and find the cone"]
)
def test_a_constraint_with_a_command_is_a_task(text: str) -> None:
    understand(text, load_shipped()).check_task()
