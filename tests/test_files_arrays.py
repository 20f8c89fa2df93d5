"""Arrays from files are numbers of the shape that belongs there, or one line of refusal."""

import io
import random
from pathlib import Path

import numpy as np
import pytest

from jaxlangnav.files.arrays import faults_as_values, parse_floats
from jaxlangnav.planner import prior


def as_npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


@pytest.mark.parametrize("shape", [(), (3,), (2, 3), (0, 4)])
def test_numbers_are_read_as_they_were_written(shape: tuple[int, ...]) -> None:
    array = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    read = parse_floats(as_npy(array))
    np.testing.assert_array_equal(read, array)
    assert read.dtype == array.dtype
    assert read.shape == shape


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x93NUMPY",
        as_npy(np.zeros(3))[:-1],
        as_npy(np.zeros(3, np.float32)) + b"\0",
        as_npy(np.zeros(3)),
        as_npy(np.array([None])),
        as_npy(np.zeros(3, [("a", "f4")])),
        as_npy(np.array(["text"])),
        as_npy(np.array([""])),
        as_npy(np.array([np.inf], np.float32)),
        b"\x93NUMPY\1\0\x10\x27" + b"(" * 10_000,
    ],
)
def test_anything_else_is_refused_in_one_line(content: bytes) -> None:
    with pytest.raises(ValueError, match=r".") as caught:
        parse_floats(content)
    assert str(caught.value).isprintable()


def test_what_a_library_raises_is_said_in_what_can_be_printed() -> None:
    for error in (KeyError("\x1b[31m\n" * 99), RecursionError(), MemoryError()):
        with pytest.raises(ValueError, match=r".") as caught, faults_as_values():
            raise error
        assert str(caught.value).isprintable()
        assert len(str(caught.value)) <= 200


def read_prior(monkeypatch: pytest.MonkeyPatch, file: Path) -> np.ndarray:
    monkeypatch.setattr(prior, "TABLE_FILE", file)
    return prior.table.__wrapped__()


def test_a_damaged_prior_is_sound_or_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped, draw, refused = prior.TABLE_FILE.read_bytes(), random.Random(0), 0
    file = tmp_path / "prior.npy"
    for _ in range(500):
        changed = bytearray(shipped)
        for _ in range(draw.choice((1, 3))):
            changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
        cut = draw.choice((None, None, draw.randrange(len(changed))))
        file.write_bytes(changed[:cut])
        said = ""
        try:
            table = read_prior(monkeypatch, file)
            assert table.shape == (prior.RANGE_BINS, prior.BEARING_BINS)
            assert np.isfinite(table).all()
            assert (table >= 0.0).all()
        except ValueError as error:
            said, refused = str(error), refused + 1
        assert not said or said.startswith(f"{file}: not a table of densities")
        assert said.isprintable()
    assert 50 < refused < 450


@pytest.mark.parametrize(
    "table",
    [np.ones((9, 15)), np.ones((15, 8)), np.ones(135), -np.ones((15, 9)), np.full((15, 9), np.nan)],
)
def test_a_prior_that_is_no_table_of_densities_is_refused(
    tmp_path: Path, table: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "prior.npy", table.astype(np.float32))
    with pytest.raises(ValueError, match="not a table of densities"):
        read_prior(monkeypatch, tmp_path / "prior.npy")


def test_a_prior_that_is_no_file_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for path in (tmp_path, tmp_path / "none", Path("/dev/zero")):
        with pytest.raises(ValueError, match="not a table of densities"):
            read_prior(monkeypatch, path)
