"""``jaxlangnav follow``: one episode, told and drawn (the whole of section 3)."""

import dataclasses
import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import tyro

from jaxlangnav.commands.checks import check_at_least, check_folder, check_range, check_seed
from jaxlangnav.commands.errors import UsageError
from jaxlangnav.commands.output import Document, Output
from jaxlangnav.commands.runtime import keep_compiled_programs
from jaxlangnav.commands.sentence import parse_text

if TYPE_CHECKING:
    from jaxlangnav.language.phrase import Parse
    from jaxlangnav.recording import Recording


@dataclasses.dataclass(frozen=True, kw_only=True)
class Follow:
    """Follow a sentence in a world never seen, until the robot says stop.

    Worlds: 1H1C, 1H2C, 2H1C, 2H2C (hydrants and cones, drawn anew for each seed so that the
    sentence is true), a shipped world (yard, street, empty-corner), or a .toml or .json file.

    Examples:
      jaxlangnav follow "go to the hydrant behind the cone"
      jaxlangnav follow "go to the hydrant nearest to the cone" --world 2H1C --range 5
      jaxlangnav follow "find the car" --world street --out pictures
      jaxlangnav follow "go to the hydrant" --policy faithful --seed 7 --json
    """

    text: tyro.conf.Positional[str]
    """The sentence, in quotes."""
    world: str = "1H1C"
    """A template, a shipped world or a file."""
    range: float | None = None
    """How far the robot sees, metres; 3, or what the world file says, if not given."""
    policy: Literal["informed", "faithful"] = "informed"
    """informed: puts its hypotheses to the test; faithful: the paper's."""
    seed: int = 0
    """Of the world and of the noise."""
    particles: int = 64
    """Hypotheses of the map kept at once."""
    max_steps: int = 120
    """Decisions after which the episode ends as a time-out."""
    out: Path | None = None
    """Folder for pictures and for the document of the episode."""
    json: bool = False
    """Print one JSON document: success, distance, trajectory, annotations, pictures, ..."""

    def run(self, output: Output) -> Document:
        """Run the episode, tell it, and draw it where a folder is given.

        Args:
            output: where the story is told.

        Returns:
            The document.

        Raises:
            ValueError: an option, the sentence or the world is refused.
        """
        self._check()
        parsed = parse_text(self.text, output)
        keep_compiled_programs()
        name, annotations, recording = self._record(parsed, output)
        document = self._document(name, annotations, recording)
        from rich.markup import escape

        from jaxlangnav.viz.narrative import tell

        for line in tell(recording):
            output.say(escape(line))
        if self.out is not None:
            self._draw(recording, document, output)
        return document

    def _check(self) -> None:
        """Refuse what can be refused before anything is loaded."""
        check_range(self.range)
        check_seed(self.seed)
        check_at_least("--particles", self.particles, 2)
        check_at_least("--max-steps", self.max_steps, 1)
        check_folder("--out", self.out)
        if self.out is not None and importlib.util.find_spec("matplotlib") is None:
            raise UsageError('--out draws pictures and needs: pip install "jaxlangnav[viz]"')

    def _record(
        self, parsed: "Parse", output: Output
    ) -> tuple[str, list[dict[str, Any]], "Recording"]:
        """Understand the sentence and run the episode."""
        import jax

        from jaxlangnav.commands.engine import missing_types, navigator_config, open_task
        from jaxlangnav.grounding.instruction import understand_parse
        from jaxlangnav.grounding.weights import load_shipped
        from jaxlangnav.navigator import default_params
        from jaxlangnav.recording import record

        understood = understand_parse(parsed, load_shipped())
        annotations = understood.annotations
        name, task = open_task(self.world, annotations, sensing_range=self.range, seed=self.seed)
        for missing in missing_types(task, annotations, understood.type_names):
            output.note(f"note: world {name} has no {missing}")
        recording = record(
            task,
            jax.tree.map(lambda leaf: leaf[None], understood.instruction),
            params=default_params(),
            config=navigator_config(self.policy, self.particles),
            max_steps=self.max_steps,
            text=self.text,
        )
        return name, annotations, recording

    def _document(
        self, name: str, annotations: list[dict[str, Any]], recording: "Recording"
    ) -> dict[str, Any]:
        """Gather what ``--json`` prints."""
        scene, result = recording.scene, recording.result
        return {
            "instruction": self.text,
            "world": name,
            "policy": self.policy,
            "seed": self.seed,
            "range": float(scene.sensor.range_max),
            "particles": self.particles,
            "success": bool(result.is_success),
            "stopped": bool(result.is_stopped),
            "distance": float(result.distance),
            "known_distance": scene.known_distance,
            "goal_distance": float(result.goal_distance),
            "steps": int(result.steps),
            "goal": [float(one) for one in scene.scenario.goal],
            "trajectory": [
                *([float(x), float(y)] for x, y in recording.frames.position),
                [float(one) for one in result.final],
            ],
            "annotations": annotations,
            "pictures": [],
        }

    def _draw(self, recording: "Recording", document: dict[str, Any], output: Output) -> None:
        """Write pictures and document into the folder."""
        import json

        from jaxlangnav.commands.output import to_json
        from jaxlangnav.experiments.archive import write_text
        from jaxlangnav.viz.pictures import write_pictures

        assert self.out is not None
        document["pictures"] = [str(path) for path in write_pictures(recording, self.out)]
        write_text(json.dumps(to_json(document), indent=2) + "\n", self.out / "episode.json")
        output.say(f"\nPictures: {', '.join(document['pictures'])}")
