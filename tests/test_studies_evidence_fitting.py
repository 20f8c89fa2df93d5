"""A relation learned from episodes: recovered within its errors, whatever was seen of it."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from studies.episode_evidence import WordsEvidence, by_setting, log_fit, log_fit_of, log_words
from studies.evidence_fitting import EpisodeFit, fit_to_episodes

from jaxlangnav.messages import BEHIND, NEAR, NONE
from jaxlangnav.pytree import replace
from jaxlangnav.relations import RelationParams, default_params, prepare
from jaxlangnav.semantic_map.params import MapParams

HYDRANT, CONE = by_hand.HYDRANT, by_hand.CONE
MEDIAN, SPREAD, AXIS, KAPPA = 3.6, 0.25, 0.4, 6.0
TRUTH = np.array([np.log(MEDIAN), SPREAD, AXIS, KAPPA])
FIELDS = ("log_distance", "log_distance_sd", "axis", "concentration")
CELLS, HALF = 16, 6.0
"""Cells a side and half a side in metres: a third of the hydrants drawn fall outside."""
MISS = (0.1, 1.0)
"""Probability of having missed an object, where the robot has looked and where it has not."""
BYSTANDERS, MISLEADING, SLOTS = 0.3, 0.05, 8
VIEWER = np.array([-HALF, 0.0, 0.0])
NUMBER = 160


def params() -> MapParams:
    numbers = by_hand.params(concentration=BYSTANDERS)
    return replace(numbers, misleading=jnp.float32(MISLEADING))


def draw_pair(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A cone anywhere and its hydrant, drawn anew until both lie in the area."""
    while True:
        cone = random.uniform(-HALF, HALF, 2)
        sight = cone - VIEWER[:2]
        angle = np.arctan2(sight[1], sight[0]) + AXIS + random.vonmises(0, KAPPA)
        distance = random.lognormal(np.log(MEDIAN), SPREAD)
        hydrant = cone + distance * np.array([np.cos(angle), np.sin(angle)])
        if random.uniform() < MISLEADING:
            hydrant = random.uniform(-HALF, HALF, 2)
        if np.abs(hydrant).max() < HALF:
            return hydrant, cone


def explored_worlds(seed: int, number: int = NUMBER) -> WordsEvidence:
    """Maps of worlds drawn from the model, as far as the robot has looked: half of each."""
    random = np.random.default_rng(seed)
    steps = (np.arange(CELLS) + 0.5) / CELLS * 2 * HALF - HALF
    cell_x, cell_y = np.meshgrid(steps, steps)
    types = np.full((number, SLOTS), NONE)
    place = np.zeros((number, SLOTS, 2))
    miss = np.zeros((number, CELLS, CELLS))
    for world in range(number):
        hydrant, cone = draw_pair(random)
        there = [(HYDRANT, hydrant), (CONE, cone)]
        for kind in (HYDRANT, CONE):
            others = random.poisson(BYSTANDERS)
            there += [(kind, random.uniform(-HALF, HALF, 2)) for _ in range(others)]
        # The half-plane that has been looked at is drawn apart from where things are.
        turn = random.uniform(-np.pi, np.pi)
        looked = cell_x * np.cos(turn) + cell_y * np.sin(turn) > 0
        miss[world] = np.where(looked, *MISS)
        slot = 0
        for kind, (x, y) in there:
            column, row = ((np.array([x, y]) + HALF) / (2 * HALF) * CELLS).astype(int)
            if random.uniform() >= miss[world, row, column]:
                types[world, slot], place[world, slot] = kind, (x, y)
                slot += 1
    relation = [(0, BEHIND, 1, False)]
    sentence = by_hand.readings([[HYDRANT, CONE]], [relation], sizes=(1, 2, 1))
    return WordsEvidence(
        object_type=jnp.asarray(types, jnp.int32),
        object_x=jnp.asarray(place[..., 0], jnp.float32),
        object_y=jnp.asarray(place[..., 1], jnp.float32),
        miss=jnp.asarray(miss.reshape(number, -1), jnp.float32),
        cell_x=jnp.tile(jnp.asarray(cell_x.ravel(), jnp.float32), (number, 1)),
        cell_y=jnp.tile(jnp.asarray(cell_y.ravel(), jnp.float32), (number, 1)),
        area=jnp.full(number, jnp.float32(4 * HALF**2)),
        viewer=jnp.tile(jnp.asarray(VIEWER, jnp.float32), (number, 1)),
        readings=jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (number, *leaf.shape)), sentence),
    )


def true_relations() -> RelationParams:
    known = default_params()
    return RelationParams(
        **{
            name: getattr(known, name).at[BEHIND].set(value)
            for name, value in zip(FIELDS, TRUTH, strict=True)
        }
    )


@jax.jit
@jax.value_and_grad
def fit_and_slope(relations: RelationParams, one: WordsEvidence) -> jax.Array:
    return log_fit(one, params=replace(params(), relations=prepare(relations)))


@functools.partial(jax.jit, static_argnames="law")
def scores(episodes: WordsEvidence, law) -> jax.Array:
    """Slopes of each episode's evidence at the truth, f32[E, 4]."""

    def slope(one: WordsEvidence) -> jax.Array:
        def value(relations: RelationParams) -> jax.Array:
            return law(one, params=replace(params(), relations=prepare(relations)))

        found = jax.grad(value)(true_relations())
        return jnp.stack([getattr(found, name)[BEHIND] for name in FIELDS])

    return jax.lax.map(slope, episodes, batch_size=16)


@pytest.mark.slow
def test_the_evidence_has_its_maximum_at_the_truth() -> None:
    """The score of a likelihood has mean zero at the truth: 1000 episodes, 4 standard errors."""
    episodes = explored_worlds(1, 1000)
    found = np.asarray(scores(episodes, log_fit), float)
    error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert (np.abs(found.mean(axis=0)) < 4 * error).all(), found.mean(axis=0) / error
    # Not so without Z: that worlds which do not fit the area are never met shortens the distance.
    blind = np.asarray(scores(episodes, log_words), float)[:, 0]
    assert blind.mean() < -10 * blind.std(ddof=1) / np.sqrt(len(blind))


@pytest.mark.slow
def test_nothing_is_learned_where_nothing_was_seen() -> None:
    one = jax.tree.map(lambda leaf: leaf[0], explored_worlds(0, 1))
    blank = replace(
        one, object_type=jnp.full_like(one.object_type, NONE), miss=jnp.ones_like(one.miss)
    )
    for relations in (default_params(), true_relations()):
        assert float(fit_and_slope(relations, blank)[0]) == 0.0
    # Half of the area searched in vain: hydrants that would lie in the other half gain.
    in_vain = replace(blank, miss=jnp.where(one.cell_x > 0.0, 0.0, 1.0))
    assert float(fit_and_slope(true_relations(), in_vain)[0]) < 0.0


@pytest.mark.slow
def test_groups_of_a_setting_sum_to_their_episodes() -> None:
    """Three viewers, of 3, 1 and 2 episodes: values and slopes as one episode at a time."""
    episodes = explored_worlds(3, 6)
    seat = jnp.array([0.0, 0.0, 2.0, 0.0, -1.0, -1.0])
    episodes = replace(episodes, viewer=episodes.viewer.at[:, 1].set(seat))
    groups = by_setting(episodes)
    assert sorted(int(np.sum(group.is_used)) for group in groups) == [1, 2, 3]

    each = [jax.tree.map(lambda leaf, k=k: leaf[k], episodes) for k in range(6)]
    value, slope = jax.tree.map(
        lambda *parts: sum(parts), *(fit_and_slope(true_relations(), one) for one in each)
    )
    of_group = jax.jit(jax.value_and_grad(lambda r, group: log_fit_of(group, r, params=params())))
    found, of_groups = jax.tree.map(
        lambda *parts: sum(parts), *(of_group(true_relations(), group) for group in groups)
    )
    np.testing.assert_allclose(found, value, rtol=1e-4)
    for name in FIELDS:
        np.testing.assert_allclose(
            getattr(of_groups, name)[BEHIND], getattr(slope, name)[BEHIND], rtol=2e-3, atol=1e-3
        )


def values_of(fit: EpisodeFit) -> np.ndarray:
    return np.array([float(getattr(fit.params, name)[BEHIND]) for name in FIELDS])


@pytest.mark.slow
def test_relation_is_recovered_from_episodes() -> None:
    fit = fit_to_episodes(
        explored_worlds(0), BEHIND, default_params(), params=params(), num_iterations=12
    )
    found, errors = values_of(fit), np.asarray(fit.standard_error)
    assert (errors > 0).all()
    assert (errors < [0.1, 0.1, 0.2, 3.0]).all(), errors
    assert (np.abs(found - TRUTH) < 4 * errors).all(), (found, TRUTH, errors)
    # From the default, nothing but the gradient has led there.
    assert abs(found[0] - float(default_params().log_distance[BEHIND])) > 5 * errors[0]
    trace = np.asarray(fit.log_evidence)
    assert trace[-1] > trace[0] + 20
    for name in ("log_distance", "axis"):
        np.testing.assert_array_equal(
            np.delete(getattr(fit.params, name), BEHIND),
            np.delete(getattr(default_params(), name), BEHIND),
        )


@pytest.mark.slow
def test_fits_err_as_much_as_they_say() -> None:
    """16 fits of fresh worlds: errors in units of their own, mean 0 and variance 1.

    The mean of 16 is within 4 / √16, the sum of squares within 4 √(2 · 16) of 16. Concentration
    is left out of the second: a scale of so few turns is skewed.
    """
    errors = []
    for seed in range(16):
        fit = fit_to_episodes(
            explored_worlds(10 + seed), BEHIND, default_params(), params=params(), num_iterations=12
        )
        errors.append((values_of(fit) - TRUTH) / np.asarray(fit.standard_error))
    found = np.array(errors)
    assert (np.abs(found.mean(axis=0)) < 1.0).all(), found.mean(axis=0)
    squares = (found[:, :3] ** 2).sum(axis=0)
    assert (np.abs(squares - 16) < 4 * np.sqrt(2 * 16)).all(), squares


def test_a_ring_cannot_be_fitted() -> None:
    with pytest.raises(ValueError, match="direction"):
        fit_to_episodes(explored_worlds(0, 2), NEAR, default_params(), params=params())


def test_superlatives_cannot_be_fitted() -> None:
    episodes = explored_worlds(0, 2)
    extreme = jnp.ones_like(episodes.readings.rank)
    episodes = replace(episodes, readings=replace(episodes.readings, rank=extreme))
    with pytest.raises(ValueError, match="superlative"):
        fit_to_episodes(episodes, BEHIND, default_params(), params=params())
