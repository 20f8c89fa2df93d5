"""Table 1's protocol."""

import numpy as np
import pytest
from grounding_fixture import TYPES, corpus

from jaxlangnav.experiments.table1 import _accuracy, _on_new_words, draw_splits, evaluate, table_1
from jaxlangnav.grounding import load_shipped
from jaxlangnav.training.scoring import Models, Scores, score_annotations, score_behaviors


def test_a_third_is_held_out_and_splits_differ():
    held_out = draw_splits(39, 20, seed=0)
    assert (held_out.sum(1) == 13).all()
    assert len({row.tobytes() for row in held_out}) == 20
    np.testing.assert_array_equal(held_out, draw_splits(39, 20, seed=0))


def test_new_words_are_those_of_no_training_sentence():
    instructions = corpus(
        num_worlds=0,
        sentences=("go to the box", "find the box", "go to the cone", "find the boxes"),
    )
    # Without the first and the third nobody has said "go" or "cone"; "boxes" is the lemma "box".
    held_out = np.array([[True, False, True, False], [True, False, False, True]])
    scores = [Scores(np.array(right), np.ones(2), np.zeros(2)) for right in ([1, 0], [1, 1])]
    found = _on_new_words("annotation", instructions, scores, held_out)
    assert found == {"accuracy_mean": 50.0, "share": 0.5}


def test_interval_by_hand():
    scores = [Scores(np.array(right), np.ones(2), np.zeros(2)) for right in ([1, 1], [1, 0])]
    interval = round(1.96 * np.std([100, 50], ddof=1) / np.sqrt(2), 2)
    assert _accuracy(scores) == {"accuracy_mean": 75.0, "accuracy_ci95": interval}


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


def test_exact_scores_are_those_of_the_beam_where_both_are_sure():
    model = load_shipped()
    instructions = corpus(
        num_worlds=2,
        sentences=("go to the box near the tree", "find the car", "go to the other box"),
    )
    both = [Models.of([one]) for one in (model.annotation, model.behavior)]
    found = score_annotations(instructions, both[0], None, TYPES, is_exact=True)
    beam, exact = found.by_width[4][0], found.exact[0]
    assert exact.is_proven.all()
    np.testing.assert_array_equal(exact.is_right, beam.is_right)
    found = score_behaviors(instructions, *both, None, TYPES, is_exact=True)
    beam, exact = found.by_width[4][0], found.exact[0]
    assert exact.is_right.shape == (6,)
    np.testing.assert_array_equal(exact.is_right, beam.is_right)
    # Half of the probability in one set proves it.
    assert exact.is_proven[beam.confidence > 0.5].all()


@pytest.mark.slow
def test_protocol_end_to_end():
    done = []
    document = evaluate(splits=4, beams=(4, 1), is_exact=True, on_progress=done.append)
    assert sum(done) == 4
    for name in ("annotation", "behavior"):
        row = document[name]
        assert row["splits"] == 4
        assert row["accuracy_mean"] >= 80.0
        assert row["train_s"] < 20.0
        assert {"accuracy_ci95", "train_compile_s", "infer_s", "examples", "features"} <= set(row)
        assert set(row["beams"]) == {"4", "1", "exact"}
        assert row["beams"]["4"]["accuracy_mean"] == row["accuracy_mean"]
        assert 0.0 <= row["new_words"]["accuracy_mean"] <= 100.0
        # A third of the corpus has a word that occurs once: it is held out as often as not.
        assert 0.2 < row["new_words"]["share"] < 0.6
        # A beam may miss the likeliest set, and where it is found nothing changes.
        assert row["beams"]["exact"]["proven"] >= 0.95
        assert row["beams"]["exact"]["accuracy_mean"] == pytest.approx(
            row["accuracy_mean"], abs=5.0
        )
    # The size of the paper's training set: 83,547 examples.
    assert 70_000 < document["annotation"]["examples"] < 100_000
    assert len(table_1(document).rows) == 11
