"""The study of what the paper leaves open: what is varied, how it is judged, how it is told."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxlangnav.episode import Task
from jaxlangnav.experiments import unknowns
from jaxlangnav.experiments.experiment import Grid, Options
from jaxlangnav.experiments.rows import PRINTED as SPECS, RowSpec, printed_rows
from jaxlangnav.experiments.unknowns import UNKNOWNS, VARIATIONS, Variation, _turned
from jaxlangnav.navigator import check
from jaxlangnav.viz import sweep as picture
from jaxlangnav.world.templates import TABLE_2

PRINTED = printed_rows(TABLE_2)
OPTIONS = Options(seed=3000)


def drawn(spec: RowSpec, *, episodes: int, seed: int) -> Task:
    grid = Grid(settings=[spec.setting(seed=seed)], arms=[], episodes=episodes, names=())
    return grid.draw(np.arange(episodes))


def test_each_variation_sets_one_thing_and_the_first_one_none() -> None:
    blank = Variation(unknown="", value="")
    for place, one in enumerate(VARIATIONS):
        changed = [
            field.name
            for field in dataclasses.fields(Variation)
            if field.name not in ("unknown", "value")
            and getattr(one, field.name) != getattr(blank, field.name)
        ]
        assert len(changed) == min(place, 1), one
        arm = one.arm(OPTIONS)
        params = arm.params
        assert params is not None
        assert arm.config is not None
        check(params, policy=arm.config.planner.chosen)
    assert len({(one.unknown, one.value) for one in VARIATIONS}) == len(VARIATIONS)
    assert UNKNOWNS.total_episodes(Options(episodes=10)) == 70 * len(VARIATIONS)


def test_only_sizes_compile_anew() -> None:
    """What is static: particles and blocks by the config, the time-out by itself."""
    configs = {one.unknown + one.value: one.arm(OPTIONS).config for one in VARIATIONS}
    first = configs[unknowns.OURS]
    other = {name: config for name, config in configs.items() if config != first}
    assert set(other) == {"particles÷ 4", "particles× 4", "frontier spacingdoubled",
                          "frontier spacinghalved"}  # fmt: skip
    sizes = [one.map.num_particles for name, one in other.items() if one and "particles" in name]
    assert sizes == [16, 256]


def test_worlds_are_turned_as_a_whole() -> None:
    tasks = drawn(RowSpec(world="2H2C", range=3.0, relation="behind"), episodes=64, seed=5)
    after = _turned(tasks, 5)
    old, new = tasks.scenario, after.scenario
    before = np.asarray(old.object_x) + 1j * np.asarray(old.object_y)
    now = np.asarray(new.object_x) + 1j * np.asarray(new.object_y)
    is_object = np.asarray(old.is_object)
    # One complex factor of modulus 1 a world: nothing is stretched, nothing mirrored.
    factor = now[is_object].reshape(64, 4) / before[is_object].reshape(64, 4)
    assert np.abs(factor) == pytest.approx(1.0, abs=1e-5)
    assert np.abs(factor - factor[:, :1]).max() < 1e-5
    goal = np.asarray(new.goal[:, 0]) + 1j * np.asarray(new.goal[:, 1])
    assert goal == pytest.approx(now[np.arange(64), np.asarray(new.goal_index)], abs=1e-5)
    # Angles over the whole circle: each quadrant has 16 of 64 ± 3.5; five standard errors.
    quadrants = np.bincount((np.angle(factor[:, 0]) // (np.pi / 2)).astype(int) + 2, minlength=4)
    assert np.abs(quadrants - 16).max() <= 5 * 3.5
    # Whatever then stands outside is not run as if it were inside.
    depth = np.asarray(old.area[:, 1])
    assert np.asarray(new.area) == pytest.approx(np.stack([-depth, depth, -depth, depth], axis=1))
    inside = (np.abs(now.real) <= depth[:, None]) & (np.abs(now.imag) <= depth[:, None])
    is_valid = np.asarray(old.is_valid) & (inside | ~is_object).all(axis=1)
    assert np.array_equal(np.asarray(new.is_valid), is_valid)
    assert np.array_equal(np.asarray(after.sensor.range_max), np.asarray(tasks.sensor.range_max))


def test_variations_share_worlds_and_keys() -> None:
    tasks = drawn(SPECS[0], episodes=3, seed=1)
    other = VARIATIONS[1].arm(OPTIONS).tasks(tasks)
    assert other.key is tasks.key
    assert other.scenario is tasks.scenario
    assert np.asarray(other.sensor.field_of_view) == pytest.approx([np.pi] * 3)
    assert np.asarray(other.sensor.noise) == pytest.approx(np.asarray(tasks.sensor.noise))


def document() -> dict[str, Any]:
    """Two variations by hand: the second has the paper's own figures but for 1H1C null."""
    rows = []
    episodes: Any = SimpleNamespace(is_valid=np.zeros(1, bool))
    for one in (VARIATIONS[0], VARIATIONS[2]):
        for index, paper in enumerate(PRINTED):
            is_off = one is VARIATIONS[0] or index == 0
            row = SPECS[index].heading() | {
                "policy": "faithful", "unknown": one.unknown, "value": one.value,
                "episodes": 400, "invalid_worlds": 1, "timeouts": 2, "not_found": 0,
                "distance_sd": 20.0,
                "success_rate": paper["success_rate"],
                "distance_mean": paper["distance_mean"] + 30.0 * is_off,
            }  # fmt: skip
            measured = unknowns._measure(row, SPECS[index], episodes, episodes)
            pair = {"distance_difference": -30.0, "distance_ci": [-31.0, -29.0]}
            rows.append(row | measured | {"paired": pair})
    return {
        "episodes": 400, "seed": 3000, "num_particles": 64,
        "noise": {"field_of_view": 2 * np.pi, "detection_probability": 0.95, "step_length": 1.0},
        "paper": PRINTED, "rows": rows, **UNKNOWNS.found(rows, OPTIONS),
    }  # fmt: skip


def test_what_explains_a_row_by_hand() -> None:
    found = document()
    assert [one["rows_near"] for one in found["variations"]] == [0, 6]
    # Standard errors of 1H1C null: 20 / 20 and 7.9 / 10.
    z = 30.0 / (1.0 + 0.79**2) ** 0.5
    assert found["rows"][0]["z_distance"] == pytest.approx(z)
    assert found["variations"][1]["rms_z"] == pytest.approx(z / 14**0.5)
    assert found["explained"][0]["both"] == []
    assert found["explained"][0]["success"] == ["field of view 90°"]
    assert found["explained"][3]["both"] == ["field of view 90°"]
    lines = UNKNOWNS.notes(found)
    assert lines[0].startswith("1H1C null: nothing explains both figures (success is near as it is")
    assert "distance by none" in lines[0]
    assert lines[3] == "1H2C behind: explained by field of view 90°."


def test_tables_by_hand() -> None:
    found = document()
    table, whole = UNKNOWNS.tables(found)
    headings, lines = table.headings, table.rows
    assert headings[2:5] == ["1H1C null", "1H1C behind", "1H2C null"]
    assert lines[0][2:4] == ["93.9 · 16.8", "98.3 · 13.4"]
    assert lines[2][:4] == ["field of view", "90°", "93.9* · 46.8", "98.3* · 13.4*"]
    assert lines[2][-2] == "6 of 7"
    long = whole.rows
    assert len(long) == 14
    assert long[1][:8] == [
        "1H1C", "3", "null", "field of view", "90°", "93.9 ± 1.2", "93.9", "+0.0",
    ]  # fmt: skip
    assert long[0][11] == ""
    assert long[1][11] == "-30.00 (-31.00 to -29.00)"
    text = UNKNOWNS.markdown(found)
    assert "γ 0.8; 64 particles; τ 0.7; α 0.3; reach 1.2 m" in text
    assert "left out: 14" in text


def test_every_variation_is_a_point_of_every_panel() -> None:
    figure = picture.unknowns_figure(document())
    assert len(figure.axes) == 14
    labels = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert labels == ["as in all our tables", "field of view  90°"]
    bars: list[Any] = figure.axes[7].containers
    points = [one.lines[0].get_xydata()[0].tolist() for one in bars]
    assert points == [[pytest.approx(46.78), 0.0], [pytest.approx(46.78), 1.0]]
    with pytest.raises(ValueError, match="nothing to draw"):
        picture.unknowns_figure({"rows": [], "paper": [], "variations": []})


@pytest.mark.slow
def test_the_study_runs_and_is_paired(tmp_path) -> None:
    done: list[int] = []
    chosen = [VARIATIONS[0], VARIATIONS[2], VARIATIONS[-1]]
    experiment = dataclasses.replace(
        UNKNOWNS, arms=lambda options: [one.arm(options) for one in chosen]
    )
    options = Options(episodes=6, seed=3000)
    found = experiment.run(options, out=tmp_path, on_progress=done.append)
    assert sum(done) == 3 * 7 * 6
    assert len(found["rows"]) == 21
    assert found["seed"] == 3000
    for row in found["rows"][:7]:
        assert row["paired"]["distance_difference"] == 0.0
    assert any(row["paired"]["distance_difference"] != 0.0 for row in found["rows"][7:14])
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {
        "unknowns.md", "unknowns.json", "unknowns_manifest.json", "unknowns_episodes.parquet",
    }  # fmt: skip
