"""Results on disk: whole or not at all, and with all that a repetition needs."""

import dataclasses
import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pytest

from jaxlangnav.episode import lanes
from jaxlangnav.experiments import archive
from jaxlangnav.experiments.archive import CompileClock
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.tasks import SENTENCES, cell, ground_sentences, make_tasks
from jaxlangnav.navigator import default_params
from jaxlangnav.pytree import replace, strong


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    given = {"a": [1]}, pa.table({"a": [1]}), "", jnp.ones(2)
    (path, *_) = archive.write_experiment(tmp_path, "x", *given)
    before = path.read_bytes()

    def full_disk(_table: object, where: Path, **_options: object) -> None:
        Path(where).write_bytes(b"torn")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(archive.pq, "write_table", full_disk)
    with pytest.raises(OSError, match="No space left"):
        archive.write_experiment(tmp_path, "x", *given)
    assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == 4


def test_the_hash_is_of_what_is_held_and_never_of_where() -> None:
    @dataclasses.dataclass(frozen=True)
    class Model:
        weights: np.ndarray
        name: str = "annotation"

    words = np.arange(6, dtype=np.float32).reshape(2, 3)
    whole = archive.pytree_hash({"words": jnp.asarray(words), "bias": jnp.float32(0.5)})
    assert archive.pytree_hash({"bias": np.float32(0.5), "words": words}) == whole
    model = archive.pytree_hash([Model(np.ones(3))])
    assert archive.pytree_hash([Model(np.ones(3))]) == model
    others = [
        {"words": words, "bias": np.float32(0.25)},
        {"words": words.reshape(3, 2), "bias": np.float32(0.5)},
        {"words": words, "offset": np.float32(0.5)},
        [Model(np.zeros(3))],
        [Model(np.ones(3), "behavior")],
    ]
    assert len({whole, model, *map(archive.pytree_hash, others)}) == 7
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


# Compilation is counted once, and does not happen anew for other numbers of the same kind.


@pytest.mark.parametrize(
    ("intervals", "expected"),
    [
        ([], 0.0),
        ([(0.0, 2.0), (5.0, 6.0)], 3.0),
        ([(1.0, 4.0), (0.0, 2.0)], 4.0),
        ([(0.0, 10.0), (2.0, 3.0), (4.0, 11.0)], 11.0),
    ],
)
def test_what_overlaps_is_counted_once(intervals, expected):
    with CompileClock() as clock:
        clock._intervals += intervals
    assert clock.seconds == pytest.approx(expected)


def test_the_clock_counts_compilation_and_not_running() -> None:
    @jax.jit
    def cube(x: jax.Array) -> jax.Array:
        return x * x * x

    given = jnp.arange(3.0)
    with CompileClock() as first:
        cube(given).block_until_ready()
    with CompileClock() as second:
        cube(given).block_until_ready()
    assert first.seconds > 0.0
    assert second.seconds == 0.0, "nothing is compiled a second time"


def test_strong_keeps_values_and_keys() -> None:
    tree = {"plain": 0.5, "weak": jnp.full(3, 2.0), "count": 7, "key": jax.random.key(1)}
    found = strong(tree)
    assert jnp.full(3, 2.0).weak_type
    assert not any(jax.typeof(leaf).weak_type for leaf in jax.tree.leaves(found))
    assert (found["plain"].dtype, found["count"].dtype) == (jnp.float32, jnp.int32)
    assert found["weak"].tolist() == [2.0, 2.0, 2.0]
    assert jax.random.key_data(found["key"]).tolist() == [0, 1]


def test_weak_types_do_not_compile_a_batch_again(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []
    monkeypatch.setattr(
        lanes,
        "_run_batch",
        lambda *arrays, params, count, **sizes: seen.append(
            [jax.typeof(leaf) for leaf in jax.tree.leaves((arrays, params, count))]
        ),
    )
    tasks = make_tasks(cell("1H1C", "null", 0, 3.0, 4, 0))
    instructions = ground_sentences([SENTENCES["null"]]).instructions
    weak = replace(tasks, sensor=replace(tasks.sensor, range_max=jnp.full(4, 2.0)))
    params = default_params()
    other = replace(params, planner=replace(params.planner, discount=0.7))
    for own, numbers, count in ((tasks, params, None), (weak, other, 3)):
        lanes.run_batch(
            own, instructions, params=numbers, config=navigator_config("informed"), count=count
        )
    assert seen[0] == seen[1]
