"""A robot's drive as a recording: pages, stories and figures show it as they show an episode.

The truth is taken at each look, with the pictures of a robot that has cameras.
"""

import dataclasses
from collections.abc import Mapping

import jax
import numpy as np
from jax import Array

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.episode.recorder import make_frame, make_scene
from jaxlangnav.episode.recording import Recording, Snapshot, stack_frames
from jaxlangnav.messages import Fault, Status
from jaxlangnav.navigator import NavigatorInfo, NavigatorState
from jaxlangnav.navigator.api import Navigator
from jaxlangnav.pytree import replace
from jaxlangnav.robots.driver import drive
from jaxlangnav.robots.kinematic import KinematicRobot, SimulatedRobot
from jaxlangnav.robots.physics.robot import PhysicsRobot
from jaxlangnav.robots.robot import Ending, NavigationRun, Step, observe
from jaxlangnav.robots.views import Views
from jaxlangnav.world.simulator import SUCCESS_RADIUS

_frame_of = jax.jit(make_frame)


class DriveRecorder:
    """Keeps a drive, step by step: ``drive(..., on_step=recorder.on_step)``."""

    def __init__(
        self, robot: PhysicsRobot | KinematicRobot, navigator: Navigator, text: str
    ) -> None:
        """Begin with a robot at its start; ``robot.on_look`` is taken for it."""
        self._robot, self._navigator, self._text = robot, navigator, text
        self._scenario = robot.scenario
        has_camera = isinstance(robot, PhysicsRobot)
        self._views = Views(robot, navigator.type_names) if has_camera else None
        self._world = robot.world_state
        self._taken: Mapping[str, bytes] = {}
        self._frames: list[Snapshot] = []
        self._pictures: list[Mapping[str, bytes]] = []
        self._clause, self._contradictions = np.int32(0), 0
        robot.on_look = self._on_look

    def _on_look(self, robot: SimulatedRobot) -> None:
        self._world = robot.world_state
        if self._views is not None:
            self._taken = self._views.jpegs()

    def on_step(self, step: Step, state: NavigatorState, info: NavigatorInfo | None) -> None:
        """Keep a decision; one without a picture shows the belief as it was."""
        if info is None:
            if not self._frames:
                return
            # The last step without anything seen, from where the robot is now.
            last, world = self._frames[-1], self._world
            frame = replace(
                last,
                position=world.position,
                heading=world.heading,
                odometry=world.odometry[:2],
                distance=world.distance,
                is_detection=np.zeros_like(last.is_detection),
                is_news=np.zeros_like(last.is_news),
            )
        else:
            clause = np.minimum(self._clause, np.asarray(state.instruction.num_clauses) - 1)
            before = replace(state, clause=np.maximum(clause, 0))
            seen = observe(np.array(step.pose), step.detections or (), self._robot.sensor)
            frame = jax.device_get(_frame_of(self._world, before, state, info, seen))
            self._contradictions += int(info.filter.is_contradiction)
        self._clause = np.asarray(state.clause)
        self._frames.append(frame)
        self._pictures.append(self._taken)

    def recording(self, ended: NavigationRun) -> Recording:
        """Put the recording of a drive together; a ValueError where no decision was kept."""
        if not self._frames:
            raise ValueError("nothing was recorded: give drive on_step=recorder.on_step")
        navigator = self._navigator
        scene = make_scene(
            self._scenario,
            self._robot.sensor,
            ended.state.instruction,
            text=self._text,
            params=navigator.params,
            config=navigator.config,
            type_names=navigator.type_names,
        )
        told = stack_frames(scene, self._frames, self._result(ended))
        why = "" if ended.ending is Ending.ARRIVED else f"{ended.ending.value}: {ended.why}"
        pictures = tuple(self._pictures) if self._views is not None else ()
        return dataclasses.replace(told, pictures=pictures, end_reason=why)

    def _result(self, ended: NavigationRun) -> EpisodeResult:
        """Judge the drive by where the robot truly is."""
        place = self._robot.true_pose[:2]
        away = float(np.hypot(*(place - np.asarray(self._scenario.goal))))
        faults = np.array([int(frame.fault) for frame in self._frames])
        samples = [float(frame.effective_sample_size) for frame in self._frames]
        is_success = ended.ending is Ending.ARRIVED and away <= SUCCESS_RADIUS
        # Of some endings no status tells.
        status = Status.__members__.get(ended.ending.name, int(ended.state.status))
        numbers = {
            "is_success": is_success,
            "is_stopped": ended.ending is not Ending.OUT_OF_TIME,
            "ending": int(status),
            "distance": self._robot.travelled,
            "steps": len(self._frames),
            "final": place,
            "goal_distance": away,
            "overflow": sum(int(frame.overflow) for frame in self._frames),
            "degenerate": int(((faults & Fault.WEIGHTS) != 0).sum()),
            "contradictions": self._contradictions,
            "faults": int(((faults & ~Fault.WEIGHTS) != 0).sum()),
            "mean_effective_sample_size": float(np.mean(samples)),
            "is_valid": bool(self._scenario.is_valid),
        }
        return EpisodeResult(**jax.tree.map(np.asarray, numbers))


def record_drive(
    robot: PhysicsRobot | KinematicRobot,
    text: str,
    *,
    navigator: Navigator,
    key: Array,
) -> tuple[NavigationRun, Recording]:
    """Let a robot, at its start, follow a sentence, and record it; see ``drive``.

    Returns:
        How it ended, and the recording: ``viz.html.write_html`` makes a page of it.
    """
    kept = DriveRecorder(robot, navigator, text)
    ended = drive(navigator, robot, text, key=key, on_step=kept.on_step)
    return ended, kept.recording(ended)
