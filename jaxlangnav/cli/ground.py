"""``jaxlangnav parse`` and ``ground``: parse tree and grounding distributions of a sentence.

Sections 3.1 and 3.3 of the paper.
"""

import dataclasses
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxlangnav.cli.checks import File, Folder, WorldName, check_extra, check_folder
from jaxlangnav.cli.output import Document, Output, UsageError
from jaxlangnav.cli.runtime import keep_compiled_programs
from jaxlangnav.experiments.table import Table, TableColumns
from jaxlangnav.inputs.limits import check_seed

if TYPE_CHECKING:
    from rich.tree import Tree

    from jaxlangnav.grounding.instruction import GroundingModel, Understanding
    from jaxlangnav.language.phrase import Parse as ParsedSentence
    from jaxlangnav.world.files import WorldSource

PAPER_NUM_OBJECTS = 7  # objects of the behavior graph if no world is given


def parse_text(text: str, output: Output, labels: Collection[str] = ()) -> "ParsedSentence":
    """Parse a sentence with a detector's ``labels``; notes repairs and unknown words."""
    if not text.strip():
        raise UsageError('the sentence is empty; say for example "go to the hydrant"')
    from jaxlangnav.language.parser import parse

    parsed = parse(text, labels)
    for original, replacement in parsed.repairs:
        output.note(f'note: "{original}" is read as "{replacement}"')
    for text_part, replacement in parsed.rewrites:
        if replacement:
            output.note(f"note: '{text_part}' read as '{replacement}'")
    for ignored in parsed.unread:
        output.note(f"note: '{ignored}' says nothing of the task; left out")
    for word, position in parsed.unknown_words:
        output.note(f'note: "{word}" (word {position}) is not in the lexicon')
    return parsed


def understand_text(
    text: str, output: Output, *, world: str, weights: Path | None
) -> "tuple[Understanding, GroundingModel, WorldSource]":
    """Ground a sentence with a world's detector; returns the models and the world too.

    Template worlds (2H1C) have a fixed vocabulary, so bad sentences are refused at once; other
    worlds bring their own labels.
    """
    is_template = world.strip()[:1].isdigit() and "/" not in world and "." not in world
    parsed = parse_text(text, output) if is_template else None
    keep_compiled_programs()
    from jaxlangnav.grounding.instruction import understand_parse
    from jaxlangnav.grounding.weights import load
    from jaxlangnav.task.loading import detector_of
    from jaxlangnav.world.files import open_world

    models, source = load(weights), open_world(world)
    detector = detector_of(source, models.type_names)
    parsed = parsed or parse_text(text, output, detector.plain_labels)
    understood = understand_parse(parsed, models, detector)
    understood.check_others()
    for note in understood.notes:
        output.note(f"note: {note}")
    return understood, models, source


def _draw_tree(phrase: Mapping[str, Any], branch: "Tree | None" = None) -> "Tree":
    """Build a rich tree of a phrase with its label, words and children."""
    from rich.text import Text
    from rich.tree import Tree

    words = [(word["text"], (f"/{word['tag']}", "dim")) for word in phrase["words"]]
    parts = [part for text, tag in words for part in (" ", text, tag)]
    line = Text.assemble((phrase["label"], "bold cyan"), *parts)
    root = Tree(line) if branch is None else branch.add(line)
    for child in phrase["children"]:
        _draw_tree(child, root)
    return root


@dataclasses.dataclass(frozen=True, kw_only=True)
class Parse:
    """Show the phrases of a sentence.

    Examples:
      jaxlangnav parse "go to the hydrant behind the cone"
      jaxlangnav parse "find the nearest car" --json
      jaxlangnav parse --grammar gbnf --nouns gazebo "fire hydrant" > controlled.gbnf
    """

    text: tyro.conf.Positional[str] = ""
    """The sentence, in quotes."""
    grammar: Annotated[
        Literal["lark", "gbnf"] | None, tyro.conf.arg(metavar="{lark,gbnf}", help_behavior_hint="")
    ] = None
    """Print the grammar of the controlled language instead, in a form that other programs read."""
    nouns: tuple[str, ...] = ()
    """Names of things that the grammar has beside the lexicon's."""
    json: bool = False
    """Print one JSON document: instruction, tree, unknown_words."""

    def run(self, output: Output) -> Document:
        """Parse the sentence and draw its tree."""
        if self.grammar is not None:
            if self.text:
                raise UsageError("give a sentence or --grammar, not both")
            from jaxlangnav.language.exported import export_grammar

            grammar = export_grammar(self.grammar, self.nouns)
            for line in grammar.splitlines():
                output.print(line)
            return {"form": self.grammar, "grammar": grammar}
        if self.nouns:
            raise UsageError("--nouns needs --grammar")
        document = parse_text(self.text, output).to_dict()
        output.print(_draw_tree(document["tree"]))
        return document


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ground:
    """Show what a sentence is taken to mean, with probabilities.

    Without a world: the annotations, what the sentence says of a place nobody has seen. With a
    world also the behaviors: what is to be done there, if all of its objects were known.

    Examples:
      jaxlangnav ground "go to the hydrant behind the cone"
      jaxlangnav ground "go to the hydrant behind the cone" --world 2H1C
      jaxlangnav ground "go to the cone nearest to the car" --out pictures
      jaxlangnav ground "move behind the cone" --json
    """

    text: tyro.conf.Positional[str]
    """The sentence, in quotes."""
    world: WorldName = None
    """A template, a shipped world or a file: ground the behavior in it too."""
    seed: int = 0
    """Of the world drawn from a template."""
    out: Folder = None
    """Where to draw the factor graph with its probabilities, graph.png and graph.svg."""
    weights: File = None
    """Trained models, written by jaxlangnav train; the shipped ones if not given."""
    json: bool = False
    """Print one JSON document: annotations, graph, behaviors, unknown_words."""

    def run(self, output: Output) -> Document:
        """Ground the sentence and show the distributions."""
        check_seed(self.seed, "--seed")
        check_folder("--out", self.out)
        if self.out is not None:
            check_extra("--out draws a picture and needs", "matplotlib", "viz")
        understood, model, source = understand_text(
            self.text, output, world=self.world or "1H1C", weights=self.weights
        )
        from rich.text import Text

        from jaxlangnav.grounding.command_summary import list_commands

        annotations = understood.annotations
        commands = list_commands(understood.instruction, understood.type_names)
        document: dict[str, Any] = {
            "instruction": self.text,
            "annotations": annotations,
            "unknown_words": understood.unknown_words,
        }
        # Errors come before any output.
        if self.world is not None:
            document |= self._ground_in(source, understood)
        document["commands"] = commands
        title = "Annotations: what it says of the world"
        output.print(Table.of(annotations, _ANNOTATIONS, title=title).text())
        if commands:
            rows = [command | {"number": position} for position, command in enumerate(commands, 1)]
            output.print(Table.of(rows, _COMMANDS, title="Commands: what it asks for").text())
        if behaviors := document.get("behaviors"):
            title = f"Behaviors in world {document['world']}"
            output.print(Table.of(behaviors, _BEHAVIORS, title=title).text())
        elif self.world is not None:
            output.note(f"note: {document['unjudged']} in world {document['world']}")
        num_objects = PAPER_NUM_OBJECTS if self.world is None else len(document["objects"])
        document["graph"] = understood.graph(num_objects)
        for graph_name, size in document["graph"].items():
            objects = f", {size['objects']} objects" if "objects" in size else ""
            counts = "{phrases} phrases, {factors} factors, {variables} variables".format_map(size)
            output.print(Text(f"{graph_name} graph: {counts}{objects}", style="dim"))
        if self.out is not None:
            from jaxlangnav.viz.graph import graph_figure
            from jaxlangnav.viz.style import save

            model = dataclasses.replace(model, type_names=understood.names)
            pictures = save(graph_figure(understood.parse, model), self.out / "graph")
            document["pictures"] = [str(path) for path in pictures]
            output.print(f"Wrote {', '.join(document['pictures'])}")
        return document

    def _ground_in(self, source: "WorldSource", understood: "Understanding") -> dict[str, Any]:
        """Infer the behavior distribution in a fully known world."""
        from jaxlangnav.task.labelled import list_behaviors, placed_world
        from jaxlangnav.task.loading import load_task

        prepared = load_task(source, understood, sensing_range=None, seed=self.seed)
        labelled = placed_world(prepared.task.scenario, understood.type_names)
        return {
            "world": prepared.world,
            "objects": [{"type": kind, "position": [x, y]} for kind, x, y in labelled.objects],
            "behaviors": list_behaviors(understood.instruction, labelled, understood.type_names),
            "unjudged": prepared.unscored,
        }


def _relation(row: dict[str, Any]) -> str:
    """Name the relation of an annotation row, or its superlative."""
    relation = row["relation"] or "-"
    superlative = {"near": "nearest", "far": "farthest"}.get(relation, f"most {relation}")
    return superlative if row["superlative"] else relation


_ANNOTATIONS: TableColumns = (
    ("Figure", lambda row: row["figure"] or "(the robot itself)"),
    ("Relation", _relation),
    ("Landmark", lambda row: row["landmark"] or "-"),
    ("Probability", "{probability:.3f}"),
)
_COMMANDS: TableColumns = (
    ("Command", "{number}"),
    ("Action", "{action}"),
    ("Mode", "{mode}"),
    ("Goal", lambda row: "{region} the {object}".format_map(row["goal"])
     if row["goal"] else "another one than before"),
    ("Keep away from",
     lambda row: ", ".join(f"the {item['object']}" for item in row["avoid"]) or "-"),
    ("Probability", "{probability:.3f}"),
)  # fmt: skip
_BEHAVIORS: TableColumns = (
    ("Action", "{action}"),
    ("Mode", "{mode}"),
    ("Goal", "{goal[region]} the {goal[object]} ({goal[position][0]:.1f}, "
     "{goal[position][1]:.1f})"),
    ("Probability", "{probability:.3f}"),
)  # fmt: skip
