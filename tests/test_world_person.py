"""The law of the simulated person, held against its words."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from recording_fixture import make_scene

from jaxlangnav.messages import NONE
from jaxlangnav.world.person import PERSONS, Person, RobotView, Says, new_person, params_of, utter

SCENARIO = jax.tree.map(jnp.asarray, make_scene().scenario)  # the goal at (9, 1), a cone at (6, 1)
GOAL, WRONG = 0, 1
speak = jax.jit(utter)


def seen(step: int = 0, target: int = NONE, asking=False, candidates=(True, True)) -> RobotView:
    return RobotView(
        step=jnp.int32(step),
        target=jnp.int32(target),
        is_asking=jnp.asarray(asking),
        is_candidate=jnp.array(candidates),
        x=jnp.array([8.8, 6.1], jnp.float32),
        y=jnp.array([1.1, 0.9], jnp.float32),
    )


def watch(params, *sights: RobotView, seed: int = 0) -> tuple[list[Says], Person]:
    person, told = new_person(), []
    for sight in sights:
        person, said, _ = speak(jax.random.key(seed), person, sight, SCENARIO, params=params)
        told.append(Says(int(said)))
    return told, person


def test_what_is_wrong_is_corrected_after_the_delay_as_often_as_allowed() -> None:
    wrong = [seen(target=WRONG)] * 5
    told, person = watch(params_of(delay=2, num_corrections=1), *wrong)
    assert told == [Says.NOTHING, Says.NOTHING, Says.OTHER, Says.NOTHING, Says.NOTHING]
    assert not bool(person.will_speak)
    assert watch(params_of(num_corrections=0), *wrong)[0] == [Says.NOTHING] * 5


def test_what_is_right_is_not_corrected_and_the_wait_begins_anew() -> None:
    assert watch(params_of(), *[seen(target=GOAL)] * 4)[0] == [Says.NOTHING] * 4
    sights = [seen(target=WRONG), seen(target=WRONG), seen(target=GOAL), seen(target=WRONG)]
    assert watch(params_of(delay=2), *sights)[0] == [Says.NOTHING] * 4


def test_a_question_is_answered() -> None:
    person, said, slot = speak(
        jax.random.key(0), new_person(), seen(asking=True), SCENARIO, params=params_of()
    )
    assert (int(said), int(slot), int(person.num_answers)) == (Says.THIS, GOAL, 1)
    sight = seen(asking=True, candidates=(False, True))
    assert watch(params_of(), sight)[0] == [Says.NONE_OF_THEM]
    assert watch(params_of(answers=False), sight)[0] == [Says.NOTHING]


def test_a_statement_is_made_once() -> None:
    sights = [seen(step=step) for step in range(4)]
    told, person = watch(params_of(states_at=2), *sights)
    assert told == [Says.NOTHING, Says.NOTHING, Says.TRUTH, Says.NOTHING]
    assert not bool(person.will_speak)
    assert watch(params_of(states_at=2), *sights[:2])[1].will_speak


@pytest.mark.parametrize("rate", [0.1, 0.5])
def test_errors_come_at_their_rate(rate: float) -> None:
    """Over 2,000 persons, within 5 standard errors."""
    keys = jax.random.split(jax.random.key(1), 2000)
    allowed = 5.0 * np.sqrt(rate * (1.0 - rate) / 2000)
    params = params_of(error_rate=rate, delay=0, states_at=0)
    for sight, wrong in (
        (seen(step=1, target=GOAL), Says.OTHER),
        (seen(step=1, target=WRONG), Says.NOTHING),
        (seen(step=0), Says.FALSEHOOD),
    ):
        _, said, _ = jax.vmap(
            lambda key, sight=sight: speak(key, new_person(), sight, SCENARIO, params=params)
        )(keys)
        assert abs(float(np.mean(np.asarray(said) == wrong)) - rate) < allowed
    _, _, slot = jax.vmap(
        lambda key: speak(key, new_person(), seen(1, asking=True), SCENARIO, params=params)
    )(keys)
    assert abs(float(np.mean(np.asarray(slot) == WRONG)) - rate) < allowed


def test_an_error_in_a_thing_is_kept() -> None:
    params = params_of(error_rate=0.5, delay=0, num_corrections=99)
    for seed in range(8):
        told, _ = watch(params, *[seen(1, target=GOAL)] * 4, seed=seed)
        assert len(set(told)) == 1


def test_numbers_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="error_rate is"):
        params_of(error_rate=1.5)
    with pytest.raises(ValueError, match="delay is"):
        params_of(delay=-1)
    with pytest.raises(ValueError, match="num_corrections is"):
        params_of(num_corrections=-1)
    for numbers in PERSONS.values():
        params_of(**numbers)
