"""The policies that stand in the tables, by name: the navigator's two and the baselines.

All of them answer the same tasks with the same records, so that every table can hold any of
them side by side, paired episode by episode.
"""

import dataclasses
import difflib
import functools
from collections.abc import Sequence

from jaxlangnav.episode import MAX_STEPS, EpisodeResult, Task
from jaxlangnav.experiments.baselines import BASELINES, run_baseline
from jaxlangnav.experiments.monte_carlo import OnProgress, map_pieces, run_tasks
from jaxlangnav.experiments.tasks import BLOCK
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import MotionParams, is_drifting
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams, default_params
from jaxlangnav.plain_text import cut
from jaxlangnav.planner.config import POLICIES, AnyPolicy, PlannerConfig
from jaxlangnav.semantic_map.params import MapConfig

POLICY_NAMES = (*reversed(POLICIES), *BASELINES)
"""Ours first: informed, faithful, then the baselines."""
DEFAULT_PARTICLES = MapConfig().num_particles

KNOWLEDGE = {
    "informed": (
        "the sentence, the operating area, what it sees, and from training worlds (other seeds) "
        "where things tend to stand; plans tours"
    ),
    "faithful": "the sentence, the operating area, what it sees; the paper's QMDP policy",
    "frontier": (
        "the operating area, the type to look for (no relation), what it sees; nearest frontier "
        "first, stops at the first thing of that type"
    ),
    "lawnmower": "as frontier, but sweeps the area in lanes as wide as it sees",
    "arc": "as frontier, and by what law the worlds are drawn; sweeps along the likeliest arc",
    "known": "the whole map and its own true position",
}
"""What each policy may use, for the captions of tables."""


def check_policies(names: Sequence[str]) -> tuple[str, ...]:
    """Check the names of policies.

    Args:
        names: as typed.

    Returns:
        The same, each once, in their order.

    Raises:
        ValueError: none at all, or one that does not exist, with the nearest that does.
    """
    if not names:
        raise ValueError(f"no policy given: choose from {', '.join(POLICY_NAMES)}")
    for name in names:
        if name not in POLICY_NAMES:
            near = difflib.get_close_matches(cut(name).lower(), POLICY_NAMES, n=1)
            hint = f'; did you mean "{near[0]}"?' if near else ""
            raise ValueError(
                f'unknown policy "{cut(name)}": choose from {", ".join(POLICY_NAMES)}{hint}'
            )
    return tuple(dict.fromkeys(names))


def navigator_config(policy: AnyPolicy, num_particles: int = DEFAULT_PARTICLES) -> NavigatorConfig:
    """Build the configuration of one of the navigator's own policies.

    Args:
        policy: "informed", "faithful", or a policy of somebody's own.
        num_particles: P.

    Returns:
        Sizes and policy.
    """
    return NavigatorConfig(
        map=MapConfig(num_particles=num_particles), planner=PlannerConfig(policy=policy)
    )


def without_compass(config: NavigatorConfig, motion: MotionParams) -> NavigatorConfig:
    """Have the belief doubt the heading where odometry lets it drift.

    Args:
        config: sizes and policy.
        motion: odometry as the belief is told it is; concrete.

    Returns:
        The same where a compass gives the heading.
    """
    if not is_drifting(motion):
        return config
    return dataclasses.replace(config, map=dataclasses.replace(config.map, has_drift=True))


def run_policy(
    policy: AnyPolicy,
    tasks: Task,
    instructions: Instruction,
    *,
    params: NavigatorParams | None = None,
    num_particles: int = DEFAULT_PARTICLES,
    on_progress: OnProgress | None = None,
    num_threads: int | None = None,
    max_steps: int = MAX_STEPS,
) -> EpisodeResult:
    """Run any policy on any number of tasks.

    Args:
        policy: one of ``POLICY_NAMES``, or a policy of somebody's own.
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        params: the navigator's numbers; its defaults if None. Baselines have none.
        num_particles: P, of the navigator's policies.
        on_progress: called with the number of episodes just finished.
        num_threads: pieces under way at once; the number of usable cores by default.
        max_steps: cycles until a time-out.

    Returns:
        Results as NumPy arrays, leaves [E, …], in the order of the tasks.

    Raises:
        ValueError: no such policy.
    """
    if isinstance(policy, str):
        check_policies([policy])
    if not isinstance(policy, str) or policy in POLICIES:
        params = default_params() if params is None else params
        return run_tasks(
            tasks,
            instructions,
            params=params,
            config=without_compass(navigator_config(policy, num_particles), params.map.motion),
            on_progress=on_progress,
            num_threads=num_threads,
            max_steps=max_steps,
        )
    one = functools.partial(run_baseline, policy=policy, max_steps=max_steps)
    return map_pieces(
        lambda pieces: [one(block, instructions) for block, _ in pieces],
        tasks,
        capacity=BLOCK,
        on_progress=on_progress,
        num_threads=num_threads,
    )
