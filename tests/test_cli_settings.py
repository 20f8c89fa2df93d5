"""Nested options made from the engine's records: names, units, defaults, limits, refusals."""

import math
from typing import Any

import numpy as np
import pytest

from jaxlangnav.cli import main as cli, settings
from jaxlangnav.cli.arguments import parse_arguments
from jaxlangnav.cli.follow import Follow
from jaxlangnav.cli.output import UsageError
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.messages import default_sensor
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.task.follow import navigator_params

TEXT = "go to the hydrant"


def typed(*words: str) -> dict[settings.SettingPath, Any]:
    command: Any = parse_arguments(["follow", TEXT, *words])
    return settings.read_settings(command.settings, Follow.SETTINGS)


def test_every_number_of_the_planner_is_an_option_with_its_help() -> None:
    found = {one.path: one for one in settings.options(["params"])}
    names = [path[-1] for path in found if path[:2] == ("params", "planner")]
    assert names == list(PlannerParams.__dataclass_fields__)
    discount = found["params", "planner", "discount"]
    assert discount.flag == "--params.planner.discount"
    assert discount.default == pytest.approx(float(navigator_params().planner.discount))
    assert discount.help.startswith("γ per metre")
    # Every number says what it is, to its end; sizes say it by their names.
    assert all(one.help or one.is_whole for one in settings.options(settings.GROUPS))
    assert found["params", "planner", "give_up"].help.endswith("of ``informed``, 0: never")
    assert found["params", "mode_speed"].default == (1.0, 1.5, 0.6)
    assert "normal, quickly, carefully" in found["params", "mode_speed"].help
    # What has an option of its own is not offered twice.
    assert "--config.map.num-particles" not in {one.flag for one in settings.options(["config"])}


def test_nothing_typed_sets_nothing() -> None:
    assert typed() == {}
    params = navigator_params()
    assert settings.apply(params, {}, "params") is params


def test_values_are_read_with_units_and_set() -> None:
    values = typed(
        "--params.planner.reach", "80 cm", "--params.map.concentration=0.2",
        "--config.map.num-objects", "6", "--sensor.field-of-view", "90 deg",
        "--params.mode-speed", "1, 2, 0.5", "--params.map.relations.log-distance-sd",
        "0.1,0.2,0.3,0.4,0.5,0.6",
    )  # fmt: skip
    params = settings.apply(navigator_params(), values, "params")
    assert float(params.planner.reach) == pytest.approx(0.8)
    assert float(params.map.concentration) == pytest.approx(0.2)
    assert np.asarray(params.mode_speed) == pytest.approx([1, 2, 0.5])
    spread = np.asarray(params.map.relations.log_distance_sd)
    assert spread == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    # What the filter has prepared from it is prepared anew.
    before = np.asarray(navigator_params().map.relations.log_constant)
    change = np.asarray(params.map.relations.log_constant) - before
    old = np.asarray(navigator_params().map.relations.log_distance_sd)
    assert change == pytest.approx(np.log(old) - np.log(spread), abs=1e-5)
    assert float(params.planner.discount) == float(navigator_params().planner.discount)
    config = settings.apply(navigator_config("faithful", 32), values, "config")
    assert (config.map.num_objects, config.map.num_particles) == (6, 32)
    assert config.planner.policy == "faithful"
    sensor = settings.apply(default_sensor(4.0), values, "sensor")
    assert float(sensor.field_of_view) == pytest.approx(math.pi / 2)
    assert float(sensor.range_max) == 4.0


def test_plain_help_is_short_and_the_long_one_has_everything(capsys):
    assert cli.main(["follow", "--help"]) == 0
    short = capsys.readouterr().out
    assert len(short.splitlines()) <= 70
    assert settings.HELP_ALL in short
    assert "--params.planner.visit-spacing" not in short
    assert cli.main(["follow", settings.HELP_ALL]) == 0
    told = capsys.readouterr().out
    assert all(one.flag in told for one in settings.options(Follow.SETTINGS))
    assert "metres between visited nodes" in told


def test_commands_without_settings_have_no_long_help() -> None:
    with pytest.raises(UsageError, match="unknown option"):
        parse_arguments(["parse", TEXT, settings.HELP_ALL])
