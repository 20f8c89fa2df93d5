"""``jaxlangnav follow``: run one episode with its narrative and figures (section 3)."""

import dataclasses
import itertools
import math
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro

from jaxlangnav.cli import checks, speech
from jaxlangnav.cli.ground import understand_text
from jaxlangnav.cli.output import Document, Output, UsageError, document_text
from jaxlangnav.cli.runtime import spinner
from jaxlangnav.cli.settings import apply_to_episode, read_options
from jaxlangnav.inputs.limits import RANGES, bounded, check_minimum, check_seed

if TYPE_CHECKING:
    from jaxlangnav.episode.recording import Recording
    from jaxlangnav.grounding.instruction import Understanding
    from jaxlangnav.task.follow import PreparedEpisode
    from jaxlangnav.task.talk import Dialogue
    from jaxlangnav.world.files import WorldSource


@dataclasses.dataclass(frozen=True, kw_only=True)
class Follow:
    """Follow a sentence in a world never seen, until the robot says stop.

    Worlds: 1H1C, 1H2C, 2H1C, 2H2C (hydrants and cones, drawn anew for each seed so that the
    sentence is true), a shipped world (yard, street, empty-corner, figure1, figure4), or a .toml
    or .json file. The numbers and sizes of filter, planner, detector and motion can be set too, for
    example --params.planner.discount 0.9: --help-params lists them with units.

    Examples:
      jaxlangnav follow "go to the hydrant behind the cone"
      jaxlangnav follow "go to the hydrant nearest to the cone" --world 2H1C --range 5
      jaxlangnav follow "find the car" --world street --out pictures
      jaxlangnav follow "move behind the cone" --live
      jaxlangnav follow "go to the hydrant" --policy faithful --seed 7 --json
      jaxlangnav follow "go to the hydrant" --sensor.field-of-view "90 deg"
      jaxlangnav follow "go to the hydrant" --world 2H1C --hear "9: no, the other one"
      jaxlangnav follow "go to the hydrant" --world 2H1C --talk
    """

    SETTINGS: ClassVar = ("params", "config", "sensor", "motion")

    text: tyro.conf.Positional[str]
    """The sentence, in quotes."""
    world: str = "1H1C"
    """A template, a shipped world or a file."""
    range: checks.OptionalMetres = None
    """How far the robot sees; 3 m, or what the world file says, if not given."""
    policy: Literal["informed", "faithful"] = "informed"
    """informed: puts its hypotheses to the test; faithful: the paper's."""
    seed: int = 0
    """Of the world and of the noise. A table's episode of this seed may differ, by rounding."""
    particles: int = 64
    """Hypotheses of the map kept at once."""
    max_steps: checks.OptionalInt = None
    """Decisions before a time-out; if not given 120, or three sweeps of the area."""
    out: checks.Folder = None
    """Where to write pictures (PNG, SVG), an interactive page (HTML) and the document."""
    hear: tyro.conf.UseAppendAction[tuple[checks.StepText, ...]] = ()
    """What is said under way: the step before whose decision it is heard, a colon, the words, as in
    --hear "5: go to the other hydrant"; may be given several times."""
    ask: bool = False
    """Let the robot ask which one is meant: you answer on the terminal, or --person does.
    A question costs 0.1 of a success unless --params.planner.question-cost says otherwise."""
    person: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """A simulated person who knows the goal, watches, corrects and answers:
    attentive, slow (waits 5 steps), careless (errs in 10 %) or patient (corrects up to 5 times)."""
    talk: bool = False
    """Type what you like while the robot goes; "stop" halts it at once,
    end of input (Ctrl-D) lets it finish alone."""
    gif: bool = False
    """Write a film too, episode.gif."""
    mp4: bool = False
    """Write episode.mp4; needs jaxlangnav[robot]."""
    rrd: bool = False
    """Write episode.rrd; needs jaxlangnav[rerun]."""
    live: bool = False
    """Draw the episode in the terminal while it runs."""
    weights: checks.File = None
    """Trained models, written by jaxlangnav train; the shipped ones if not given."""
    json: bool = False
    """Print one JSON document; known_distance is the way to the goal itself."""
    settings: tyro.conf.Suppress[Any] = None

    def run(self, output: Output) -> Document:
        """Run the episode, print its narrative, and write figures if a folder is given."""
        script = self._check()
        values = read_options(self.settings, self.SETTINGS)
        understood, models, world = understand_text(
            self.text, output, world=self.world, weights=self.weights
        )
        from jaxlangnav.experiments.sizes import check_recording
        from jaxlangnav.grounding import GraphGrounder
        from jaxlangnav.task.follow import precompile_cycle
        from jaxlangnav.task.loading import detector_of, step_limit
        from jaxlangnav.task.talk import padded

        opened = self._open(world, understood, values)
        source = None
        if script or self.ask or self.talk or self.person:
            grounder = GraphGrounder.of_detector(models, detector_of(world, models.type_names))
            speech.check_script(script, grounder, understood)
            opened = dataclasses.replace(opened, understood=padded(understood))
            speakers = {name: getattr(self, name) for name in ("person", "ask", "talk")}
            fields = {"grounder": grounder, "first": opened.understood, "scene": opened.scene()}
            source = speech.listener(output, **speakers, script=script, **fields)
        task = opened.prepared.task
        max_steps = self.max_steps or step_limit(task)
        speech.read_script(self.hear, max_steps)
        check_recording(opened.config, max_steps)
        self._note_world(opened, output)
        precompile_cycle(opened)
        recording = self._record(opened, source, max_steps, output)
        document = self._document(opened.prepared.world, understood.annotations, recording)
        if self.out is not None:
            self._draw(recording, document, output)
        return document

    def _check(self) -> dict[int, list[str]]:
        """Validate the options; returns the scripted utterances by step."""
        if self.range is not None:
            bounded(self.range, *RANGES, "--range", "give metres")
        check_seed(self.seed, "--seed")
        check_minimum(2, **{"--particles": self.particles})
        check_minimum(1, **{"--max-steps": 1 if self.max_steps is None else self.max_steps})
        checks.check_folder("--out", self.out)
        script = speech.read_script(self.hear, self.max_steps or math.inf)
        speech.check_speakers(ask=self.ask, talk=self.talk, person=self.person)
        if self.talk and self.live:
            raise UsageError("--talk tells the story as it goes: leave out --live")
        if self.out is not None:
            checks.check_extra("--out draws pictures and needs", "matplotlib", "viz")
        for name in ("gif", "mp4", "rrd"):
            if getattr(self, name) and self.out is None:
                reason = f"--{name} writes episode.{name} into the folder of --out"
                raise UsageError(f"{reason}: add --out DIR")
        if self.rrd:
            checks.check_extra("--rrd needs the rerun viewer", "rerun", "rerun")
        if self.mp4:
            checks.check_extra("--mp4 is written by OpenCV", "cv2", "robot")
        return script

    def _open(
        self, world: "WorldSource", understood: "Understanding", values: dict[Any, Any]
    ) -> "PreparedEpisode":
        """Prepare the episode, set the parameters, and check their validity."""
        from jaxlangnav.messages import check_sensor
        from jaxlangnav.navigator import check
        from jaxlangnav.task.follow import prepare_episode
        from jaxlangnav.task.talk import allow_questions

        options = self.range, self.policy, self.seed, self.particles
        opened = prepare_episode(understood, world, *options)
        opened = apply_to_episode(opened, values)
        if self.ask:
            opened = dataclasses.replace(opened, params=allow_questions(opened.params))
        check_sensor(opened.prepared.task.sensor)
        if values:
            check(opened.params, policy=opened.config.planner.chosen)
        return opened

    def _note_world(self, opened: "PreparedEpisode", output: Output) -> None:
        """Note object types that the world lacks, and that success cannot be judged."""
        from jaxlangnav.task.loading import absent_types, count_types

        prepared, understood = opened.prepared, opened.understood
        counts = count_types(prepared.task.scenario, understood.type_names)
        for name in absent_types(counts, understood):
            output.note(f"note: world {prepared.world} has no {name}")
        if prepared.unscored and not (prepared.goal_exists and self.person):
            output.note(f"note: {prepared.unscored}, so success cannot be judged")

    def _record(
        self, opened: "PreparedEpisode", source: "Dialogue | None", max_steps: int, output: Output
    ) -> "Recording":
        """Run the episode and print its narrative, live or afterwards."""
        from jaxlangnav.episode.recording import stack_frames
        from jaxlangnav.task.follow import score
        from jaxlangnav.task.talk import add_talk
        from jaxlangnav.viz.narrative import closing, narrate, narrate_live, opening

        scene = opened.scene()
        steps = opened.play(max_steps, source)
        message = "compiling the robot's mind; what is compiled is kept for the next run"
        with spinner(message, f"compile {self.policy} {opened.config.map}", default_seconds=60.0):
            first = next(steps)
        steps = itertools.chain([first], steps)
        utterances = [] if source is None else source.utterances
        is_typed = self.talk or (self.ask and self.person is None)
        if self.live:
            from rich.console import Console

            from jaxlangnav.viz.terminal import watch

            # Standard output is kept for the document where a script reads it.
            recording = watch(scene, steps, said=utterances, console=Console(stderr=self.json))
        else:
            if is_typed:
                output.print_wrapped(opening(scene))
                steps = narrate_live(scene, steps, utterances, output.print_wrapped)
            recording = stack_frames(scene, steps)
        recording = score(recording, opened.prepared, has_person=self.person is not None)
        recording = recording if source is None else add_talk(recording, source)
        if self.live or is_typed:
            output.print("")
            output.print_wrapped(closing(recording.last_scene, recording.at(-1), recording.result))
        else:
            output.print_wrapped(narrate(recording))
        return recording

    def _document(
        self, name: str, annotations: list[dict[str, Any]], recording: "Recording"
    ) -> dict[str, Any]:
        from jaxlangnav.messages import Status

        scene, result = recording.scene, recording.result
        return {
            "instruction": self.text,
            "world": name,
            "policy": self.policy,
            "seed": self.seed,
            "range": scene.sensor.range_max,
            "particles": self.particles,
            "success": result.is_success if scene.is_scored else None,
            "stopped": result.is_stopped,
            "ending": Status(int(result.ending)).word,
            "missing": recording.missing,
            **speech.describe_talk(recording),
            "distance": result.distance,
            "known_distance": scene.known_distance,
            "goal_distance": result.goal_distance,
            "steps": result.steps,
            "goal": scene.scenario.goal,
            "trajectory": [*recording.frames.position, result.final],
            "annotations": annotations,
            "pictures": [],
        }

    def _draw(self, recording: "Recording", document: dict[str, Any], output: Output) -> None:
        from jaxlangnav.inputs.atomic_files import write_text
        from jaxlangnav.viz.film import write_film
        from jaxlangnav.viz.html import write_report_files

        assert self.out is not None
        paths = write_report_files(recording, self.out)
        for name in ("gif", "mp4"):
            if getattr(self, name):
                paths.append(write_film(recording, self.out / f"episode.{name}"))
        if self.rrd:
            from jaxlangnav.viz.rrd import write_rrd

            paths.append(write_rrd(recording, self.out / "episode.rrd"))
        document["pictures"] = [str(path) for path in paths]
        write_text(document_text(document), self.out / "episode.json")
        names = ", ".join(path.name for path in paths)
        output.print("")
        output.print(f"Wrote {names} and episode.json into {self.out}")
