"""What a sentence asks for in the world that it speaks of: told before anything has been seen."""

import pytest

from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.grounding.asked import asked
from jaxlangnav.messages import AT, BEHIND, NEAR, NONE


@pytest.fixture(scope="module")
def ask():
    model = load_shipped()

    def of(text: str):
        understood = understand(text, model)
        kinds = understood.instruction.readings.mention_type[0].tolist()
        names = (*understood.type_names, "nothing")
        found = asked(understood.instruction)
        return found, [names[kinds[one.mention] if one.mention >= 0 else NONE] for one in found]

    return of


def test_commands_and_what_to_keep_away_from(ask) -> None:
    found, goals = ask("go to the hydrant behind the cone and avoid the car, then find the bench")
    assert goals == ["hydrant", "bench"]
    assert [one.action for one in found] == ["navigate", "find"]
    assert [one.region for one in found] == [AT, AT]
    assert [len(one.avoid) for one in found] == [1, 0]
    assert found[0].avoid[0][0] == NEAR
    # The hydrant is placed against the cone; the car and the bench are no business of its.
    assert [len(one.against) for one in found] == [1, 0]


def test_a_region_and_a_manner(ask) -> None:
    found, goals = ask("carefully move behind the cone")
    assert goals == ["cone"]
    assert found[0].region == BEHIND
    assert found[0].mode == "carefully"


def test_the_other_one_is_none_that_was_named(ask) -> None:
    _, goals = ask("go to the cone, then go to the other cone")
    assert goals == ["cone", "nothing"]
