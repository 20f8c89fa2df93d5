"""TOML and JSON from outside: deep, huge and broken ones end in one line."""

from pathlib import Path

import pytest

from jaxlangnav.inputs.documents import DEEPEST, DocumentError, parse_json, parse_toml, read_text

DEEP = 100_000


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a = " + "[" * DEEP + "]" * DEEP, "nested more than 32 deep"),
        ("a = " + "[" * 40 + "]" * 40, "nested more than 32 deep"),
        ("a = " + "{a = " * DEEP, "nested more than 32 deep"),
        (".".join("a" * DEEP) + " = 1", "a key of more than 32 parts"),
        ("[" + " . ".join(['"a"'] * 50) + "]", "a key of more than 32 parts"),
        ("a = " + "1" * 5000, "a number of too many digits"),
        ("a = 0x" + "f" * 5000, "a whole number of 20000 bits"),
        ("a = 2021-02-31", "no such date|is no valid TOML"),
        ("a = 'x", "is no valid TOML"),
        ("a = 1\n" * 3, "is no valid TOML"),
        ("\x00", "is no valid TOML"),
    ],
    ids=range(11),
)
def test_bad_toml_is_one_line(text: str, says: str) -> None:
    with pytest.raises(DocumentError, match=says) as caught:
        parse_toml(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[" * DEEP + "]" * DEEP, "nested more than 32 deep"),
        ('{"a":' * 40 + "1" + "}" * 40, "nested more than 32 deep"),
        ("1" * 5000, "a number of too many digits"),
        ("[" + "9" * 30 + "]", "a whole number of 100 bits"),
        ("{", "is no valid JSON"),
        ("", "is no valid JSON"),
    ],
    ids=range(6),
)
def test_bad_json_is_one_line(text: str, says: str) -> None:
    with pytest.raises(DocumentError, match=says) as caught:
        parse_json(text)
    assert "\n" not in str(caught.value)


def test_honest_documents_are_read() -> None:
    assert parse_toml("[a.b]\nc = 'a.b.c.d'  # 1.2.3\nd = -1\ne = 1e400\n")["a"]["b"]["d"] == -1
    nested = "[" * DEEPEST + "]" * DEEPEST
    assert parse_json(nested)
    assert parse_json('{"a": [1, 2.5, null, "x"]}') == {"a": [1, 2.5, None, "x"]}
    sentence = "go to the cone. " * 200 + "v1.2.3"
    assert parse_toml(f'a = "{sentence}"') == {"a": sentence}


@pytest.mark.parametrize("part", ["aaaa", '""', "' '", '"', "a.", ". a", "'a' ", "-_-"])
def test_a_long_run_of_key_parts_does_not_keep_the_reader_busy(part: str) -> None:
    """With the square of its length, or worse, this would take hours."""
    with pytest.raises(DocumentError):
        parse_toml(part * 500_000)


def test_text_that_is_none_is_named(tmp_path: Path) -> None:
    path = tmp_path / "words.toml"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match=r"words.toml: is no text: save it as UTF-8"):
        read_text(path, at_most=10)
