"""Sweeps: killed, resumed, split, on many devices: the bytes of an undisturbed run."""

import math
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from placed import world_file

from jaxlangnav.cli import main as cli
from jaxlangnav.episode import begin
from jaxlangnav.experiments import monte_carlo, sizes, summary, sweep
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.rows import RowSpec
from jaxlangnav.experiments.shards import lock
from jaxlangnav.experiments.sweep_config import SweepConfig, config_from_dict, read_config
from jaxlangnav.experiments.sweep_plan import make_plan, parse_shard
from jaxlangnav.experiments.tasks import draw_tasks, ground_sentences

SMALL: dict[str, Any] = {"worlds": ["1H1C"], "commands": ["behind"]}


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
        ({"wrolds": ["1H1C"]}, r'wrolds is unknown: known keys are .*did you mean "worlds"\?'),
        ({"sensor": {"fov": 1.0}}, "sensor.fov is unknown: known keys are"),
        ({"map": {"kernel": []}}, "kernel is empty: the grid would be empty"),
        ({"ranges": ["3 deg"]}, r'ranges = "3 deg" is an angle, but a length is needed \(m, cm'),
        ({"ranges": ["3 kg"]}, r'ranges = "3 kg" has the unknown unit "kg", but a length'),
        ({"ranges": [0]}, "ranges is 0, but must be above 0 m"),
        ({"ranges": [3, "300 cm"]}, "ranges lists a value twice"),
        ({"sensor": {"field_of_view": 360}}, 'at most 6.28319 rad; write "360 deg"'),
        ({"motion": {"odometry_noise": 2}}, 'at most 1; write "2 %"'),
        ({"sensor": {"noise": -0.1}}, "sensor.noise is -0.1, but must be at least 0 m"),
        ({"episodes": 0}, "episodes is 0, but must be a whole number, at least 1"),
        ({"seeds": [2**32]}, r"seeds\[0\] is 4294967296, but .* at most 4294967295"),
        ({"policies": ["infromed"]}, r'unknown policy "infromed".*did you mean "informed"'),
        ({"worlds": ["1X"]}, "unknown world template '1X'"),
        ({"worlds": ["yrad"]}, "unknown world 'yrad'"),
        ({"worlds": ["1H0C"]}, "has no cone for the relation 'behind'"),
        ({"commands": ["find the car"]}, r'command "find the car": say by which relation'),
        ({"commands": [{"text": "find it", "relation": "behnd"}]}, "unknown relation 'behnd'"),
        (
            {"policies": ["faithful"], "planner": {"stop_probability": 0.9},
             "map": {"concentration": 3}},
            "stop_probability is 0.9, but with concentration 3",
        ),
        # More than fits.
        (
            {"episodes": 10**12},
            r"1 cells times 1,000,000,000,000 episodes, which make 976,562,500 files, but a folder "
            r"holds 1,000,000: at most 1,024,000,000 episodes a cell fit",
        ),
        ({"episodes": 10**100}, r"times 1\.0·10\^100 episodes"),
        (
            {"particles": [64, 10**12], "policies": ["informed"]},
            r"particles is 1,000,000,000,000 with .*, which takes .* but there are .*: at most",
        ),
        ({"environments": 2**32}, "environments is 4294967296, but must be a whole number"),
    ],
)  # fmt: skip
def test_mistakes(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        make_plan(config_from_dict(SMALL | changes))
    assert "\n" not in str(error.value)


def test_missing_keys_and_files(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="commands is missing: add it"):
        config_from_dict({"worlds": ["1H1C"]})
    with pytest.raises(ValueError, match="no such file"):
        read_config(tmp_path / "none.toml")
    with pytest.raises(ValueError, match="not a regular file"):
        read_config(tmp_path)
    broken = tmp_path / "broken.toml"
    broken.write_text("worlds = [")
    with pytest.raises(ValueError, match=r"broken.toml: is no valid TOML"):
        read_config(broken)
    broken.write_text('worlds = ["1H1C"]\ncommands = ["null"]\nrange = 3\n')
    with pytest.raises(ValueError, match=r'broken.toml: range is unknown: .*did you mean "ranges"'):
        read_config(broken)
    (tmp_path / "list.json").write_text("[1]")
    with pytest.raises(ValueError, match=r"list.json: the document is \[1\], but must be a table"):
        read_config(tmp_path / "list.json", overrides={"planner": {"discount": 0.9}})


@pytest.mark.parametrize(
    ("more", "number", "said"),
    [
        ({}, 3, r"world own.toml has no \[goal\], by which a sweep tells success: add it"),
        (
            {"goal": {"x": 1.0, "y": 1.0}},
            9,
            "world own.toml has 9 objects, but .* at most 8: remove",
        ),
    ],
)
def test_worlds_that_no_sweep_holds_are_refused(more, number, said, tmp_path) -> None:
    things = [("box", i / 2, 0.0) for i in range(number)]
    (tmp_path / "own.toml").write_text(world_file((0.0, 9.0, -9.0, 9.0), *things, **more))
    (tmp_path / "grid.toml").write_text('worlds = ["own.toml"]\ncommands = ["null"]\n')
    with pytest.raises(ValueError, match=said):
        read_config(tmp_path / "grid.toml")


def test_the_plan_holds_every_episode_once() -> None:
    table = {
        "episodes": 70, "seeds": [0, 3], "worlds": ["1H1C", "2H1C"],
        "commands": ["null", "behind"], "ranges": [2, 5], "policies": ["informed", "frontier"],
        "particles": [64, 128], "sensor": {"noise": [0.1, 0.2]},
        "planner": {"discount": [0.7, 0.8, 0.9]},
    }  # fmt: skip
    plan = make_plan(config_from_dict(table))
    # Settings 2·2·2·2·2 = 32 of 70 episodes; informed in 2·3 arms, the baseline in one.
    assert plan.episodes_of("1/1") == 32 * 70 * 7
    # The example: 3 worlds, 2 commands, 2 ranges, 2 detectors, 50 episodes, 3 policies.
    example = read_config(Path(__file__).parent.parent / "examples" / "grid.toml")
    assert make_plan(example).episodes_of("1/1") == 24 * 50 * 3
    rows = set()
    for index in range(plan.num_files):
        columns = plan.grid._labels(plan.arm(index), plan.episode_indices(index))
        assert {len(values) for values in columns.values()} == {plan.size(index)}
        rows |= set(zip(*columns.values(), strict=True))
    assert len(rows) == plan.episodes_of("1/1")


def test_a_part_of_a_billion_episodes_is_a_part() -> None:
    plan = make_plan(config_from_dict(SMALL | {"episodes": 10**8, "seeds": list(range(10))}))
    assert plan.episodes_of("1/1") == 10**9 * len(plan.grid.arms) * len(plan.grid.settings) // 10
    parts = [plan.episodes_of(f"{i}/1000") for i in (1, 500, 1000)]
    assert max(parts) - min(parts) <= 1024
    last = plan.files("7/1000")[-1]
    first = plan.episode_indices(last)[0]
    columns = plan.grid._labels(plan.arm(last), plan.episode_indices(last))
    assert columns["episode"][0] == first % 10**8
    assert columns["seed"][0] == first // 10**8
    assert sum(plan.episodes_of(f"{i}/7") for i in range(1, 8)) == plan.episodes_of("1/1")


@pytest.mark.parametrize("text", ["0/4", "5/4", "4", "a/b", "1/0", "-1/2"])
def test_bad_shards(text: str) -> None:
    with pytest.raises(ValueError, match="shard is"):
        parse_shard(text)


# Sweeps: killed, resumed and split, they end with the bytes of an undisturbed run.


BASELINES = """
name = "two robots"
episodes = 70
seeds = [0, 1]
worlds = ["1H1C", "yard"]
commands = ["null", "behind"]
ranges = [3]
policies = ["known", "lawnmower"]
[motion]
odometry_noise = [0, "1 %", "4 %", "16 %"]
"""
ROWS = 2 * 2 * 2 * 70 * 2 * 4
SCRIPT = """
import sys
from jaxlangnav.experiments import sweep
from jaxlangnav.experiments.sweep_config import read_config
sweep.run_sweep(read_config(sys.argv[1]), sys.argv[2], num_threads=1)
"""


def write(text: str, folder: Path) -> SweepConfig:
    path = folder / "sweep.toml"
    path.write_text(text)
    return read_config(path)


def contents(folder: Path, of: str = "*") -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob(of))}


def run_and_kill(text: str, folder: Path, out: Path, pytestconfig: pytest.Config) -> int:
    """Start a sweep in a process of its own and kill it after its second file; files it left."""
    write(text, folder)
    process = start(["-c", SCRIPT, str(folder / "sweep.toml"), str(out)], pytestconfig)
    deadline = time.monotonic() + 300
    try:
        while len(list(out.glob("episodes-*.parquet"))) < 2 and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.002)
    finally:
        process.kill()
        process.communicate()
    return len(list(out.glob("episodes-*.parquet")))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> tuple[SweepConfig, Path]:
    folder = tmp_path_factory.mktemp("undisturbed")
    config = write(BASELINES, folder)
    done: list[int] = []
    document = sweep.run_sweep(config, folder / "out", on_progress=done.append)
    # 2 worlds, 2 commands, 2 seeds, 70 episodes; 2 policies under 4 noises.
    assert sum(done) == sweep.total_episodes(config) == document["episodes"] == ROWS
    assert document["is_complete"]
    return config, folder / "out"


def test_kill_and_resume(undisturbed, tmp_path, pytestconfig):
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


def test_another_sweep_is_not_mixed_in(undisturbed, tmp_path):
    _, whole = undisturbed
    other = write(BASELINES.replace("episodes = 70", "episodes = 71"), tmp_path)
    with pytest.raises(ValueError, match=r"another sweep \(episodes: 70 there, 71 here\)"):
        sweep.run_sweep(other, whole, resume=True)
    stray = tmp_path / "stray"
    stray.mkdir()
    (stray / "episodes-000000.parquet").write_bytes(b"")
    with pytest.raises(ValueError, match="without a manifest"):
        sweep.run_sweep(other, stray)


def test_rows_are_tidy(undisturbed: tuple[SweepConfig, Path]) -> None:
    _, whole = undisturbed
    files = sorted(whole.glob("episodes-*.parquet"))
    assert len({pq.read_schema(file) for file in files}) == 1
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
    varied = {"world", "command", "relation", "policy", "motion.odometry_noise"}
    assert set(document["varied"]) == varied
    # 2 worlds, 2 commands, 4 noises; both policies in each.
    assert len(document["rows"]) == 32
    assert len(document["comparisons"]) == 16
    for row in document["rows"]:
        assert row["episodes"] == 140
        if row["policy"] == "known":
            assert row["success_rate"] == 100.0
    for one in document["comparisons"]:
        assert (one["first"]["policy"], one["second"]["policy"]) == ("known", "lawnmower")
        assert one["pairs"] == 140
    text = summary.summary_markdown(document)
    assert "two robots" in text
    assert text.count("\n| 1H1C |") == 24
    assert summary.render(document) is not None
    with pytest.raises(ValueError, match="holds no sweep"):
        summary.summarize_directory(tmp_path)


def test_damaged_files_are_named_and_made_again(undisturbed, tmp_path, capsys):
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
    assert "5 of them because they are damaged" in summary.summary_markdown(document)
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


def test_a_folder_of_nothing_sound_is_refused(undisturbed, tmp_path):
    _, whole = undisturbed
    manifest = (whole / sweep.MANIFEST).read_text()
    (tmp_path / sweep.MANIFEST).write_text(manifest)
    with pytest.raises(ValueError, match="holds no episodes yet"):
        summary.summarize_directory(tmp_path)
    name = "episodes-000000.parquet"
    shutil.copy(whole / name, tmp_path)
    # A manifest that says otherwise is that of another sweep.
    (tmp_path / sweep.MANIFEST).write_text(manifest.replace('"rows": ', '"rows": 1'))
    with pytest.raises(
        ValueError, match=f"no sound episodes: .*{name} is of another sweep, or of another version"
    ):
        summary.summarize_directory(tmp_path)
    (tmp_path / sweep.MANIFEST).write_text(manifest[:99])
    with pytest.raises(ValueError, match="is not the manifest of a sweep, or is damaged"):
        summary.summarize_directory(tmp_path)


def test_files_that_somebody_is_at_work_on_are_left_to_them(undisturbed, tmp_path):
    """Of two processes: ``test_experiments_shards``."""
    config, _ = undisturbed
    for shard in ("1/1", "2/3"):
        with (
            lock(tmp_path, (1, 1), on_note=print),
            pytest.raises(ValueError, match=f"process {os.getpid()} on .* part 1/1"),
        ):
            sweep.run_sweep(config, tmp_path, resume=True, shard=shard)
    assert not list(tmp_path.glob("*"))


# Work is sized before it is begun: one line with size, limit and what would fit; nothing left.


def test_the_account_is_that_of_the_real_records() -> None:
    spec = RowSpec(world="1H1C", range=3.0, relation="null")
    tasks = draw_tasks([spec.setting(seed=0)], np.zeros(2, int), np.arange(2))
    assert 2 * sizes.task_bytes() == sizes._bytes_of(tasks)
    instructions = ground_sentences(["go to the hydrant"]).instructions
    task = jax.tree.map(lambda leaf: leaf[0], tasks)
    for particles in (7, 64):
        config = navigator_config("informed", particles)
        progress = jax.jit(begin, static_argnames="config")(task, instructions, config=config)
        fixed, each = sizes._episode_bytes(config)
        assert fixed + particles * each == sizes._bytes_of(progress)
    # Bytes are counted without wrapping.
    leaf = jax.ShapeDtypeStruct((10**10, 10**10), np.dtype(np.float32))
    assert sizes._bytes_of([leaf, np.zeros(3, bool)]) == 4 * 10**20 + 3


def test_what_fits_fits_and_one_more_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sizes, "_memory", lambda: 1000 << 20)
    each, fixed = 10 << 20, 100 << 20
    sizes.check_count("things", 90, each=each, fixed=fixed)
    with pytest.raises(ValueError, match=r"things is 91 with wings, .* 1,010 MiB .*: at most 90 "):
        sizes.check_count("things", 91, each=each, fixed=fixed, context="wings")
    with pytest.raises(ValueError, match="not even one fits"):
        sizes.check_count("things", 1, each=each, fixed=10 * fixed)
    with pytest.raises(ValueError, match=r"things is 1\.0·10\^30, which takes .* MiB"):
        sizes.check_count("things", 10**30, each=10**3)


def test_the_memory_is_that_of_the_container_where_it_is_less(tmp_path, monkeypatch):
    assert sizes._memory() > 1 << 28
    limit = tmp_path / "memory.max"
    for text, expected in ((f"{1 << 28}\n", 1 << 28), ("max\n", None), ("", None)):
        limit.write_text(text)
        monkeypatch.setattr(sizes, "_CGROUP_LIMITS", (limit, tmp_path / "none"))
        sizes._memory.cache_clear()
        found = sizes._memory()
        assert found == expected if expected else found > 1 << 28
    monkeypatch.undo()
    sizes._memory.cache_clear()


# ------------ many devices and processes give the bytes of one

NAVIGATOR = """
episodes = 300
worlds = ["1H1C"]
commands = ["null", "behind"]
ranges = [3, 5]
policies = ["informed", "known"]
particles = [16]
[planner]
discount = [0.7, 0.8, 0.9]
"""
MEETING = """
import sys, time
from jaxlangnav.experiments import monte_carlo
place, number = monte_carlo.join_devices(sys.argv[1], 2, int(sys.argv[2]))
print(place, number, flush=True)
import jax.numpy as jnp
time.sleep(30.0 if place == 0 else 3.0)
print(int(jnp.arange(4).sum()), flush=True)
"""


def free_address() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"


def start(
    arguments: list[str], pytestconfig: pytest.Config, **environment: str
) -> subprocess.Popen[str]:
    own = {
        "JAX_PLATFORMS": "cpu", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_COMPILATION_CACHE_DIR": f"{pytestconfig.rootpath}/.pytest_cache/jax",
    }  # fmt: skip
    return subprocess.Popen(
        [sys.executable, *arguments], env=os.environ | own | environment,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_mistakes_are_one_line() -> None:
    with pytest.raises(ValueError, match='coordinator is "here", but must be HOST:PORT'):
        monte_carlo.join_devices("here", 2, 0)
    with pytest.raises(ValueError, match="cannot join the other processes: ") as caught:
        monte_carlo.join_devices("127.0.0.1:9", 2, 2)
    assert "\n" not in str(caught.value)


def slurm(place: int, job: int) -> dict[str, str]:
    """What srun tells its tasks; JAX derives the meeting place from the job's number."""
    return {
        "SLURM_JOB_ID": str(job),
        "SLURM_STEP_NODELIST": "localhost",
        "SLURM_STEP_NUM_NODES": "1",
        "SLURM_NTASKS": "2",
        "SLURM_PROCID": str(place),
        "SLURM_LOCALID": str(place),
    }


# Quick are its parts: test_a_launcher_tells_where_to_meet, and test_shards_in_any_order.
@pytest.mark.slow
def test_two_processes_divide_a_sweep(undisturbed, tmp_path, pytestconfig):
    write(BASELINES, tmp_path)
    address, out = free_address(), tmp_path / "out"
    command = ["-m", "jaxlangnav", "sweep", str(tmp_path / "sweep.toml"), "--out", str(out)]
    command += ["--json", "--coordinator", address, "--processes", "2", "--process"]
    peers = [start([*command, place], pytestconfig) for place in ("0", "1")]
    said = [peer.communicate(timeout=120) for peer in peers]
    assert [peer.returncode for peer in peers] == [0, 0], said
    for place, (text, _) in enumerate(said):
        assert f'"shard": "{place + 1}/2"' in text
    assert contents(out, "episodes-*") == contents(undisturbed[1], "episodes-*")


def test_a_launcher_tells_where_to_meet(pytestconfig: pytest.Config) -> None:
    code = "from jaxlangnav.experiments import monte_carlo; print(*monte_carlo.join_devices())"
    job = int(free_address().split(":")[1])
    peers = [start(["-c", code], pytestconfig, **slurm(place, job)) for place in (0, 1)]
    assert [peer.communicate(timeout=60)[0] for peer in peers] == ["0 2\n", "1 2\n"]


def test_a_dead_process_does_not_take_its_peer_along(pytestconfig: pytest.Config) -> None:
    address = free_address()
    first, second = (start(["-c", MEETING, address, place], pytestconfig) for place in ("0", "1"))
    try:
        assert first.stdout is not None
        assert first.stdout.readline() == "0 2\n"
        # The first process holds the meeting place: its death is the hardest.
        first.send_signal(signal.SIGKILL)
        text, errors = second.communicate(timeout=60)
    finally:
        first.kill()
        first.communicate()
    assert (text, second.returncode) == ("1 2\n6\n", 0), errors


@pytest.mark.slow
def test_two_devices_give_the_bytes_of_one(tmp_path: Path, pytestconfig: pytest.Config) -> None:
    config = write(NAVIGATOR, tmp_path)
    # 3 arms of two chunks, so that the two devices are given different Params and an odd rest.
    document = sweep.run_sweep(config, tmp_path / "alone", shard="1/1")
    assert document["is_complete"]
    assert monte_carlo.mesh().size == 1
    command = ["-m", "jaxlangnav", "sweep", str(tmp_path / "sweep.toml"), "--out"]
    begin = time.monotonic()
    both = start(
        [*command, str(tmp_path / "out"), "--json"],
        pytestconfig,
        XLA_FLAGS="--xla_force_host_platform_device_count=2",
    )
    _, errors = both.communicate(timeout=600)
    assert both.returncode == 0, (errors, time.monotonic() - begin)
    assert '"count": 2' in (tmp_path / "out" / "manifest.json").read_text()
    both, alone = (contents(tmp_path / name, "episodes-*") for name in ("out", "alone"))
    assert both == alone
