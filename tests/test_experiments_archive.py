"""Results on disk: whole or not at all, and with all that a repetition needs."""

import dataclasses
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest

from jaxlangnav.experiments import archive


def test_a_table_comes_back_as_it_was_written(tmp_path: Path) -> None:
    columns = {
        "world": ["1H1C", "2H1C", "2H1C"],
        "distance": np.array([8.5, 12.25, 3.0], np.float32),
        "is_success": np.array([True, False, True]),
        "final": np.arange(6, dtype=np.float32).reshape(3, 2),
    }
    path = archive.write_table(columns, tmp_path / "new" / "episodes.parquet")
    table = pq.read_table(path).to_pydict()
    assert table["world"] == columns["world"]
    assert table["distance"] == [8.5, 12.25, 3.0]
    assert table["is_success"] == [True, False, True]
    assert table["final"] == [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]
    assert [entry.name for entry in path.parent.iterdir()] == ["episodes.parquet"]


def test_a_failed_write_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = archive.write_table({"a": [1]}, tmp_path / "episodes.parquet")
    before = path.read_bytes()

    def full_disk(_table: object, where: Path, **_options: object) -> None:
        Path(where).write_bytes(b"torn")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(archive.pq, "write_table", full_disk)
    with pytest.raises(OSError, match="No space left"):
        archive.write_table({"a": [2]}, path)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["episodes.parquet"]


def test_columns_of_different_lengths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="different lengths"):
        archive.write_table({"a": [1, 2], "b": [1]}, tmp_path / "episodes.parquet")


def test_the_hash_tells_weights_apart() -> None:
    weights = {"words": jnp.arange(6.0).reshape(2, 3), "bias": jnp.float32(0.5)}
    same = {"bias": np.float32(0.5), "words": np.arange(6, dtype=np.float32).reshape(2, 3)}
    assert archive.pytree_hash(weights) == archive.pytree_hash(same)
    for other in (
        {**weights, "bias": jnp.float32(0.25)},
        {**weights, "words": weights["words"].reshape(3, 2)},
        {"words": weights["words"], "offset": weights["bias"]},
    ):
        assert archive.pytree_hash(other) != archive.pytree_hash(weights)


def test_a_hash_is_of_what_is_held_and_never_of_where() -> None:
    @dataclasses.dataclass(frozen=True)
    class Model:
        weights: np.ndarray
        name: str = "annotation"

    one, other = Model(np.ones(3)), Model(np.ones(3))
    assert archive.pytree_hash(one) == archive.pytree_hash(other)
    assert archive.pytree_hash(one) != archive.pytree_hash(Model(np.zeros(3)))
    assert archive.pytree_hash(one) != archive.pytree_hash(Model(np.ones(3), "behavior"))
    assert archive.pytree_hash({"both": [one]}) == archive.pytree_hash({"both": [other]})
    with pytest.raises(ValueError, match="it has no hash"):
        archive.pytree_hash({"thing": object()})


def test_a_manifest_says_how(tmp_path: Path) -> None:
    document = archive.manifest({"seed": 3, "episodes": 100}, models={"w": jnp.ones(2)})
    path = archive.write_manifest(document, tmp_path / "manifest.json")
    read = json.loads(path.read_text("utf-8"))
    assert read == document
    assert read["settings"] == {"seed": 3, "episodes": 100}
    assert len(read["models_sha256"]) == 64
    assert set(read["libraries"]) >= {"jax", "numpy"}
