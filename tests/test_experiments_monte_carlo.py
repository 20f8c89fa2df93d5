"""Episodes are the same however they are asked for: alone, in a batch, in any order of cells."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.episode import Task
from jaxlangnav.experiments import monte_carlo
from jaxlangnav.experiments.experiment import Grid, run_grid
from jaxlangnav.experiments.metrics import summarize
from jaxlangnav.experiments.policies import Arm, policy_arm, run_policy
from jaxlangnav.experiments.rows import RowSpec
from jaxlangnav.experiments.sweep_config import config_from_dict
from jaxlangnav.experiments.sweep_plan import make_plan
from jaxlangnav.experiments.tasks import (
    BLOCK,
    SENTENCES,
    Cell,
    draw_tasks,
    ground_sentences,
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
    one = Cell(world="2H1C", relation="behind", instruction_index=1, seed=5)
    whole = make_tasks(one, BLOCK + 30)
    assert whole.instruction_index.shape == (BLOCK + 30,)
    same(take(whole, slice(0, 7)), make_tasks(one, 7))
    same(take(whole, slice(BLOCK, BLOCK + 20)), make_tasks(one, 20, first=BLOCK))


def test_any_selection_of_cells_gives_the_same_tasks() -> None:
    cells = [
        RowSpec(world="1H1C", range=2.0, relation="null").setting(seed=0),
        RowSpec(world="2H2C", range=5.0, relation="nearest").setting(seed=0),
        Cell(world="1H2C", relation="behind", instruction_index=1, seed=9),
    ]
    alone = [make_tasks(one, 6) for one in cells]
    index, numbers = np.array([2, 0, 1, 1, 0]), np.array([5, 0, 3, 2, 4])
    mixed = draw_tasks(cells, index, numbers)
    for place, (which, number) in enumerate(zip(index, numbers, strict=True)):
        same(take(mixed, slice(place, place + 1)), take(alone[which], slice(number, number + 1)))


def test_worlds_are_shared_by_ranges_and_commands_but_not_by_seeds() -> None:
    near = make_tasks(RowSpec(world="1H1C", range=2.0, relation="behind").setting(seed=0), 4)
    far = make_tasks(RowSpec(world="1H1C", range=20.0, relation="behind").setting(seed=0), 4)
    same(take(near, slice(4)), dataclasses.replace(far, sensor=near.sensor))
    null = make_tasks(RowSpec(world="1H1C", range=2.0, relation="null").setting(seed=0), 4)
    np.testing.assert_array_equal(null.scenario.object_x, near.scenario.object_x)
    other = make_tasks(RowSpec(world="1H1C", range=2.0, relation="behind").setting(seed=1), 4)
    assert not np.any(near.scenario.goal == other.scenario.goal)


def test_environments_are_taken_in_turn() -> None:
    one = Cell(world="2H1C", relation="behind", instruction_index=1, seed=0)
    fresh, few = make_tasks(one, 7), make_tasks(dataclasses.replace(one, environments=3), 7)
    turn = np.arange(7) % 3
    same(dataclasses.replace(few, scenario=take(fresh, turn).scenario), few)
    # The noise is each episode's own.
    np.testing.assert_array_equal(jax.random.key_data(few.key), jax.random.key_data(fresh.key))


def test_a_world_of_ones_own_stands_as_it_is() -> None:
    own = open_world("yard")
    assert isinstance(own, WorldFile)
    one = Cell(world="yard", relation="null", seed=0, scenario=own.scenario)
    tasks = make_tasks(one, 5)
    np.testing.assert_array_equal(tasks.scenario.goal, np.tile(own.scenario.goal, (5, 1)))
    np.testing.assert_array_equal(tasks.scenario.area[3], own.scenario.area)
    assert len(np.unique(np.asarray(jax.random.key_data(tasks.key)), axis=0)) == 5
    cells = [one, Cell(world="1H1C", relation="null", seed=0)]
    mixed = draw_tasks(cells, np.array([1, 0]), np.array([0, 1]))
    np.testing.assert_array_equal(mixed.scenario.goal[1], own.scenario.goal)
    same(take(mixed, slice(0, 1)), make_tasks(Cell(world="1H1C", relation="null", seed=0), 1))


def test_bad_cells_are_refused() -> None:
    with pytest.raises(ValueError, match="episodes is 0, but must be at least 1"):
        make_tasks(Cell(world="1H1C", relation="null", seed=0), 0)
    with pytest.raises(ValueError, match="seed is 4294967296, but must lie between 0 and"):
        Cell(world="1H1C", relation="null", seed=2**32)


def test_pieces_come_back_in_order_and_without_padding(monkeypatch) -> None:
    monkeypatch.setattr(monte_carlo, "concurrent_calls", lambda: 2)
    number, seen = 2 * monte_carlo.CHUNK_SIZE + 3, []
    tasks = make_tasks(Cell(world="1H1C", relation="null", seed=0), number)
    found = run_policy("known", tasks, INSTRUCTIONS, on_progress=seen.append)
    np.testing.assert_allclose(found.distance, known_distances(tasks), atol=1.0)
    assert len(seen) > 2
    assert len(found.distance) == sum(seen) == number
    alone = run_policy("known", take(tasks, slice(5)), INSTRUCTIONS)
    np.testing.assert_array_equal(found.distance[:5], alone.distance)


# The one engine of tables, studies and sweeps: the presets are grids of the same episodes.


EPISODES = 5
SPECS = [RowSpec(world="1H1C", range=one, relation="null") for one in (2.0, 5.0)]
GRID = Grid(
    settings=[one.setting(seed=3) for one in SPECS],
    arms=[policy_arm("known", num_particles=64)],
    episodes=EPISODES,
    names=("world", "range", "relation", "policy"),
)
PLACES = np.arange(2 * EPISODES)


def test_a_table_and_a_sweep_are_the_same_episodes() -> None:
    table = {"worlds": ["1H1C"], "commands": ["null"], "ranges": [2, 5], "policies": ["known"]}
    swept = make_plan(config_from_dict(table | {"episodes": EPISODES, "seeds": [3]})).grid
    ours, theirs = GRID.draw(PLACES), swept.arms[0].tasks(swept.draw(PLACES))
    np.testing.assert_array_equal(ours.scenario.object_x, theirs.scenario.object_x)
    np.testing.assert_array_equal(ours.sensor.range_max, theirs.sensor.range_max)
    labels = swept._labels(swept.arms[0], PLACES)
    for name, values in GRID._labels(GRID.arms[0], PLACES).items():
        assert labels[name] == values
    # Any part of an arm's episodes is what it is in the whole.
    part = GRID.draw(PLACES[3:7])
    np.testing.assert_array_equal(part.scenario.object_x, ours.scenario.object_x[3:7])


def test_an_arm_sets_its_worlds_and_keeps_their_keys() -> None:
    drawn = GRID.draw(PLACES)
    arm = Arm(policy="known", labels={}, sensor={"noise": 0.5}, transform=lambda tasks: tasks)
    tasks = arm.tasks(drawn)
    assert tasks.key is drawn.key
    np.testing.assert_allclose(tasks.sensor.noise, 0.5)
    np.testing.assert_array_equal(tasks.sensor.range_max, drawn.sensor.range_max)


def test_a_grid_is_run_arm_by_arm_and_summed_up_by_setting() -> None:
    done: list[int] = []
    (played,) = run_grid(GRID, INSTRUCTIONS, on_progress=done.append)
    assert sum(done) == 2 * EPISODES
    rows = [summarize(*played.of_setting(place)) for place in range(2)]
    columns = GRID.columns(played.arm, PLACES, played.results, played.known_distances)
    assert columns["range"].to_pylist() == [2.0] * EPISODES + [5.0] * EPISODES
    assert [row.episodes for row in rows] == [EPISODES] * 2
    distance = np.asarray(columns["distance"])
    assert [row.distance_mean for row in rows] == [
        np.mean(distance[:EPISODES], dtype=np.float64),
        np.mean(distance[EPISODES:], dtype=np.float64),
    ]
    assert list(columns)[:6] == ["world", "range", "relation", "policy", "seed", "episode"]


def test_a_setting_may_have_numbers_of_its_own_to_believe(monkeypatch):
    """Those of one set of numbers are run together, and each ends where its setting stands."""
    believed = ({}, {"concentration": 2.0}, {})
    settings = [dataclasses.replace(GRID.settings[0], overrides=numbers) for numbers in believed]
    arm = dataclasses.replace(policy_arm("informed", num_particles=64), calibration_episodes=2)
    calls: list[tuple[float, int]] = []

    def run(self: Arm, tasks: Task, *_: object, with_tally: bool, **__: object) -> tuple[Any, Any]:
        assert self.params is not None
        assert self.config is arm.config
        calls.append((float(self.params.map.concentration), tasks.key.shape[0]))
        x = np.asarray(tasks.scenario.object_x)
        return x + 100.0 * calls[-1][0], x if with_tally else None

    monkeypatch.setattr(Arm, "run", run)
    grid = dataclasses.replace(GRID, settings=settings, arms=[arm])
    (played,) = run_grid(grid, None)  # pyright: ignore
    usual = float(np.float32(0.3))
    assert calls == [(usual, 4), (usual, 2 * EPISODES - 4), (2.0, 2), (2.0, EPISODES - 2)]
    added = np.repeat([usual, 2.0, usual], EPISODES)[:, None]
    drawn = np.asarray(grid.draw(np.arange(3 * EPISODES)).scenario.object_x)
    np.testing.assert_allclose(np.asarray(played.results), drawn + 100.0 * added, rtol=1e-6)
    firsts = drawn.reshape(3, EPISODES, -1)[:, :2].reshape(6, -1)
    np.testing.assert_array_equal(np.asarray(played.tally), firsts)
    # A baseline believes nothing.
    known = policy_arm("known", num_particles=64)
    assert known.with_overrides({"concentration": 2.0}) is known
