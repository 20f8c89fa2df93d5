"""Text from others never does anything: neither to a terminal nor in Markdown."""

import io
import unicodedata

import pytest
from hypothesis import given, strategies as st

from jaxlangnav.inputs.sanitize import (
    MAX_NAME,
    Escaped,
    as_text,
    markdown,
    markdown_table,
    name_fault,
    sanitize,
    shorten,
)

HOSTILE = [
    "\x1b[31mred\x1b[0m",  # colours
    "\x1b]0;title\x07",  # sets a terminal's title
    "\x1b]8;;https://example.org\x1b\\link\x1b]8;;\x1b\\",  # a link of OSC 8
    "\x9b2J",  # clears the screen, by one character of C1
    "hydrant\rcone",
    "hydrant\njaxlangnav: all is well",
    "\u202egnitirw\u202c",
    "\u2066isolate\u2069",
    "\u2028line",
    "NUL\x00",
    "bell\x07\x08\x7f",
    "zero\u200bwidth\ufeff",
    "lone \ud800 surrogate",
]


PLAIN = ["", "go to the hydrant", "Äpfel, 12 m · “cone” → 90 %", "消火栓", "a\u00a0m", "[red]"]


@pytest.mark.parametrize("text", HOSTILE + PLAIN)
def test_what_is_plain_stays_as_it_is_and_nothing_else(text: str) -> None:
    is_printable, written = text in PLAIN, sanitize(text)
    assert (written == text) is is_printable
    assert ("\\" in written) is not is_printable
    assert (name_fault(text) is None) is is_printable
    written.encode("utf-8")


@given(st.text(st.characters()))
def test_no_text_whatever_leaves_a_control_character(text: str) -> None:
    kinds = {unicodedata.category(one) for one in sanitize(text)}
    assert not kinds & {"Cc", "Cf", "Cs", "Zl", "Zp"}
    assert sanitize("a\nb\x1b", keep="\n") == "a\nb\\x1b"


def test_a_name_of_absurd_length_is_a_fault() -> None:
    assert name_fault("x" * MAX_NAME) is None
    assert str(name_fault("x" * 5000)).startswith("has 5000 characters")


@pytest.mark.parametrize(
    "value",
    [10**5000, -(10**5000), "x" * 10**6, [[]] * 10**5, {"a": 1}, ["\x1b" * 100] * 8, 1e300, None],
    ids=range(8),
)
def test_a_value_in_a_message_is_short(value: object) -> None:
    assert 0 < len(as_text(value)) <= 70
    assert as_text(value).isprintable()


def test_deep_values_are_shown_without_recursion() -> None:
    deep: list = []
    for _ in range(100_000):
        deep = [deep]
    assert as_text(deep) == "a list of 1 entries"


def test_short_values_are_shown_in_full() -> None:
    assert as_text("hydrant") == "'hydrant'"
    assert as_text([1, 2]) == "[1, 2]"
    assert shorten("abcdef", 4) == "abc…"


def test_what_rich_draws_is_made_printable_and_keeps_its_colours() -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title="\x1b]0;title\x07")
    table.add_column("\x9b2J")
    table.add_row(Text("cell \x1b[2J \u202e", style="red"))
    file = io.StringIO()
    Console(file=file, force_terminal=True, color_system="standard", width=60).print(Escaped(table))
    told = file.getvalue()
    assert "\x1b[31m" in told  # ours
    assert not any(one in told for one in ("\x1b]0", "\x07", "\x1b[2J", "\x9b", "\u202e"))
    assert "\\x1b[2J" in told


def test_markdown_shows_every_sign() -> None:
    text = "a|b <script> [x](http://y) **b** `c` _d_ odometry_noise\nnext &lt; \\ ~~s~~"
    written = markdown(text)
    assert "\n" not in written
    assert written == (
        r"a\|b &lt;script&gt; \[x\](http://y) \*\*b\*\* \`c\` \_d\_ odometry_noise\\nnext"
        r" &amp;lt; \\ \~\~s\~\~"
    )
    assert markdown("2H1C 97.5 (93.1-99.2) 3.20 ± 0.1") == "2H1C 97.5 (93.1-99.2) 3.20 ± 0.1"


def test_a_cell_cannot_break_its_table() -> None:
    written = markdown_table(["world", "m"], [["a|b\n| c |", "1"]])
    lines = written.splitlines()
    assert len(lines) == 3
    assert lines[1] == "| --- | --- |"
    assert lines[2] == r"| a\|b\\n\| c \| | 1 |"
