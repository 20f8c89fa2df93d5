"""Record a robot's drive in the format of an episode, for pages, narratives and figures.

The ground truth is sampled at each detector query, with images of a robot that has cameras: a chase
view, and its camera image with detected tags.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

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
from jaxlangnav.robots import libraries
from jaxlangnav.robots.driver import drive
from jaxlangnav.robots.kinematic import KinematicRobot, SimulatedRobot
from jaxlangnav.robots.physics.robot import PhysicsRobot
from jaxlangnav.robots.physics.tags import TAGS_PER_TYPE, object_center
from jaxlangnav.robots.robot import Ending, NavigationRun, Step, observe
from jaxlangnav.world.simulator import SUCCESS_RADIUS

_frame_of = jax.jit(make_frame)
PANEL_SIZE = (400, 300)
"""Pixels, width and height of an image."""
BACKGROUND = (45, 45, 45)
"""Blue, green, red: fill color of a missing image, and background of labels."""
_GREEN, _ORANGE = (60, 220, 60), (40, 160, 250)
_CAMERA_TITLE = "Through its camera: tags used (green), tags outside its gates (orange)"
_QUALITY = 75  # of a JPEG, in percent


class Views:
    """Renders images of a robot; each is u8[H, W, 3], blue, green, red, as in OpenCV."""

    def __init__(self, robot: PhysicsRobot, type_names: tuple[str, ...]) -> None:
        """Set up a chase camera; tags of types without a name are not labelled."""
        self._robot, self._type_names = robot, type_names
        self._cv2 = libraries.opencv()
        self._view = libraries.mujoco().MjvCamera()

    def chase_view(self) -> np.ndarray:
        """Render the robot from behind and above."""
        x, y, heading = self._robot.true_pose
        self._view.lookat[:] = x + 0.8 * np.cos(heading), y + 0.8 * np.sin(heading), 0.3
        self._view.distance, self._view.elevation = 4.5, -28.0
        self._view.azimuth = 35.0
        return self._to_panel(self._robot.render(self._view)[..., ::-1])

    def camera_view(self) -> np.ndarray:
        """Draw the last camera image with its tags, see ``_CAMERA_TITLE``; blank without one."""
        robot = self._robot
        if robot.last_picture is None or not robot.camera_works:
            return np.full((*PANEL_SIZE[::-1], 3), BACKGROUND, np.uint8)
        image = np.ascontiguousarray(robot.last_picture[..., ::-1])
        labelled: set[int] = set()
        for tag in sorted(robot.last_tags, key=lambda tag: np.hypot(*tag.position[[0, 2]])):
            corners = tag.corners.round().astype(np.int32)
            color = _GREEN if robot.is_used(tag) else _ORANGE
            self._cv2.polylines(image, [corners[:, None]], True, color, 5)
            index, names = tag.tag_id // TAGS_PER_TYPE, self._type_names
            if index < len(names) and tag.tag_id not in labelled:
                labelled.add(tag.tag_id)
                dist = np.hypot(*object_center(tag, robot.robot_model.camera_ahead))
                self._draw_label(image, f"{names[index]} {dist:.1f} m", corners.min(axis=0), color)
        return self._to_panel(image)

    def jpegs(self) -> dict[str, bytes]:
        """Render both images, as JPEG by their titles."""
        images = {"From outside": self.chase_view(), _CAMERA_TITLE: self.camera_view()}
        options = [self._cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
        return {
            title: self._cv2.imencode(".jpg", image, options)[1].tobytes()
            for title, image in images.items()
        }

    def _draw_label(self, image: np.ndarray, label: str, corner: np.ndarray, color: Any) -> None:
        """Draw a label on a dark background above a tag."""
        cv2, font = self._cv2, self._cv2.FONT_HERSHEY_SIMPLEX
        (width, height), baseline = cv2.getTextSize(label, font, 1.3, 3)
        bottom, columns = max(int(corner[1]) - 14, height + baseline), _panel_columns(image)
        left = min(max(int(corner[0]), columns.start), columns.stop - width)
        end = left + width, bottom + baseline
        cv2.rectangle(image, (left, bottom - height - baseline), end, BACKGROUND, -1)
        cv2.putText(image, label, (left, bottom), font, 1.3, color, 3, cv2.LINE_AA)

    def _to_panel(self, image: np.ndarray) -> Any:
        """Crop an image to the aspect ratio of a panel, and resize it."""
        cropped = image[:, _panel_columns(image)]
        return self._cv2.resize(cropped, PANEL_SIZE, interpolation=self._cv2.INTER_AREA)


def _panel_columns(image: np.ndarray) -> slice:
    """Find the central columns of an image that have the aspect ratio of a panel."""
    height, width = image.shape[:2]
    panel_width = height * PANEL_SIZE[0] // PANEL_SIZE[1]
    left = (width - panel_width) // 2
    return slice(left, left + panel_width)


class DriveRecorder:
    """Recorder of a drive, step by step: ``drive(..., on_step=recorder.on_step)``."""

    def __init__(
        self, robot: PhysicsRobot | KinematicRobot, navigator: Navigator, text: str
    ) -> None:
        """Set up for a robot at its start; takes over ``robot.on_detection``."""
        self._robot, self._navigator, self._text = robot, navigator, text
        self._scenario = robot.scenario
        has_camera = isinstance(robot, PhysicsRobot)
        self._views = Views(robot, navigator.type_names) if has_camera else None
        self._world = robot.world_state
        self._images: Mapping[str, bytes] = {}
        self._frames: list[Snapshot] = []
        self._step_images: list[Mapping[str, bytes]] = []
        self._clause, self._contradictions = np.int32(0), 0
        robot.on_detection = self._on_detection

    def _on_detection(self, robot: SimulatedRobot) -> None:
        self._world = robot.world_state
        if self._views is not None:
            self._images = self._views.jpegs()

    def on_step(self, step: Step, state: NavigatorState, info: NavigatorInfo | None) -> None:
        """Record a decision; without a picture the previous belief is repeated."""
        if info is None:
            if not self._frames:
                return
            # Repeat the last frame without what it observed, at the robot's present pose.
            last_frame, world = self._frames[-1], self._world
            names = ("is_detection", "is_news", "num_regrounded", "fault", "overflow")
            frame = replace(
                last_frame,
                position=world.position,
                heading=world.heading,
                odometry=world.odometry[:2],
                distance=world.distance,
                **{name: np.zeros_like(getattr(last_frame, name)) for name in names},
            )
        else:
            clause = np.minimum(self._clause, np.asarray(state.instruction.num_clauses) - 1)
            before = replace(state, clause=np.maximum(clause, 0))
            observation = observe(np.array(step.pose), step.detections or (), self._robot.sensor)
            frame = jax.device_get(_frame_of(self._world, before, state, info, observation))
            self._contradictions += int(info.filter.is_contradiction)
        self._clause = np.asarray(state.clause)
        self._frames.append(frame)
        self._step_images.append(self._images)

    def recording(self, run: NavigationRun) -> Recording:
        """Assemble the recording of a drive; a ValueError where no decision was recorded."""
        if not self._frames:
            raise ValueError("nothing was recorded: give drive on_step=recorder.on_step")
        navigator = self._navigator
        names = {"text": self._text, "type_names": navigator.type_names}
        inputs = self._scenario, self._robot.sensor, run.state.instruction
        result = self._result(run)
        scene = make_scene(*inputs, **names, params=navigator.params, config=navigator.config)
        recording = stack_frames(scene, [(frame, result) for frame in self._frames])
        why = "" if run.ending is Ending.ARRIVED else f"{run.ending.value}: {run.why}"
        pictures = tuple(self._step_images) if self._views is not None else ()
        return dataclasses.replace(recording, pictures=pictures, end_reason=why)

    def _result(self, run: NavigationRun) -> EpisodeResult:
        """Evaluate the drive by the robot's ground-truth position."""
        position = self._robot.true_pose[:2]
        distance = float(np.hypot(*(position - np.asarray(self._scenario.goal))))
        faults = np.array([int(frame.fault) for frame in self._frames])
        sample_sizes = [float(frame.effective_sample_size) for frame in self._frames]
        # Some endings correspond to no status.
        status = Status.__members__.get(run.ending.name, int(run.state.status))
        fields = {
            "is_success": run.ending is Ending.ARRIVED and distance <= SUCCESS_RADIUS,
            "is_stopped": run.ending is not Ending.OUT_OF_TIME,
            "ending": int(status),
            "distance": self._robot.travelled,
            "steps": len(self._frames),
            "final": position,
            "goal_distance": distance,
            "overflow": sum(int(frame.overflow) for frame in self._frames),
            "degenerate": int(((faults & Fault.WEIGHTS) != 0).sum()),
            "contradictions": self._contradictions,
            "faults": int(((faults & ~Fault.WEIGHTS) != 0).sum()),
            "mean_effective_sample_size": float(np.mean(sample_sizes)),
            "is_valid": bool(self._scenario.is_valid),
        }
        return EpisodeResult(**jax.tree.map(np.asarray, fields))


def record_drive(
    robot: PhysicsRobot | KinematicRobot, text: str, *, navigator: Navigator, key: Array
) -> tuple[NavigationRun, Recording]:
    """Drive a robot from its start by an instruction, and record the drive; see ``drive``.

    Returns:
        The run and its recording: ``viz.html.write_html`` makes a page of it.
    """
    recorder = DriveRecorder(robot, navigator, text)
    run = drive(navigator, robot, text, key=key, on_step=recorder.on_step)
    return run, recorder.recording(run)
