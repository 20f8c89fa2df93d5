"""The command line under hostile input, and its options: exit code 2, one line, a calm terminal."""

import io
import json
import math
import os
import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jaxlangnav.cli import main as cli, settings
from jaxlangnav.cli.follow import Follow
from jaxlangnav.cli.main import parse_arguments
from jaxlangnav.cli.output import Output, platform_fault, write_document
from jaxlangnav.cli.reproduce import Reproduce
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.messages import default_sensor
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.task.follow import navigator_params

ANSI = "\x1b[31mred\x1b]0;title\x07\u202e\x9b2J"
MARKUP = "[red]x[/red] [link=https://example.org]y[/link] :skull:"


def refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run, and return the one line of the refusal; there may be notes before it."""
    assert cli.main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    *notes, line = captured.err.splitlines()
    assert all(note.startswith(("note: ", "reading the corpus")) for note in notes), notes
    assert line.startswith("jaxlangnav: ")
    assert "internal" not in line
    assert line.isprintable()
    assert len(line) < 700
    return line


def document(words: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Run with ``--json``, and return the one document."""
    assert cli.main([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


GO, TABLE_2 = ["follow", "go to the hydrant"], ["reproduce", "table2"]
HUGE = "1000000000000"
REFUSED: list[tuple[list[str], str]] = [
    # Sentences.
    *(([command, text], "") for command in ("parse", "ground", "follow")
      for text in ("", "   ", "behind behind behind", "?!", "the of to")),
    (["follow", "go to the car"], "world 1H1C has no car, only 1 hydrant and 1 cone"),
    (["follow", "the hydrant is behind the cone"], "asks for nothing to be done"),
    (["follow", "go past the cone"], "past"),
    # Signs that steer a terminal, and values of any length, whose reason is not pushed out.
    *((words, "") for words in (
        ["parse", f"go to the {ANSI}"], [ANSI], ["parse", "x", f"--{ANSI}"],
        [*GO, "--world", ANSI], [*GO, "--policy", ANSI], [*GO, "--world", "x" * 100_000],
        [*GO, "--world", "x/" * 100_000], [*GO, "--world", "9" * 5000 + "H1C"],
        [*GO, "--seed", "9" * 5000],
    )),
    (["ground", "go to the cone", "--world", "x" * 5000 + ".toml"], "no such file; shipped"),
    # Options of their own.
    *(([*GO, "--range", far], "--range is") for far in ("1e39", "1e400", "nan", "-1", "1e-46")),
    ([*GO, "--range", "0.005"], "--range is 0.005, but must lie between 0.01 and"),
    ([*GO, "--particles", "1"], "--particles is 1"),
    ([*GO, "--max-steps", "0"], "--max-steps is 0"),
    ([*GO, "--seed", "-1"], "--seed is -1"),
    ([*GO, "--policy", "clever"], "clever"),
    ([*GO, "--world", "yrad"], 'did you mean "yard"'),
    ([*GO, "--world", "nowhere.toml"], "no such file"),
    ([*GO, "--out", __file__], "is a file"),
    (["ground", "go to the cone", "--world", "9H9C"], "hydrants"),
    (["ground", "go to the cone", "--out", __file__], "is a file"),
    (["ground", "go to the cone", "--weights", "nowhere.npz"], "nowhere.npz"),
    (["train", "grammar"], "grammar"),
    (["train", "behavior", "--corpus", "nowhere.jsonl"], "nowhere.jsonl"),
    (["train", "behavior", "--base", "nowhere.npz"], "nowhere.npz"),
    (["train", "behavior", "--out", "weights.txt"], "must end in .npz"),
    (["evaluate", "--splits", "1"], "--splits is 1"),
    (["evaluate", "--seed", "-1"], "--seed is -1"),
    (["reproduce", "tabel2"], 'did you mean "table2"'),
    ([*TABLE_2, "--episodes", "0"], "--episodes is 0"),
    ([*TABLE_2, "--policy", "infromed"], "informed"),
    ([*TABLE_2, "--out", __file__], "is a file"),
    ([*TABLE_2, "--ranges", "3,"], "--ranges is ''"),
    ([*TABLE_2, "--ranges", "0"], "--ranges is 0"),
    (["reproduce", "table1", "--sensor.noise", "1"], "--sensor.noise changes nothing in table1"),
    (["reproduce", "time", "--motion.step-length", "1"], "changes nothing in time"),
    (["reproduce", "robustness", "--sensor.noise", "1"], "changes nothing in robustness"),
    (["reproduce", "robustness", "--policy", "arc"], 'policy is "arc"'),
    (["reproduce", "fig5", "--extra"], "--extra is for table2 and all, but fig5 is run"),
    (["reproduce", "fig4", "--ranges", "3"], "--ranges is for table2 and fig5 and all"),
    (["reproduce", "conversation", "--policy", "faithful"], "conversation takes informed"),
    (["sweep", "nowhere.toml", "--out", "results"], "nowhere.toml: no such file"),
    (["sweep", "nowhere.toml"], "missing --out DIR: Folder for the shards"),
    (["sweep"], "missing CONFIG: What to run, TOML; --out DIR: Folder for the shards"),
    (["sweep", "nowhere.toml", "--out", __file__], "is a file"),
    (["summarize", "nowhere"], "nowhere holds no sweep"),
    # Numbers of the engine.
    ([*GO, "--params.planner.discunt", "1"], 'did you mean "--params.planner.discount"'),
    ([*GO, "--params.planner.gamma", "1"], 'did you mean "--params.planner.discount"'),
    ([*GO, "--params.filter.concentration", "1"], 'did you mean "--params.map.concentration"'),
    ([*GO, "--parms.planner.reach=1"], 'did you mean "--params.planner.reach"'),
    ([*GO, "--config.map.num-particles", "9"], 'did you mean "--particles"'),
    ([*GO, "--sensor.range-max", "9"], 'did you mean "--range"'),
    ([*TABLE_2, "--sensor.range-max", "3"], 'did you mean "--ranges"'),
    ([*GO, "--params.planner.reach"], "--params.planner.reach needs a value"),
    ([*GO, "--params.planner.reach="], "--params.planner.reach is '', but must be a length"),
    ([*GO, "--help-parms"], 'did you mean "--help-params"'),
    ([*GO, "--params.planner.reach", "-1"], "--params.planner.reach is -1"),
    ([*GO, "--params.planner.reach", "90 deg"], "is an angle, but a length is needed"),
    (["sweep", "x.toml", "--out", "x", "--params.planner.reach", "1 s"], "unknown unit"),
    ([*GO, "--params.planner.discount", "80"], 'write "80 %" if percent is meant'),
    ([*TABLE_2, "--params.planner.discount", "1"], "must be above 0 and below 1"),
    ([*GO, "--policy", "faithful", "--params.planner.stop-probability", "0.99"],
     "lower stop_probability"),
    ([*GO, "--params.mode-speed", "1,2"], "needs 3 numbers"),
    ([*GO, "--config.map.num-objects", "many"], "must be a whole number"),
    ([*GO, "--config.map.num-objects", "0"], "num_objects is 0, but must be at least 1"),
    (["parse", "go", "--params.planner.discount", "1"], 'unknown option "--params.planner.disc'),
    (["parse", "go", settings.HELP_ALL], "unknown option"),
    # Work that no memory holds, which leaves nothing behind.
    ([*GO, "--particles", HUGE, "--out", "out"], "particles is 1,000,000,000,000"),
    ([*GO, "--max-steps", HUGE, "--out", "out"], "max steps is 1,000,000,000,000"),
    ([*GO, "--config.map.num-cells", "360000", "--out", "out"], "360,000 cells a side"),
    ([*GO, "--config.map.num-objects", "1" + 30 * "0"], "memory"),
    *((["reproduce", part, "--particles", HUGE, "--out", "out"], "particles is 1,000,000,000,000")
      for part in ("fig4", "fig5")),
    *((["reproduce", part, "--episodes", HUGE, "--out", "out"], "episodes is 1,000,000,000,000")
      for part in ("table2", "all", "unknowns")),
    (["evaluate", "--splits", HUGE], "splits is 1,000,000,000,000"),
    (["evaluate", "--splits", "10000000"], "splits is 10,000,000"),
    (["evaluate", "--beams", HUGE], "beam width is 1,000,000,000,000, but must be 256 or less"),
    # What is said on the way.
    *(([*GO, "--hear", said], "must name a step") for said in ("stop", "x: go", "5:", "-1: go")),
    ([*GO, "--hear", "158: stop", "--world", "yard"], "the last one is 157"),
    ([*GO, "--hear", "9999999999999: stop"], "is for step 9999999999999, but the last one is 119"),
    ([*GO, "--hear", "5: frobnicate the zorp"], '--hear "5: frobnicate the zorp"'),
    ([*GO, "--person", "atentive"], 'did you mean "attentive"'),
    ([*GO, "--ask"], "--ask needs a terminal"),
    ([*GO, "--talk"], "--talk needs a terminal"),
    # A detector with which the robot would stand still.
    ([*GO, "--sensor.noise", "5"], "noise is 5, but must lie between 0 and 3"),
    ([*TABLE_2, "--sensor.noise", "5"], "noise is 5, but must lie between 0 and 3"),
    ([*GO, "--sensor.noise", "1", "--range", "0.5"], "between 0 and 0.5"),
    ([*GO, "--sensor.false-detections", "101"], "at most 100"),
    ([*GO, "--sensor.field-of-view", "0.0001"], "at least 0.001 and at most 6.28319 rad"),
]  # fmt: skip


@pytest.mark.parametrize(("words", "why"), REFUSED)
def test_what_is_wrong_is_one_line_and_nothing_is_begun(words, why, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))
    for begins in ("jaxlangnav.task.follow.precompile_cycle", "jaxlangnav.episode.recorder.play"):
        monkeypatch.setattr(begins, lambda *_, **__: pytest.fail("begun"))
    assert why in refused([*words, "--json"], capsys)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("text", [ANSI, "a\nb", "lone \ud800"])
def test_every_way_out_makes_text_printable(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    from rich.table import Table

    output, table = Output(is_json=False), Table(title=text)
    table.add_column(text)
    table.add_row(text)
    output.print(text, table)
    output.print_wrapped([text])
    output.note(text)
    captured = capsys.readouterr()
    assert all(one.isprintable() for one in (captured.out + captured.err).split("\n"))


def test_markup_in_text_from_others_is_not_read(capsys: pytest.CaptureFixture[str]) -> None:
    from rich.table import Table

    table = Table(title=MARKUP)
    table.add_column(MARKUP)
    table.add_row(MARKUP)
    Output(is_json=False).print(MARKUP, table)
    assert capsys.readouterr().out.count(MARKUP) == 4


def test_the_document_steers_no_terminal_and_loses_nothing(capsys):
    text = f"{ANSI} “é” 𝄞 \x7f\u2028 \U000e0041"
    write_document({"text": text})
    told = capsys.readouterr().out
    assert all(one.isprintable() for one in told.split("\n"))
    assert json.loads(told) == {"text": text}
    assert "“é”" in told


def test_a_terminal_without_unicode_is_served(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, "ascii"))
    assert cli.main(["parse", "go to the “cone”", "--json"]) == 0
    assert json.loads(raw.getvalue().decode("ascii"))["instruction"] == "go to the “cone”"
    assert cli.main(["parse", "go to the “cone”"]) == 0


def test_a_platform_that_is_not_there_is_named() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "jaxlangnav", "ground", "go to the cone"],
        env={**os.environ, "JAX_PLATFORMS": "\x1b[31m"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith('jaxlangnav: JAX_PLATFORMS is "\\x1b[31m", but JAX')
    assert done.stderr.count("\n") == 1


def test_one_missing_platform_of_several_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """JAX fails the first time and then goes on with what it has found."""
    monkeypatch.setenv("JAX_PLATFORMS", "cpu,nope")
    failure = RuntimeError("Unable to initialize backend 'nope': unknown")
    assert str(platform_fault(failure)).startswith('JAX_PLATFORMS is "cpu,nope", but')
    assert platform_fault(RuntimeError("something else")) is None


# ----------------------------------------------------------- options made from the engine's records

TEXT = "go to the hydrant"


def typed(*words: str) -> dict[settings.OptionPath, Any]:
    command: Any = parse_arguments(["follow", TEXT, *words])
    return settings.read_options(command.settings, Follow.SETTINGS)


def test_every_number_of_the_planner_is_an_option_with_its_help() -> None:
    found = {one.path: one for one in settings.options(Follow.SETTINGS)}
    names = [path[-1] for path in found if path[:2] == ("params", "planner")]
    assert names == list(PlannerParams.__dataclass_fields__)
    discount = found["params", "planner", "discount"]
    assert discount.flag == "--params.planner.discount"
    assert discount.default == pytest.approx(float(navigator_params().planner.discount))
    assert discount.help.startswith("γ per metre")
    # Every number says what it is, to its end; sizes say it by their names.
    assert all(one.help or isinstance(one.default, int) for one in found.values())
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


def test_the_command_that_repeats_an_experiment_is_quoted() -> None:
    command = Reproduce(what="table2", policy="informed, known", seed=1).command("table2")
    assert command == "jaxlangnav reproduce table2 --policy 'informed, known' --seed 1"
