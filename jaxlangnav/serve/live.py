"""One episode behind the page: it runs in a thread, is looked at and spoken to from others."""

import contextlib
import dataclasses
import queue
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from jaxlangnav.episode import EpisodeResult, EpisodeState, recorder
from jaxlangnav.episode.recording import Frame, Recording, stack_frames
from jaxlangnav.experiments.sizes import check_recording
from jaxlangnav.grounding import GraphGrounder, GroundingModel
from jaxlangnav.inputs.documents import parse_json, parse_toml
from jaxlangnav.inputs.limits import RANGES
from jaxlangnav.inputs.sanitize import sanitize, shorten
from jaxlangnav.inputs.schema import PlainText, bad_choice
from jaxlangnav.inputs.whole_files import write_text
from jaxlangnav.navigator.candidates import Candidate
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.task.follow import OpenedEpisode, alone, judged, open_episode
from jaxlangnav.task.opening import detector_of, usual_steps
from jaxlangnav.task.talk import YOU, Earshot, allow_questions, name_candidates, roomy, with_talk
from jaxlangnav.viz.html import page_data
from jaxlangnav.viz.sentences import percent
from jaxlangnav.world.files import (
    LARGEST_WORLD_FILE,
    WorldFile,
    open_world,
    shipped_worlds,
    to_toml,
    world_from_dict,
    world_to_dict,
)
from jaxlangnav.world.templates import TEMPLATE_NAMES

LONGEST_UTTERANCE = 1000  # characters
_MOST_UNHEARD = 8  # utterances that wait for the next decision
_PATIENCE = 1800.0  # seconds that a robot at rest waits for another word; then its episode ends
_ENGINE = threading.Lock()  # held while a program may be compiled, lest two threads compile it


class Request(Struct, forbid_unknown_fields=True, kw_only=True):
    """What the page asks for: a sentence, a world and a robot; units as of ``task.follow``."""

    text: PlainText
    world: Annotated[str, Meta(max_length=64)] = "1H1C"
    document: Annotated[str, Meta(max_length=LARGEST_WORLD_FILE)] = ""
    """A world file, TOML or JSON, in place of ``world``; none if empty."""
    range: Annotated[float, Meta(ge=RANGES[0], le=RANGES[1])] | None = None
    policy: Literal["informed", "faithful"] = "informed"
    seed: Annotated[int, Meta(ge=0, lt=2**32)] = 0
    particles: Annotated[int, Meta(ge=2, le=4096)] = MapConfig().num_particles
    max_steps: Annotated[int, Meta(ge=1, le=10_000)] | None = None
    may_ask: bool = True


class Message(Struct, forbid_unknown_fields=True):
    """What comes from the page on the way: an utterance, or that nobody listens any more."""

    say: str = ""
    close: bool = False


def places() -> tuple[str, ...]:
    """List the worlds that can be picked by name: templates and shipped ones."""
    return *TEMPLATE_NAMES, *shipped_worlds()


def read_world(text: str) -> dict[str, Any]:
    """Read a world file's text, TOML or JSON, with all defaults; ``ValueError`` if it is none."""
    try:
        table = (parse_json if text.lstrip().startswith("{") else parse_toml)(text)
    except ValueError as error:
        raise ValueError(f"your world: {error}") from None
    return world_to_dict(world_from_dict(table, file="your world"))


class LiveEpisode:
    """An episode that goes on until it is closed, has no steps left, or nobody says more."""

    def __init__(self, request: Request, *, model: GroundingModel, folder: Path, pace: float):
        """Open an episode.

        Args:
            request: what is asked for.
            model: trained models of language.
            folder: where the world of this episode is kept while it lasts.
            pace: seconds that a step takes at least.

        Raises:
            ValueError: the sentence, the world or an option is refused; one line.
        """
        self.request, self._pace = request, pace
        self._world = self._find_world(folder)
        with _ENGINE:
            opened = open_episode(
                request.text,
                self._world,
                request.range,
                request.policy,
                request.seed,
                request.particles,
                model=model,
            )
        task = opened.prepared.task
        self._max_steps = request.max_steps or usual_steps(task.scenario, task.sensor)
        check_recording(opened.config, self._max_steps)
        grounder = GraphGrounder.of_detector(
            model, detector_of(self._world, opened.understood.type_names)
        )
        self._opened = self._equip(opened)
        self._ear = self._listen(grounder)
        self._steps: list[tuple[Frame, EpisodeResult]] = []
        self._unheard: queue.Queue[str | None] = queue.Queue(_MOST_UNHEARD)
        self._question: list[dict[str, str]] = []
        self._is_resting, self._heard_at = False, -1
        self._change, self._version = threading.Condition(), 0
        self._closed = threading.Event()
        self.is_over, self.fault = False, ""

    def _find_world(self, folder: Path) -> str:
        """Name the world that is picked; one that was sent is kept in a file."""
        if not self.request.document:
            if self.request.world not in places():
                raise ValueError(bad_choice("world", self.request.world, places()))
            return self.request.world
        path = folder / "your world.toml"
        write_text(to_toml(read_world(self.request.document)) + "\n", path)
        return str(path)

    def _equip(self, opened: OpenedEpisode) -> OpenedEpisode:
        """Make room for what else may be said, and let the robot ask."""
        params = allow_questions(opened.params) if self.request.may_ask else opened.params
        return dataclasses.replace(opened, understood=roomy(opened.understood), params=params)

    def _listen(self, grounder: GraphGrounder) -> Earshot:
        understood, task = self._opened.understood, self._opened.prepared.task
        scene = recorder.scene_of(
            task.scenario,
            task.sensor,
            understood.instruction,
            text=self._opened.text,
            type_names=understood.type_names,
            params=self._opened.params,
            config=self._opened.config,
        )
        return Earshot(
            grounder=grounder,
            first=understood,
            scene=scene,
            voices={YOU: self._hear},
            is_awaited=lambda progress: not self._closed.is_set(),
            on_said=lambda said: self._tell(),
        )

    def start(self) -> None:
        """Run the episode in a thread of its own."""
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        opened = self._opened
        steps = recorder.play(
            opened.prepared.task,
            alone(opened.understood),
            params=opened.params,
            config=opened.config,
            max_steps=self._max_steps,
            ear=self._ear,
        )
        try:
            with _ENGINE:
                self._steps.append(next(steps))
            self._tell()
            for one in steps:
                self._closed.wait(self._pace)
                self._steps.append(one)
                self._tell()
        except Exception as error:  # a fault of ours is shown on the page, the server goes on
            line = " ".join(str(error).split()) or type(error).__name__
            self.fault = sanitize(shorten(line, 300))
        finally:
            self.is_over, self._question = True, []
            self._tell()

    def _hear(self, step: int, progress: EpisodeState, doubt: Sequence[Candidate]) -> str | None:
        """Take the next utterance: a robot at rest, or one that asks, waits for it."""
        if step == self._heard_at:
            # What came of it is seen after the step; until then more may be said, nothing need be.
            return self._next(0.0)
        is_resting = bool(progress.navigator.is_resting)
        self._is_resting, words = is_resting, name_candidates(doubt)
        self._question = [
            {
                "say": words[one.slot],
                "thing": f"the {one.type_name} at ({one.x:.1f}, {one.y:.1f}) m, "
                f"{percent(one.probability)}",
            }
            for one in doubt
            if one.slot in words
        ]
        is_waiting = (is_resting or bool(doubt)) and not self._closed.is_set()
        if is_waiting:
            self._tell()
        said = self._next(_PATIENCE if is_waiting else 0.0)
        if said is not None:
            self._heard_at, self._is_resting, self._question = step, False, []
        elif is_waiting:
            self._closed.set()
        return said

    def _next(self, seconds: float) -> str | None:
        """Take what is said within so many seconds."""
        try:
            return self._unheard.get(seconds > 0.0, seconds)
        except queue.Empty:
            return None

    def say(self, text: str) -> None:
        """Say something to the robot, which hears it before its next decision.

        Raises:
            ValueError: nothing is said, too much, or nobody listens any more; one line.
        """
        said = text.strip()
        if not said:
            raise ValueError("nothing is said: type a sentence")
        if len(said) > LONGEST_UTTERANCE:
            most = f"at most {LONGEST_UTTERANCE}"
            raise ValueError(f"{len(said)} characters are said, but {most} are heard: say less")
        if self.is_over:
            raise ValueError("this episode has ended: press go for another")
        try:
            self._unheard.put_nowait(said)
        except queue.Full:
            raise ValueError(f"{_MOST_UNHEARD} utterances are still unheard: wait") from None

    def close(self) -> None:
        """End the episode after its present step."""
        self._closed.set()
        with contextlib.suppress(queue.Full):
            self._unheard.put_nowait(None)

    def _tell(self) -> None:
        """Wake those who wait for something new."""
        with self._change:
            self._version += 1
            self._change.notify_all()

    def wait(self, version: int, seconds: float) -> int:
        """Wait at most so long until there is something newer than a version; the newest."""
        with self._change:
            self._change.wait_for(lambda: self._version > version, seconds)
            return self._version

    def recording(self) -> Recording | None:
        """Stack the steps so far, judged as if it ended here; None before the first."""
        steps = list(self._steps)
        if not steps:
            return None
        frames, results = zip(*steps, strict=True)
        recording = stack_frames(self._ear.scene, list(frames), results[-1])
        return with_talk(judged(recording, self._opened.prepared), self._ear)

    def describe(self) -> dict[str, Any]:
        """Gather what the page shows now, in JSON's own types; a robot that asks is under way."""
        is_over, is_resting, question = self.is_over, self._is_resting, self._question
        recording = self.recording()
        is_under_way = not is_over and (bool(question) or not is_resting)
        heard = [
            {"text": sanitize(one.text), "kind": one.kind, "refusal": sanitize(one.refusal)}
            for one in list(self._ear.said)
        ]
        return {
            "episode": recording and page_data(recording, is_under_way=is_under_way),
            "heard": heard,
            "question": question,
            "is_resting": is_resting,
            "is_over": is_over,
            "fault": self.fault,
        }

    def world(self) -> str:
        """Write the world of this episode as a world file, TOML."""
        prepared, place = self._opened.prepared, open_world(self._world)
        task = prepared.task
        if isinstance(place, WorldFile):
            world = dataclasses.replace(place, scenario=task.scenario, sensor=task.sensor)
        else:
            world = WorldFile(
                name=prepared.world,
                scenario=task.scenario,
                sensor=task.sensor,
                motion=task.motion,
                instruction=self._opened.text,
            )
        return to_toml(world_to_dict(world)) + "\n"


def warm_up(model: GroundingModel, folder: Path) -> None:
    """Load or compile what the first sentence in a drawn world needs."""
    episode = LiveEpisode(
        Request(text="go to the hydrant behind the cone", max_steps=1),
        model=model,
        folder=folder,
        pace=0.0,
    )
    episode.close()
    episode._run()
    if episode.fault:
        raise RuntimeError(episode.fault)
