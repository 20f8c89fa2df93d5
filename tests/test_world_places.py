"""Random places beyond Table 2: what the law promises, and that nothing else moves them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.experiments.tasks import Cell, draw_tasks
from jaxlangnav.messages import NONE, default_sensor
from jaxlangnav.world.places import (
    BORDER_MARGIN,
    GOAL_GAP,
    NUM_FIXED_CLUTTER,
    PAIR_GAP,
    WorldParams,
    is_related,
    world_params,
)
from jaxlangnav.world.state import CONE, HYDRANT

AREA = (-2.0, 12.0, -9.0, 9.0)
NUMBER = 40
LAWS = {
    "plain": world_params(area=AREA),
    "pairs": world_params(area=AREA, num_pairs=4, num_bystanders=6),
    "false": world_params(area=AREA, side=-1.0, num_pairs=2),
    "crowd": world_params(area=AREA, num_pairs=1, num_bystanders=56),
    "small": world_params(area=(-4.0, 4.0, -4.0, 4.0), num_clutter=3),
    "no goal": world_params(area=AREA, has_goal=False),
    "no cone": world_params(area=AREA, has_cone=False),
}


def cell(law: WorldParams) -> Cell:
    told = default_sensor()
    return Cell(world="here", relation="behind", seed=0, world_params=law, assumed_sensor=told)


@pytest.fixture(scope="module")
def drawn() -> dict[str, object]:
    """All laws in one batch, as the grid draws them; scenarios with leaves [NUMBER, …]."""
    index, numbers = np.repeat(np.arange(len(LAWS)), NUMBER), np.tile(np.arange(NUMBER), len(LAWS))
    placed = draw_tasks([cell(law) for law in LAWS.values()], index, numbers)
    return {
        name: jax.tree.map(lambda leaf, at=at: np.asarray(leaf)[index == at], placed.scenario)
        for at, name in enumerate(LAWS)
    }


@pytest.mark.parametrize("name", LAWS)
def test_things_stand_by_the_law(drawn: dict, name: str) -> None:
    law, places = LAWS[name], drawn[name]
    assert places.is_valid.all()
    expected = 2 * int(law.num_pairs) + int(law.num_bystanders)
    expected += int(law.has_goal) + int(law.has_cone)
    assert set(places.is_object.sum(axis=1)) == {expected}
    for lane in range(NUMBER):
        used = np.flatnonzero(places.is_object[lane])
        at = np.stack([places.object_x[lane], places.object_y[lane]])
        kind = places.object_type[lane]
        low, high = np.asarray(law.area)[0::2], np.asarray(law.area)[1::2]
        border = np.minimum(at[:, used].T - low, high - at[:, used].T)
        assert border.min() >= BORDER_MARGIN - 1e-4
        apart = np.hypot(*(at[:, :, None] - at[:, None, :])) + 99.0 * np.eye(len(kind))
        assert apart[np.ix_(used, used)].min() >= float(law.gap) - 1e-4
        own = [one for one in (0, 1) if one in used]
        rest = [one for one in used if one > 1]
        if own and rest:
            assert apart[np.ix_(own, rest)].min() >= GOAL_GAP - 1e-4
        hydrants, cones = used[kind[used] == HYDRANT], used[kind[used] == CONE]
        fits = {
            (int(h), int(c))
            for h in hydrants
            for c in cones
            if bool(is_related(jnp.asarray(at[:, h]), jnp.asarray(at[:, c]), law.stated_side))
        }
        is_true = bool(law.has_goal & law.has_cone) and float(law.side) == float(law.stated_side)
        assert fits == ({(0, 1)} if is_true else set())
        if len(own) == 2:
            assert PAIR_GAP[0] - 1e-4 <= apart[0, 1] <= PAIR_GAP[1] + 1e-4
            np.testing.assert_allclose(places.goal[lane], at[:, 0])


def test_goals_are_all_round(drawn: dict) -> None:
    goal = drawn["small"].goal
    turns = np.arctan2(goal[:, 1], goal[:, 0])
    assert {int(one // (np.pi / 2)) for one in turns} == {-2, -1, 0, 1}


def test_a_place_without_goal_or_haunting_says_so(drawn: dict) -> None:
    assert set(drawn["no goal"].goal_index) == {NONE}
    assert set(drawn["plain"].goal_index) == {0}
    num_clutter = (drawn["small"].errors.clutter_type != NONE).sum(axis=1)
    assert set(num_clutter) == {3}
    assert drawn["plain"].errors.clutter_type.shape[1] == NUM_FIXED_CLUTTER


def test_a_place_is_the_same_alone_and_among_others(drawn: dict) -> None:
    alone = draw_tasks([cell(LAWS["crowd"])], np.zeros(3, int), np.array([5, 7, 0]))
    for lane, number in enumerate((5, 7, 0)):
        mine = jax.tree.map(lambda leaf, lane=lane: np.asarray(leaf)[lane], alone.scenario)
        others = jax.tree.map(lambda leaf, at=number: leaf[at], drawn["crowd"])
        for one, other in zip(jax.tree.leaves(mine), jax.tree.leaves(others), strict=True):
            np.testing.assert_array_equal(one, other)


def test_too_many_things_are_refused() -> None:
    with pytest.raises(ValueError, match="66 objects and 0 places"):
        world_params(area=AREA, num_bystanders=64)


def test_a_given_gap_is_kept_in_a_crowd() -> None:
    assert float(LAWS["crowd"].gap) == 0.5
    assert float(world_params(area=AREA, num_bystanders=40, gap=0.7).gap) == pytest.approx(0.7)


def test_places_and_templates_are_not_drawn_at_once() -> None:
    both = [cell(LAWS["plain"]), Cell(world="1H1C", relation="null", seed=0)]
    with pytest.raises(ValueError, match="cannot be drawn at once"):
        draw_tasks(both, np.array([0, 1]), np.array([0, 0]))
