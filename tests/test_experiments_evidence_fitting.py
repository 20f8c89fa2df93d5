"""A relation learned from episodes: recovered within its errors, whatever was seen of it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

from jaxlangnav.experiments.episode_evidence import WordsEvidence
from jaxlangnav.experiments.evidence_fitting import fit_to_episodes
from jaxlangnav.messages import BEHIND, NEAR, NONE
from jaxlangnav.pytree import replace
from jaxlangnav.relations import default_params

HYDRANT, CONE = by_hand.HYDRANT, by_hand.CONE
MEDIAN, SPREAD, AXIS, KAPPA = 3.6, 0.25, 0.4, 6.0
CELLS, HALF = 12, 15.0
NUMBER = 160


def explored_worlds(seed: int) -> WordsEvidence:
    """Maps whose words were said of a hydrant; half of the hydrants have not been seen."""
    random = np.random.default_rng(seed)
    steps = (np.arange(CELLS) + 0.5) / CELLS * 2 * HALF - HALF
    cell_x, cell_y = np.meshgrid(steps, steps)
    each = []
    while len(each) < NUMBER:
        cone = random.uniform(-8, 8, 2)
        angle = np.arctan2(cone[1], cone[0]) + AXIS + random.vonmises(0, KAPPA)
        offset = random.lognormal(np.log(MEDIAN), SPREAD) * np.array([np.cos(angle), np.sin(angle)])
        hydrant, bystander = cone + offset, random.uniform(-HALF, HALF, 2)
        # The half-plane that has been looked at is drawn apart from where things are.
        turn = random.uniform(-np.pi, np.pi)
        miss = np.where(cell_x * np.cos(turn) + cell_y * np.sin(turn) > 0, 0.02, 1.0)
        is_seen = hydrant @ [np.cos(turn), np.sin(turn)] > 0
        types, x, y = np.full(4, NONE), np.zeros(4), np.zeros(4)
        seen = [(CONE, cone)] + [(HYDRANT, hydrant)] * int(is_seen)
        if random.uniform() < 0.3 and bystander @ [np.cos(turn), np.sin(turn)] > 0:
            seen.append((HYDRANT, bystander))
        for slot, (kind, place) in enumerate(seen):
            types[slot], (x[slot], y[slot]) = kind, place
        each.append((types, x, y, miss.ravel()))
    types, x, y, miss = (np.stack(part) for part in zip(*each, strict=True))
    sentence = by_hand.readings([[HYDRANT, CONE]], [[(0, BEHIND, 1, False)]])
    return WordsEvidence(
        object_type=jnp.asarray(types, jnp.int32),
        object_x=jnp.asarray(x, jnp.float32),
        object_y=jnp.asarray(y, jnp.float32),
        miss=jnp.asarray(miss, jnp.float32),
        cell_x=jnp.tile(jnp.asarray(cell_x.ravel(), jnp.float32), (NUMBER, 1)),
        cell_y=jnp.tile(jnp.asarray(cell_y.ravel(), jnp.float32), (NUMBER, 1)),
        area=jnp.full(NUMBER, jnp.float32(4 * HALF**2)),
        viewer=jnp.zeros((NUMBER, 3)),
        readings=jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (NUMBER, *leaf.shape)), sentence),
    )


def test_relation_is_recovered_from_episodes() -> None:
    fit = fit_to_episodes(
        explored_worlds(0),
        BEHIND,
        default_params(),
        params=replace(by_hand.params(concentration=0.6), misleading=jnp.float32(0.001)),
    )
    found = [
        float(getattr(fit.params, name)[BEHIND])
        for name in ("log_distance", "log_distance_sd", "axis", "concentration")
    ]
    errors = np.asarray(fit.standard_error)
    truth = [np.log(MEDIAN), SPREAD, AXIS, KAPPA]
    assert (errors > 0).all()
    assert (errors < [0.1, 0.1, 0.2, 3.0]).all(), errors
    assert (np.abs(np.array(found) - truth) < 4 * errors).all(), (found, truth, errors)
    # From the default, nothing but the gradient has led there.
    assert abs(found[0] - float(default_params().log_distance[BEHIND])) > 5 * errors[0]
    trace = np.asarray(fit.log_evidence)
    assert trace[-1] > trace[0] + 20
    for name in ("log_distance", "axis"):
        np.testing.assert_array_equal(
            np.delete(getattr(fit.params, name), BEHIND),
            np.delete(getattr(default_params(), name), BEHIND),
        )


def test_a_ring_cannot_be_fitted() -> None:
    with pytest.raises(ValueError, match="direction"):
        fit_to_episodes(explored_worlds(0), NEAR, default_params(), params=by_hand.params())
