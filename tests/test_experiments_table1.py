"""Table 1's protocol."""

import numpy as np
import pytest

from jaxlangnav.experiments.table1 import draw_splits, evaluate, render, summarise
from jaxlangnav.grounding.evaluation import Scores


def test_a_third_is_held_out_and_splits_differ():
    held_out = draw_splits(39, 20, seed=0)
    assert (held_out.sum(1) == 13).all()
    assert len({row.tobytes() for row in held_out}) == 20
    np.testing.assert_array_equal(held_out, draw_splits(39, 20, seed=0))


def test_interval_by_hand():
    scores = [Scores(np.array(right), np.ones(2), np.zeros(2)) for right in ([1, 1], [1, 0])]
    mean, interval = summarise(scores)
    assert mean == 75.0
    assert interval == pytest.approx(1.96 * np.std([100, 50], ddof=1) / np.sqrt(2))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"splits": 1}, "at least 2"),
        ({"beams": (0,)}, "1 or more"),
        ({"without": ("smell",)}, "unknown features"),
    ],
)
def test_bad_requests_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        evaluate(**arguments)


@pytest.mark.slow
def test_protocol_end_to_end():
    done = []
    document = evaluate(splits=4, beams=(4, 1), on_progress=done.append)
    assert done == [1] * 4
    for name in ("annotation", "behavior"):
        row = document[name]
        assert row["splits"] == 4
        assert row["accuracy_mean"] >= 80.0
        assert row["train_s"] < 20.0
        assert {"accuracy_ci95", "train_compile_s", "infer_s", "examples", "features"} <= set(row)
        assert set(row["beams"]) == {"4", "1"}
    # The size of the paper's training set: 83,547 examples.
    assert 70_000 < document["annotation"]["examples"] < 100_000
    assert render(document).row_count == 8
