"""Where the command line keeps what is compiled, and that nobody else can write there."""

import os
import queue
import stat
from collections.abc import Iterator
from pathlib import Path

import jax
import pytest

from jaxlangnav.cli.main import DEBUG, XLA_LOG_LEVEL, main
from jaxlangnav.cli.output import Output
from jaxlangnav.cli.runtime import (
    compile_fast,
    expected_duration,
    keep_compiled_programs,
    progress_bar,
    save_duration,
)
from jaxlangnav.inputs.program_cache import cache_dir, set_cache_dir

SETTINGS = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    before = {name: getattr(jax.config, name) for name in SETTINGS}
    jax.config.update("jax_compilation_cache_dir", None)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    yield tmp_path / "home"
    set_cache_dir(None)
    for name, value in before.items():
        jax.config.update(name, value)


def jax_folder() -> str | None:
    return getattr(jax.config, "jax_compilation_cache_dir", None)


def test_both_caches_are_closed_to_others(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keep_compiled_programs()
    cache = home / ".cache" / "jaxlangnav"
    assert jax_folder() == str(cache / "xla")
    assert cache_dir() == cache / "programs"
    for folder in (home, home / ".cache", cache, cache / "xla", cache / "programs"):
        assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert capsys.readouterr().err == ""


def test_a_folder_named_for_jax_is_taken_if_nobody_else_can_write_it(tmp_path: Path) -> None:
    jax.config.update("jax_compilation_cache_dir", str(tmp_path / "jax"))
    keep_compiled_programs()
    assert jax_folder() == str(tmp_path / "jax")
    assert cache_dir() == tmp_path / "jax" / "programs"


@pytest.mark.parametrize("shared", ["folder", "address"])
def test_a_shared_folder_named_for_jax_is_left_to_jax(shared, home, tmp_path, capsys):
    (tmp_path / "jax").mkdir()
    (tmp_path / "jax").chmod(0o777)
    named = str(tmp_path / "jax") if shared == "folder" else "gs://bucket/jax"
    jax.config.update("jax_compilation_cache_dir", named)
    keep_compiled_programs()
    assert jax_folder() == named
    assert cache_dir() == home / ".cache" / "jaxlangnav" / "programs"
    assert not list((tmp_path / "jax").iterdir())
    assert capsys.readouterr().err == ""


def test_where_others_can_write_nothing_is_kept_and_that_is_said_once(
    home, tmp_path, monkeypatch, capsys
):
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(0o777)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "shared"))
    keep_compiled_programs()
    assert jax_folder() is None
    assert cache_dir() is None
    found = capsys.readouterr()
    assert found.out == ""
    assert found.err == (
        f"compiled programs are not kept: {tmp_path / 'shared'}: others can write in it; "
        "remedy: chmod go-w\n"
    )
    assert not list((tmp_path / "shared").iterdir())


def test_where_no_folder_can_be_made_nothing_is_kept(tmp_path, monkeypatch, capsys):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("HOME", str(tmp_path / "file/cache"))
    keep_compiled_programs()
    assert (jax_folder(), cache_dir()) == (None, None)
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("compiled programs are not kept: ")


def test_who_wants_no_cache_has_none(home: Path) -> None:
    jax.config.update("jax_enable_compilation_cache", False)
    try:
        keep_compiled_programs()
    finally:
        jax.config.update("jax_enable_compilation_cache", True)
    assert (jax_folder(), cache_dir()) == (None, None)
    assert not home.exists()


@pytest.mark.parametrize(
    ("own", "debug", "level"), [(None, None, "3"), ("0", None, "0"), (None, "1", None)]
)
def test_the_compilers_log_stays_off_the_terminal(own, debug, level, monkeypatch):
    """Its note of a slow compilation is not ours; whoever asks for its log has it."""
    for name, value in ((XLA_LOG_LEVEL, own), (DEBUG, debug)):
        monkeypatch.setenv(name, value or "")
        if value is None:
            monkeypatch.delenv(name)
    assert main(["--version"]) == 0
    assert os.environ.get(XLA_LOG_LEVEL) == level


def test_progress_is_a_line_where_there_is_no_terminal(monkeypatch):
    lines: queue.Queue[str] = queue.Queue()
    monkeypatch.setattr(Output, "note", lambda _, text: lines.put(text))
    with progress_bar("episodes", 10, delay=0.0) as advance:
        advance(4)
        assert lines.get().startswith("episodes: ")  # the next one is a minute away


def test_a_duration_is_expected_from_the_last_run(home):
    sizes, default = (5, 10, 20), (10, 8.0)
    assert [expected_duration("table2", n, default=default) for n in sizes] == [8.0, 8.0, 16.0]
    save_duration("table2", 30.0, 10)
    save_duration("fig1", 5.0, 2)  # mostly compilation: more items cost what they cost elsewhere
    assert expected_duration("fig1", 12, default=default) == 13.0
    assert [expected_duration("table2", n, default=default) for n in sizes] == [30.0, 30.0, 60.0]
    for damaged in ("{", "[1]", '{"table2": ["ten", 1]}', '{"table2": 3}'):
        (home / ".cache" / "jaxlangnav" / "durations.json").write_text(damaged)
        assert expected_duration("table2", 10, default=default) == 8.0
        save_duration("fig1", 5.0)


def test_compilation_is_fast_unless_chosen_otherwise(monkeypatch):
    flag = "--xla_cpu_use_fusion_emitters="
    for given, minor, added in (("--a", 10, f" {flag}false"), (f"{flag}true", 9, ""), ("", 12, "")):
        monkeypatch.setenv("XLA_FLAGS", given)
        monkeypatch.setattr(jax, "__version_info__", (0, minor, 0))
        for _ in range(2):  # once: the flags are part of the name of what is kept
            compile_fast()
            assert os.environ["XLA_FLAGS"] == given + added
