"""Sweeps: killed, resumed and split, they end with the bytes of an undisturbed run."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from jaxlangnav.cli import main as cli
from jaxlangnav.experiments import summary, summary_tables, sweep, sweep_folder
from jaxlangnav.experiments.sweep_config import SweepConfig, read_config

BASELINES = """
name = "two robots"
episodes = 70
seeds = [0, 1]
worlds = ["1H1C", "yard"]
commands = ["null", "behind"]
ranges = [3]
policies = ["known", "lawnmower"]
[motion]
odometry_noise = [0, "1 %", "2 %", "4 %", "8 %", "16 %"]
"""
ROWS = 2 * 2 * 2 * 70 * 2 * 6
FEW = """
episodes = 700
worlds = ["1H1C"]
commands = ["null", "behind"]
policies = ["known"]
"""
NAVIGATOR = """
episodes = 300
worlds = ["1H1C"]
commands = ["null", "behind"]
ranges = [3, 5]
policies = ["informed"]
[planner]
discount = [0.7, 0.8, 0.9]
"""
SCRIPT = """
import sys, jax
jax.config.update("jax_compilation_cache_dir", sys.argv[3])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
from jaxlangnav.experiments import sweep
from jaxlangnav.experiments.sweep_config import read_config
sweep.run_sweep(read_config(sys.argv[1]), sys.argv[2], num_threads=1)
"""


def write(text: str, folder: Path) -> SweepConfig:
    path = folder / "sweep.toml"
    path.write_text(text)
    return read_config(path)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def start(folder: Path, out: Path, pytestconfig: pytest.Config) -> subprocess.Popen[bytes]:
    """Start a sweep in a process of its own."""
    cache = str(Path(pytestconfig.rootpath) / ".pytest_cache" / "jax")
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, str(folder / "sweep.toml"), str(out), cache],
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
    )


def wait_for_files(process: subprocess.Popen[bytes], out: Path, number: int) -> None:
    deadline = time.monotonic() + 300
    while len(list(out.glob("episodes-*.parquet"))) < number and process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.002)


def run_and_kill(text: str, folder: Path, out: Path, pytestconfig: pytest.Config) -> int:
    """Start a sweep in a process of its own and kill it after its second file; files it left."""
    write(text, folder)
    process = start(folder, out, pytestconfig)
    try:
        wait_for_files(process, out, 2)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    return len(list(out.glob("episodes-*.parquet")))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[SweepConfig, Path]:
    folder = tmp_path_factory.mktemp("undisturbed")
    config = write(BASELINES, folder)
    done: list[int] = []
    document = sweep.run_sweep(config, folder / "out", on_progress=done.append)
    # 2 worlds, 2 commands, 2 seeds, 70 episodes; 2 policies under 6 noises.
    assert sum(done) == sweep.total_episodes(config) == document["episodes"] == ROWS
    assert document["is_complete"]
    return config, folder / "out"


def test_kill_and_resume(
    undisturbed: tuple[SweepConfig, Path], tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    config, whole = undisturbed
    out = tmp_path / "out"
    left = run_and_kill(BASELINES, tmp_path, out, pytestconfig)
    assert 2 <= left < len(list(whole.glob("episodes-*.parquet")))
    # What a kill in the middle of a write may leave.
    last = max(one.stem for one in whole.glob("episodes-*.parquet"))
    (out / f".{last}.partial-77-abc.parquet").write_bytes(b"torn")
    told: list[str] = []
    with pytest.raises(ValueError, match="already holds episodes of this sweep: add --resume"):
        sweep.run_sweep(config, out, on_note=told.append)
    (line,) = told
    assert "took over from process" in line
    document = sweep.run_sweep(config, out, resume=True, on_note=told.append)
    assert document["is_complete"]
    assert document["kept"] >= 1024 + 96
    # What the dead process had finished is sound.
    assert len(told) == 1
    assert contents(out) == contents(whole)


def test_shards_in_any_order(undisturbed: tuple[SweepConfig, Path], tmp_path: Path) -> None:
    config, whole = undisturbed
    for shard in ("3/3", "1/3", "2/3"):
        document = sweep.run_sweep(config, tmp_path, shard=shard, num_threads=1)
        assert document["is_complete"] == (shard == "2/3")
    assert contents(tmp_path) == contents(whole)


def test_another_sweep_is_not_mixed_in(
    undisturbed: tuple[SweepConfig, Path], tmp_path: Path
) -> None:
    _, whole = undisturbed
    other = write(BASELINES.replace("episodes = 70", "episodes = 71"), tmp_path)
    with pytest.raises(ValueError, match=r"another sweep \(episodes: 70 there, 71 here\)"):
        sweep.run_sweep(other, whole, resume=True)
    stray = tmp_path / "stray"
    stray.mkdir()
    (stray / "episodes-000000.parquet").write_bytes(b"")
    with pytest.raises(ValueError, match="without a manifest"):
        sweep.run_sweep(other, stray)


def test_a_full_disk_keeps_what_is_written(
    undisturbed: tuple[SweepConfig, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config, whole = undisturbed
    write_bytes, written = Path.write_bytes, []

    def disk(where: Path, content: bytes) -> int:
        written.append(where)
        if len(written) > 4:
            write_bytes(where, b"torn")
            raise OSError(28, "No space left on device")
        return write_bytes(where, content)

    monkeypatch.setattr(Path, "write_bytes", disk)
    with pytest.raises(OSError, match="No space left"):
        sweep.run_sweep(config, tmp_path, num_threads=1)
    left = contents(tmp_path)
    assert len(left) == 4
    assert left.items() <= contents(whole).items()


def test_rows_are_tidy(undisturbed: tuple[SweepConfig, Path]) -> None:
    _, whole = undisturbed
    files = sorted(whole.glob("episodes-*.parquet"))
    schemas = {pq.read_schema(file) for file in files}
    assert len(schemas) == 1
    table = pa.concat_tables([pq.read_table(file) for file in files])
    assert table.num_rows == ROWS
    assert {"world", "policy", "motion.odometry_noise", "is_success", "final_x"} <= set(
        table.column_names
    )
    assert table["particles"].null_count == ROWS


def test_summary(undisturbed: tuple[SweepConfig, Path], tmp_path: Path) -> None:
    _, whole = undisturbed
    document = summary.summarize_directory(whole)
    assert document["missing"] == 0
    assert document["episodes"] == ROWS
    assert set(document["varied"]) == {
        "world",
        "command",
        "relation",
        "policy",
        "motion.odometry_noise",
    }
    # 2 worlds, 2 commands, 6 noises; both policies in each.
    assert len(document["rows"]) == 48
    assert len(document["comparisons"]) == 24
    for row in document["rows"]:
        assert row["episodes"] == 140
        if row["policy"] == "known":
            assert row["success_rate"] == 100.0
    for one in document["comparisons"]:
        assert (one["first"]["policy"], one["second"]["policy"]) == ("known", "lawnmower")
        assert one["pairs"] == 140
    text = summary_tables.summary_markdown(document)
    assert "two robots" in text
    assert text.count("\n| 1H1C |") == 36
    assert summary_tables.render(document) is not None
    with pytest.raises(ValueError, match="holds no sweep"):
        summary.summarize_directory(tmp_path)


def test_damaged_files_are_named_and_made_again(
    undisturbed: tuple[SweepConfig, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config, whole = undisturbed
    out = tmp_path / "out"
    shutil.copytree(whole, out)
    names = [f"episodes-{index:06d}.parquet" for index in range(5)]
    (out / names[0]).write_bytes((whole / names[0]).read_bytes()[:-100])
    (out / names[1]).write_bytes(b"")
    (out / names[2]).rename(out / "aside")
    (out / names[3]).rename(out / names[2])
    (out / "aside").rename(out / names[3])
    flipped = bytearray((whole / names[4]).read_bytes())
    flipped[len(flipped) // 3] ^= 1
    (out / names[4]).write_bytes(flipped)

    document = summary.summarize_directory(out)
    assert document["missing"] == 5
    assert [line.split()[0] for line in document["damaged"]] == [str(out / one) for one in names]
    assert document["episodes"] < ROWS
    assert "5 of them because they are damaged" in summary_tables.summary_markdown(document)
    assert cli.main(["summarize", str(out)]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line.split()[1] for line in lines] == [str(out / one) for one in names]
    assert all(line.endswith("left out: make it again with sweep --resume") for line in lines)

    told: list[str] = []
    document = sweep.run_sweep(config, out, resume=True, on_note=told.append, num_threads=1)
    assert document["is_complete"]
    assert document["kept"] + document["episodes"] == ROWS
    assert [line.split()[1] for line in told] == [str(out / one) for one in names]
    for line, fault in zip(
        told, ("cut short", "is empty", "place of another", "place of another", "SHA"), strict=True
    ):
        assert fault in line
    assert contents(out) == contents(whole)


def test_a_folder_of_nothing_sound_is_refused(
    undisturbed: tuple[SweepConfig, Path], tmp_path: Path
) -> None:
    _, whole = undisturbed
    manifest = (whole / sweep_folder.MANIFEST).read_text()
    (tmp_path / sweep_folder.MANIFEST).write_text(manifest)
    with pytest.raises(ValueError, match="holds no episodes yet"):
        summary.summarize_directory(tmp_path)
    name = "episodes-000000.parquet"
    shutil.copy(whole / name, tmp_path)
    # A manifest that says otherwise is that of another sweep.
    (tmp_path / sweep_folder.MANIFEST).write_text(manifest.replace('"rows": ', '"rows": 1'))
    with pytest.raises(
        ValueError, match=f"no sound episodes: .*{name} is of another sweep, or of another version"
    ):
        summary.summarize_directory(tmp_path)
    for text in ("", "{", "[]", "{}", '{"settings": {"files": "x"}}', "[" * 100_000, manifest[:99]):
        (tmp_path / sweep_folder.MANIFEST).write_text(text)
        with pytest.raises(ValueError, match="is not the manifest of a sweep, or is damaged"):
            summary.summarize_directory(tmp_path)


def test_of_two_at_once_one_is_refused(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    config = write(FEW, tmp_path)
    out = tmp_path / "out"
    first = start(tmp_path, out, pytestconfig)
    try:
        wait_for_files(first, out, 1)
        first.send_signal(signal.SIGSTOP)
        for shard in ("1/1", "2/3"):
            with pytest.raises(ValueError, match=f"process {first.pid} on .* part 1/1"):
                sweep.run_sweep(config, out, resume=True, shard=shard)
        first.send_signal(signal.SIGCONT)
        assert first.wait(300) == 0
    finally:
        first.kill()
        first.wait()
    document = sweep.run_sweep(config, out, resume=True)
    assert (document["episodes"], document["kept"]) == (0, sweep.total_episodes(config))


@pytest.mark.slow
def test_kill_and_resume_the_navigator(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    folder = tmp_path / "whole"
    folder.mkdir()
    config = write(NAVIGATOR, folder)
    sweep.run_sweep(config, folder / "out")
    out = tmp_path / "out"
    assert run_and_kill(NAVIGATOR, tmp_path, out, pytestconfig) < 6
    sweep.run_sweep(config, out, resume=True, shard="2/2", num_threads=1)
    sweep.run_sweep(config, out, resume=True, shard="1/2")
    assert contents(out) == contents(folder / "out")
    document = summary.summarize_directory(out)
    assert len(document["comparisons"]) == 4 * 3
