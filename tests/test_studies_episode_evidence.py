"""Evidence of whole episodes: exact values, exact gradients, by relations and by the sensor."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from differences import central
from oracles import enumeration
from studies.episode_evidence import WordsEvidence, log_words, remember
from studies.map_evidence import log_map
from test_semantic_map_enumeration import small_world

from jaxlangnav.messages import BEHIND, NEAR, NONE, Readings
from jaxlangnav.pytree import replace
from jaxlangnav.relations import RelationParams, default_params, prepare
from jaxlangnav.semantic_map.params import MapParams

HYDRANT, CONE = by_hand.HYDRANT, by_hand.CONE
SEEN = [(HYDRANT, 6.4, 1.3), (CONE, 4.2, 0.6), (HYDRANT, 3.4, -2.6)]
CASES = {
    "null": ([HYDRANT], [(0, NONE, NONE, False)]),
    "behind": ([HYDRANT, CONE], [(0, BEHIND, 1, False)]),
    "near": ([HYDRANT, CONE], [(0, NEAR, 1, False)]),
    "nearest": ([HYDRANT, CONE], [(0, NEAR, 1, True)]),
}
FIELDS = ("log_distance", "log_distance_sd", "axis", "concentration")


def sentence(name: str) -> Readings:
    return by_hand.readings([CASES[name][0]], [CASES[name][1]])


def explored(objects: list) -> WordsEvidence:
    """A map with some objects, half of it looked at."""
    log_miss = np.zeros((by_hand.CONFIG.num_cells, by_hand.CONFIG.num_cells))
    log_miss[:, :14] = np.log(0.05)
    belief = by_hand.with_objects(by_hand.begin(), objects)
    return remember(by_hand.with_coverage(belief, log_miss), sentence("behind"), blocks=1)


def params(relations: RelationParams, misleading: float = 0.05) -> MapParams:
    numbers = by_hand.params(concentration=3.0)
    return replace(numbers, relations=prepare(relations), misleading=jnp.float32(misleading))


VALUE = jax.jit(
    lambda one, relations, misleading: log_words(
        one, params=replace(params(relations), misleading=misleading)
    )
)
"""One program for all sentences and maps."""


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("objects", [[], SEEN[1:2], SEEN], ids=["none", "cone", "three"])
def test_words_evidence_equals_enumeration(name: str, objects: list) -> None:
    one = replace(explored(objects), readings=sentence(name))
    found = float(VALUE(one, default_params(), jnp.float32(0.0)))
    cells = by_hand.CONFIG.num_cells
    miss = np.ones((cells, cells))
    miss[:, :14] = 0.05
    world = dataclasses.replace(
        small_world(objects, miss, fineness=1), alpha=3.0, viewer=(0.0, 0.0, 0.0)
    )
    world = dataclasses.replace(world, **{k: 0.0 for k in ("misleading",) if hasattr(world, k)})
    total, _ = enumeration.groundings(world, *CASES[name])
    assert found == pytest.approx(np.log(total.sum()), abs=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["behind", "near", "nearest"])
def test_words_evidence_gradient_is_exact_in_a_small_area(name: str) -> None:
    """Where samples would cross cells and edges (finding F13), the grid does not."""
    one = replace(explored(SEEN), readings=sentence(name))
    relation, start = CASES[name][1][0][1], default_params()
    slopes = jax.jit(jax.grad(lambda p: log_words(one, params=params(p))))(start)
    for field in FIELDS:
        if field == "concentration" and relation == NEAR:
            continue  # κ = 0 is the edge of what is allowed

        def moved(by: float, field: str = field) -> jax.Array:
            relations = replace(start, **{field: getattr(start, field).at[relation].add(by)})
            return VALUE(one, relations, jnp.float32(0.05))

        difference, error = central(moved, 1e-2)
        assert abs(difference - float(getattr(slopes, field)[relation])) < error, field


def test_filter_samples_the_same_evidence() -> None:
    """The filter's estimate of the words' evidence, 128 seeds × 64 particles: 4 errors."""
    log_miss = np.zeros((by_hand.CONFIG.num_cells, by_hand.CONFIG.num_cells))
    log_miss[:, :14] = np.log(0.05)
    belief = by_hand.with_coverage(by_hand.with_objects(by_hand.begin(), SEEN), log_miss)
    numbers = params(default_params())
    _, log_weight = by_hand.ground_many(
        jax.random.split(jax.random.key(5), by_hand.SEEDS), belief, sentence("behind"), numbers
    )
    each = np.exp(np.asarray(log_weight, float)).mean(1)
    exact = np.exp(float(VALUE(explored(SEEN), default_params(), jnp.float32(0.05))))
    assert abs(each.mean() - exact) < 4 * each.std() / np.sqrt(len(each)) + 0.02 * exact


def looks(random: np.random.Generator, noise: float) -> object:
    """Drive past two objects far apart; noise as stated, odometry almost none."""
    specification, found = by_hand.sensor(noise=noise, probability=0.9), []
    for step in range(by_hand.STEPS):
        x = 0.5 * step
        seen = [
            (name, there - x + random.normal(0, noise), y + random.normal(0, noise))
            for name, there, y in ((CONE, 2.0, 1.5), (HYDRANT, 4.0, -1.5))
            if np.hypot(there - x, y) < 2.6 and random.uniform() < 0.9
        ]
        found.append(by_hand.observation(np.array([x, 0.0, 0.0]), seen, specification))
    return by_hand.stack(found)


NAMES = ("noise", "detection_probability", "odometry_noise")
UNIT = dict(zip(NAMES, jnp.eye(len(NAMES)), strict=True))


@jax.jit
def map_value_and_slope(values, tangent, observations):
    """Evidence of a drive under ``NAMES``, f32[3], and its slope along a tangent."""

    def value(values: jax.Array) -> jax.Array:
        noise, probability, odometry = values
        numbers = by_hand.params(concentration=0.3)
        return log_map(
            jax.random.key(0),
            by_hand.begin(),
            observations,
            params=replace(numbers, motion=replace(numbers.motion, odometry_noise=odometry)),
            sensor=replace(by_hand.sensor(), noise=noise, detection_probability=probability),
            num_types=2,
        )

    return jax.jvp(value, (values,), (tangent,))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "step"), [("noise", 2e-3), ("detection_probability", 5e-3), ("odometry_noise", 2e-3)]
)
def test_map_evidence_gradient_equals_finite_differences(name: str, step: float) -> None:
    """Detection noise, detection probability, odometry, through every step of the filter."""
    observations = looks(np.random.default_rng(0), 0.15)
    start, tangent = jnp.array([0.12, 0.8, 0.05]), UNIT[name]
    slope = float(map_value_and_slope(start, tangent, observations)[1])
    difference, error = central(
        lambda by: map_value_and_slope(start + by * tangent, tangent, observations)[0], step
    )
    assert abs(slope) > 1.0
    assert abs(difference - slope) < error, (difference, slope, error)


@pytest.mark.slow
def test_map_evidence_has_its_maximum_at_the_true_sensor() -> None:
    """The slope at the truth, over 24 drives, is within 4 standard errors of zero."""
    truth = jnp.array([0.15, 0.9, 0.02])
    for name in ("noise", "detection_probability"):
        slopes = np.array(
            [
                float(
                    map_value_and_slope(
                        truth, UNIT[name], looks(np.random.default_rng(100 + seed), 0.15)
                    )[1]
                )
                for seed in range(24)
            ]
        )
        error = slopes.std(ddof=1) / np.sqrt(len(slopes))
        assert abs(slopes.mean()) < 4 * error, (name, slopes.mean(), error)
