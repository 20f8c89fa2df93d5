"""The command line under hostile input: exit code 2, one line, and a terminal that stays still."""

import io
import json
import os
import subprocess
import sys
from typing import Any

import pytest

from jaxlangnav.cli import main as cli
from jaxlangnav.cli.output import Output, platform_fault, write_document
from jaxlangnav.language.parser import parse
from jaxlangnav.language.phrase import LanguageError

ANSI = "\x1b[31mred\x1b]0;title\x07\u202e\x9b2J"
MARKUP = "[red]x[/red] [link=https://example.org]y[/link] :skull:"


def refused(words: list[str], capsys: pytest.CaptureFixture[str], *, lines: int = 1) -> str:
    """Run, and return the one line of the refusal, the last where there are notes before it."""
    assert cli.main(words) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == lines
    line = captured.err.splitlines()[-1]
    assert line.startswith("jaxlangnav: ")
    assert "internal" not in line
    assert line.isprintable()
    assert len(line) < 700
    return line


def document(words: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    """Run with ``--json``, and return the one document."""
    assert cli.main([*words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_escape_sequences_of_a_sentence_are_shown_not_sent(capsys):
    refused(["parse", f"go to the {ANSI}"], capsys)
    refused([ANSI], capsys)
    refused(["parse", "x", f"--{ANSI}"], capsys)
    refused(["follow", "go to the cone", "--world", ANSI], capsys)
    refused(["follow", "go to the cone", "--policy", ANSI], capsys)


def test_a_value_of_any_length_is_cut(capsys: pytest.CaptureFixture[str]) -> None:
    refused(["follow", "go to the cone", "--world", "x" * 100_000], capsys)
    refused(["follow", "go to the cone", "--world", "x/" * 100_000], capsys)
    refused(["follow", "go to the cone", "--world", "9" * 5000 + "H1C"], capsys)
    refused(["follow", "go to the cone", "--seed", "9" * 5000], capsys)
    line = refused(["ground", "go to the cone", "--world", "x" * 5000 + ".toml"], capsys)
    assert "xxx" in line
    # The reason is not pushed out.
    assert "shipped worlds are" in line or "too long" in line.lower()


@pytest.mark.parametrize("far", ["1e39", "1e400", "nan", "-1", "0", "1e-46"])
def test_a_range_beyond_single_precision_is_refused(far, capsys):
    assert "--range is" in refused(["follow", "go to the cone", "--range", far], capsys)


def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "zero.toml").symlink_to("/dev/zero")
    for name in ("pipe.toml", "zero.toml"):
        path = str(tmp_path / name)
        said = "go to the cone"
        assert "not a regular file" in refused(["ground", said, "--world", path, "--json"], capsys)
        assert "not a regular file" in refused(
            ["sweep", path, "--out", str(tmp_path / "o")], capsys
        )
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("text", [ANSI, "a\nb", "lone \ud800"])
def test_every_way_out_makes_text_printable(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    from rich.table import Table

    output, table = Output(is_json=False), Table(title=text)
    table.add_column(text)
    table.add_row(text)
    output.say(text, table)
    output.tell([text])
    output.note(text)
    captured = capsys.readouterr()
    assert all(one.isprintable() for one in (captured.out + captured.err).split("\n"))


def test_markup_in_text_from_others_is_not_read(capsys: pytest.CaptureFixture[str]) -> None:
    from rich.table import Table

    table = Table(title=MARKUP)
    table.add_column(MARKUP)
    table.add_row(MARKUP)
    Output(is_json=False).say(MARKUP, table)
    assert capsys.readouterr().out.count(MARKUP) == 4


def test_the_document_steers_no_terminal_and_loses_nothing(capsys):
    text = f"{ANSI} “é” 𝄞 \x7f\u2028 \U000e0041"
    write_document({"text": text})
    told = capsys.readouterr().out
    assert all(one.isprintable() for one in told.split("\n"))
    assert json.loads(told) == {"text": text}
    assert "“é”" in told


def test_a_terminal_without_unicode_is_served(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(raw, "ascii"))
    assert cli.main(["parse", "go to the “cone”", "--json"]) == 0
    assert json.loads(raw.getvalue().decode("ascii"))["instruction"] == "go to the “cone”"
    assert cli.main(["parse", "go to the “cone”"]) == 0


def test_a_platform_that_is_not_there_is_named() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "jaxlangnav", "ground", "go to the cone"],
        env={**os.environ, "JAX_PLATFORMS": "\x1b[31m"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith('jaxlangnav: JAX_PLATFORMS is "\\x1b[31m", but JAX')
    assert done.stderr.count("\n") == 1


def test_one_missing_platform_of_several_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """JAX fails the first time and then goes on with what it has found."""
    monkeypatch.setenv("JAX_PLATFORMS", "cpu,nope")
    failure = RuntimeError("Unable to initialize backend 'nope': unknown")
    assert str(platform_fault(failure)).startswith('JAX_PLATFORMS is "cpu,nope", but')
    assert platform_fault(RuntimeError("something else")) is None


def test_a_bad_world_is_refused_before_anything_is_told(tmp_path, capsys):
    (tmp_path / "bad.toml").write_text("nothing = 1")
    refused(["ground", "go to the hydrant", "--world", str(tmp_path / "bad.toml")], capsys)


@pytest.mark.parametrize("text", ["go to the zorb\x07", "Stop! \x1b[31m", "go\x00 to"])
def test_a_refusal_of_a_sentence_cannot_act_on_a_terminal(text: str) -> None:
    with pytest.raises(LanguageError) as caught:
        parse(text)
    assert str(caught.value).isprintable()
