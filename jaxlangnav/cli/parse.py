"""``jaxlangnav parse``: the phrase tree of a sentence (section 3.1)."""

import dataclasses
from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from jaxlangnav.cli.output import Document, Output, UsageError

if TYPE_CHECKING:
    from rich.tree import Tree

    from jaxlangnav.language.phrase import Parse as ParsedSentence


def parse_text(text: str, output: Output, labels: Collection[str] = ()) -> "ParsedSentence":
    """Parse a sentence and note what was mended or is not known; refuses one not understood.

    ``labels`` are what the detector tells apart.
    """
    if not text.strip():
        raise UsageError('the sentence is empty; say for example "go to the hydrant"')
    from jaxlangnav.language.parser import parse

    parsed = parse(text, labels)
    for written, meant in parsed.repairs:
        output.note(f'note: "{written}" is read as "{meant}"')
    for said, meant in parsed.rewrites:
        if meant:
            output.note(f"note: '{said}' read as '{meant}'")
    for left in parsed.unread:
        output.note(f"note: '{left}' says nothing of the task; left out")
    for word, position in parsed.unknown_words:
        output.note(f'note: "{word}" (word {position}) is not in the lexicon')
    return parsed


def is_template(world: str) -> bool:
    """Tell whether a world's name is that of a template, 2H1C: no file has to be read."""
    return world.strip()[:1].isdigit() and "/" not in world and "." not in world


def _draw_tree(phrase: Mapping[str, Any], branch: "Tree | None" = None) -> "Tree":
    """Draw a phrase, its label and words, and all below it."""
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
                output.say(line)
            return {"form": self.grammar, "grammar": grammar}
        if self.nouns:
            raise UsageError("--nouns needs --grammar")
        document = parse_text(self.text, output).to_dict()
        output.say(_draw_tree(document["tree"]))
        return document
