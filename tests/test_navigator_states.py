"""A state belongs to its navigator: to its labels and to its policy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav import agent, navigator
from jaxlangnav.pytree import replace

LABELS = ("hydrant", "cone")
SAID = "go to the hydrant"


@pytest.fixture(scope="module")
def one() -> agent.Navigator:
    return agent.Navigator.pretrained(labels=LABELS)


def doors(other: agent.Navigator):
    yield lambda state: other.step(jax.random.key(0), state, other.observation((0.0, 0.0, 0.0)))
    yield lambda state: other.hear(state, "go to the cone")
    yield lambda state: other.take(state, "stop")
    yield from (other.candidates, other.missing, other.spoken)


@pytest.mark.parametrize("labels", [("gazebo", "cone"), ("cone", "hydrant"), (*LABELS, "gazebo")])
def test_a_state_of_other_labels_is_refused(one, labels: tuple[str, ...]) -> None:
    other = agent.Navigator.pretrained(labels=labels)
    for state in (one.start(SAID), one.wait()):
        for door in doors(other):
            with pytest.raises(ValueError, match=f"other labels than {labels[0]}") as refusal:
                door(state)
            assert "\n" not in str(refusal.value)


def test_a_state_of_another_policy_is_refused(one) -> None:
    other = agent.Navigator.pretrained("faithful", labels=LABELS)
    for door in doors(other):
        with pytest.raises(ValueError, match="another policy than faithful") as refusal:
            door(one.start(SAID))
        assert "\n" not in str(refusal.value)


def test_a_state_is_taken_by_a_navigator_alike(one) -> None:
    """Other numbers are no other navigator, and a state may have been written to a file."""
    like = agent.Navigator.pretrained(labels=list(LABELS), reach=2.0)
    state = one.start(SAID)
    leaves, structure = jax.tree.flatten(state)
    read = jax.tree.unflatten(structure, [np.array(leaf) for leaf in leaves])
    for given in (state, one.hear(state, "stop"), read):
        assert like.spoken(given) == ["hydrant"]


def test_a_state_of_the_engine_is_anybodys(one) -> None:
    state = one.start(SAID)
    bare = navigator.start(
        state.instruction, jnp.zeros(3), jnp.array([-9.0, 9.0, -9.0, 9.0]), config=one.config
    )
    assert one.spoken(bare) == ["hydrant"]
    assert one.take(bare, "stop")[0].signature is not None


def test_states_are_stacked_and_traced(one) -> None:
    states = jax.tree.map(lambda *leaves: jnp.stack(leaves), one.start(SAID), one.wait())
    halted = jax.jit(jax.vmap(lambda state: replace(state, is_halted=jnp.asarray(True))))(states)
    first = jax.tree.map(lambda leaf: leaf[0], halted)
    assert one.spoken(first) == ["hydrant"]
