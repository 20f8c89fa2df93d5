"""``jaxlangnav parse``: the phrase tree of a sentence (section 3.1)."""

import dataclasses
from typing import Annotated, Literal

import tyro

from jaxlangnav.cli.errors import UsageError
from jaxlangnav.cli.output import Document, Output
from jaxlangnav.cli.sentence import draw_tree, parse_text


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
        output.say(draw_tree(document["tree"]))
        return document
