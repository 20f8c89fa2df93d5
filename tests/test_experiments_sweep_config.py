"""A mistake in a sweep's configuration is one clear line before anything runs."""

import math
from pathlib import Path
from typing import Any

import pytest

from jaxlangnav.experiments.sweep_config import config_from_dict, read_config
from jaxlangnav.experiments.sweep_plan import (
    make_plan,
    parse_shard,
    shard_episodes,
    shard_files,
)

SMALL: dict[str, Any] = {"worlds": ["1H1C"], "commands": ["behind"]}


def test_defaults() -> None:
    config = config_from_dict(SMALL)
    assert config.ranges == (3.0,)
    assert config.policies == ("informed",)
    assert (config.episodes, config.seeds) == (100, (0,))
    assert config.commands[0].text == "go to the hydrant behind the cone"


def test_units() -> None:
    table = SMALL | {
        "ranges": [2, "500 cm", "0.01 km"],
        "sensor": {"field_of_view": "180 deg", "noise": "5 cm", "detection_probability": "95 %"},
        "motion": {"odometry_noise": ["2 %", 0.1]},
    }
    config = config_from_dict(table)
    assert config.ranges == pytest.approx((2.0, 5.0, 10.0))
    assert config.params["sensor"]["field_of_view"] == pytest.approx((math.pi,))
    assert config.params["sensor"]["noise"] == pytest.approx((0.05,))
    assert config.params["sensor"]["detection_probability"] == pytest.approx((0.95,))
    assert config.params["motion"]["odometry_noise"] == pytest.approx((0.02, 0.1))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"wrolds": ["1H1C"]}, r'unknown key "wrolds"; did you mean "worlds"\?'),
        ({"sensor": {"fov": 1.0}}, r'unknown key "sensor.fov"'),
        ({"planner": {"discont": 0.5}}, r'"planner.discont"; did you mean "discount"\?'),
        ({"worlds": []}, "worlds is empty: the grid would be empty"),
        ({"ranges": []}, "ranges is empty: the grid would be empty"),
        ({"map": {"kernel": []}}, "kernel is empty: the grid would be empty"),
        ({"ranges": ["3 deg"]}, r'ranges = "3 deg" is an angle, but a length is needed \(m, cm'),
        ({"ranges": ["3 kg"]}, r'ranges = "3 kg" has the unknown unit "kg", but a length'),
        ({"ranges": [0]}, "ranges is 0, but must be above 0 m"),
        ({"ranges": ["three"]}, "ranges is 'three', but must be a length"),
        ({"ranges": [True]}, "ranges is True, but must be a length"),
        ({"ranges": [3, "300 cm"]}, "ranges lists a value twice"),
        ({"sensor": {"field_of_view": 360}}, 'at most 6.28319 rad; write "360 deg"'),
        ({"motion": {"odometry_noise": 2}}, 'at most 1; write "2 %"'),
        ({"sensor": {"noise": -0.1}}, "sensor.noise is -0.1, but must be at least 0 m"),
        ({"sensor": 3}, r"sensor is 3, but must be a table: \[sensor\]"),
        ({"episodes": 0}, "episodes is 0, but must be at least 1"),
        ({"episodes": [1, 2]}, "episodes is a list, but must be one whole number"),
        ({"episodes": 1.5}, "episodes is 1.5, but must be a whole number"),
        ({"seeds": [-1]}, "seeds is -1, but must be at least 0"),
        ({"seeds": [2**32]}, "seeds is 4294967296, but must be below 4294967296"),
        ({"policies": ["infromed"]}, r'unknown policy "infromed".*did you mean "informed"'),
        ({"worlds": ["1X"]}, "unknown world template '1X'"),
        ({"worlds": ["yrad"]}, "unknown world 'yrad'"),
        ({"worlds": ["1H0C"]}, "has no cone for the relation 'behind'"),
        ({"commands": ["find the car"]}, r'command "find the car": say by which relation'),
        ({"commands": [{"text": "find it", "relation": "behnd"}]}, "unknown relation 'behnd'"),
        ({"commands": [{"txt": "find it"}]}, r'unknown key "commands.txt"; did you mean "text"'),
        ({"commands": [""]}, "commands holds '', but must hold sentences"),
    ],
)
def test_mistakes(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        config_from_dict(SMALL | changes)
    assert "\n" not in str(error.value)


def test_missing_keys_and_files(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="commands is missing: the grid would be empty"):
        config_from_dict({"worlds": ["1H1C"]})
    with pytest.raises(ValueError, match="no such file"):
        read_config(tmp_path / "none.toml")
    broken = tmp_path / "broken.toml"
    broken.write_text("worlds = [")
    with pytest.raises(ValueError, match=r"broken.toml: is no valid TOML"):
        read_config(broken)
    broken.write_text('worlds = ["1H1C"]\ncommands = ["null"]\nrange = 3\n')
    with pytest.raises(
        ValueError, match=r'broken.toml: unknown key "range"; did you mean "ranges"'
    ):
        read_config(broken)


@pytest.mark.parametrize(
    ("goal", "number", "said"),
    [
        ("", 3, r"world own.toml has no \[goal\], by which a sweep tells success: add it"),
        ("[goal]\nx = 1.0\ny = 1.0\n", 9, "world own.toml has 9 objects, but .* at most 8: remove"),
    ],
)
def test_worlds_that_no_sweep_holds_are_refused(goal, number, said, tmp_path) -> None:
    area = "[area]\nx_min = 0.0\nx_max = 9.0\ny_min = -9.0\ny_max = 9.0\n"
    things = [f'[[objects]]\ntype = "box"\nx = {i / 2}\ny = 0.0\n' for i in range(number)]
    (tmp_path / "own.toml").write_text(area + goal + "".join(things))
    (tmp_path / "grid.toml").write_text('worlds = ["own.toml"]\ncommands = ["null"]\n')
    with pytest.raises(ValueError, match=said):
        read_config(tmp_path / "grid.toml")


def test_a_navigator_that_could_never_stop_is_refused() -> None:
    config = config_from_dict(
        SMALL
        | {"policies": ["faithful"]}
        | {"planner": {"stop_probability": 0.9}, "map": {"concentration": 3}}
    )
    with pytest.raises(ValueError, match=r"stop_probability is 0.9, but with concentration 3"):
        make_plan(config)


def test_the_plan_holds_every_episode_once() -> None:
    config = config_from_dict(
        {
            "episodes": 70,
            "seeds": [0, 3],
            "worlds": ["1H1C", "2H1C"],
            "commands": ["null", "behind"],
            "ranges": [2, 5],
            "policies": ["informed", "frontier"],
            "particles": [64, 128],
            "sensor": {"noise": [0.1, 0.2]},
            "planner": {"discount": [0.7, 0.8, 0.9]},
        }
    )
    plan = make_plan(config)
    # Settings 2·2·2·2·2 = 32 of 70 episodes; informed in 2·3 arms, the baseline in one.
    assert plan.episodes() == 32 * 70 * 7
    rows = set()
    for index in range(plan.num_files):
        chunk = plan.chunk(index)
        columns = plan.grid.labels(chunk.arm, chunk.places)
        assert {len(values) for values in columns.values()} == {chunk.size}
        rows |= set(zip(*columns.values(), strict=True))
    assert len(rows) == plan.episodes()


def test_shards_split_the_plan() -> None:
    plan = make_plan(config_from_dict(SMALL | {"episodes": 3000}))
    parts = [shard_files(plan, f"{i}/5") for i in range(1, 6)]
    assert sorted([index for part in parts for index in part]) == list(range(plan.num_files))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1


def test_a_part_of_a_billion_episodes_is_a_part() -> None:
    config = config_from_dict(SMALL | {"episodes": 10**8, "seeds": list(range(10))})
    plan = make_plan(config)
    assert plan.episodes() == 10**9 * plan.num_arms * plan.num_settings // 10
    parts = [shard_episodes(plan, f"{i}/1000") for i in (1, 500, 1000)]
    assert max(parts) - min(parts) <= 1024
    last = plan.chunk(shard_files(plan, "7/1000")[-1])
    columns = plan.grid.labels(last.arm, last.places)
    assert columns["episode"][0] == last.first % 10**8
    assert columns["seed"][0] == last.first // 10**8
    assert sum(shard_episodes(plan, f"{i}/7") for i in range(1, 8)) == plan.episodes()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"episodes": 10**12},
            r"1 cells times 1,000,000,000,000 episodes, which make 976,562,500 files, but a folder "
            r"holds 1,000,000: at most 1,024,000,000 episodes a cell fit",
        ),
        ({"episodes": 10**100}, r"times 1\.0·10\^100 episodes"),
        (
            {
                "episodes": 1,
                "seeds": list(range(2000)),
                "ranges": [1 + i / 1000 for i in range(2000)],
                "sensor": {"noise": [i / 1000 for i in range(1, 1001)]},
            },
            r"4,000,000,000 cells .* not even one a cell fits; or divide the lists",
        ),
        (
            {"particles": [64, 10**12], "policies": ["informed"]},
            r"particles is 1,000,000,000,000 with .*, which takes .* but there are .*: at most",
        ),
        ({"environments": 2**32}, "environments is 4294967296, but must be below"),
    ],
)
def test_more_than_fits_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        make_plan(config_from_dict(SMALL | changes))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("text", ["0/4", "5/4", "4", "a/b", "1/0", "-1/2"])
def test_bad_shards(text: str) -> None:
    with pytest.raises(ValueError, match="shard is"):
        parse_shard(text)


def test_the_example_is_a_sweep() -> None:
    config = read_config(Path(__file__).parent.parent / "examples" / "grid.toml")
    # 3 worlds, 2 commands, 2 ranges, 2 detectors, 50 episodes, 3 policies.
    assert make_plan(config).episodes() == 24 * 50 * 3
