"""Work is sized before it is begun: one line with size, limit and what would fit; nothing left."""

from pathlib import Path

import jax
import numpy as np
import pytest

from jaxlangnav.cli import main as cli
from jaxlangnav.episode import begin
from jaxlangnav.experiments import sizes
from jaxlangnav.experiments.experiment import check_episodes
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.rows import RowSpec
from jaxlangnav.experiments.sentences import ground_sentences
from jaxlangnav.experiments.tasks import draw_tasks
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.semantic_map.params import MapConfig

HUGE = "1000000000000"


def test_the_account_is_that_of_the_real_records() -> None:
    spec = RowSpec(world="1H1C", range=3.0, relation="null")
    tasks = draw_tasks([spec.setting(seed=0).cell], np.zeros(2, int), np.arange(2))
    assert 2 * sizes.task_bytes() == sizes.bytes_of(tasks)
    instructions = ground_sentences(["go to the hydrant"]).instructions
    task = jax.tree.map(lambda leaf: leaf[0], tasks)
    for particles in (7, 64):
        config = navigator_config("informed", particles)
        progress = jax.jit(begin, static_argnames="config")(task, instructions, config=config)
        fixed, each = sizes.episode_bytes(config)
        assert fixed + particles * each == sizes.bytes_of(progress)


def test_what_fits_fits_and_one_more_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sizes, "memory", lambda: 1000)
    sizes.check_count("things", 90, each=10, fixed=100)
    with pytest.raises(ValueError, match=r"things is 91 with wings, .* 1010 bytes .*: at most 90 "):
        sizes.check_count("things", 91, each=10, fixed=100, beside="wings")
    with pytest.raises(ValueError, match="not even one fits"):
        sizes.check_count("things", 1, each=10, fixed=1000)
    with pytest.raises(ValueError, match=r"things is 1\.0·10\^30, which takes .* EiB"):
        sizes.check_count("things", 10**30, each=10**3)


@pytest.mark.parametrize(
    "config",
    [
        navigator_config("informed", 10**12),
        navigator_config("faithful", 10**30),
        NavigatorConfig(map=MapConfig(num_cells=36 * 10**6)),
        NavigatorConfig(map=MapConfig(num_objects=10**6)),
        NavigatorConfig(map=MapConfig(num_objects=10**30)),
    ],
    ids=["particles", "endless particles", "cells", "objects", "endless objects"],
)
def test_an_engine_that_no_memory_holds_is_refused(config: NavigatorConfig) -> None:
    for check in (sizes.check_engine, lambda one: sizes.check_recording(one, 120)):
        with pytest.raises(ValueError, match="memory") as caught:
            check(config)
        assert "\n" not in str(caught.value)


def test_an_engine_of_the_usual_size_is_not() -> None:
    for particles in (2, 64, 1000):
        sizes.check_engine(navigator_config("informed", particles))
        sizes.check_recording(navigator_config("faithful", particles), 120)
    assert check_episodes(1000, rows=7, kept=6) == 1000


def test_the_memory_is_that_of_the_container_where_it_is_less(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert sizes.memory() > 1 << 28
    limit = tmp_path / "memory.max"
    for text, expected in ((f"{1 << 28}\n", 1 << 28), ("max\n", None), ("", None)):
        limit.write_text(text)
        monkeypatch.setattr(sizes, "_LIMITS", (limit, tmp_path / "none"))
        sizes._host_memory.cache_clear()
        found = sizes._host_memory()
        assert found == expected if expected else found > 1 << 28
    monkeypatch.undo()
    sizes._host_memory.cache_clear()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["follow", "go to the cone", "--particles", HUGE], "particles is 1,000,000,000,000"),
        (["follow", "go to the cone", "--max-steps", HUGE], "max steps is 1,000,000,000,000"),
        (["follow", "go to the cone", "--config.map.num-cells", "360000"], "360,000 cells a side"),
        (["reproduce", "table2", "--episodes", HUGE], "episodes is 1,000,000,000,000"),
        (["reproduce", "all", "--episodes", HUGE], "episodes is 1,000,000,000,000"),
        (["reproduce", "fig5", "--particles", HUGE], "particles is 1,000,000,000,000"),
        (["reproduce", "fig4", "--particles", HUGE], "particles is 1,000,000,000,000"),
        (["reproduce", "unknowns", "--episodes", HUGE], "episodes is 1,000,000,000,000"),
        (["evaluate", "--splits", HUGE], "splits is 1,000,000,000,000"),
        (["evaluate", "--splits", "10000000"], "splits is 10,000,000"),
        (["evaluate", "--beams", HUGE], "beam width is 1,000,000,000,000, but must be 256 or less"),
        (["sweep", "GRID", "episodes"], "episodes, which make 976,562,500 files"),
        (["sweep", "GRID", "particles"], "particles is 1,000,000,000,000"),
        (["follow", "go to the cone", "--world", "WORLD"], "has more than 262,144 bytes"),
    ],
)
def test_every_command_says_what_would_fit_and_leaves_nothing(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = [_written(word, words[-1], tmp_path) for word in words]
    if words[0] == "sweep":
        words.pop()
    if words[0] != "evaluate":
        words += ["--out", str(out)]
    assert cli.main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    (line,) = captured.err.splitlines()
    assert message in line
    assert any(remedy in line for remedy in (" fit", "or less", "shorten it"))
    assert not out.exists()


def _written(word: str, last: str, folder: Path) -> str:
    """Write the file that a word stands for."""
    if word == "GRID":
        path = folder / "grid.toml"
        path.write_text(f'worlds = ["1H1C"]\ncommands = ["null"]\n{last} = {HUGE}\n')
        return str(path)
    if word == "WORLD":
        path = folder / "world.toml"
        things = '\n[[objects]]\ntype = "cone"\nx = 0\ny = 0' * 1_000_000
        path.write_text(f"[area]\nx_min = 0\n{things}\n")
        return str(path)
    return word


def test_bytes_are_counted_without_wrapping() -> None:
    leaf = jax.ShapeDtypeStruct((10**10, 10**10), np.dtype(np.float32))
    assert sizes.bytes_of([leaf, np.zeros(3, bool)]) == 4 * 10**20 + 3
