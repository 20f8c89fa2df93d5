"""Run the trials of Table 3 in parallel processes, store each result, and build the table.

A trial's result is determined by its row, its number and the seed. Stored trials are not repeated,
except those that crashed.
"""

import concurrent.futures
import dataclasses
import json
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxlangnav import __version__
from jaxlangnav.experiments.metrics import wilson_interval
from jaxlangnav.experiments.table import TableColumns
from jaxlangnav.inputs.atomic_files import write_text
from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.robots.libraries import check_libraries
from jaxlangnav.robots.physics.robot import ODOMETRY_NOISE
from jaxlangnav.robots.table3 import TABLE3, TrialRow, navigator_of, run_known, run_trial

KNOWN_MAP = "known"
"""Instead of a trial's number: the run with a completely known map."""
_CRASHED = "crashed"  # ending of a trial in which an exception was raised
_CACHE_OPTION = "jax_compilation_cache_dir"


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrialPlan:
    """Trials to run, and where to store their results."""

    trials: int
    """Trials of each row, besides the run with the known map."""
    seed: int = 0
    policy: str = "informed"
    out: Path | None = None
    """Folder for ``trials/``, one file for each, and ``recordings/``, a page of each row's first
    trial and of each that fails; None: nothing is stored or reused."""
    processes: int = 2

    def __post_init__(self) -> None:
        """Validate the counts."""
        check_minimum(1, trials=self.trials, processes=self.processes)

    def path(self, row: TrialRow, trial: int | str) -> Path | None:
        """Name the file of a trial."""
        if self.out is None:
            return None
        return self.out / "trials" / f"{row.name}-{self.policy}-seed{self.seed}-{trial}.json"

    def page(self, row: TrialRow, trial: int | str) -> Path | None:
        """Name the page of a trial's recording."""
        path = self.path(row, trial)
        return path and path.parent.with_name("recordings") / f"{path.stem}.html"

    @property
    def made(self) -> dict[str, Any]:
        """Settings that a stored trial must share to be reused."""
        return {
            "version": __version__,
            "seed": self.seed,
            "policy": self.policy,
            "odometry_noise": ODOMETRY_NOISE,
        }


def reproduce_table3(
    plan: TrialPlan,
    *,
    rows: Sequence[TrialRow] = TABLE3,
    on_progress: Callable[[int], None] = lambda done: None,
) -> dict[str, Any]:
    """Reproduce Table 3.

    Args:
        plan: how many trials, and where to store them.
        rows: all of the paper's by default.
        on_progress: called with the number of trials that have just ended.

    Returns:
        The document: ``rows``, each with the paper's; ``success`` over all trials; ``wall_s``.

    Raises:
        MissingExtraError: a library of the extra ``robot`` is not installed, or offscreen
            rendering does not work.
    """
    start_time = time.perf_counter()
    check_libraries()
    trials = [(row, trial) for row in rows for trial in (KNOWN_MAP, *range(plan.trials))]
    stored = {key: _read_result(plan, *key) for key in trials}
    results = {key: result for key, result in stored.items() if result is not None}
    missing = [key for key in trials if key not in results]
    on_progress(len(results))
    for row, trial, result in _run_missing(plan, missing):
        path = plan.path(row, trial)
        if path is not None:
            write_text(json.dumps({**result, "made": plan.made}, indent=1) + "\n", path)
        results[row, trial] = result
        on_progress(1)
    summaries = [
        _summary(row, results[row, KNOWN_MAP], [results[row, n] for n in range(plan.trials)])
        for row in rows
    ]
    successes = sum(row["successes"] for row in summaries)
    return {
        "experiment": "table3",
        **plan.made,
        "trials": plan.trials,
        "rows": summaries,
        "success": successes / (plan.trials * len(summaries)),
        "success_interval": wilson_interval(successes, plan.trials * len(summaries)),
        "resumed": len(trials) - len(missing),
        "wall_s": time.perf_counter() - start_time,
    }


def _read_result(plan: TrialPlan, row: TrialRow, trial: int | str) -> dict[str, Any] | None:
    """Read a stored trial of the plan's settings; None if it is missing, invalid or crashed."""
    path = plan.path(row, trial)
    if path is None or not path.is_file():
        return None
    try:
        result = json.loads(path.read_text("utf-8"))
    except ValueError:
        return None
    is_valid = isinstance(result, dict) and result.get("made") == plan.made
    return result if is_valid and result.get("ending") != _CRASHED else None


def _run_missing(
    plan: TrialPlan, missing: Sequence[tuple[TrialRow, int | str]]
) -> Iterator[tuple[TrialRow, int | str, dict[str, Any]]]:
    """Run trials in a process pool, and yield each as it ends."""
    if not missing:
        return
    # MuJoCo's and JAX's threads do not survive a fork.
    pool = concurrent.futures.ProcessPoolExecutor(
        max_workers=min(plan.processes, len(missing)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_init_worker,
        initargs=(getattr(jax.config, _CACHE_OPTION),),
    )
    with pool:
        futures = {pool.submit(_run_one, row, trial, plan): (row, trial) for row, trial in missing}
        try:
            for future in concurrent.futures.as_completed(futures):
                yield *futures[future], future.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _init_worker(cache: str | None) -> None:
    """Set up a worker process with the main process's cache of compiled programs."""
    if cache:
        jax.config.update(_CACHE_OPTION, cache)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


def _run_one(row: TrialRow, trial: int | str, plan: TrialPlan) -> dict[str, Any]:
    """Run one trial in a worker process; an exception becomes a failed result."""
    try:
        if isinstance(trial, str):
            return run_known(row, seed=plan.seed)
        navigator, page = navigator_of(row.robot, plan.policy), plan.page(row, trial)
        first = page if trial == 0 else None
        result = run_trial(row, trial, navigator=navigator, seed=plan.seed, page=first)
        if not result["success"] and page != first:
            # Repeat the same run, to record its page.
            run_trial(row, trial, navigator=navigator, seed=plan.seed, page=page)
        return result
    except Exception as error:  # a lost trial must not lose the others
        if os.environ.get("JAXLANGNAV_DEBUG"):
            raise
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        missing = {"distance": None, "goal_distance": None, "seconds": None}
        failed = {"ending": _CRASHED, "why": reason, "success": False, **missing}
        return {"row": row.name, "trial": trial, "seed": plan.seed, **failed}


_PRINTED = ("success", "known_distance", "distance", "distance_sd")


def _summary(
    row: TrialRow, known: dict[str, Any], trials: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    successes = sum(bool(trial["success"]) for trial in trials)
    distances = np.array([trial["distance"] for trial in trials if trial["distance"] is not None])
    seconds = [trial["seconds"] for trial in trials if trial["seconds"] is not None]
    return {
        **{name: getattr(row, name) for name in ("robot", "world", "range")},
        "relation": None if row.relation == "null" else row.relation,
        "trials": len(trials),
        "successes": successes,
        "success": successes / len(trials),
        "success_interval": wilson_interval(successes, len(trials)),
        "distance": float(distances.mean()) if len(distances) else None,
        "distance_sd": float(distances.std(ddof=1)) if len(distances) > 1 else None,
        "seconds": float(np.mean(seconds)) if seconds else None,
        "known_success": bool(known["success"]),
        "known_distance": known["distance"],
        "endings": dict(Counter(trial["ending"] for trial in trials)),
        "failures": [
            {key: trial[key] for key in ("trial", "ending", "why", "goal_distance")}
            for trial in trials
            if not trial["success"]
        ],
        "paper": {name: getattr(row, name) for name in _PRINTED},
    }


def _metres(value: float | None, sd: float | None = None) -> str:
    """Format a distance, or a dash for None."""
    return "–" if value is None else f"{value:.2f}" + ("" if sd is None else f" ({sd:.2f})")


TRIAL_COLUMNS: TableColumns = (
    ("robot", "{robot}"),
    ("world", "{world}"),
    ("range (m)", "{range:g}"),
    ("relation", lambda row: row["relation"] or "null"),
    ("success", "{success:.0%} [{success_interval[0]:.0%}, {success_interval[1]:.0%}]"),
    ("paper", "{paper[success]:g}%"),
    ("distance (m)", lambda row: _metres(row["distance"], row["distance_sd"])),
    ("paper", lambda row: _metres(row["paper"]["distance"], row["paper"]["distance_sd"])),
    (
        "known (m)",
        lambda row: _metres(row["known_distance"]) + ("" if row["known_success"] else " (failed)"),
    ),
    ("paper", lambda row: _metres(row["paper"]["known_distance"])),
    ("time (s)", lambda row: "–" if row["seconds"] is None else f"{row['seconds']:.0f}"),
    ("endings", lambda row: ", ".join(f"{n} {name}" for name, n in row["endings"].items())),
)
"""Columns of the table of the rows of ``reproduce_table3``; distances are mean (sd), metres."""
