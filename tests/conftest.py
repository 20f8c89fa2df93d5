"""What every test runs under: no silent broadcasting, programs compiled briefly and kept."""

import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

# Tests take the CPU unless told otherwise: their tolerances are derived for it.
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import pytest

from jaxlangnav.cli.runtime import compile_fast

RUN_LONG = ("test_experiments_", "test_kept", "test_language_", "test_training_")
"""Files whose programs run longer than they compile, or are held to the last digits of float32."""
TOGETHER = {
    "the filter": (
        "test_semantic_map_", "test_conversation_enumeration", "test_relations_fit",
        "test_studies_episode_evidence",
    ),
    "robots": (
        "test_any_noun", "test_outside", "test_conversation", "test_navigator_",
        "test_robots_", "test_measured", "test_follow_talk", "test_halting",
    ),
    "follow": (
        "test_cli_experiments", "test_cli_follow", "test_follow_constructs", "test_recording",
    ),
    "corpora": ("test_language_corpus", "test_training_labelled"),
}  # fmt: skip
"""Files that run the same programs, by the beginnings of their names: one worker runs them all."""
FIRST = ("test_notebooks.py", *TOGETHER, "test_experiments_sweep.py")
"""What to begin with, so that no worker waits for it at the end."""
FULL = 2e9
"""Bytes of a worker from which on it lets compiled programs go; a decision cycle's is 0.4e9."""


def pytest_configure(config: pytest.Config) -> None:
    """Set JAX up before any test module is imported, and a cache other than the user's."""
    compile_fast()
    jax.config.update("jax_numpy_rank_promotion", "raise")
    cache = Path(config.rootpath) / ".pytest_cache"
    os.environ["XDG_CACHE_HOME"] = str(cache / "user")
    jax.config.update("jax_compilation_cache_dir", str(cache / "jax"))
    # Small programs too: there are thousands, and workers share them.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Put files together that share programs, and those last that are compiled in full."""
    order = {name: place for place, name in enumerate(FIRST)}

    def turn(item: pytest.Item) -> tuple[bool, int]:
        # Each worker changes once from programs compiled briefly to others.
        is_last = _is_quick(config) and item.path.name.startswith(RUN_LONG)
        return is_last, order.get(_group(item.path.name), len(order))

    items.sort(key=turn)


def pytest_collection_finish() -> None:
    """Collect garbage seldom: searching a heap of that many objects is a sixth of all tracing."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Send files that share programs to one worker; with the slow tests each file goes alone."""
    from xdist.scheduler import LoadFileScheduling

    class Groups(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return _group(Path(super()._split_scope(nodeid)).name)

    is_wanted = _is_quick(config) and config.getvalue("dist") == "loadfile"
    return Groups(config, log) if is_wanted else None


def _is_quick(config: pytest.Config) -> bool:
    return config.option.markexpr == "not slow"


def _group(file: str) -> str:
    """Name what a file goes to one worker with; itself by default."""
    return next((group for group, files in TOGETHER.items() if file.startswith(files)), file)


@pytest.fixture(scope="session")
def robot() -> Any:
    """The navigator as it ships."""
    from jaxlangnav import Navigator

    return Navigator.pretrained()


@pytest.fixture(scope="session")
def navigator(robot: Any) -> Any:
    """That navigator, by the name it has where it drives a robot."""
    return robot


@pytest.fixture(scope="session")
def model() -> Any:
    """The trained models as they ship."""
    from jaxlangnav.grounding import load_shipped

    return load_shipped()


@pytest.fixture(autouse=True, scope="module")
def _compile_briefly(request: pytest.FixtureRequest) -> Iterator[None]:
    """Compile without LLVM's optimisation, in half the time; with the slow tests as users do."""
    is_brief = _is_quick(request.config) and not request.path.name.startswith(RUN_LONG)
    if is_brief != jax.config.read("jax_disable_most_optimizations"):
        # A worker would go on with the other kind of program, which rounds otherwise.
        _drop_programs()
    jax.config.update("jax_disable_most_optimizations", is_brief)
    yield
    _give_back_memory()


def _give_back_memory() -> None:
    """Return what the compiler has freed: half of what a worker seems to hold, with glibc."""
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is None:
        return
    trim(0)
    pages = int(Path("/proc/self/statm").read_text("utf-8").split()[1])
    if pages * os.sysconf("SC_PAGE_SIZE") > FULL:
        _drop_programs()
        trim(0)


def _drop_programs() -> None:
    """Let all compiled programs go."""
    jax.clear_caches()
    if "jaxlangnav.experiments.monte_carlo" in sys.modules:
        sys.modules["jaxlangnav.experiments.monte_carlo"]._programs.clear()
