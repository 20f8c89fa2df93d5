"""Our worlds for Gymnasium: one environment, and many in one compiled program (section 4.2).

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
from jaxlangnav.environments.command import text_of
from jaxlangnav.environments.functional import DISCRETE_ACTIONS, EnvironmentState
from jaxlangnav.environments.pool import NUM_WORLDS, draw_pool
from jaxlangnav.inputs.limits import refuse_below
from jaxlangnav.pytree import replace
from jaxlangnav.viz.mapping import render_world
from jaxlangnav.viz.style import require

Actions = Literal["continuous", "discrete"]
RenderMode = Literal["rgb_array"]
METADATA: dict[str, Any] = {"render_modes": list(get_args(RenderMode)), "render_fps": 4}


def _choice(name: str, value: str, kind: Any, more: str = "") -> str:
    """Refuse a word that is none of a few."""
    if value not in get_args(kind):
        known = ", ".join(get_args(kind))
        raise ValueError(f'{name} is "{value}", but must be one of {known}{more}')
    return value


def observation_space() -> spaces.Box:
    """Describe observations: bounded as ``functional`` clips them."""
    limit = functional.BOUND
    return spaces.Box(-limit, limit, (functional.OBSERVATION_SIZE,), np.float32)


def action_space(actions: str) -> spaces.Box | spaces.Discrete[np.int64]:
    """Describe actions: a step along x and y, and stop; or one of few, the first of them stop."""
    if _choice("actions", actions, Actions) == "discrete":
        return spaces.Discrete(len(DISCRETE_ACTIONS))
    return spaces.Box(-1.0, 1.0, (functional.ACTION_SIZE,), np.float32)


def to_functional(actions: Any, space: spaces.Space[Any]) -> np.ndarray:
    """Turn actions of a space, one or many, into those of ``functional``: f32[..., 3]."""
    if isinstance(space, spaces.Discrete):
        return DISCRETE_ACTIONS[np.asarray(actions)]
    return np.asarray(actions, np.float32)


def _seed(generator: np.random.Generator) -> np.integer:
    """Draw what a compiled function makes its key of; made here, it would cost half a step."""
    return generator.integers(2**32, dtype=np.uint32)


class _Worlds:
    """What both environments hold: parameters, the present state, and the way of every lane."""

    def __init__(self, render_mode: str | None, options: dict[str, Any]) -> None:
        """Set up, and refuse at once what could not be drawn later."""
        if render_mode is not None:
            _choice("render_mode", render_mode, RenderMode, ", or None")
            require("matplotlib")
        self.is_drawn = render_mode is not None
        self.params = functional.default_params(**options)
        self.text = text_of(**options)
        self.state: EnvironmentState | None = None
        self._ways: list[list[np.ndarray]] = []

    def see(self, observation: jax.Array, state: EnvironmentState) -> np.ndarray:
        """Take over a state; a lane whose episode has just begun begins its way anew."""
        self.state = state
        if self.is_drawn:
            places = np.asarray(state.world.position).reshape(-1, 2)
            begun = np.asarray(state.steps).reshape(-1) == 0
            former = self._ways if len(self._ways) == len(places) else [[] for _ in places]
            self._ways = [
                [place] if is_begun else [*way, place]
                for way, place, is_begun in zip(former, places, begun, strict=True)
            ]
        return np.asarray(observation)

    def started(self, what: str) -> EnvironmentState:
        """Give the present state, or say what comes too early."""
        if self.state is None:
            raise ValueError(f"{what} before reset: begin an episode first")
        return self.state

    def draw(self) -> tuple[np.ndarray, ...] | None:
        """Draw every lane, u8[480, W, 3] each; None, with a warning, without a render mode."""
        if not self.is_drawn:
            gymnasium.logger.warn('nothing to render: make it with render_mode="rgb_array"')
            return None
        lanes: Any = jax.tree.map(np.asarray, self.started("render"))
        if lanes.steps.ndim == 0:
            lanes = jax.tree.map(lambda leaf: leaf[None], lanes)
        pictures = []
        for index, way in enumerate(self._ways):
            lane: EnvironmentState = jax.tree.map(lambda leaf, at=index: leaf[at], lanes)
            seen = lane.scenario, self.params.sensor, lane.world
            pictures.append(render_world(*seen, path=np.stack(way), text=self.text))
        return tuple(pictures)


class FollowEnv(gymnasium.Env[np.ndarray, Any]):
    """A robot to be driven to the goal of a command, in a world drawn anew for each episode."""

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
        self._worlds = _Worlds(render_mode, options)
        self.instruction = self._worlds.text

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Draw a world and put the robot at its start.

        Returns the first observation, and the command as text. ``seed`` is of this episode and
        those after it; no ``options`` are known.
        """
        super().reset(seed=seed)
        begun = _reset(_seed(self.np_random), self._worlds.params)
        return self._worlds.see(*begun), {"instruction": self.instruction}

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Carry out an action: observation, reward, terminated (stopped), truncated, and info."""
        worlds, before = self._worlds, self._worlds.started("step")
        action = to_functional(action, self.action_space)
        seed = _seed(self.np_random)
        observation, state, reward, _, info = _step(seed, before, action, worlds.params)
        told = {name: value.item() for name, value in _told(info).items()}
        ended, late = told["is_stopped"], told["is_cut_off"]
        return worlds.see(observation, state), float(reward), ended, late, told

    def render(self) -> np.ndarray | None:
        """Draw the true world, the way gone and what is in view: u8[480, W, 3], or None."""
        pictures = self._worlds.draw()
        return pictures[0] if pictures else None


class FollowVectorEnv(VectorEnv[np.ndarray, Any, np.ndarray]):
    """Many worlds at once, in one compiled program; a lane that has ended begins anew next step.

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
        """Set up ``num_envs`` environments, options as of ``FollowEnv``; a picture for each.

        ``num_worlds``: worlds drawn ahead, out of which every episode takes one by lot; 0 draws
        fresh ones in every step of every lane, at hundreds of times the cost.
        """
        refuse_below(1, num_envs=num_envs)
        if num_worlds < 0:
            raise ValueError(f"num_worlds is {num_worlds}, but must be 0 (always fresh) or more")
        self.metadata = {**METADATA, "autoreset_mode": AutoresetMode.NEXT_STEP}
        self.num_envs, self._num_worlds = num_envs, num_worlds
        self.single_observation_space = observation_space()
        self.single_action_space = action_space(actions)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.render_mode = render_mode
        self._worlds = _Worlds(render_mode, options)
        self._is_over = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Draw the worlds and begin an episode in every lane: f32[num_envs, …], the command."""
        super().reset(seed=seed)
        params = self._worlds.params
        if self._num_worlds:
            key = jax.random.key(_seed(self.np_random))
            worlds = draw_pool(key, params.worlds, num_worlds=self._num_worlds)
            params = replace(params, worlds=worlds)
        self._params = params
        keys = _keys(_seed(self.np_random), self.num_envs)
        self._is_over = np.zeros(self.num_envs, bool)
        told = {"instruction": np.full(self.num_envs, self._worlds.text)}
        return self._worlds.see(*_reset_many(keys, self._params)), told

    def step(
        self, actions: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Carry out one action in every lane, but for those that begin anew; as ``FollowEnv.step``.

        Observations, rewards, terminated, truncated, and info as arrays over lanes.
        """
        worlds, before = self._worlds, self._worlds.started("step")
        keys = _keys(_seed(self.np_random), self.num_envs)
        actions = to_functional(actions, self.single_action_space)
        observation, state, reward, info = _step_many(
            keys, before, actions, self._params, self._is_over
        )
        told = _told(info)
        ended, late = told["is_stopped"], told["is_cut_off"]
        self._is_over = ended | late
        return worlds.see(observation, state), np.asarray(reward), ended, late, told

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Draw every lane, as ``FollowEnv.render``."""
        return self._worlds.draw()


def _told(info: functional.EnvironmentInfo) -> dict[str, np.ndarray]:
    return {name: np.asarray(value) for name, value in vars(info).items()}


_reset = jax.jit(lambda seed, *rest: functional.reset(jax.random.key(seed), *rest))
_step = jax.jit(lambda seed, *rest: functional.step(jax.random.key(seed), *rest))
_keys = jax.jit(lambda seed, of: jax.random.split(jax.random.key(seed), of), static_argnums=1)
_reset_many = jax.jit(jax.vmap(functional.reset, in_axes=(0, None)))
_step_many = jax.jit(jax.vmap(functional.step_or_reset, in_axes=(0, 0, 0, None, 0)))
