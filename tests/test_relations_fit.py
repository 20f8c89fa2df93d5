"""Relations learned from pairs: known parameters recovered, gradients and posteriors exact."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from oracles import relations as oracle

from jaxlangnav.messages import BEHIND, FRONT, LEFT, NEAR, RELATIONS
from jaxlangnav.relations import RelationParams, default_params, fit as fitting
from jaxlangnav.relations.fit import FRAMES, RelationFit, RelationPairs, make_pairs

VIEWER, ROBOT, UNDIRECTED = range(3)
TRUE = {
    BEHIND: {"median": 3.4, "spread": 0.25, "axis": 0.35, "concentration": 5.0},
    LEFT: {"median": 1.7, "spread": 0.45, "axis": np.pi / 2, "concentration": 20.0},
    NEAR: {"median": 3.0, "spread": 0.5, "axis": 0.0, "concentration": 0.0},
}
SHARES = {BEHIND: (0.6, 0.25, 0.15), LEFT: (0.2, 0.7, 0.1), NEAR: (1.0, 0.0, 0.0)}
FIELDS = ("log_distance", "log_distance_sd", "axis", "concentration")
NUMBER, FEW = 600, 300
"""Pairs of a word, and of all words of a small fit: a fit of as many pairs compiles nothing."""


def direction(pose: np.ndarray, landmark: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Angle of "along": from the pose through the landmark; backwards of the robot itself."""
    sight = np.arctan2(landmark[:, 1] - pose[:, 1], landmark[:, 0] - pose[:, 0])
    return np.where(own, pose[:, 2] + np.pi, sight)


def synthesise(
    seed: int, relations: tuple[int, ...] = (BEHIND, LEFT, NEAR), number: int = NUMBER
) -> tuple[RelationPairs, np.ndarray]:
    """Draw pairs from the equations by NumPy; also the true frame of each."""
    random = np.random.default_rng(seed)
    word = np.repeat(relations, number)
    size = len(word)
    viewer = np.column_stack([random.normal(0, 1, (size, 2)), random.uniform(-3, 3, size)])
    robot = np.column_stack([random.normal(0, 8, (size, 2)), random.uniform(-3, 3, size)])
    landmark = random.uniform(-10, 10, (size, 2))
    own = random.uniform(size=size) < 0.2
    frame = np.array([random.choice(3, p=SHARES[one]) for one in word])
    pose = np.where((frame == ROBOT)[:, None], robot, viewer)
    where = np.where(own[:, None], pose[:, :2], landmark)
    distance = np.array(
        [random.lognormal(np.log(TRUE[one]["median"]), TRUE[one]["spread"]) for one in word]
    )
    kappa = np.array([TRUE[one]["concentration"] for one in word])
    turn = np.where(
        (frame == UNDIRECTED) | (kappa == 0),
        random.uniform(-np.pi, np.pi, size),
        random.vonmises(0.0, np.maximum(kappa, 1e-6)),
    )
    # "Left" has its axis at +π/2 of the line of sight, which of the robot itself points backwards.
    sign = np.where(own, -1.0, 1.0)
    angle = direction(pose, where, own)
    angle = angle + sign * np.array([TRUE[one]["axis"] for one in word]) + turn
    figure = where + distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    return make_pairs(word, figure, landmark, viewer, robot, own), frame


def true_params() -> RelationParams:
    params = default_params()
    for index, law in TRUE.items():
        params = RelationParams(
            log_distance=params.log_distance.at[index].set(np.log(law["median"])),
            log_distance_sd=params.log_distance_sd.at[index].set(law["spread"]),
            axis=params.axis.at[index].set(law["axis"]),
            concentration=params.concentration.at[index].set(law["concentration"]),
        )
    return params


Fitted = tuple[RelationPairs, np.ndarray, RelationFit]
"""Pairs, the true frame of each, and what is learned of them."""


@pytest.fixture(scope="module")
def fitted() -> Fitted:
    pairs, frame = synthesise(0)
    return pairs, frame, fitting.fit_relations(pairs)


def test_known_parameters_are_recovered_within_their_errors(fitted: Fitted) -> None:
    _, _, fit = fitted
    assert bool(fit.is_converged)
    truth = true_params()
    for name in FIELDS:
        for index in TRUE:
            if index == NEAR and name in ("axis", "concentration"):
                continue
            found = float(getattr(fit.params, name)[index])
            error = float(getattr(fit.standard_error, name)[index])
            expected = float(getattr(truth, name)[index])
            assert 0.0 < error < 0.15 * max(1.0, abs(expected)), (name, index, error)
            assert abs(found - expected) < 4 * error, (name, index, found, expected, error)
    for index in (BEHIND, LEFT):
        share, error = np.asarray(fit.frame_share[index]), np.asarray(fit.frame_share_error[index])
        assert (np.abs(share - SHARES[index]) < 4 * error).all(), (share, error)
        assert (error < 0.05).all()
    assert float(fit.log_likelihood) > float(fit.log_likelihood_before) + 0.2


def test_standard_errors_are_those_of_repetition() -> None:
    """Pulls (found − true) / error of 8 repetitions have a deviation of one, to a third."""
    truth, pulls, words = true_params(), [], (BEHIND, LEFT)
    for seed in range(8):
        fit = fitting.fit_relations(synthesise(100 + seed, words, FEW // 2)[0])
        for name in FIELDS:
            gap = getattr(fit.params, name) - getattr(truth, name)
            pulls += (gap / getattr(fit.standard_error, name))[jnp.array(words)].tolist()
    # 64 pulls: the deviation is known to 1 / √128; the shift to 1 / √64.
    assert abs(np.std(pulls) - 1.0) < 4 / np.sqrt(128)
    assert abs(np.mean(pulls)) < 4 / np.sqrt(64)


def test_posterior_of_the_frame_equals_brute_force(fitted: Fitted) -> None:
    """Bayes' rule with the oracle's densities, every pair."""
    pairs, frame, fit = fitted
    flat = jax.tree.map(np.asarray, pairs)
    expected = np.zeros((len(flat.relation), len(FRAMES)))
    for row in range(0, len(flat.relation), 3):
        index, own = flat.relation[row], bool(flat.is_robot[row])
        median, *numbers = (float(getattr(fit.params, name)[index]) for name in FIELDS)
        law = dict(zip(("spread", "axis", "concentration"), numbers, strict=True))
        law |= {"median": np.exp(median), "axis": law["axis"] * (-1.0 if own else 1.0)}
        figure = np.array(flat.figure[row], float)
        there = np.array(flat.landmark[row], float)
        for k, pose in enumerate((flat.viewer[row], flat.robot[row], flat.viewer[row])):
            where = pose[:2] if own else there
            sight = float(direction(pose[None], where[None], np.array([own]))[0])
            told = law | ({"concentration": 0.0} if k == UNDIRECTED else {})
            value = oracle.density(figure - where, sight, **told)
            expected[row, k] = value * float(fit.frame_share[index, k])
    rows = expected.sum(1) > 0
    assert rows.sum() > 500
    expected = expected[rows] / expected[rows].sum(1, keepdims=True)
    np.testing.assert_allclose(np.asarray(fit.frame_posterior)[rows], expected, atol=2e-3)
    # And it is calibrated: the mean posterior of the true frame's pairs is their share.
    for k in range(3):
        chosen = flat.relation != NEAR
        believed = np.asarray(fit.frame_posterior)[chosen, k]
        spread = np.sqrt((believed * (1 - believed)).sum())
        assert abs(believed.sum() - (frame[chosen] == k).sum()) < 5 * spread


def test_words_without_pairs_keep_their_parameters() -> None:
    pairs, _ = synthesise(1, (BEHIND,), FEW)
    fit = fitting.fit_relations(pairs)
    for name in FIELDS:
        before, after = getattr(default_params(), name), getattr(fit.params, name)
        np.testing.assert_allclose(after[FRONT], before[FRONT], atol=2e-3, rtol=1e-3)
        assert float(getattr(fit.standard_error, name)[FRONT]) == 0.0
    assert np.flatnonzero(fit.num_pairs).tolist() == [BEHIND]
    assert [row["relation"] for row in fitting.describe(fit)] == [RELATIONS[BEHIND]]


def test_order_and_repetition_of_the_pairs_do_not_matter() -> None:
    pairs, _ = synthesise(2, (BEHIND, LEFT), FEW // 2)
    order = np.random.default_rng(0).permutation(FEW)
    shuffled = jax.tree.map(lambda leaf: leaf[order], pairs)
    one, other = fitting.fit_relations(pairs), fitting.fit_relations(shuffled)
    for left, right in zip(jax.tree.leaves(one.params), jax.tree.leaves(other.params), strict=True):
        np.testing.assert_allclose(left, right, rtol=5e-3, atol=5e-3)
    posterior = np.asarray(one.frame_posterior)[order]
    np.testing.assert_allclose(posterior, other.frame_posterior, atol=1e-2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"relation": np.zeros(0, int)}, "no pairs"),
        ({"relation": np.array([6])}, "index from 0 to 5"),
        ({"relation": np.array([[BEHIND]])}, "relation has shape"),
        ({"figure": np.zeros((1, 3))}, "figure has shape"),
        ({"viewer": np.full((1, 3), np.nan)}, "not finite"),
    ],
)
def test_bad_pairs_are_refused(changes: dict, message: str) -> None:
    good = {"relation": np.array([BEHIND]), "figure": np.zeros((1, 2))}
    good |= {"landmark": np.ones((1, 2)), "viewer": np.zeros((1, 3))}
    with pytest.raises(ValueError, match=message):
        make_pairs(**(good | changes))
