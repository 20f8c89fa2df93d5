"""What every test runs under: no silent broadcasting, and compiled programs are kept."""

import os
from pathlib import Path

# Tests take the CPU unless told otherwise: their tolerances are derived for it.
os.environ.setdefault("JAX_PLATFORMS", "cpu")

import jax
import pytest

BRIEFLY = "--xla_backend_optimization_level=0"
"""Half the time to compile a decision cycle; what it computes is the same, only slower."""


def pytest_configure(config: pytest.Config) -> None:
    """Set JAX up before any test module is imported."""
    # The quick tier compiles much and runs it briefly. The slow tests run what users run.
    if config.option.markexpr == "not slow":
        os.environ["XLA_FLAGS"] = f"{BRIEFLY} {os.environ.get('XLA_FLAGS', '')}".strip()
    jax.config.update("jax_numpy_rank_promotion", "raise")
    cache = Path(config.rootpath) / ".pytest_cache" / "jax"
    jax.config.update("jax_compilation_cache_dir", str(cache))
    # Small programs too: there are thousands, and workers share them.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the notebooks, the longest file: no worker waits for it at the end."""
    items.sort(key=lambda item: item.path.name != "test_notebooks.py")
