"""The one engine of tables, studies and sweeps: the presets are grids of the same episodes."""

import dataclasses

import numpy as np
import pytest

from jaxlangnav.episode import Task
from jaxlangnav.experiments.grid import Arm, Grid, policy_arm, run_grid, typed
from jaxlangnav.experiments.rows import RowSpec
from jaxlangnav.experiments.sentences import SENTENCES, ground_sentences
from jaxlangnav.experiments.sweep_config import config_from_dict
from jaxlangnav.experiments.sweep_plan import make_plan

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
    labels = swept.labels(swept.arms[0], PLACES)
    for name, values in GRID.labels(GRID.arms[0], PLACES).items():
        assert labels[name] == values
    # Any part of an arm's episodes is what it is in the whole.
    part = GRID.draw(PLACES[3:7])
    np.testing.assert_array_equal(part.scenario.object_x, ours.scenario.object_x[3:7])


def test_an_arm_sets_its_worlds_and_keeps_their_keys() -> None:
    drawn = GRID.draw(PLACES)
    arm = Arm(policy="known", told={}, sensor={"noise": 0.5}, worlds=lambda tasks: tasks)
    tasks = arm.tasks(drawn)
    assert tasks.key is drawn.key
    np.testing.assert_allclose(tasks.sensor.noise, 0.5)
    np.testing.assert_array_equal(tasks.sensor.range_max, drawn.sensor.range_max)


def test_a_grid_is_run_arm_by_arm_and_summed_up_by_setting() -> None:
    done: list[int] = []
    instructions = ground_sentences(list(SENTENCES.values())).instructions
    (played,) = run_grid(GRID, instructions, on_progress=done.append)
    assert sum(done) == 2 * EPISODES
    rows, columns = played.rows(), played.columns()
    assert [(row["range"], row["policy"], row["episodes"]) for row in rows] == [
        (2.0, "known", EPISODES),
        (5.0, "known", EPISODES),
    ]
    distance = np.asarray(columns["distance"])
    assert [row["distance_mean"] for row in rows] == [
        np.mean(distance[:EPISODES], dtype=np.float64),
        np.mean(distance[EPISODES:], dtype=np.float64),
    ]
    assert list(columns)[:6] == ["world", "range", "relation", "policy", "seed", "episode"]


def test_labels_have_one_type_in_every_file() -> None:
    found = typed({"particles": [None], "map.kernel": [None], "world": ["1H1C"], "seed": [1]})
    assert [str(one.type) for one in found.values()] == ["int64", "double", "string", "int64"]


def test_a_setting_may_have_numbers_of_its_own_to_believe(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Those of one set of numbers are run together, and each ends where its setting stands."""
    believed = ({}, {"concentration": 2.0}, {})
    settings = [dataclasses.replace(GRID.settings[0], believed=numbers) for numbers in believed]
    arm = policy_arm("informed", num_particles=64)
    calls: list[tuple[float, int]] = []

    def judge(self: Arm, tasks: Task, *_: object, **__: object) -> tuple[np.ndarray, None]:
        assert self.params is not None
        assert self.config is arm.config
        calls.append((float(self.params.map.concentration), tasks.key.shape[0]))
        return np.asarray(tasks.scenario.object_x) + 100.0 * calls[-1][0], None

    monkeypatch.setattr(Arm, "judge", judge)
    grid = dataclasses.replace(GRID, settings=settings, arms=[arm])
    (played,) = run_grid(grid, None)  # pyright: ignore
    usual = float(np.float32(0.3))
    assert calls == [(usual, 2 * EPISODES), (2.0, EPISODES)]
    added = np.repeat([usual, 2.0, usual], EPISODES)[:, None]
    drawn = np.asarray(grid.draw(np.arange(3 * EPISODES)).scenario.object_x)
    np.testing.assert_allclose(np.asarray(played.results), drawn + 100.0 * added, rtol=1e-6)
    # A baseline believes nothing.
    known = policy_arm("known", num_particles=64)
    assert known.believing({"concentration": 2.0}) is known
