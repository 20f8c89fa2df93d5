"""Measuring: costs of work, entries of the bench's document, their table."""

import dataclasses
import os
import platform
import statistics
import time
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from jaxlangnav.episode import MAX_STEPS
from jaxlangnav.experiments.devices import CHUNK, LANES, usable_cores
from jaxlangnav.experiments.table import Table

POLICY = "informed"
"""The policy that is measured."""
Measurement = dict[str, Any]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cost:
    """What something took."""

    cpu: float
    """CPU seconds; seconds on the wall where the work is on another device."""
    wall: float
    """Seconds."""


def describe_machine() -> dict[str, Any]:
    """Say on what the figures were measured."""
    device = jax.devices()[0]
    return {
        "platform": device.platform,
        "device": device.device_kind,
        "devices": jax.device_count(),
        "cpu": platform.processor() or platform.machine(),
        "cores": os.cpu_count(),
        "threads": usable_cores(),
        "load": round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None,
        "jax": jax.__version__,
        "numpy": np.__version__,
        "chunk": CHUNK,
        "lanes": LANES,
        "policy": POLICY,
    }


def entry(
    name: str,
    value: float,
    unit: str,
    *,
    baseline: float | None = None,
    ratio: float | None = None,
    target: float | None = None,
    is_limit: bool = False,
) -> Measurement:
    """Build an entry.

    Args:
        name: what was measured.
        value: ours.
        unit: of value and baseline.
        baseline: theirs, in the same run.
        ratio: how many times better ours is.
        target: of the ratio, or of the value where there is no ratio.
        is_limit: the value is to stay below the target.

    Returns:
        The entry; ``holds`` says whether the target is reached, None without one.
    """
    judged = value if ratio is None else ratio
    holds = None if target is None else bool(judged <= target if is_limit else judged >= target)
    return {
        "name": name,
        "value": value,
        "unit": unit,
        "baseline": baseline,
        "ratio": ratio,
        "target": target,
        "holds": holds,
    }


def against(ours: float, theirs: float, target: float) -> Measurement:
    """Fill in a comparison of costs."""
    ratio = theirs / ours
    return {"baseline": theirs, "ratio": ratio, "target": target, "holds": ratio >= target}


def measure(work: Callable[[], Any], repetitions: int, *, patience: float = float("inf")) -> Cost:
    """Time some work, warmed up by the caller.

    Args:
        work: returns arrays, which are waited for.
        repetitions: how often; the medians count.
        patience: seconds after which it is not repeated any more.

    Returns:
        Its cost.
    """
    is_local = jax.default_backend() == "cpu"
    costs = []
    begin = time.perf_counter()
    while not costs or (len(costs) < repetitions and time.perf_counter() - begin < patience):
        cpu, wall = time.process_time(), time.perf_counter()
        jax.block_until_ready(work())
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        costs.append((cpu if is_local else wall, wall))
    return Cost(
        cpu=statistics.median(cost[0] for cost in costs),
        wall=statistics.median(cost[1] for cost in costs),
    )


def is_cache_on() -> bool:
    """Tell whether compiled programs are kept on disk."""
    flags: Any = jax.config
    return bool(flags.jax_enable_compilation_cache)


def render(document: dict[str, Any]) -> Any:
    """Draw the figures for people.

    Args:
        document: of ``run_bench``.

    Returns:
        A rich table.
    """
    machine = document["machine"]
    caption = (
        f"{machine['device']}, {machine['threads']} threads, load {machine['load']} at the start; "
        f"JAX {machine['jax']}; policy {machine['policy']}, at most {MAX_STEPS} cycles an episode; "
        f"at most {machine['chunk']} episodes a call, in {machine['lanes']} lanes."
    )
    rows = [
        [
            one["name"],
            f"{one['value']:.3g} {one['unit']}".strip(),
            *(_number(one[name]) for name in ("baseline", "ratio", "target")),
            {True: "yes", False: "no", None: ""}[one["holds"]],
        ]
        for one in document["entries"]
    ]
    headings = ["Measured", "Ours", "Baseline", "Ratio", "Target", "Holds"]
    return Table(headings=headings, rows=rows, title="Speed", caption=caption).text()


def _number(value: float | None) -> str:
    """Write a number, or nothing."""
    return "" if value is None else f"{value:.3g}"
