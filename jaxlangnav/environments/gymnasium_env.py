"""Gymnasium wrappers: a single environment, and a vectorized one in one compiled program.

    env = gymnasium.make("jaxlangnav:jaxlangnav/Follow-v2", world="2H1C", relation="behind")
    envs = gymnasium.make_vec("jaxlangnav:jaxlangnav/Follow-v2", num_envs=64, world="yard")

It needs the extra ``gym``, and ``viz`` for ``render_mode="rgb_array"``. Observations and actions
are those of ``functional``; a discrete action is a row of its ``DISCRETE_ACTIONS``.
"""

from typing import Any, Literal, get_args

import gymnasium
import jax
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from jaxlangnav.environments import functional
from jaxlangnav.environments.command import command_text
from jaxlangnav.environments.functional import DISCRETE_ACTIONS, EnvironmentState
from jaxlangnav.environments.pool import NUM_WORLDS, draw_pool
from jaxlangnav.inputs.limits import check_minimum
from jaxlangnav.inputs.schema import bad_choice
from jaxlangnav.pytree import replace
from jaxlangnav.viz.mapping import render_world
from jaxlangnav.viz.style import require

Actions = Literal["continuous", "discrete"]
RenderMode = Literal["rgb_array"]
METADATA: dict[str, Any] = {"render_modes": list(get_args(RenderMode)), "render_fps": 4}


def observation_space() -> spaces.Box:
    """Build the observation space, bounded by ``functional.MAX_OBSERVATION``."""
    limit = functional.MAX_OBSERVATION
    return spaces.Box(-limit, limit, (functional.OBSERVATION_SIZE,), np.float32)


def action_space(actions: str) -> spaces.Box | spaces.Discrete[np.int64]:
    """Build the action space: continuous step along x and y and stop, or discrete."""
    if actions not in get_args(Actions):
        raise ValueError(bad_choice("actions", actions, get_args(Actions)))
    if actions == "discrete":
        return spaces.Discrete(len(DISCRETE_ACTIONS))
    return spaces.Box(-1.0, 1.0, (functional.ACTION_SIZE,), np.float32)


def to_functional_action(actions: Any, space: spaces.Space[Any]) -> np.ndarray:
    """Convert one or many actions of a space to those of ``functional``: f32[..., 3]."""
    if isinstance(space, spaces.Discrete):
        return DISCRETE_ACTIONS[np.asarray(actions)]
    return np.asarray(actions, np.float32)


def _seed(generator: np.random.Generator) -> np.integer:
    """Draw a seed; the compiled functions turn it into a key, which is faster than here."""
    return generator.integers(2**32, dtype=np.uint32)


class _SharedState:
    """State shared by both environments: parameters, current state, and trajectories to draw."""

    def __init__(self, render_mode: str | None, options: dict[str, Any]) -> None:
        """Create the parameters, and check the render mode."""
        if render_mode is not None:
            if render_mode not in get_args(RenderMode):
                raise ValueError(bad_choice("render_mode", render_mode, get_args(RenderMode)))
            require("matplotlib")
        self.has_rendering = render_mode is not None
        self.params = functional.default_params(**options)
        self.text = command_text(**options)
        self.state: EnvironmentState | None = None
        self._paths: list[list[np.ndarray]] = []

    def update(self, observation: jax.Array, state: EnvironmentState) -> np.ndarray:
        """Set the state and extend the trajectories, which restart with each episode."""
        self.state = state
        if self.has_rendering:
            positions = np.asarray(state.world.position).reshape(-1, 2)
            is_first = np.asarray(state.steps).reshape(-1) == 0
            paths = self._paths if len(self._paths) == len(positions) else [[] for _ in positions]
            self._paths = [
                [position] if is_new else [*path, position]
                for path, position, is_new in zip(paths, positions, is_first, strict=True)
            ]
        return np.asarray(observation)

    def require_state(self, caller: str) -> EnvironmentState:
        """Return the current state, or raise ValueError before the first reset."""
        if self.state is None:
            raise ValueError(f"{caller} before reset: begin an episode first")
        return self.state

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Render every environment, u8[480, W, 3]; None, with a warning, without a render mode."""
        if not self.has_rendering:
            gymnasium.logger.warn('nothing to render: make it with render_mode="rgb_array"')
            return None
        states: Any = jax.tree.map(np.asarray, self.require_state("render"))
        if states.steps.ndim == 0:
            states = jax.tree.map(lambda leaf: leaf[None], states)
        images = []
        for index, path in enumerate(self._paths):
            member: EnvironmentState = jax.tree.map(lambda leaf, i=index: leaf[i], states)
            args = member.scenario, self.params.sensor, member.world
            images.append(render_world(*args, path=np.stack(path), text=self.text))
        return tuple(images)


class FollowEnv(gymnasium.Env[np.ndarray, Any]):
    """Gymnasium environment: drive a robot to the goal of a command in a random world."""

    metadata = METADATA

    def __init__(
        self,
        *,
        actions: Actions = "continuous",
        render_mode: RenderMode | None = None,
        **options: Any,
    ) -> None:
        """Set up the environment.

        Args:
            actions: "continuous", f32[3] as of ``functional.step``, or "discrete", an index into
                ``DISCRETE_ACTIONS``.
            render_mode: "rgb_array" for pictures, which need the extra ``viz``, or None.
            **options: world, relation, instruction, sensing_range, max_steps, metre_cost, shaping,
                as of ``functional.default_params``.

        Raises:
            ValueError: an unknown option, or a number outside its limits.
        """
        self.observation_space = observation_space()
        self.action_space = action_space(actions)
        self.render_mode = render_mode
        self._shared = _SharedState(render_mode, options)
        self.instruction = self._shared.text

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode in a new world.

        Returns the first observation, and the command as text. ``seed`` is of this episode and
        those after it; no ``options`` are known.
        """
        super().reset(seed=seed)
        first = _reset(_seed(self.np_random), self._shared.params)
        return self._shared.update(*first), {"instruction": self.instruction}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Execute an action: observation, reward, terminated (stopped), truncated, and info."""
        shared, state_before = self._shared, self._shared.require_state("step")
        action = to_functional_action(action, self.action_space)
        seed = _seed(self.np_random)
        observation, state, reward, _, info = _step(seed, state_before, action, shared.params)
        scalars = {name: value.item() for name, value in _info_dict(info).items()}
        terminated, truncated = scalars["is_stopped"], scalars["is_truncated"]
        return shared.update(observation, state), float(reward), terminated, truncated, scalars

    def render(self) -> np.ndarray | None:
        """Render the true world, the trajectory and the field of view: u8[480, W, 3], or None."""
        pictures = self._shared.render()
        return pictures[0] if pictures else None


class FollowVectorEnv(VectorEnv[np.ndarray, Any, np.ndarray]):
    """Vectorized environment in one compiled program; autoreset in the step after an end.

    Every episode begins in one of ``num_worlds`` worlds drawn at ``reset`` (see ``pool``).
    """

    def __init__(
        self,
        num_envs: int,
        *,
        num_worlds: int = NUM_WORLDS,
        actions: Actions = "continuous",
        render_mode: RenderMode | None = None,
        **options: Any,
    ) -> None:
        """Set up ``num_envs`` environments, options and errors as of ``FollowEnv``.

        ``num_worlds``: size of the pool from which each episode takes a random world; 0 samples
        a new world in every step of every environment, at hundreds of times the cost.
        """
        check_minimum(1, num_envs=num_envs)
        check_minimum(0, num_worlds=num_worlds)
        self.metadata = {**METADATA, "autoreset_mode": AutoresetMode.NEXT_STEP}
        self.num_envs, self._num_worlds = num_envs, num_worlds
        self.single_observation_space = observation_space()
        self.single_action_space = action_space(actions)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.render_mode = render_mode
        self._shared = _SharedState(render_mode, options)
        self._is_over = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Sample the pool and start all episodes: observations f32[num_envs, …], the command."""
        super().reset(seed=seed)
        self._params = self._shared.params
        if self._num_worlds:
            key = jax.random.key(_seed(self.np_random))
            worlds = draw_pool(key, self._params.worlds, num_worlds=self._num_worlds)
            self._params = replace(self._params, worlds=worlds)
        keys = _keys(_seed(self.np_random), self.num_envs)
        self._is_over = np.zeros(self.num_envs, bool)
        info = {"instruction": np.full(self.num_envs, self._shared.text)}
        return self._shared.update(*_reset_many(keys, self._params)), info

    def step(
        self, actions: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Execute one action in every environment that is not being reset; as ``FollowEnv.step``.

        Observations, rewards, terminated, truncated, and info as arrays over environments.
        """
        shared, state_before = self._shared, self._shared.require_state("step")
        keys = _keys(_seed(self.np_random), self.num_envs)
        actions = to_functional_action(actions, self.single_action_space)
        observation, state, reward, info = _step_many(
            keys, state_before, actions, self._params, self._is_over
        )
        arrays = _info_dict(info)
        terminated, truncated = arrays["is_stopped"], arrays["is_truncated"]
        self._is_over = terminated | truncated
        return shared.update(observation, state), np.asarray(reward), terminated, truncated, arrays

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Render every environment, as ``FollowEnv.render``."""
        return self._shared.render()


def _info_dict(info: functional.EnvironmentInfo) -> dict[str, np.ndarray]:
    return {name: np.asarray(value) for name, value in vars(info).items()}


_reset = jax.jit(lambda seed, *rest: functional.reset(jax.random.key(seed), *rest))
_step = jax.jit(lambda seed, *rest: functional.step(jax.random.key(seed), *rest))
_keys = jax.jit(lambda seed, n: jax.random.split(jax.random.key(seed), n), static_argnums=1)
_reset_many = jax.jit(jax.vmap(functional.reset, in_axes=(0, None)))
_step_many = jax.jit(jax.vmap(functional.step_or_reset, in_axes=(0, 0, 0, None, 0)))
