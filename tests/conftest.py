"""What every test runs under: no silent broadcasting, and compiled programs are kept."""

import os
from collections.abc import Iterator
from pathlib import Path

# Tests take the CPU unless told otherwise: their tolerances are derived for it.
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import pytest

RUN_LONG = ("test_experiments_", "test_language_")
"""Files whose programs run longer than they compile; single programs elsewhere: readings.OFTEN."""


def pytest_configure(config: pytest.Config) -> None:
    """Set JAX up before any test module is imported."""
    jax.config.update("jax_numpy_rank_promotion", "raise")
    cache = Path(config.rootpath) / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    # Small programs too: there are thousands, and workers share them.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


@pytest.fixture(autouse=True, scope="module")
def _compile_briefly(request: pytest.FixtureRequest) -> Iterator[None]:
    """Compile without LLVM's optimisation, in half the time: the quick tier runs hardly anything.

    With the slow tests everything is compiled as users compile it.
    """
    is_quick = request.config.option.markexpr == "not slow"
    is_brief = is_quick and not request.path.name.startswith(RUN_LONG)
    jax.config.update("jax_disable_most_optimizations", is_brief)
    yield
    jax.config.update("jax_disable_most_optimizations", False)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the notebooks, the longest file: no worker waits for it at the end."""
    items.sort(key=lambda item: item.path.name != "test_notebooks.py")
