"""The policies that stand in the tables, by name: the navigator's two and the baselines.

All of them answer the same tasks with the same records, paired episode by episode.
"""

import dataclasses
import difflib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from jaxlangnav.episode import MAX_STEPS, EpisodeResult, Task
from jaxlangnav.episode.lanes import EPISODE, EpisodeProgram
from jaxlangnav.experiments.baselines import BASELINES
from jaxlangnav.experiments.calibration import Tally
from jaxlangnav.experiments.judging import JUDGED
from jaxlangnav.experiments.monte_carlo import OnProgress, run_tasks
from jaxlangnav.experiments.tasks import Numbers
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.sanitize import shorten
from jaxlangnav.messages import MotionParams, is_drifting
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams, default_params
from jaxlangnav.navigator.deployment import with_numbers
from jaxlangnav.planner.config import POLICIES, AnyPolicy, PlannerConfig, split_arrays
from jaxlangnav.pytree import replace
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
    """Check policies' names as typed, each once, in order; refuses with the nearest there is."""
    choose = f"choose from {', '.join(POLICY_NAMES)}"
    if not names:
        raise ValueError(f"no policy given: {choose}")
    for name in names:
        if name not in POLICY_NAMES:
            near = difflib.get_close_matches(shorten(name).lower(), POLICY_NAMES, n=1)
            hint = f'; did you mean "{near[0]}"?' if near else ""
            raise ValueError(f'unknown policy "{shorten(name)}": {choose}{hint}')
    return tuple(dict.fromkeys(names))


def navigator_config(policy: AnyPolicy, num_particles: int = DEFAULT_PARTICLES) -> NavigatorConfig:
    """Build sizes of a navigator's policy: "informed", "faithful", or one of somebody's own."""
    sizes, planner = MapConfig(num_particles=num_particles), PlannerConfig(policy=policy)
    return NavigatorConfig(map=sizes, planner=planner)


def without_compass(config: NavigatorConfig, motion: MotionParams) -> NavigatorConfig:
    """Have the belief doubt the heading where odometry, as it is told, lets it drift; concrete."""
    if not is_drifting(motion):
        return config
    return dataclasses.replace(config, map=dataclasses.replace(config.map, has_drift=True))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arm:
    """What is compared: a policy with its numbers and sizes."""

    policy: str
    told: Mapping[str, Any]  # what the columns say of it, by name
    config: NavigatorConfig | None = None  # None for a baseline, which has none
    params: NavigatorParams | None = None
    """The navigator's numbers; a baseline has none of these either."""
    motion: MotionParams | None = None  # odometry of its worlds; that of the setting if None
    sensor: Numbers = dataclasses.field(default_factory=dict)
    """Numbers of the detector in place of the setting's."""
    max_steps: int = MAX_STEPS
    judged: int = 0
    """In how many of the first episodes of a setting every step's belief is held against the truth;
    none of a baseline's."""
    worlds: Callable[[Task], Task] | None = None  # sets its worlds otherwise

    @property
    def course(self) -> EpisodeProgram:
        """What lanes run where nothing is judged."""
        return BASELINES.get(self.policy, EPISODE)

    def tasks(self, tasks: Task) -> Task:
        """Set odometry, detector and worlds of tasks, leaves [E, …]; keys stay, so arms pair."""
        number = tasks.instruction_index.shape[0]
        sensor = {name: jnp.full(number, one, jnp.float32) for name, one in self.sensor.items()}
        tasks = replace(tasks, sensor=replace(tasks.sensor, **sensor))
        if self.motion is not None:
            spread = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (number,)), self.motion)
            tasks = replace(tasks, motion=spread)
        return tasks if self.worlds is None else self.worlds(tasks)

    def believing(self, numbers: Numbers) -> "Arm":
        """Set single numbers of the navigator by name, if it has any; the program stays."""
        if self.params is None or not numbers:
            return self
        return dataclasses.replace(self, params=with_numbers(numbers, params=self.params))

    def run(
        self,
        tasks: Task,
        instructions: Instruction,
        *,
        is_judged: bool = False,
        on_progress: OnProgress | None = None,
        num_threads: int | None = None,
    ) -> tuple[EpisodeResult, Tally | None]:
        """Run any number of tasks, as ``run_tasks`` takes them.

        Gives results as NumPy arrays, leaves [E, …], in the order of the tasks; and, if
        ``is_judged``, the belief of every step held against the truth: the sums of each episode,
        leaves [E, …], else None.
        """
        found = run_tasks(
            tasks,
            instructions,
            params=self.params,
            config=self.config or NavigatorConfig(),
            on_progress=on_progress,
            num_threads=num_threads,
            max_steps=self.max_steps,
            course=JUDGED if is_judged else self.course,
        )
        return found if is_judged else (found, None)


def policy_arm(
    policy: AnyPolicy,
    *,
    num_particles: int,
    params: NavigatorParams | None = None,
    motion: MotionParams | None = None,
    told: Mapping[str, Any] | None = None,
) -> Arm:
    """Build the arm of a policy: one of ``POLICY_NAMES``, or a policy of somebody's own.

    ``num_particles`` and ``params`` (the defaults if None) are the navigator's. ``motion``:
    odometry, of which the belief is told; that of the settings if None. ``told``: what the columns
    say of it; its name if None.
    """
    policy, arrays = split_arrays(policy)
    name = check_policies([policy])[0] if isinstance(policy, str) else str(policy)
    told = {"policy": name} if told is None else told
    if name in BASELINES:
        return Arm(policy=name, told=told, motion=motion)
    params = replace(default_params() if params is None else params, policy=arrays)
    if motion is not None:
        params = replace(params, map=replace(params.map, motion=motion))
    config = without_compass(navigator_config(policy, num_particles), params.map.motion)
    return Arm(policy=name, told=told, config=config, params=params, motion=motion)


def run_policy(
    policy: AnyPolicy,
    tasks: Task,
    instructions: Instruction,
    *,
    num_particles: int = DEFAULT_PARTICLES,
    on_progress: OnProgress | None = None,
    num_threads: int | None = None,
) -> EpisodeResult:
    """Run any policy on any number of tasks; ``ValueError`` where there is none of that name.

    Args:
        policy: one of ``POLICY_NAMES``, or a policy of somebody's own.
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        num_particles: P, of the navigator's policies.
        on_progress: called with the number of episodes just finished.
        num_threads: pieces under way at once; the number of usable cores by default.

    Returns:
        Results as NumPy arrays, leaves [E, …], in the order of the tasks.
    """
    arm = policy_arm(policy, num_particles=num_particles)
    return arm.run(tasks, instructions, on_progress=on_progress, num_threads=num_threads)[0]
