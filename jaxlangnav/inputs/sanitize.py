"""Escaping of untrusted text for terminals, Markdown and messages, and validation of names.

Names in world files, words of sentences and file names may contain escape sequences that move a
terminal's cursor or set its title, bidirectional marks, or line breaks that forge a line of output.
All text printed to a terminal passes through ``sanitize``.
"""

import difflib
import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType
    from rich.segment import Segment

MAX_NAME = 100
"""Limit of the length of a name: of a world, of an object in it, of a sweep."""
_MAX_SHOWN = 60  # length to which a value is shortened in a message


def is_printable(character: str) -> bool:
    """Tell whether a character is printable without side effects.

    Control characters, line ends, invisible formats (bidirectional marks, joiners), lone surrogates
    and unassigned code points are not.
    """
    return character.isprintable() or character in "\N{NO-BREAK SPACE}\N{NARROW NO-BREAK SPACE}"


def sanitize(text: str, *, keep: str = "") -> str:
    r"""Escape unprintable characters of a text for a terminal: ``\x1b``, ``\u202e``.

    ``keep``: characters that are not escaped, such as line breaks of our own.
    """
    if text.isprintable():
        return text
    # Python's escapes, for lone surrogates too.
    return "".join(
        char
        if is_printable(char) or char in keep
        else char.encode("unicode_escape", "surrogatepass").decode("ascii")
        for char in text
    )


def as_text(value: Any) -> str:
    """Format a JSON or TOML value for a message: texts quoted, about 60 characters at most."""
    if isinstance(value, dict) and value:
        return f"a table of {len(value)} keys"
    if isinstance(value, list):
        if len(value) > 8 or any(isinstance(item, list | dict) for item in value):
            return f"a list of {len(value)} entries"
        return shorten(f"[{', '.join(as_text(item) for item in value)}]")
    if isinstance(value, int) and value.bit_length() > 128:
        return f"a whole number of {value.bit_length()} bits"
    try:
        # Shortened before quoting: a text may have millions of characters.
        representation = repr(shorten(value) if isinstance(value, str) else value)
    except Exception:  # an object may fail to write itself, as numbers of 5,000 digits do
        return f"a {type(value).__name__}"
    return shorten(" ".join(representation.split()))


def quote(value: Any, max_length: int = 40) -> str:
    """Format any value in one line for an error, texts quoted and shortened to ``max_length``."""
    if isinstance(value, str):  # shortened before escaping: it may be of any length
        return f"'{shorten(sanitize(' '.join(value[: 2 * max_length].split())), max_length)}'"
    try:
        text = str(value)
    except Exception:  # an object may fail to write itself, as numbers of 5,000 digits do
        text = as_text(value)
    return shorten(sanitize(" ".join(text.split())), max_length)


def shorten(text: str, max_length: int = _MAX_SHOWN) -> str:
    """Shorten a text to ``max_length`` characters, of which the last is an ellipsis."""
    return text if len(text) <= max_length else text[: max_length - 1] + "…"


def closest(name: str, known: Iterable[str], *, cutoff: float = 0.6) -> str | None:
    """Find the known name closest to a mistyped one, of any case and length; None if none is."""
    by_lower_case = {key.lower(): key for key in known}
    found = difflib.get_close_matches(shorten(name).lower(), by_lower_case, n=1, cutoff=cutoff)
    return by_lower_case[found[0]] if found else None


def did_you_mean(name: str, known: Iterable[str], *, cutoff: float = 0.6) -> str:
    """Suggest the closest known name, '; did you mean "follow"?', or return ""."""
    match = closest(name, known, cutoff=cutoff)
    return f'; did you mean "{match}"?' if match else ""


def name_fault(text: str, *, max_length: int = MAX_NAME) -> str | None:
    """Describe why a text is invalid as a name or sentence, and the remedy; or None."""
    if len(text) > max_length:
        return f"has {len(text)} characters but must have at most {max_length}: shorten it"
    index = next((i for i, char in enumerate(text) if not is_printable(char)), None)
    if index is None:
        return None
    return f"has the control character U+{ord(text[index]):04X} at place {index + 1}: remove it"


def check_names(names: Iterable[str], what: str, *, max_count: int) -> tuple[str, ...]:
    """Validate names, of which at most ``max_count`` are read; ``ValueError`` if one is invalid."""
    try:
        items = None if isinstance(names, str | bytes) else iter(names)
    except TypeError:
        items = None
    if items is None:
        raise ValueError(f"{what} is {quote(names)}, but must be a list of names")
    checked: list[str] = []
    for i, name in enumerate(itertools.islice(items, max_count)):
        if not isinstance(name, str):
            raise ValueError(f"{what}[{i}] is {quote(name)}, but must be a name (a text)")
        if fault := name_fault(name):
            raise ValueError(f"{what}[{i}], {quote(name)}, {fault}")
        checked.append(name)
    return tuple(checked)


class Escaped:
    """Wrapper of a rich renderable that escapes its text and keeps its style."""

    def __init__(self, renderable: "RenderableType") -> None:
        """Wrap a table, a tree, a panel, ..."""
        self.renderable = renderable

    def __rich_console__(
        self, console: "Console", options: "ConsoleOptions"
    ) -> "Iterator[Segment]":
        """Render; text segments are escaped, rich's own control codes are kept."""
        from rich.segment import Segment

        for text, style, control in console.render(self.renderable, options):
            yield Segment(text if control else sanitize(text, keep="\n"), style, control)


_MARKDOWN_SPECIAL = re.compile(r"[\\`*\[\]|~]|(?<!\w)_|_(?!\w)")


def markdown(text: str) -> str:
    r"""Escape a text for Markdown, on one line: ``\|``, ``\*``, ``&lt;``."""
    plain = sanitize(text).replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    return _MARKDOWN_SPECIAL.sub(r"\\\g<0>", plain)


def markdown_table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a table in Markdown: ``headings``, and rows of as many cells."""
    lines = [[markdown(cell) for cell in line] for line in (headings, *rows)]
    lines.insert(1, ["---"] * len(headings))
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
