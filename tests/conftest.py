"""What every test runs under: no silent broadcasting, programs compiled briefly and kept."""

import ctypes
import os
import sys
from collections.abc import Iterator
from pathlib import Path

# Tests take the CPU unless told otherwise: their tolerances are derived for it.
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import pytest

RUN_LONG = ("test_experiments_", "test_kept", "test_language_", "test_training_")
"""Files whose programs run longer than they compile, or are held to the last digits of float32 or
to other processes; single programs elsewhere: readings.OFTEN."""
LONGEST = (
    "test_notebooks",
    "test_follow_constructs",
    "test_cli_experiments",
    "test_episode_batch",
    "test_outside",
    "test_experiments_sweep",
    "test_semantic_map_laws",
    "test_grounding_behavior",
    "test_any_noun",
)
"""Files to begin with, so that no worker waits for one at the end."""
FULL = 2e9
"""Bytes of a worker from which on it lets compiled programs go; a decision cycle's is 0.4e9."""


def pytest_configure(config: pytest.Config) -> None:
    """Set JAX up before any test module is imported."""
    jax.config.update("jax_numpy_rank_promotion", "raise")
    cache = Path(config.rootpath) / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    # Small programs too: there are thousands, and workers share them.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files."""
    order = {name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.stem, len(order)))


@pytest.fixture(autouse=True, scope="module")
def _compile_briefly(request: pytest.FixtureRequest) -> Iterator[None]:
    """Compile without LLVM's optimisation, in half the time: the quick tier runs hardly anything.

    With the slow tests everything is compiled as users compile it.
    """
    is_quick = request.config.option.markexpr == "not slow"
    is_brief = is_quick and not request.path.name.startswith(RUN_LONG)
    if is_brief != jax.config.read("jax_disable_most_optimizations"):
        # A worker would go on with the other kind of program, which rounds otherwise.
        jax.clear_caches()
        if "jaxlangnav.experiments.devices" in sys.modules:
            sys.modules["jaxlangnav.experiments.devices"]._programs.clear()
    jax.config.update("jax_disable_most_optimizations", is_brief)
    yield
    _give_back_memory()


def _give_back_memory() -> None:
    """Return what the compiler has freed: half of what a worker seems to hold, with glibc."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is None:
        return
    trim(0)
    if _resident() > FULL:
        jax.clear_caches()
        trim(0)


def _resident() -> int:
    """Read off how many bytes of memory this process has; only where there is glibc."""
    pages = int(Path("/proc/self/statm").read_text("utf-8").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
