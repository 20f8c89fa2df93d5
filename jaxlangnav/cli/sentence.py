"""What every command does with a sentence: check that there is one, parse it, draw it."""

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

from jaxlangnav.cli.errors import UsageError
from jaxlangnav.cli.output import Output

if TYPE_CHECKING:
    from rich.text import Text

    from jaxlangnav.language.phrase import Parse


def parse_text(text: str, output: Output, labels: Collection[str] = ()) -> "Parse":
    """Parse a sentence and tell the person what was mended or not known.

    Args:
        text: what was typed.
        output: where repairs and unknown words are noted.
        labels: what the detector tells apart.

    Returns:
        The parse.

    Raises:
        UsageError: there is no text.
        LanguageError: the text is not understood; one line that names the word.
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


def draw_tree(phrase: Mapping[str, Any]) -> Any:
    """Draw a phrase and all below it.

    Args:
        phrase: nested ``label``, ``words`` (each ``text`` and ``tag``) and ``children``.

    Returns:
        A rich tree.
    """
    from rich.tree import Tree

    root = Tree(_phrase_line(phrase))
    _grow(root, phrase)
    return root


def _grow(branch: Any, phrase: Mapping[str, Any]) -> None:
    """Add a phrase's children to its branch."""
    for child in phrase["children"]:
        _grow(branch.add(_phrase_line(child)), child)


def _phrase_line(phrase: Mapping[str, Any]) -> "Text":
    """Write a phrase's label and words."""
    from rich.text import Text

    words = [(word["text"], (f"/{word['tag']}", "dim")) for word in phrase["words"]]
    parts = [part for text, tag in words for part in (" ", text, tag)]
    return Text.assemble((phrase["label"], "bold cyan"), *parts)
