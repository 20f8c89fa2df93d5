"""Episodes are the same however they are asked for: alone, in a batch, in any order of cells."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.episode import EpisodeResult, Task
from jaxlangnav.experiments import monte_carlo
from jaxlangnav.experiments.baselines import run_baseline
from jaxlangnav.experiments.policies import run_policy
from jaxlangnav.experiments.sentences import SENTENCES, ground_sentences
from jaxlangnav.experiments.tasks import (
    BLOCK,
    cell,
    concatenate,
    draw_tasks,
    known_distances,
    make_tasks,
)
from jaxlangnav.world.files import WorldFile, open_world

INSTRUCTIONS = ground_sentences(list(SENTENCES.values())).instructions


def same(one: Task, other: Task) -> None:
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        if jnp.issubdtype(a.dtype, jax.dtypes.prng_key):
            a, b = jax.random.key_data(a), jax.random.key_data(b)
        np.testing.assert_array_equal(a, b)


def take(tasks: Task, index: Any) -> Task:
    return jax.tree.map(lambda leaf: leaf[index], tasks)


def test_an_episode_depends_on_its_number_only() -> None:
    whole = make_tasks(cell("2H1C", "behind", 1, 3.0, BLOCK + 30, 5))
    assert whole.instruction_index.shape == (BLOCK + 30,)
    same(take(whole, slice(0, 7)), make_tasks(cell("2H1C", "behind", 1, 3.0, 7, 5)))
    later = dataclasses.replace(cell("2H1C", "behind", 1, 3.0, 20, 5), first_episode=BLOCK)
    same(take(whole, slice(BLOCK, BLOCK + 20)), make_tasks(later))


def test_any_selection_of_cells_gives_the_same_tasks() -> None:
    cells = [
        cell("1H1C", "null", 0, 2.0, 6, 0),
        cell("2H2C", "nearest", 2, 5.0, 6, 0),
        cell("1H2C", "behind", 1, 3.0, 6, 9),
    ]
    alone = [make_tasks(one) for one in cells]
    index, numbers = np.array([2, 0, 1, 1, 0]), np.array([5, 0, 3, 2, 4])
    mixed = draw_tasks(cells, index, numbers)
    for place, (which, number) in enumerate(zip(index, numbers, strict=True)):
        same(take(mixed, slice(place, place + 1)), take(alone[which], slice(number, number + 1)))


def test_worlds_are_shared_by_ranges_and_commands_but_not_by_seeds() -> None:
    near = make_tasks(cell("1H1C", "behind", 1, 2.0, 4, 0))
    far = make_tasks(cell("1H1C", "behind", 1, 20.0, 4, 0))
    same(take(near, slice(4)), dataclasses.replace(far, sensor=near.sensor))
    null = make_tasks(cell("1H1C", "null", 0, 2.0, 4, 0))
    np.testing.assert_array_equal(null.scenario.object_x, near.scenario.object_x)
    other = make_tasks(cell("1H1C", "behind", 1, 2.0, 4, 1))
    assert not np.any(near.scenario.goal == other.scenario.goal)


def test_environments_are_taken_in_turn() -> None:
    fresh = make_tasks(cell("2H1C", "behind", 1, 3.0, 7, 0))
    few = make_tasks(dataclasses.replace(cell("2H1C", "behind", 1, 3.0, 7, 0), environments=3))
    turn = np.arange(7) % 3
    same(dataclasses.replace(few, scenario=take(fresh, turn).scenario), few)
    # The noise is each episode's own.
    np.testing.assert_array_equal(jax.random.key_data(few.key), jax.random.key_data(fresh.key))


def test_a_world_of_ones_own_stands_as_it_is() -> None:
    own = open_world("yard")
    assert isinstance(own, WorldFile)
    one = dataclasses.replace(cell("yard", "null", 0, 3.0, 5, 0), scenario=own.scenario)
    tasks = make_tasks(one)
    np.testing.assert_array_equal(tasks.scenario.goal, np.tile(own.scenario.goal, (5, 1)))
    np.testing.assert_array_equal(tasks.scenario.area[3], own.scenario.area)
    keys = jax.random.key_data(tasks.key)
    assert len(np.unique(np.asarray(keys), axis=0)) == 5
    mixed = draw_tasks(
        [one, cell("1H1C", "null", 0, 3.0, 5, 0)], np.array([1, 0]), np.array([0, 1])
    )
    np.testing.assert_array_equal(mixed.scenario.goal[1], own.scenario.goal)
    same(take(mixed, slice(0, 1)), make_tasks(cell("1H1C", "null", 0, 3.0, 1, 0)))


def test_bad_cells_are_refused() -> None:
    with pytest.raises(ValueError, match="episodes is 0, but must be at least 1"):
        make_tasks(cell("1H1C", "null", 0, 3.0, 0, 0))
    with pytest.raises(ValueError, match="unknown relation"):
        make_tasks(cell("1H1C", "behnd", 0, 3.0, 1, 0))
    with pytest.raises(ValueError, match="unknown world template"):
        make_tasks(cell("hydrant", "null", 0, 3.0, 1, 0))
    with pytest.raises(ValueError, match="seed is 4294967296, but must lie between 0 and"):
        cell("1H1C", "null", 0, 3.0, 1, 2**32)


@pytest.mark.parametrize(
    ("number", "threads", "expected"),
    [
        (1, 2, [(0, 1)]),
        (700, 2, [(0, 350), (350, 350)]),
        (1025, 1, [(0, 512), (512, 513)]),
        (4800, 2, [(800 * k, 800) for k in range(6)]),
        (70, 2, [(0, 70)]),
    ],
)
def test_pieces_by_hand(number: int, threads: int, expected: list[tuple[int, int]]) -> None:
    assert monte_carlo.pieces(number, 1024, threads) == expected


def test_pieces_come_back_in_order_and_without_padding() -> None:
    tasks = make_tasks(cell("1H1C", "null", 0, 3.0, 2 * BLOCK + 3, 0))
    seen: list[int] = []

    def one(piece: Task, count: int) -> EpisodeResult:
        assert piece.instruction_index.shape == (BLOCK,)
        assert count <= BLOCK
        return run_baseline(piece, INSTRUCTIONS, policy="known")

    found = monte_carlo.map_pieces(
        one, tasks, capacity=BLOCK, on_progress=seen.append, num_threads=2
    )
    np.testing.assert_allclose(found.distance, known_distances(tasks), atol=1.0)
    assert len(found.distance) == sum(seen) == 2 * BLOCK + 3
    alone = monte_carlo.map_pieces(one, take(tasks, slice(5)), capacity=BLOCK)
    np.testing.assert_array_equal(found.distance[:5], alone.distance)


@pytest.mark.slow
def test_the_navigator_does_not_care_how_episodes_are_split() -> None:
    parts = [
        make_tasks(cell("2H1C", "behind", 1, 3.0, 40, 3)),
        make_tasks(cell("1H2C", "null", 0, 5.0, 40, 3)),
    ]
    tasks = concatenate(parts)
    whole = run_policy("informed", tasks, INSTRUCTIONS, num_threads=1)
    order = np.random.default_rng(0).permutation(80)
    mixed = run_policy("informed", take(tasks, order), INSTRUCTIONS, num_threads=1)
    few = run_policy("informed", take(tasks, slice(37, 44)), INSTRUCTIONS)
    for a, b, c in zip(
        jax.tree.leaves(whole), jax.tree.leaves(mixed), jax.tree.leaves(few), strict=True
    ):
        np.testing.assert_array_equal(a[order], b)
        np.testing.assert_array_equal(a[37:44], c)
