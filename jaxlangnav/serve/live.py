"""An episode that runs in its own thread, with thread-safe access for the web server."""

import contextlib
import dataclasses
import queue
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

from jaxlangnav.episode import EpisodeResult, EpisodeState
from jaxlangnav.episode.recording import Recording, Snapshot, stack_frames
from jaxlangnav.experiments.sizes import check_recording
from jaxlangnav.grounding import GraphGrounder, GroundingModel, understand
from jaxlangnav.inputs.atomic_files import write_text
from jaxlangnav.inputs.documents import error_prefix, parse_json, parse_toml
from jaxlangnav.inputs.limits import MAX_SEED, RANGES
from jaxlangnav.inputs.sanitize import sanitize, shorten
from jaxlangnav.inputs.schema import PlainText, bad_choice
from jaxlangnav.navigator.candidates import Candidate
from jaxlangnav.semantic_map.params import MapConfig
from jaxlangnav.task.follow import prepare_episode, score
from jaxlangnav.task.loading import detector_of, step_limit
from jaxlangnav.task.talk import YOU, Dialogue, add_talk, allow_questions, name_candidates, padded
from jaxlangnav.viz.html import page_data
from jaxlangnav.viz.sentences import percent
from jaxlangnav.world import files
from jaxlangnav.world.templates import TEMPLATE_NAMES

MAX_UTTERANCE_LENGTH = 1000  # characters
_QUEUE_SIZE = 8  # utterances that may wait for the next decision
_IDLE_TIMEOUT = 1800.0  # seconds without utterance after which an idle episode ends
_compile_lock = threading.Lock()  # held while a program may be compiled


class Request(Struct, forbid_unknown_fields=True, kw_only=True):
    """Request to open an episode: sentence, world and options; units as of ``task.follow``."""

    text: PlainText
    world: Annotated[str, Meta(max_length=64)] = "1H1C"
    document: Annotated[str, Meta(max_length=files.MAX_FILE_BYTES)] = ""
    """A world file, TOML or JSON, that replaces ``world`` unless empty."""
    range: Annotated[float, Meta(ge=RANGES[0], le=RANGES[1])] | None = None
    policy: Literal["informed", "faithful"] = "informed"
    seed: Annotated[int, Meta(ge=0, le=MAX_SEED)] = 0
    particles: Annotated[int, Meta(ge=2, le=4096)] = MapConfig().num_particles
    max_steps: Annotated[int, Meta(ge=1, le=10_000)] | None = None
    may_ask: bool = True


class Message(Struct, forbid_unknown_fields=True):
    """WebSocket message from the page: an utterance, or the request to end the episode."""

    say: str = ""
    close: bool = False


def world_names() -> tuple[str, ...]:
    """List the names of the available worlds: templates and shipped ones."""
    return *TEMPLATE_NAMES, *files.shipped_worlds()


def read_world(text: str) -> dict[str, Any]:
    """Parse a world file, TOML or JSON, and fill in defaults; ``ValueError`` if it is invalid."""
    with error_prefix("your world"):
        table = (parse_json if text.lstrip().startswith("{") else parse_toml)(text)
    return files.world_to_dict(files.world_from_dict(table, file="your world"))


class LiveEpisode:
    """An interactive episode that runs until it is closed, out of steps, or idle too long."""

    def __init__(self, request: Request, *, model: GroundingModel, folder: Path, pace: float):
        """Open an episode.

        Args:
            request: sentence, world and options.
            model: trained models of language.
            folder: where the world file of this episode is stored.
            pace: minimum duration of a step, seconds.

        Raises:
            ValueError: the sentence, the world or an option is refused; one line.
        """
        self.request, self._pace = request, pace
        self._world = self._open_world(folder)
        options = request.range, request.policy, request.seed, request.particles
        with _compile_lock:
            detector = detector_of(self._world, model.type_names)
            understood = understand(request.text, model, detector)
            opened = prepare_episode(understood, self._world, *options)
        task = opened.prepared.task
        self._max_steps = request.max_steps or step_limit(task)
        check_recording(opened.config, self._max_steps)
        grounder = GraphGrounder.of_detector(model, detector_of(self._world, understood.type_names))
        # Reserve capacity for later utterances.
        understood = padded(understood)
        params = allow_questions(opened.params) if request.may_ask else opened.params
        self._opened = dataclasses.replace(opened, understood=understood, params=params)
        self._source = Dialogue(
            grounder=grounder,
            first=understood,
            scene=self._opened.scene(),
            speakers={YOU: self._read},
            is_present=lambda progress: not self._closed.is_set(),
            on_heard=lambda _: self._notify(),
        )
        self._steps: list[tuple[Snapshot, EpisodeResult]] = []
        self._queue: queue.Queue[str | None] = queue.Queue(_QUEUE_SIZE)
        self._question: list[dict[str, str]] = []
        self._is_resting, self._last_step = False, -1
        self._change, self._version = threading.Condition(), 0
        self._closed = threading.Event()
        self.is_over, self.fault = False, ""

    def _open_world(self, folder: Path) -> files.WorldSource:
        """Open the world of a name, or the file to which a sent world is written."""
        if not self.request.document:
            if self.request.world not in world_names():
                raise ValueError(bad_choice("world", self.request.world, world_names()))
            return files.open_world(self.request.world)
        path = folder / "your world.toml"
        write_text(files.to_toml(read_world(self.request.document)) + "\n", path)
        return files.open_world(str(path))

    def start(self) -> None:
        """Run the episode in a new thread."""
        threading.Thread(target=self.run, daemon=True).start()

    def run(self) -> None:
        """Run the episode to its end, step by step; for its thread."""
        steps = self._opened.play(self._max_steps, self._source)
        try:
            with _compile_lock:
                self._steps.append(next(steps))
            self._notify()
            for step in steps:
                self._closed.wait(self._pace)
                self._steps.append(step)
                self._notify()
        except Exception as error:  # shown on the page; the server goes on
            line = " ".join(str(error).split()) or type(error).__name__
            self.fault = sanitize(shorten(line, 300))
        finally:
            self.is_over, self._question = True, []
            self._notify()

    def _read(self, step: int, state: EpisodeState, options: Sequence[Candidate]) -> str | None:
        """Return the next utterance; blocks while the robot rests or asks a question."""
        if step == self._last_step:
            # An utterance was taken in this step: do not wait for another one.
            return self._poll(0.0)
        is_resting = bool(state.navigator.is_resting)
        self._is_resting, answers = is_resting, name_candidates(options)
        self._question = [
            {
                "say": answers[candidate.slot],
                "thing": f"the {candidate.type_name} at ({candidate.x:.1f}, {candidate.y:.1f}) m, "
                f"{percent(candidate.probability)}",
            }
            for candidate in options
            if candidate.slot in answers
        ]
        is_waiting = (is_resting or bool(options)) and not self._closed.is_set()
        if is_waiting:
            self._notify()
        text = self._poll(_IDLE_TIMEOUT if is_waiting else 0.0)
        if text is not None:
            self._last_step, self._is_resting, self._question = step, False, []
        elif is_waiting:
            self._closed.set()
        return text

    def _poll(self, seconds: float) -> str | None:
        """Take an utterance from the queue within a number of seconds, else None."""
        with contextlib.suppress(queue.Empty):
            return self._queue.get(seconds > 0.0, seconds)
        return None

    def say(self, text: str) -> None:
        """Queue an utterance for the robot, which reads it before its next decision.

        Raises:
            ValueError: empty or too long, or the episode has ended; one line.
        """
        words = text.strip()
        if not words:
            raise ValueError("nothing is said: type a sentence")
        if len(words) > MAX_UTTERANCE_LENGTH:
            limit = f"at most {MAX_UTTERANCE_LENGTH}"
            raise ValueError(f"{len(words)} characters are said, but {limit} are heard: say less")
        if self.is_over:
            raise ValueError("this episode has ended: press go for another")
        try:
            self._queue.put_nowait(words)
        except queue.Full:
            raise ValueError(f"{_QUEUE_SIZE} utterances are still unheard: wait") from None

    def close(self) -> None:
        """End the episode after its present step."""
        self._closed.set()
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait(None)

    def _notify(self) -> None:
        """Increment the version and wake the waiting threads."""
        with self._change:
            self._version += 1
            self._change.notify_all()

    def wait(self, version: int, seconds: float) -> int:
        """Wait, with a timeout, for a version newer than a given one; returns the newest."""
        with self._change:
            self._change.wait_for(lambda: self._version > version, seconds)
            return self._version

    def recording(self) -> Recording | None:
        """Stack the steps so far into a recording with its outcome; None before the first step."""
        steps = list(self._steps)
        if not steps:
            return None
        recording = stack_frames(self._source.scene, steps)
        return add_talk(score(recording, self._opened.prepared), self._source)

    def describe(self) -> dict[str, Any]:
        """Build the JSON state for the page; an episode with an open question is under way."""
        is_over, is_resting, question = self.is_over, self._is_resting, self._question
        recording = self.recording()
        is_under_way = not is_over and (bool(question) or not is_resting)
        utterances = [
            {"text": sanitize(item.text), "kind": item.kind, "refusal": sanitize(item.refusal)}
            for item in list(self._source.utterances)
        ]
        return {
            "episode": recording and page_data(recording, is_under_way=is_under_way),
            "heard": utterances,
            "question": question,
            "is_resting": is_resting,
            "is_over": is_over,
            "fault": self.fault,
        }

    def world(self) -> str:
        """Serialize the world of this episode as a TOML world file."""
        prepared, source = self._opened.prepared, self._world
        task = prepared.task
        if isinstance(source, files.WorldFile):
            world = dataclasses.replace(source, scenario=task.scenario, sensor=task.sensor)
        else:
            world = files.WorldFile(
                name=prepared.world,
                scenario=task.scenario,
                sensor=task.sensor,
                motion=task.motion,
                instruction=sanitize(" ".join(self.request.text.split())),
            )
        return files.to_toml(files.world_to_dict(world)) + "\n"
