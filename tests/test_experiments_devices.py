"""Many devices and processes: they divide the work and give the bytes of one."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from test_experiments_sweep import write

from jaxlangnav.experiments import monte_carlo, sweep

SMALL = """
episodes = 300
worlds = ["1H1C", "yard"]
commands = ["null", "behind"]
policies = ["known", "lawnmower"]
"""
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


def episodes(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.glob("episodes-*"))}


def test_rounds_by_hand() -> None:
    ours, known = ("informed", 64), ("known", None)
    kinds = [ours, known, ours, ("informed", 16), ours, known]
    found = list(sweep._rounds(range(6), kinds.__getitem__, 2))
    assert found == [[0, 2], [1, 5], [3], [4]]
    assert [len(own) for own in sweep._rounds(range(6), kinds.__getitem__, 1)] == [1] * 6


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
def test_two_processes_divide_a_sweep(tmp_path, pytestconfig):
    config = write(SMALL, tmp_path)
    sweep.run_sweep(config, tmp_path / "alone")
    address, out = free_address(), tmp_path / "out"
    command = ["-m", "jaxlangnav", "sweep", str(tmp_path / "sweep.toml"), "--out", str(out)]
    command += ["--json", "--coordinator", address, "--processes", "2", "--process"]
    peers = [start([*command, place], pytestconfig) for place in ("0", "1")]
    said = [peer.communicate(timeout=120) for peer in peers]
    assert [peer.returncode for peer in peers] == [0, 0], said
    for place, (text, _) in enumerate(said):
        assert f'"shard": "{place + 1}/2"' in text
    assert len(episodes(out)) == 4
    assert episodes(out) == episodes(tmp_path / "alone")


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
    assert episodes(tmp_path / "out") == episodes(tmp_path / "alone")
