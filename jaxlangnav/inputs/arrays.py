"""Reading of untrusted NumPy files (``.npy``, ``.npz``) with validated headers and sizes.

An archive may declare wrong sizes, contain a name twice, or contain pickled Python objects. So
nothing is decompressed or allocated before the declared sizes have been compared with the expected
ones, and only numbers and text are read.
"""

import contextlib
import io
import math
import warnings
import zipfile
from collections.abc import Iterator

import numpy as np

from jaxlangnav.inputs.sanitize import sanitize

_MAX_HEADER_BYTES = 4096  # limit of a header's bytes; NumPy's own have 128
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


@contextlib.contextmanager
def as_value_error() -> Iterator[None]:
    """Context that converts any exception of a parser into a one-line ``ValueError``."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    except Exception as error:  # zipfile, zlib, numpy and json have a dozen kinds
        message = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(sanitize(message)[:200]) from error


def open_arrays(content: bytes) -> zipfile.ZipFile:
    """Open an archive of arrays (``.npz``) from bytes; ValueError for a duplicate name."""
    with as_value_error():
        archive = zipfile.ZipFile(io.BytesIO(content))
        if len(set(archive.namelist())) < len(archive.namelist()):
            raise ValueError("a name stands in it twice")
        return archive


def read_floats(archive: zipfile.ZipFile, name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Read an array of a given shape: f32, finite, read-only; otherwise ValueError."""
    with as_value_error():
        array = parse_floats(_read_member(archive, name, 4 * math.prod(shape) + _MAX_HEADER_BYTES))
        if array.shape != shape:
            raise ValueError(f"{name} has shape {array.shape}, not {shape}")
        return array


def read_text_entry(archive: zipfile.ZipFile, name: str, *, max_length: int) -> str:
    """Read a text, a 0-d array of at most ``max_length`` characters; otherwise ValueError."""
    with as_value_error():
        array = _parse_array(_read_member(archive, name, 4 * max_length + _MAX_HEADER_BYTES))
        if array.dtype.kind != "U" or array.shape != ():
            raise ValueError(f"{name} is {array.dtype} of shape {array.shape}, not one text")
        return str(array)


def parse_floats(content: bytes) -> np.ndarray:
    """Parse the bytes of a ``.npy`` file: f32[...], finite, read-only; otherwise ValueError."""
    with as_value_error():
        array = _parse_array(content)
        if array.dtype != np.float32:
            raise ValueError(f"numbers are {array.dtype}, not float32")
        if not np.isfinite(array).all():
            raise ValueError("a number is not finite")
        return array


def _read_member(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    """Decompress a file of an archive, which verifies its checksum."""
    if f"{name}.npy" not in archive.namelist():
        raise ValueError(f"{name} is missing")
    info = archive.getinfo(f"{name}.npy")
    if info.file_size > max_bytes:
        raise ValueError(f"{name} has {info.file_size:,} bytes; at most {max_bytes:,} belong there")
    if info.compress_type not in _COMPRESSIONS:
        raise ValueError(f"{name} is compressed in an unknown way")
    with archive.open(info) as file:
        return file.read(max_bytes + 1)


def _parse_array(content: bytes) -> np.ndarray:
    """Parse numbers or text, with exactly as many bytes as the header declares."""
    stream, npy = io.BytesIO(content), np.lib.format
    if npy.read_magic(stream) != (1, 0):
        raise ValueError("not of NumPy's format 1.0")
    shape, is_fortran, dtype = npy.read_array_header_1_0(stream, max_header_size=_MAX_HEADER_BYTES)
    body = content[stream.tell() :]
    if dtype.kind not in "fU" or dtype.itemsize == 0 or is_fortran:
        raise ValueError(f"holds {dtype}, not numbers or text in rows")
    if math.prod(shape) * dtype.itemsize != len(body):
        raise ValueError(f"promises shape {shape} of {dtype}, holds {len(body):,} bytes")
    return np.frombuffer(body, dtype).reshape(shape)
