"""Text from others is data: how it is shown, and when it is refused.

A name in a world file, a word of a sentence, the name of a file may hold escape sequences that
move a terminal's cursor or set its title, letters that turn the direction of writing, line breaks
that forge a line of ours. ``sanitize`` stands at every door where text leaves for a terminal.
"""

import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

LONGEST_NAME = 100
"""Characters that a name may have: of a world, of an object in it, of a sweep."""
_SHOWN = 60
"""Characters of a value that are shown in a message."""


def is_plain(character: str) -> bool:
    """Tell whether a character can be printed as it is: it takes room and moves nothing.

    Control characters, line ends, formats that nobody sees (bidirectional marks, joiners), lone
    surrogates and what Unicode does not know cannot.
    """
    return character.isprintable() or character in "\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}"


def sanitize(text: str, *, keep: str = "") -> str:
    r"""Write a text so that a terminal shows it and does nothing else: ``\x1b``, ``\u202e``.

    ``keep`` are characters that are left as they are, such as line breaks of our own.
    """
    if text.isprintable():
        return text
    # As Python writes them; lone surrogates too.
    return "".join(
        one
        if is_plain(one) or one in keep
        else one.encode("unicode_escape", "surrogatepass").decode("ascii")
        for one in text
    )


def as_text(value: Any) -> str:
    """Write a value of JSON or TOML in a message: a text in quotes, cut to about 60 characters."""
    if isinstance(value, dict) and value:
        return f"a table of {len(value)} keys"
    if isinstance(value, list):
        if len(value) > 8 or any(isinstance(one, list | dict) for one in value):
            return f"a list of {len(value)} entries"
        return shorten(f"[{', '.join(as_text(one) for one in value)}]")
    if isinstance(value, int) and value.bit_length() > 128:
        return f"a whole number of {value.bit_length()} bits"
    try:
        # Cut before it is quoted: a text may have millions of characters.
        written = repr(shorten(value) if isinstance(value, str) else value)
    except Exception:  # an object may fail to write itself, as numbers of 5,000 digits do
        return f"a {type(value).__name__}"
    return shorten(" ".join(written.split()))


def quote(value: Any, most: int = 40) -> str:
    """Write any value in one line of a refusal, a text in quotes; ``most`` characters at most."""
    if isinstance(value, str):  # cut before it is looked through: it may be of any length
        return f"'{shorten(sanitize(' '.join(value[: 2 * most].split())), most)}'"
    try:
        text = str(value)
    except Exception:  # an object may fail to write itself, as numbers of 5,000 digits do
        text = as_text(value)
    return shorten(sanitize(" ".join(text.split())), most)


def shorten(text: str, most: int = _SHOWN) -> str:
    """Cut a text to ``most`` characters; the last of them is an ellipsis for the rest."""
    return text if len(text) <= most else text[: most - 1] + "…"


def name_fault(text: str, *, longest: int = LONGEST_NAME) -> str | None:
    """Say why people cannot be shown a text as a name or sentence, and the remedy; or None."""
    if len(text) > longest:
        return f"has {len(text)} characters but must have at most {longest}: shorten it"
    odd = next((place for place, one in enumerate(text) if not is_plain(one)), None)
    if odd is None:
        return None
    return f"has the control character U+{ord(text[odd]):04X} at place {odd + 1}: remove it"


def check_names(names: Iterable[str], what: str, *, at_most: int) -> tuple[str, ...]:
    """Take names one by one, so many at most, and refuse what is none with a ValueError."""
    try:
        rows = None if isinstance(names, str | bytes) else iter(names)
    except TypeError:
        rows = None
    if rows is None:
        raise ValueError(f"{what} is {quote(names)}, but must be a list of names")
    found: list[str] = []
    for place, name in enumerate(itertools.islice(rows, at_most)):
        if not isinstance(name, str):
            raise ValueError(f"{what}[{place}] is {quote(name)}, but must be a name (a text)")
        if fault := name_fault(name):
            raise ValueError(f"{what}[{place}], {quote(name)}, {fault}")
        found.append(name)
    return tuple(found)


class Plain:
    """Something that rich draws, its text made printable; colours and frames stay."""

    def __init__(self, renderable: "RenderableType") -> None:
        """Wrap a table, a tree, a panel, ..."""
        self.renderable = renderable

    def __rich_console__(
        self, console: "Console", options: "ConsoleOptions"
    ) -> "Iterator[Segment]":
        """Draw; segments of text lose what is not plain, rich's own control codes stay."""
        from rich.segment import Segment

        for text, style, control in console.render(self.renderable, options):
            yield Segment(text if control else sanitize(text, keep="\n"), style, control)


_MARKDOWN = re.compile(r"[\\`*\[\]|~]|(?<!\w)_|_(?!\w)")


def markdown(text: str) -> str:
    r"""Write a text on one line that Markdown shows letter by letter: ``\|``, ``\*``, ``&lt;``."""
    plain = sanitize(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return _MARKDOWN.sub(r"\\\g<0>", plain)


def markdown_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table in Markdown: ``headings``, and rows of as many texts."""
    lines = [[markdown(one) for one in line] for line in (headings, *rows)]
    lines.insert(1, ["---"] * len(headings))
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
