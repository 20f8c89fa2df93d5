"""Worlds of the belief's own prior: their law, and that belief is calibrated in them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from studies.own_worlds import OWN_AREA, check_readings, draw_own_world, judge_own_worlds

from jaxlangnav.experiments.calibration import scores
from jaxlangnav.experiments.tasks import SENTENCES, ground_sentences
from jaxlangnav.messages import BEHIND, LEFT, NEAR, NONE, ROBOT, Readings
from jaxlangnav.navigator import default_params as default_navigator_params
from jaxlangnav.pytree import replace
from jaxlangnav.relations import default_params
from jaxlangnav.semantic_map.params import default_map_params
from jaxlangnav.world.state import Scenario

HYDRANT, CONE, CAR = by_hand.HYDRANT, by_hand.CONE, by_hand.CAR
NUMBER = 4000
EPISODES = 400
"""Of each sentence whose worlds are judged."""
WIDE = (-300.0, 300.0, -300.0, 300.0)
"""An area so wide that no figure falls outside."""


def draw(
    sentence: Readings, area: tuple[float, float, float, float] = OWN_AREA, **changes: float
) -> Scenario:
    params = replace(
        default_map_params(), **{name: jnp.float32(value) for name, value in changes.items()}
    )
    keys = jax.random.split(jax.random.key(3), NUMBER)
    start = jnp.array([0.0, 0.0, 0.4])
    worlds = jax.vmap(
        lambda key: draw_own_world(
            key, sentence, jnp.asarray(area, jnp.float32), start, params=params
        )
    )(keys)
    return jax.tree.map(np.asarray, worlds)


def landmark_of(worlds: Scenario, kind: int) -> np.ndarray:
    """Find the first object of a type: the one mentioned, f32[E, 2]."""
    slot = np.argmax(worlds.object_type == kind, axis=1)
    rows = np.arange(len(slot))
    return np.stack([worlds.object_x[rows, slot], worlds.object_y[rows, slot]], axis=1)


@pytest.mark.slow
def test_behind_follows_the_density_of_the_relation() -> None:
    sentence = by_hand.readings([[HYDRANT, CONE]], [[(0, BEHIND, 1, False)]])
    worlds = draw(sentence, WIDE, misleading=0.0)
    assert worlds.is_valid.all()
    cone = landmark_of(worlds, CONE)
    offset = worlds.goal - cone
    free = default_params()
    log_distance = np.log(np.hypot(*offset.T))
    error = float(free.log_distance_sd[BEHIND]) / np.sqrt(NUMBER)
    assert abs(log_distance.mean() - float(free.log_distance[BEHIND])) < 5 * error
    assert abs(log_distance.std() - float(free.log_distance_sd[BEHIND])) < 5 * error
    turn = np.arctan2(*offset.T[::-1]) - np.arctan2(*cone.T[::-1])
    # Mean resultant length of a von Mises law: I₁(κ) / I₀(κ).
    kappa = float(free.concentration[BEHIND])
    grid = np.linspace(-np.pi, np.pi, 20001)
    weight = np.exp(kappa * (np.cos(grid) - 1))
    expected = (weight * np.cos(grid)).sum() / weight.sum()
    assert abs(np.cos(turn).mean() - expected) < 5 * np.cos(turn).std() / np.sqrt(NUMBER)
    assert abs(np.sin(turn).mean()) < 5 * np.sin(turn).std() / np.sqrt(NUMBER)


@pytest.mark.slow
def test_objects_stand_inside_and_bystanders_are_poisson() -> None:
    sentence = by_hand.readings([[HYDRANT, CONE]], [[(0, BEHIND, 1, False)]])
    worlds = draw(sentence, concentration=0.5)
    assert worlds.is_valid.all()
    x, y, there = worlds.object_x, worlds.object_y, worlds.is_object
    inside = (x >= OWN_AREA[0]) & (x <= OWN_AREA[1]) & (y >= OWN_AREA[2]) & (y <= OWN_AREA[3])
    assert (inside | ~there).all()
    for kind in (HYDRANT, CONE):
        others = ((worlds.object_type == kind) & there).sum(1) - 1
        assert others.min() >= 0
        assert abs(others.mean() - 0.5) < 5 * np.sqrt(0.5 / NUMBER)
        assert abs((others == 0).mean() - np.exp(-0.5)) < 5 * np.sqrt(0.25 / NUMBER)
    rows = np.arange(NUMBER)
    assert (worlds.object_type[rows, worlds.goal_index] == HYDRANT).all()
    np.testing.assert_array_equal(worlds.object_x[rows, worlds.goal_index], worlds.goal[:, 0])


@pytest.mark.slow
def test_a_misleading_relation_says_nothing() -> None:
    sentence = by_hand.readings([[HYDRANT, CONE]], [[(0, BEHIND, 1, False)]])
    worlds = draw(sentence, misleading=1.0)
    x_mean = 0.5 * (OWN_AREA[0] + OWN_AREA[1])
    error = (OWN_AREA[1] - OWN_AREA[0]) / np.sqrt(12 * NUMBER)
    assert abs(worlds.goal[:, 0].mean() - x_mean) < 5 * error
    cone = landmark_of(worlds, CONE)
    assert abs(np.corrcoef(worlds.goal[:, 1], cone[:, 1])[0, 1]) < 5 / np.sqrt(NUMBER)


@pytest.mark.slow
def test_nearest_has_hardly_a_nearer_rival() -> None:
    sentence = by_hand.readings([[HYDRANT, CONE]], [[(0, NEAR, 1, True)]])
    worlds = draw(sentence, concentration=2.0, misleading=0.0)
    cone = landmark_of(worlds, CONE)
    apart = np.hypot(worlds.object_x - cone[:, :1], worlds.object_y - cone[:, 1:])
    hydrants = np.where((worlds.object_type == HYDRANT) & worlds.is_object, apart, np.inf)
    own = np.hypot(*(worlds.goal - cone).T)
    excess = own - hydrants.min(1)
    several = ((worlds.object_type == HYDRANT) & worlds.is_object).sum(1) > 1
    assert several.mean() > 0.5
    # exp(−excess / 0.3 m): hardly any rival is nearer by more than a metre.
    assert (excess > 1.0).mean() < 0.02
    assert (excess > 0.0).any()


@pytest.mark.slow
def test_relation_to_the_robot_and_a_chain() -> None:
    sentence = by_hand.readings(
        [[HYDRANT, CONE, ROBOT]], [[(0, BEHIND, 1, False), (1, LEFT, 2, False)]]
    )
    check_readings(sentence)
    worlds = draw(sentence, WIDE, misleading=0.0)
    assert worlds.is_valid.all()
    cone = landmark_of(worlds, CONE)
    # A side of the robot: any distance, directions of a von Mises law with κ = 4.
    assert np.median(np.hypot(*cone.T)) > 100.0
    left = np.array([-np.sin(0.4), np.cos(0.4)])
    toward = cone @ left / np.hypot(*cone.T)
    # I₁(4) / I₀(4) = 0.8635
    assert abs(toward.mean() - 0.8635) < 5 * toward.std() / np.sqrt(NUMBER)
    # Behind, as seen from the start: further along the line of sight.
    offset = worlds.goal - cone
    along = (offset * cone).sum(1) / np.hypot(*cone.T) / np.hypot(*offset.T)
    assert along.mean() > 0.9
    assert not (worlds.object_type == ROBOT).any()


def test_what_cannot_be_drawn_is_refused() -> None:
    twice = by_hand.readings([[HYDRANT, CONE, CAR]], [[(0, BEHIND, 1, False), (0, NEAR, 2, False)]])
    with pytest.raises(ValueError, match="more than once"):
        check_readings(twice)
    order = by_hand.readings([[HYDRANT, CONE]], [[(0, NEAR, 1, True)]])
    check_readings(replace(order, rank=order.rank.at[0, 0].set(1)))
    order = replace(order, rank=order.rank.at[0, 0].set(2))
    with pytest.raises(ValueError, match="order"):
        check_readings(order)
    check_readings(by_hand.readings([[HYDRANT]], [[(0, NONE, NONE, False)]]))


def test_an_area_too_small_is_refused() -> None:
    sentences = ground_sentences(list(SENTENCES.values()))
    params = default_navigator_params()
    # Where no relation misleads, two metres of distance do not fit into a square of 0.2 m.
    params = replace(params, map=replace(params.map, misleading=jnp.float32(0.0)))
    with pytest.raises(ValueError, match="enlarge"):
        judge_own_worlds(
            sentences, {"behind": 3.0}, policy="informed", episodes=2, seed=0, params=params,
            area=(0.0, 0.2, -0.1, 0.1),
        )  # fmt: skip


@pytest.mark.slow
def test_belief_is_calibrated_in_its_own_worlds() -> None:
    """The target of closed-loop calibration: ECE at most 0.03, coverage between 87 and 93 %.

    A perfect belief shows the floor in so few episodes; both add up like independent errors.
    """
    sentences = ground_sentences(list(SENTENCES.values()))
    judged = judge_own_worlds(
        sentences,
        {"null": 3.0, "behind": 3.0, "nearest": 5.0},
        policy="informed",
        episodes=EPISODES,
        seed=20,
    )
    for name, tally in judged.items():
        found = scores(tally)
        ece, floor, ece_map = found["ece"], found["ece_floor"], found["ece_map"]
        coverage, error = found["coverage90"], found["coverage90_se"]
        assert ece is not None, name
        assert floor is not None, name
        assert ece_map is not None, name
        assert coverage is not None, name
        assert error is not None, name
        # The floor is the mean of a chance error's size, √(2 / π) of its standard deviation.
        assert ece <= np.hypot(0.03, floor * np.sqrt(np.pi / 2)), (name, found)
        # What the planner works with is what the map says: no doubt is counted twice.
        assert abs(ece - ece_map) <= 0.005, (name, found)
        assert 87.0 - 2 * error <= coverage <= 93.0 + 2 * error, (name, found)
