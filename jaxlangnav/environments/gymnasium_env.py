"""Our worlds for Gymnasium: one environment, and many in one compiled program (section 4.2).

Importing this module registers ``jaxlangnav/Follow-v0``:

    import gymnasium, jaxlangnav.environments.gymnasium_env
    env = gymnasium.make("jaxlangnav/Follow-v0", world="2H1C", relation="behind")

It needs the extra ``gym``. Observations and actions are those of ``functional``.
"""

from typing import Any

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from jaxlangnav.environments import functional
from jaxlangnav.environments.functional import EnvironmentInfo

ID = "jaxlangnav/Follow-v0"


def _observation_space() -> spaces.Box:
    """Describe observations: bounded as ``functional.to_vector`` clips them."""
    bound = functional.BOUND
    return spaces.Box(-bound, bound, (functional.OBSERVATION_SIZE,), np.float32)


def _action_space() -> spaces.Box:
    """Describe actions: a step along x and y, and stop."""
    return spaces.Box(-1.0, 1.0, (functional.ACTION_SIZE,), np.float32)


def _key(generator: np.random.Generator) -> jax.Array:
    """Draw a random key from Gymnasium's generator."""
    return jax.random.key(generator.integers(2**32, dtype=np.uint32))


class FollowEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """A robot to be driven to the goal of a command, in a world drawn anew for each episode."""

    def __init__(
        self,
        *,
        world: str = "1H1C",
        relation: str = "behind",
        sensing_range: float = 3.0,
        max_steps: int = functional.MAX_STEPS,
        metre_cost: float = 0.01,
    ) -> None:
        """Set up the environment.

        Args:
            world: a template such as "2H1C".
            relation: "null", "behind" or "nearest": which command is given.
            sensing_range: metres.
            max_steps: steps after which an episode is truncated.
            metre_cost: subtracted from the reward for each metre travelled.

        Raises:
            ValueError: an unknown world or relation, or a number outside its limits.
        """
        self.observation_space = _observation_space()
        self.action_space = _action_space()
        self._params = functional.default_params(
            world=world,
            relation=relation,
            sensing_range=sensing_range,
            max_steps=max_steps,
            metre_cost=metre_cost,
        )
        self.instruction = functional.COMMANDS[relation]
        self._state: functional.EnvironmentState | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Draw a world and put the robot at its start.

        Args:
            seed: of this episode and those after it.
            options: none are known.

        Returns:
            The first observation, and the command as text.
        """
        super().reset(seed=seed)
        observation, self._state = _reset(_key(self.np_random), self._params)
        return np.asarray(observation), {"instruction": self.instruction}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Carry out one action.

        Args:
            action: f32[3], in [−1, 1]: x, y, stop where above 0.

        Returns:
            Observation, reward, terminated (it has stopped), truncated (out of time), info.

        Raises:
            ValueError: before the first ``reset``.
        """
        if self._state is None:
            raise ValueError("step before reset: begin an episode first")
        observation, self._state, reward, _, info = _step(
            _key(self.np_random), self._state, np.asarray(action, np.float32), self._params
        )
        told = {name: np.asarray(value).item() for name, value in _fields(info).items()}
        ended, late = bool(told["is_stopped"]), bool(told["is_cut_off"])
        return np.asarray(observation), float(reward), ended, late, told


class FollowVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many worlds at once, in one compiled program; a lane that has ended begins anew next step."""

    def __init__(self, num_envs: int, **options: Any) -> None:
        """Set up the environments.

        Args:
            num_envs: lanes.
            options: as of ``FollowEnv``.

        Raises:
            ValueError: as ``FollowEnv``, or fewer than one lane.
        """
        if num_envs < 1:
            raise ValueError(f"num_envs is {num_envs}, but must be at least 1")
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}
        self.num_envs = num_envs
        self.single_observation_space = _observation_space()
        self.single_action_space = _action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._params = functional.default_params(**options)
        self._state: functional.EnvironmentState | None = None
        self._is_over = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in every lane.

        Args:
            seed: of all lanes.
            options: none are known.

        Returns:
            Observations f32[num_envs, 52], and no info.
        """
        super().reset(seed=seed)
        keys = jax.random.split(_key(self.np_random), self.num_envs)
        observation, self._state = _reset_many(keys, self._params)
        self._is_over = np.zeros(self.num_envs, bool)
        return np.asarray(observation), {}

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Carry out one action in every lane.

        Args:
            actions: f32[num_envs, 3]; ignored in lanes that begin anew.

        Returns:
            Observations, rewards, terminated, truncated, and info as arrays over lanes.

        Raises:
            ValueError: before the first ``reset``.
        """
        if self._state is None:
            raise ValueError("step before reset: begin the episodes first")
        keys = jax.random.split(_key(self.np_random), self.num_envs)
        observation, self._state, reward, info = _step_many(
            keys, self._state, np.asarray(actions, np.float32), self._params, self._is_over
        )
        told = {name: np.asarray(value) for name, value in _fields(info).items()}
        ended, late = told["is_stopped"], told["is_cut_off"]
        self._is_over = ended | late
        return np.asarray(observation), np.asarray(reward), ended, late, told


def _fields(info: EnvironmentInfo) -> dict[str, jax.Array]:
    """List the fields of an info by name."""
    return vars(info)


def _step_or_reset(
    key: jax.Array,
    state: functional.EnvironmentState,
    action: jax.Array,
    params: functional.EnvironmentParams,
    is_over: jax.Array,
) -> tuple[jax.Array, functional.EnvironmentState, jax.Array, EnvironmentInfo]:
    """Carry out an action, or begin a new episode where the last one is over."""
    observation, after, reward, _, info = functional.step(key, state, action, params)
    first, begun = functional.reset(key, params)
    nothing = jax.tree.map(jnp.zeros_like, (reward, info))
    new, old = (first, begun, *nothing), (observation, after, reward, info)
    chosen: Any = jax.tree.map(lambda one, two: jnp.where(is_over, one, two), new, old)
    return chosen


_reset = jax.jit(functional.reset)
_step = jax.jit(functional.step)
_reset_many = jax.jit(jax.vmap(functional.reset, in_axes=(0, None)))
_step_many = jax.jit(jax.vmap(_step_or_reset, in_axes=(0, 0, 0, None, 0)))

if ID not in gymnasium.registry:
    gymnasium.register(
        ID,
        entry_point=f"{__name__}:FollowEnv",
        vector_entry_point=f"{__name__}:FollowVectorEnv",
    )
