"""``jaxlangnav parse``: the phrase tree of a sentence (section 3.1)."""

import dataclasses

import tyro

from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.sentence import draw_tree, parse_text


@dataclasses.dataclass(frozen=True, kw_only=True)
class Parse:
    """Show the phrases of a sentence.

    Examples:
      jaxlangnav parse "go to the hydrant behind the cone"
      jaxlangnav parse "find the nearest car" --json
    """

    text: tyro.conf.Positional[str]
    """The sentence, in quotes."""
    json: bool = False
    """Print one JSON document: instruction, tree, unknown_words."""

    def run(self, output: Output) -> Document:
        """Parse the sentence and draw its tree."""
        document = parse_text(self.text, output).to_dict()
        output.say(draw_tree(document["tree"]))
        return document
