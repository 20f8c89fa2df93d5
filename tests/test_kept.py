"""Programs kept whole: found again without tracing, and never in the way."""

import json
import pickle
import random
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from jaxlangnav.inputs import program_cache as module
from jaxlangnav.inputs.program_cache import cached_jit, set_cache_dir
from jaxlangnav.inputs.program_serialization import load_program
from jaxlangnav.messages import default_motion
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.planner.config import PlannerConfig
from jaxlangnav.pytree import replace

TRACES: list[int] = []


def noisy(key: jax.Array, record, *, times: int = 1):
    """A key and a record in, a record and an array out; tells that it has been traced."""
    TRACES.append(times)
    drawn = times * jax.random.normal(key, (3,))
    return replace(record, odometry_noise=record.odometry_noise + drawn[0]), drawn


@pytest.fixture
def said() -> list[str]:
    """What has been said of the folder."""
    return []


@pytest.fixture
def folder(tmp_path: Path, said: list[str]) -> Iterator[Path]:
    TRACES.clear()
    set_cache_dir(tmp_path / "whole", say=said.append)
    yield tmp_path / "whole"
    set_cache_dir(None)


def another_process() -> Callable:
    """A wrapper that knows of nothing but the folder."""
    return cached_jit(static_argnames=("times",))(noisy)


def same(one, other) -> None:
    def numbers(leaf):
        is_key = jnp.issubdtype(jax.typeof(leaf).dtype, jax.dtypes.prng_key)
        return np.asarray(jax.random.key_data(leaf) if is_key else leaf)

    jax.tree.map(lambda a, b: np.testing.assert_array_equal(numbers(a), numbers(b)), one, other)


def test_a_kept_program_is_neither_traced_nor_different(folder: Path) -> None:
    arguments = jax.random.key(3), default_motion()
    first = another_process()(*arguments, times=2)
    assert len(TRACES) == 1
    assert len(list(folder.glob("*.program"))) == 1
    call = another_process()
    same(call(*arguments, times=2), first)
    same(call(*arguments, times=2), first)
    assert len(TRACES) == 1
    same(jax.jit(noisy, static_argnames="times")(*arguments, times=2), first)


def test_what_makes_another_program_makes_another_file(folder: Path) -> None:
    key, motion = jax.random.key(3), default_motion()
    call = another_process()
    call(key, motion, times=1)
    call(key, motion, times=2)  # static
    call(key, replace(motion, odometry_noise=jnp.zeros(3)), times=1)  # shape
    call(jax.random.key(3, impl="rbg"), motion, times=1)  # type
    assert len(list(folder.glob("*.program"))) == len(TRACES) == 4
    _, drawn = call(jax.random.key(4), motion, times=1)  # only data
    same(drawn, jax.random.normal(jax.random.key(4), (3,)))
    assert len(TRACES) == 4


def _own(situation):
    """A policy of somebody's own: another process may give the name to other code."""
    raise NotImplementedError


@pytest.mark.parametrize(("policy", "number"), [("informed", 1), (_own, 0)])
def test_what_others_have_written_is_not_kept(folder: Path, policy, number: int) -> None:
    def cells(x: jax.Array, *, config: NavigatorConfig) -> jax.Array:
        return x + config.map.num_cells

    config = NavigatorConfig(planner=PlannerConfig(policy=policy))
    call = cached_jit(static_argnames=("config",))(cells)
    np.testing.assert_array_equal(call(jnp.zeros(2), config=config), 36.0)
    assert len(list(folder.glob("*.program"))) == number


def flipped(content: bytes, at: int, bit: int) -> bytes:
    changed = bytearray(content)
    changed[at] ^= 1 << bit
    return bytes(changed)


def test_no_flipped_bit_is_ever_parsed_or_loaded(folder, monkeypatch):
    another_process()(jax.random.key(3), default_motion())
    (path,) = folder.glob("*.program")
    content = path.read_bytes()
    monkeypatch.setattr(json, "loads", None)
    payload = content.index(b"\n", content.index(b"\n") + 1) + 1
    draw = random.Random(0)
    places = [*range(payload), *draw.sample(range(payload, len(content)), 2000)]
    damaged = [flipped(content, at, draw.randrange(8)) for at in places]
    damaged += [content[:at] for at in (0, 1, 63, 64, 65, payload, len(content) - 1)]
    damaged += [content + b"\0", content[1:], pickle.dumps(content), bytes(len(content))]
    for one in damaged:
        with pytest.raises(ValueError, match="is damaged"):
            load_program(one, name=path.name)


def damage(share: float) -> Callable[[Path], object]:
    return lambda path: path.write_bytes(
        flipped(path.read_bytes(), int(share * path.stat().st_size), 5)
    )


def swap(path: Path) -> None:
    """Put another program's file in the place."""
    another_process()(jax.random.key(3), default_motion(), times=2)
    (other,) = (one for one in path.parent.glob("*.program") if one != path)
    other.replace(path)


@pytest.mark.parametrize(
    ("harm", "why"),
    [
        (damage(0.0), "is damaged"),
        (damage(0.5), "is damaged"),
        (swap, "is another program's"),
        (lambda path: path.chmod(0o620), "others can write it"),
        (lambda path: path.symlink_to(path.rename(path.parent.parent / "elsewhere")), "symbolic"),
    ],
)
def test_a_file_that_is_not_what_was_kept_is_compiled_anew_and_said_once(harm, why, folder, said):
    arguments = jax.random.key(3), default_motion()
    first = another_process()(*arguments)
    (path,) = folder.glob("*.program")
    for _ in range(2):
        harm(path)
        traces = len(TRACES)
        for _ in range(2):
            same(another_process()(*arguments), first)
        assert len(TRACES) == traces + 1
        assert not path.is_symlink()
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
    (line,) = said
    assert line.startswith(f"compiling anew what was kept in {path}: ")
    assert why in line


def test_another_process_runs_what_is_kept(folder: Path) -> None:
    key, motion = jax.random.key(3), default_motion()
    _, drawn = another_process()(key, motion, times=2)
    script = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r})\n"
        "import jax, test_kept as t; from pathlib import Path\n"
        f"t.set_cache_dir(Path({str(folder)!r}))\n"
        "record, drawn = t.another_process()(jax.random.key(3), t.default_motion(), times=2)\n"
        "print(t.TRACES, type(record).__name__, drawn.tolist())"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=120
    )
    assert done.stdout.strip() == f"[] MotionParams {drawn.tolist()}"


def with_everything(key: jax.Array, numbers: dict[str, jax.Array]):
    """Return every kind of result that has a form in a file."""
    rbg = jax.random.key(1, impl="rbg")
    record = replace(default_motion(), odometry_noise=numbers["b"])
    return {"z": (key, [None, rbg]), "a": [record, 2.0], "m": numbers["a"] > 0}, ()


def test_every_part_of_a_result_comes_back_as_it_was(folder: Path) -> None:
    arguments = jax.random.key(3), {"b": jnp.ones(3), "a": np.arange(3.0)}
    first = cached_jit()(with_everything)(*arguments)
    again = cached_jit()(with_everything)(*arguments)
    assert len(list(folder.iterdir())) == 1
    assert jax.tree.structure(first) == jax.tree.structure(again)
    for one, other in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        assert jax.typeof(one) == jax.typeof(other)
        same(one, other)


class Pair(NamedTuple):
    one: jax.Array
    other: jax.Array


def test_what_has_no_form_in_a_file_is_only_compiled(folder: Path, said: list[str]) -> None:
    """LAPACK's and Python's functions lie elsewhere in another process: a call there ends it."""
    functions = {
        "lapack": lambda x: jnp.linalg.cholesky(x),
        "python": lambda x: jax.pure_callback(np.sin, x, x),
        "tuple": lambda x: Pair(x, x),
        "keys": lambda x: {0: x},
    }
    for function in functions.values():
        same(cached_jit()(function)(jnp.eye(2)), jax.jit(function)(jnp.eye(2)))
    assert not list(folder.iterdir())
    assert said == []


def test_settings_that_watch_what_runs_are_heeded(folder: Path) -> None:
    with jax.debug_nans(True), pytest.raises(FloatingPointError):
        cached_jit()(lambda x: jnp.log(x))(-jnp.ones(2))
    assert not list(folder.iterdir())


def test_a_program_lost_is_written_whole_again(folder: Path, tmp_path: Path) -> None:
    """JAX's own cache must not hold it: what JAX has loaded from there cannot be written again."""
    settings = {
        "jax_compilation_cache_dir": str(tmp_path / "jax"),
        "jax_persistent_cache_min_compile_time_secs": 0.0,
    }
    before = {name: getattr(jax.config, name) for name in settings}
    for name, value in settings.items():
        jax.config.update(name, value)
    compilation_cache.reset_cache()
    try:
        arguments = jax.random.key(3), default_motion()
        first = another_process()(*arguments)
        for _ in range(2):
            (path,) = folder.glob("*.program")
            path.unlink()
            same(another_process()(*arguments), first)
            traces = len(TRACES)
            same(another_process()(*arguments), first)
            assert len(TRACES) == traces
    finally:
        for name, value in before.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()


def test_another_source_is_another_program(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = jax.random.key(3), default_motion()
    another_process()(*arguments)
    machine = module._fingerprint()
    monkeypatch.setattr(module, "_fingerprint", lambda: ("another digest", *machine[1:]))
    another_process()(*arguments)
    assert len(TRACES) == 2


def test_threads_wait_for_one_program(folder: Path) -> None:
    """What is prepared in a thread is not compiled again, and settings come back as they were."""
    name = "jax_persistent_cache_min_compile_time_secs"
    before = getattr(jax.config, name)
    call, motion = another_process(), default_motion()
    with ThreadPoolExecutor(4) as pool:
        asked = [pool.submit(call, jax.random.key(3), motion, times=times) for times in [1, 2] * 4]
    drawn = [one.result() for one in asked]
    assert sorted(TRACES) == [1, 2]
    for times, found in zip([1, 2] * 4, drawn, strict=True):
        same(found[1], times * drawn[0][1])
    assert getattr(jax.config, name) == before


def test_where_nothing_can_be_written_it_computes(folder, said, monkeypatch):
    def full(*_: object, is_private: bool) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "write_bytes", full)
    for _ in range(2):
        _, drawn = another_process()(jax.random.key(3), default_motion())
        same(drawn, jax.random.normal(jax.random.key(3), (3,)))
    assert len(said) == 1
    assert "No space left on device" in said[0]


def test_inside_of_other_programs_it_is_a_plain_function(folder: Path) -> None:
    call, keys = another_process(), jax.random.split(jax.random.key(0), 4)
    _, drawn = jax.jit(jax.vmap(lambda key: call(key, default_motion())))(keys)
    same(drawn, jax.vmap(lambda key: jax.random.normal(key, (3,)))(keys))
    assert not list(folder.iterdir())


def test_only_the_programs_used_last_stay(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MAX_PROGRAMS", 2)
    call = another_process()
    for times in range(4):
        call(jax.random.key(3), default_motion(), times=times)
    assert len(list(folder.glob("*.program"))) == 2
