"""Compilation is counted once, and does not happen anew for other numbers of the same kind."""

import jax
import jax.numpy as jnp
import pytest

from jaxlangnav import lanes
from jaxlangnav.experiments.compilation import CompileClock, union_length
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.experiments.sentences import SENTENCES, ground_sentences
from jaxlangnav.experiments.tasks import cell, make_tasks
from jaxlangnav.navigator import default_params
from jaxlangnav.pytree import replace, strong


@pytest.mark.parametrize(
    ("intervals", "expected"),
    [
        ([], 0.0),
        ([(0.0, 2.0), (5.0, 6.0)], 3.0),
        ([(1.0, 4.0), (0.0, 2.0)], 4.0),
        ([(0.0, 10.0), (2.0, 3.0), (4.0, 11.0)], 11.0),
    ],
)
def test_union_length(intervals: list[tuple[float, float]], expected: float) -> None:
    assert union_length(intervals) == pytest.approx(expected)


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
