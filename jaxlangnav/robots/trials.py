"""Many trials of Table 3 in parallel processes, each kept as it ends, and the table they make.

A trial's result follows from its row, its number and the seed alone. One that has been kept is not
run again.
"""

import concurrent.futures
import dataclasses
import functools
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
from jaxlangnav.experiments.table import Table, TableColumns
from jaxlangnav.inputs.limits import refuse_below
from jaxlangnav.inputs.whole_files import write_text
from jaxlangnav.robots.libraries import check_libraries
from jaxlangnav.robots.physics.robot import ODOMETRY_NOISE
from jaxlangnav.robots.table3 import TABLE3, TrialRow, navigator_of, run_known, run_trial

KNOWN = "known"
"""In place of a trial's number: the run with a completely known map."""
_CACHE = "jax_compilation_cache_dir"


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrialPlan:
    """What is run."""

    trials: int
    """Of each row, besides the known run."""
    seed: int = 0
    policy: str = "informed"
    out: Path | None = None
    """Folder for ``trials/``, one file for each, and ``recordings/``, a page of each row's first
    trial and of each that fails; nothing is kept, or found again, without."""
    processes: int = 2

    def __post_init__(self) -> None:
        """Refuse what cannot be run."""
        refuse_below(1, trials=self.trials, processes=self.processes)

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
        """What a kept trial must have been made with to be used again."""
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
    """Run Table 3.

    Args:
        plan: how many trials, and where they are kept.
        rows: all of the paper's by default.
        on_progress: is told how many trials have just ended.

    Returns:
        The document: ``rows``, each beside the paper's; ``success`` over all trials; ``wall_s``.

    Raises:
        MissingExtraError: a library of the extra ``robot`` is not installed.
        MissingSystemLibraryError: rendering off screen does not work.
    """
    begin = time.perf_counter()
    check_libraries()
    wanted = [(row, one) for row in rows for one in (KNOWN, *range(plan.trials))]
    read = {(row, trial): _read(plan, row, trial) for row, trial in wanted}
    found = {one: kept for one, kept in read.items() if kept is not None}
    missing = [one for one in wanted if one not in found]
    for _ in found:
        on_progress(1)
    for row, trial, result in _run(plan, missing):
        path = plan.path(row, trial)
        if path is not None:
            write_text(json.dumps({**result, "made": plan.made}, indent=1) + "\n", path)
        found[row, trial] = result
        on_progress(1)
    summaries = [
        _summary(row, found[row, KNOWN], [found[row, n] for n in range(plan.trials)])
        for row in rows
    ]
    successes = sum(one["successes"] for one in summaries)
    return {
        "experiment": "table3",
        **plan.made,
        "trials": plan.trials,
        "rows": summaries,
        "success": successes / (plan.trials * len(summaries)),
        "success_interval": wilson_interval(successes, plan.trials * len(summaries)),
        "resumed": len(wanted) - len(missing),
        "wall_s": time.perf_counter() - begin,
    }


def _read(plan: TrialPlan, row: TrialRow, trial: int | str) -> dict[str, Any] | None:
    """Read a trial that has been kept; None if there is none that is whole and made alike."""
    path = plan.path(row, trial)
    if path is None or not path.is_file():
        return None
    try:
        kept = json.loads(path.read_text("utf-8"))
    except ValueError:
        return None
    return kept if isinstance(kept, dict) and kept.get("made") == plan.made else None


def _run(
    plan: TrialPlan, missing: Sequence[tuple[TrialRow, int | str]]
) -> Iterator[tuple[TrialRow, int | str, dict[str, Any]]]:
    """Run trials, and yield each as it ends."""
    if not missing:
        return
    # MuJoCo's and JAX's threads do not survive a fork.
    pool = concurrent.futures.ProcessPoolExecutor(
        max_workers=min(plan.processes, len(missing)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin,
        initargs=(getattr(jax.config, _CACHE),),
    )
    with pool:
        waiting = {pool.submit(_one, row, trial, plan): (row, trial) for row, trial in missing}
        try:
            for done in concurrent.futures.as_completed(waiting):
                yield *waiting[done], done.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _begin(cache: str | None) -> None:
    """Set up a process: compiled programs are found where the first one keeps them."""
    if cache:
        jax.config.update(_CACHE, cache)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


_navigator_of = functools.cache(navigator_of)


def _one(row: TrialRow, trial: int | str, plan: TrialPlan) -> dict[str, Any]:
    """Run one trial in its process; whatever goes wrong in it is a result, too."""
    seed = plan.seed
    try:
        if isinstance(trial, str):
            return run_known(row, seed=seed)
        navigator, page = _navigator_of(row.robot, plan.policy), plan.page(row, trial)
        first = page if trial == 0 else None
        found = run_trial(row, trial, navigator=navigator, seed=seed, page=first)
        if not found["success"] and page != first:
            # Once more, the same to the last decision, to be looked at.
            run_trial(row, trial, navigator=navigator, seed=seed, page=page)
        return found
    except Exception as error:  # a lost trial must not lose the others
        if os.environ.get("JAXLANGNAV_DEBUG"):
            raise
        why = f"{type(error).__name__}: {' '.join(str(error).split())}"
        nothing = {"distance": None, "goal_distance": None, "seconds": None}
        failed = {"ending": "crashed", "why": why, "success": False, **nothing}
        return {"row": row.name, "trial": trial, "seed": seed, **failed}


def _summary(
    row: TrialRow, known: dict[str, Any], trials: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """Make a row of the table out of its trials."""
    successes = sum(bool(one["success"]) for one in trials)
    way = np.array([one["distance"] for one in trials if one["distance"] is not None])
    seconds = [one["seconds"] for one in trials if one["seconds"] is not None]
    return {
        "robot": row.robot,
        "world": row.world,
        "range": row.range,
        "relation": None if row.relation == "null" else row.relation,
        "trials": len(trials),
        "successes": successes,
        "success": successes / len(trials),
        "success_interval": wilson_interval(successes, len(trials)),
        "distance": float(way.mean()) if len(way) else None,
        "distance_sd": float(way.std(ddof=1)) if len(way) > 1 else None,
        "seconds": float(np.mean(seconds)) if seconds else None,
        "known_success": bool(known["success"]),
        "known_distance": known["distance"],
        "endings": dict(Counter(one["ending"] for one in trials)),
        "failures": [
            {key: one[key] for key in ("trial", "ending", "why", "goal_distance")}
            for one in trials
            if not one["success"]
        ],
        "paper": {
            "success": row.success,
            "known_distance": row.known,
            "distance": row.distance,
            "distance_sd": row.distance_sd,
        },
    }


def trials_table(document: dict[str, Any], **rest: Any) -> Table:
    """Lay out the document of ``reproduce_table3``, a line for each row, ours beside the paper's.

    Distances are mean (sd), metres; ``rest`` are the table's title and caption.
    """
    return Table.of(document["rows"], _COLUMNS, **rest)


def _success(row: dict[str, Any]) -> str:
    """Write a share with its interval, percent."""
    low, high = (100 * one for one in row["success_interval"])
    return f"{100 * row['success']:.0f} [{low:.0f}, {high:.0f}]"


def _metres(mean: float | None, spread: float | None = None) -> str:
    """Write a distance, or a dash where there is none."""
    if mean is None:
        return "–"
    return f"{mean:.2f}" + ("" if spread is None else f" ({spread:.2f})")


_COLUMNS: TableColumns = (
    ("robot", "{robot}"),
    ("world", "{world}"),
    ("range (m)", "{range:g}"),
    ("relation", lambda row: row["relation"] or "null"),
    ("success (%)", _success),
    ("paper", "{paper[success]:g}"),
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
