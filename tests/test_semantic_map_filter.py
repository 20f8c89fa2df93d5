"""Whole filter steps against exact posteriors: what is meant, and what is where (eq. 5-8)."""

import dataclasses

import jax
import numpy as np
import pytest
import readings as by_hand
from oracles import associations, enumeration
from test_semantic_map_enumeration import EMPTY, by_category, small_world

from jaxlangnav.messages import BEHIND, NEAR, NONE
from jaxlangnav.pytree import replace

HYDRANT, CONE, CAR = by_hand.HYDRANT, by_hand.CONE, by_hand.CAR
PATH = [(0.7 * step, 0.0) for step in range(by_hand.STEPS)]
CONES = [(CONE, 3.5, 0.8), (CONE, 4.0, -2.4)]
HYDRANTS = [(HYDRANT, 5.9, 1.0), (HYDRANT, 1.8, 2.6)]
ALPHA = 3.0
WORDS = {
    "null": ([HYDRANT], [EMPTY]),
    "behind": ([HYDRANT, CONE], [(0, BEHIND, 1, False)]),
    "nearest": ([HYDRANT, CONE], [(0, NEAR, 1, True)]),
}


def drive(sentence, objects):
    """Drive along PATH and detect all within 2.8 m: the last beliefs, things in order of slots."""
    specification = by_hand.sensor(range_max=3.0, probability=0.9, noise=0.05)
    seen, looks = [], []
    for x, y in PATH:
        found = [one for one in objects if np.hypot(one[1] - x, one[2] - y) < 2.8]
        seen += [one for one in found if one not in seen]
        offsets = [(name, there_x - x, there_y - y) for name, there_x, there_y in found]
        looks.append(by_hand.observation(np.array([x, y, 0.0]), offsets, specification))
    numbers = by_hand.params(concentration=ALPHA, odometry_noise=0.0)
    return by_hand.run_lanes(looks, sentence, numbers)[0], seen


@pytest.mark.parametrize("name", WORDS)
@pytest.mark.parametrize("objects", [CONES, CONES + HYDRANTS], ids=["nothing found", "found"])
def test_posterior_after_a_drive_equals_enumeration(name: str, objects: list) -> None:
    """P(figure and landmark are these | words, looks, absences), 4 standard errors."""
    kinds, edges = WORDS[name]
    beliefs, seen = drive(by_hand.readings([kinds], [edges]), objects)
    world = dataclasses.replace(
        small_world(seen, np.exp(np.asarray(beliefs.coverage.log_miss[0], float)), fineness=1),
        viewer=(0.0, 0.0, 0.0),
    )
    truth, moments = enumeration.groundings(world, kinds, edges)
    weight = np.exp(np.asarray(beliefs.log_weight, float))
    weight /= weight.sum(-1, keepdims=True)
    particles = jax.tree.map(np.asarray, beliefs.particles)
    number = len(seen) + 1
    assert (particles.object_type[:, : len(seen), 0] == [name for name, _, _ in seen]).all()
    samples = by_category(particles, weight * weight.shape[-1], number, len(kinds))
    expected = (truth / truth.sum()).ravel()
    error = samples.std(0, ddof=1) / np.sqrt(by_hand.SEEDS)
    # Self-normalised weights of P particles are biased by less than 1 / P.
    allowed = 4.0 * error + 0.5 * expected * (1 - expected) / by_hand.CONFIG.num_particles
    np.testing.assert_array_less(np.abs(samples.mean(0) - expected), allowed + 1e-4)
    is_open = weight * (particles.referent[:, 0] == NONE)
    share = np.take(truth, number - 1, axis=0).sum()
    for axis, place in enumerate((particles.hypothesis_x, particles.hypothesis_y)):
        centre = np.take(moments[axis], number - 1, axis=0).sum() / share
        # A ratio of means; its error by the linearised residuals.
        residual = (is_open * (place[:, 0] - centre)).sum(-1) / is_open.sum(-1).mean()
        error = residual.std(ddof=1) / np.sqrt(by_hand.SEEDS)
        assert abs(residual.mean()) < 4.0 * error + 0.05, (name, axis, residual.mean(), error)


POSE = np.array([5.0, 0.0, 0.0])
LOOKS = {
    "one object, one outlier": [
        [(1.5, 0.0)], [(1.5, 0.9)], [(1.4, 0.3)], [(1.6, 0.6)], [(1.5, 0.2)], [(1.55, 0.3)], [], [],
    ],
    "two objects, often missed": [
        [(1.5, 0.0)], [(1.5, 0.9)], [(1.4, 0.0), (1.5, 1.0)], [(1.6, 0.6)], [], [(1.5, 0.3)],
        [], [],
    ],
    "one object or two": [[(1.5, 0.0)], [(1.5, 0.8)], [], [(1.4, 1.0)], [], [(1.5, 0.2)], [], []],
}  # fmt: skip


def looked(looks: list[list[tuple[float, float]]], specification, numbers):
    """Stand at POSE and see hydrants, having heard of a car."""
    seen = [
        by_hand.observation(POSE, [(HYDRANT, *place) for place in look], specification)
        for look in looks
    ]
    car = by_hand.readings([[CAR]], [[EMPTY]])
    return by_hand.run_lanes(seen, car, numbers, by_hand.begin(tuple(POSE)))[0]


@pytest.mark.parametrize("name", LOOKS)
def test_number_of_objects_equals_enumeration(name: str) -> None:
    """P(how many objects there are): wrong associations must die out, not live on."""
    noise, probability, concentration = 0.3, 0.7, 20.0
    specification = by_hand.sensor(noise=noise, probability=probability)
    # The words speak of something else, so that they do not bear on the number.
    beliefs = looked(LOOKS[name], specification, by_hand.params(concentration=concentration))
    expected, _ = associations.posterior(
        LOOKS[name],
        intensity=concentration / 100.0,
        detection_probability=probability,
        variance=noise**2,
    )
    weight = np.exp(np.asarray(beliefs.log_weight, float))
    count = np.asarray(beliefs.particles.is_observed).sum(1)
    samples = np.stack([(weight * (count == n)).sum(-1) for n in range(len(expected))], 1)
    error = samples.std(0, ddof=1) / np.sqrt(by_hand.SEEDS)
    allowed = 4.0 * error + 1.0 / by_hand.CONFIG.num_particles
    np.testing.assert_array_less(np.abs(samples.mean(0) - expected), allowed)


@pytest.mark.parametrize("clumping", [0.0, 2.0])
def test_evidence_of_detections_is_the_predictive_density(clumping: float) -> None:
    """One object, three looks, next to nothing else possible: log-evidence in closed form."""
    concentration, noise = 1e-6, 0.2
    places = [(1.0, 0.5), (1.1, 0.4), (0.9, 0.6)]
    looks = [[place] for place in places] + [[]] * (by_hand.STEPS - 3)
    specification = by_hand.sensor(noise=noise, probability=0.7)
    numbers = by_hand.params(concentration=concentration, clumping=clumping)
    beliefs = looked(looks, specification, numbers)
    _, expected = associations.posterior(
        looks, intensity=concentration / 100.0, detection_probability=0.7, variance=noise**2
    )
    # The car is spoken of and not seen either: its absence is part of the evidence.
    area_seen = np.pi * 3.0**2 / 100.0
    not_seen = np.log(1 - area_seen * (1 - 0.3 ** np.array([1.0, by_hand.STEPS])))
    # Where one stands, others are expected; that no look has shown any is evidence, too.
    share_seen = 1 - np.exp(np.asarray(beliefs.coverage.log_miss[0], float)).mean()
    expected -= np.log1p(clumping * share_seen)
    log_evidence = np.asarray(beliefs.log_evidence)
    # The first look falls before the words are grounded; the others after.
    assert abs(log_evidence.mean() - expected - (not_seen[1] - not_seen[0])) < 0.05


@pytest.mark.parametrize("must_ground", [True, False], ids=["words come", "no words"])
def test_weights_are_those_of_the_maps_whoever_draws_anew(must_ground: bool) -> None:
    """Where words come all draw and keep w; else one is kept, by P w, or draws anew, at 1 / P."""
    number = by_hand.CONFIG.num_particles
    weight = np.random.default_rng(3).dirichlet(np.full(number, 0.8))
    belief = by_hand.begin()
    belief = replace(
        belief, log_weight=np.log(weight).astype(np.float32), must_ground=np.array(must_ground)
    )
    looks = [by_hand.observation(np.zeros(3), [])] * by_hand.STEPS
    _, infos = by_hand.run_lanes(looks, by_hand.NULL, by_hand.params(), belief, seed=5)
    after = weight if must_ground else np.maximum(weight, 1.0 / number)
    expected = after.sum() ** 2 / (after**2).sum()
    np.testing.assert_allclose(infos.effective_sample_size[:, 0], expected, rtol=1e-3)
