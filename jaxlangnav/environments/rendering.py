"""Pictures of environments: remembers the way of every lane and draws it when asked.

It needs the extra ``viz``; without a render mode nothing is remembered and nothing is needed.
"""

from typing import Any, Literal, get_args

import gymnasium
import jax
import numpy as np

from jaxlangnav.environments.functional import EnvironmentParams, EnvironmentState
from jaxlangnav.viz.panels import drive_picture
from jaxlangnav.viz.style import require

RenderMode = Literal["rgb_array"]
METADATA: dict[str, Any] = {"render_modes": list(get_args(RenderMode)), "render_fps": 4}


class Renderer:
    """What an environment needs to draw; lanes of a batch alike."""

    def __init__(self, render_mode: str | None, text: str) -> None:
        """Set up, and refuse at once what could not be drawn later.

        Args:
            render_mode: "rgb_array", or None for no pictures.
            text: the command.

        Raises:
            MissingExtraError: pictures are asked for without the extra ``viz``.
            ValueError: an unknown render mode.
        """
        known = get_args(RenderMode)
        if render_mode is not None and render_mode not in known:
            raise ValueError(
                f'render_mode is "{render_mode}", but must be one of {", ".join(known)}, or None'
            )
        if render_mode is not None:
            require("matplotlib")
        self._is_on = render_mode is not None
        self._text = text
        self._ways: list[list[np.ndarray]] = []

    def see(self, state: EnvironmentState) -> None:
        """Remember where the robots are; a lane whose episode has just begun begins anew.

        Args:
            state: with or without a leading axis of lanes.
        """
        if not self._is_on:
            return
        places = np.asarray(state.world.position).reshape(-1, 2)
        begun = np.asarray(state.steps).reshape(-1) == 0
        former = self._ways if len(self._ways) == len(places) else [[] for _ in places]
        self._ways = [
            [place] if is_begun else [*way, place]
            for way, place, is_begun in zip(former, places, begun, strict=True)
        ]

    def draw(
        self, state: EnvironmentState | None, *, params: EnvironmentParams
    ) -> tuple[np.ndarray, ...] | None:
        """Draw every lane.

        Args:
            state: what ``see`` was last given; None before the first reset.
            params: of the environment.

        Returns:
            One picture a lane, u8[480, W, 3]; None, with a warning, without a render mode.

        Raises:
            ValueError: before the first reset.
        """
        if not self._is_on:
            gymnasium.logger.warn('nothing to render: make it with render_mode="rgb_array"')
            return None
        if state is None:
            raise ValueError("render before reset: begin an episode first")
        lanes: Any = jax.tree.map(np.asarray, state)
        if lanes.steps.ndim == 0:
            lanes = jax.tree.map(lambda leaf: leaf[None], lanes)
        pictures = []
        for index, way in enumerate(self._ways):
            lane: EnvironmentState = jax.tree.map(lambda leaf, at=index: leaf[at], lanes)
            picture = drive_picture(
                lane, params=params, world=lane.world, way=np.stack(way), text=self._text
            )
            pictures.append(picture)
        return tuple(pictures)
