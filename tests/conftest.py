"""What every test runs under: no silent broadcasting, and compiled programs are kept."""

import os
from pathlib import Path

# Tests take the CPU unless told otherwise: their tolerances are derived for it.
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import pytest


def pytest_configure(config: pytest.Config) -> None:
    """Set JAX up before any test module is imported."""
    jax.config.update("jax_numpy_rank_promotion", "raise")
    cache = Path(config.rootpath) / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the notebooks, the longest file: no worker waits for it at the end."""
    items.sort(key=lambda item: item.path.name != "test_notebooks.py")
