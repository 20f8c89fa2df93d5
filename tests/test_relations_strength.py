"""How strongly a relation holds and who is n-th: host and device say the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.language.labels import Geometry, PlacedWorld
from jaxlangnav.messages import BEHIND, FAR, FRONT, LEFT, NEAR, RELATIONS, RIGHT
from jaxlangnav.relations.strength import degree, degree_of, num_before, value_of_rank
from jaxlangnav.relations.table import NUM_RANKS, ORDERS

DEGREE = jax.jit(degree)
NTH = jax.jit(value_of_rank, static_argnames="tie")


def test_one_step_to_the_left_by_hand() -> None:
    """3 m away and 2 m to the left: the far one by 3, the leftmost by 2, the nearest by -3."""
    expected = {FRONT: -3.0, BEHIND: -3.0, LEFT: 2.0, RIGHT: -2.0, NEAR: -3.0, FAR: 3.0}
    for relation, value in expected.items():
        assert float(degree_of(relation, np.array(3.0), np.array(2.0))) == value


def test_host_and_device_agree() -> None:
    generator = np.random.default_rng(0)
    distance, sideways = generator.uniform(-5, 5, (2, 100)).astype(np.float32)
    for relation in range(len(RELATIONS)):
        on_device = DEGREE(jnp.full(100, relation), jnp.asarray(distance), jnp.asarray(sideways))
        np.testing.assert_array_equal(on_device, degree_of(relation, distance, sideways))


@pytest.mark.parametrize("relation", ORDERS)
def test_who_is_nth_on_the_host_is_nth_on_the_device(relation: int) -> None:
    generator = np.random.default_rng(relation)
    objects = tuple(("cone", *generator.uniform(-5, 5, 2)) for _ in range(6))
    geometry = Geometry(PlacedWorld(objects=objects, robot=(0.3, -0.2, 0.9)))
    strength = geometry.strength[relation, :, 6]
    before = num_before(strength, ~np.eye(6, dtype=bool))
    everything, merit = tuple(range(6)), jnp.asarray(-strength, jnp.float32)
    for rank in range(1, NUM_RANKS + 1):
        nth = int(np.flatnonzero(before == rank - 1)[0])
        assert geometry.is_extreme(relation, nth, 6, rank, everything)
        assert float(NTH(jnp.int32(rank), merit, tie=1e-6)) == float(merit[nth])
    assert float(NTH(jnp.int32(5), merit, tie=1e-6)) == np.inf
