"""Programs kept whole: found again without tracing, and never in the way."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

from jaxlangnav import kept as module
from jaxlangnav.kept import keep_in, kept
from jaxlangnav.messages import default_motion
from jaxlangnav.pytree import replace

TRACES: list[int] = []


def noisy(key: jax.Array, record, *, times: int = 1):
    """A key and a record in, a record and an array out; tells that it has been traced."""
    TRACES.append(times)
    drawn = times * jax.random.normal(key, (3,))
    return replace(record, odometry_noise=record.odometry_noise + drawn[0]), drawn


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    TRACES.clear()
    keep_in(tmp_path / "whole")
    yield tmp_path / "whole"
    keep_in(None)


def another_process() -> Callable:
    """A wrapper that knows of nothing but the folder."""
    return kept(static_argnames=("times",))(noisy)


def same(one, other) -> None:
    jax.tree.map(np.testing.assert_array_equal, one, other)


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
    call(jax.random.key(4), motion, times=1)  # only data
    assert len(TRACES) == 4


def test_values_are_those_of_the_call(folder: Path) -> None:
    call, motion = another_process(), default_motion()
    one, other = (call(jax.random.key(seed), motion)[1] for seed in (1, 2))
    assert not np.array_equal(one, other)


@pytest.mark.parametrize("content", [b"", b"not a program", b"\x80\x04N."])
def test_a_damaged_file_is_compiled_anew(folder: Path, content: bytes) -> None:
    arguments = jax.random.key(3), default_motion()
    first = another_process()(*arguments)
    (path,) = folder.glob("*.program")
    good = path.stat().st_size
    path.write_bytes(content)
    same(another_process()(*arguments), first)
    assert len(TRACES) == 2
    assert path.stat().st_size == pytest.approx(good, rel=0.1)


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
    machine = module._machine()
    monkeypatch.setattr(module, "_machine", lambda: ("another digest", *machine[1:]))
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


def test_where_nothing_can_be_kept_it_computes(tmp_path: Path) -> None:
    TRACES.clear()
    (tmp_path / "file").write_text("in the way")
    keep_in(tmp_path / "file" / "whole")
    try:
        _, drawn = another_process()(jax.random.key(3), default_motion())
    finally:
        keep_in(None)
    same(drawn, jax.random.normal(jax.random.key(3), (3,)))


def test_inside_of_other_programs_it_is_a_plain_function(folder: Path) -> None:
    call, keys = another_process(), jax.random.split(jax.random.key(0), 4)
    _, drawn = jax.jit(jax.vmap(lambda key: call(key, default_motion())))(keys)
    same(drawn, jax.vmap(lambda key: jax.random.normal(key, (3,)))(keys))
    assert not folder.exists()


def test_only_the_programs_used_last_stay(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_MAX_PROGRAMS", 2)
    call = another_process()
    for times in range(4):
        call(jax.random.key(3), default_motion(), times=times)
    assert len(list(folder.glob("*.program"))) == 2
