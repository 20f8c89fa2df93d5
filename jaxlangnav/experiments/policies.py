"""Arms of an experiment: the navigator's policies and the baselines, by name.

All arms run the same tasks and return the same records, paired episode by episode.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from jaxlangnav.episode import MAX_STEPS, EpisodeResult, Task
from jaxlangnav.episode.lanes import EPISODE, EpisodeProgram
from jaxlangnav.experiments.baselines import BASELINES
from jaxlangnav.experiments.calibration import Tally
from jaxlangnav.experiments.monte_carlo import OnProgress, run_tasks
from jaxlangnav.experiments.reliability import TALLY_PROGRAM
from jaxlangnav.experiments.tasks import Overrides
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.sanitize import did_you_mean, shorten
from jaxlangnav.messages import MotionParams, is_drifting
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams, default_params
from jaxlangnav.navigator.deployment import set_params
from jaxlangnav.planner.config import POLICIES, AnyPolicy, PlannerConfig, split_arrays
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.params import MapConfig

POLICY_NAMES = (*reversed(POLICIES), *BASELINES)
"""All policies: informed (ours), faithful (the paper's), then the baselines."""
DEFAULT_PARTICLES = MapConfig().num_particles

POLICY_KNOWLEDGE = {
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
    "arc": "as frontier, and the distribution of the worlds; sweeps along the likeliest arc",
    "known": "the whole map and its own true position",
}
"""Information that each policy may use, for the captions of tables."""


def check_policies(names: Sequence[str]) -> tuple[str, ...]:
    """Validate names of policies, without duplicates, in order; errors suggest the closest."""
    choose = f"choose from {', '.join(POLICY_NAMES)}"
    if not names:
        raise ValueError(f"no policy given: {choose}")
    for name in names:
        if name not in POLICY_NAMES:
            hint = did_you_mean(shorten(name), POLICY_NAMES)
            raise ValueError(f'unknown policy "{shorten(name)}": {choose}{hint}')
    return tuple(dict.fromkeys(names))


def navigator_config(policy: AnyPolicy, num_particles: int = DEFAULT_PARTICLES) -> NavigatorConfig:
    """Build the configuration of "informed", "faithful" or a custom policy."""
    map_config, planner = MapConfig(num_particles=num_particles), PlannerConfig(policy=policy)
    return NavigatorConfig(map=map_config, planner=planner)


def set_heading_bias(config: NavigatorConfig, motion: MotionParams) -> NavigatorConfig:
    """Estimate a heading bias if and only if the motion model has drift; needs concrete values."""
    sizes = dataclasses.replace(config.map, has_drift=is_drifting(motion))
    return dataclasses.replace(config, map=sizes)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Arm:
    """One arm of a comparison: a policy with its parameters and capacities."""

    policy: str
    labels: Mapping[str, Any]  # its label columns, by name
    config: NavigatorConfig | None = None  # None for a baseline, which has none
    params: NavigatorParams | None = None
    """Parameters of the navigator; None for a baseline."""
    motion: MotionParams | None = None  # motion model of its worlds; the setting's if None
    sensor: Overrides = dataclasses.field(default_factory=dict)
    """Fields of the sensor model that replace the setting's."""
    max_steps: int = MAX_STEPS
    calibration_episodes: int = 0
    """Number of episodes of a setting, the first ones, in which calibration is measured at every
    step; none of a baseline's."""
    transform: Callable[[Task], Task] | None = None  # of the worlds

    @property
    def program(self) -> EpisodeProgram:
        """Episode program without calibration sums."""
        return BASELINES.get(self.policy, EPISODE)

    def tasks(self, tasks: Task) -> Task:
        """Set motion, sensor and worlds of tasks, leaves [E, …]; keys stay, so arms pair."""
        count = tasks.instruction_index.shape[0]
        sensor = {name: jnp.full(count, value, jnp.float32) for name, value in self.sensor.items()}
        tasks = replace(tasks, sensor=replace(tasks.sensor, **sensor))
        if self.motion is not None:
            batch = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count,)), self.motion)
            tasks = replace(tasks, motion=batch)
        return tasks if self.transform is None else self.transform(tasks)

    def with_overrides(self, values: Overrides) -> "Arm":
        """Replace parameters of the navigator by name, if it has any; no recompilation."""
        if self.params is None or not values:
            return self
        return dataclasses.replace(self, params=set_params(values, params=self.params))

    def run(
        self,
        tasks: Task,
        instructions: Instruction,
        *,
        with_tally: bool = False,
        on_progress: OnProgress | None = None,
    ) -> tuple[EpisodeResult, Tally | None]:
        """Run tasks, at least one, as ``run_tasks`` takes them.

        Gives results as NumPy arrays, leaves [E, …], in the order of the tasks; and, if
        ``with_tally``, the calibration sums of each episode, leaves [E, …], else None.
        """
        results = run_tasks(
            tasks,
            instructions,
            params=self.params,
            config=self.config or NavigatorConfig(),
            on_progress=on_progress,
            max_steps=self.max_steps,
            program=TALLY_PROGRAM if with_tally else self.program,
        )
        return results if with_tally else (results, None)


def policy_arm(
    policy: AnyPolicy,
    *,
    num_particles: int,
    params: NavigatorParams | None = None,
    motion: MotionParams | None = None,
    labels: Mapping[str, Any] | None = None,
) -> Arm:
    """Build the arm of a policy: one of ``POLICY_NAMES``, or a custom policy.

    ``num_particles`` and ``params`` (the defaults if None) are the navigator's. ``motion``: motion
    model of the worlds, assumed by the filter too; the settings' if None. ``labels``: its label
    columns; its name if None.
    """
    policy, arrays = split_arrays(policy)
    name = check_policies([policy])[0] if isinstance(policy, str) else str(policy)
    labels = {"policy": name} if labels is None else labels
    if name in BASELINES:
        return Arm(policy=name, labels=labels, motion=motion)
    params = replace(default_params() if params is None else params, policy=arrays)
    if motion is not None:
        params = replace(params, map=replace(params.map, motion=motion))
    config = set_heading_bias(navigator_config(policy, num_particles), params.map.motion)
    return Arm(policy=name, labels=labels, config=config, params=params, motion=motion)


def run_policy(
    policy: AnyPolicy,
    tasks: Task,
    instructions: Instruction,
    *,
    num_particles: int = DEFAULT_PARTICLES,
    on_progress: OnProgress | None = None,
) -> EpisodeResult:
    """Run any policy on tasks, at least one; ``ValueError`` where there is none of that name.

    Args:
        policy: one of ``POLICY_NAMES``, or a custom policy.
        tasks: leaves [E, …].
        instructions: leaves [I, …].
        num_particles: P, of the navigator's policies.
        on_progress: called with the number of episodes just finished.

    Returns:
        Results as NumPy arrays, leaves [E, …], in the order of the tasks.
    """
    arm = policy_arm(policy, num_particles=num_particles)
    return arm.run(tasks, instructions, on_progress=on_progress)[0]
