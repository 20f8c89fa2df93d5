"""The trained reader: its mathematics against enumeration, what it reads, what never goes."""

import itertools
import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxlangnav.language.parser import Sentence, parse
from jaxlangnav.language.phrase import LanguageError
from jaxlangnav.language.reader import model as crf
from jaxlangnav.language.reader.proposals import propose_readings
from jaxlangnav.training.reader import (
    Batch,
    ReaderConfig,
    ReaderWeights,
    align,
    fit_acceptance,
    label_lines,
    negative_log_likelihood,
    read_reader_corpus,
    train_reader,
)

NAMES = ("post office", "bench", "tree", "statue", "barn", "silo", "kiosk", "gate", "flower")


def goals(text: str) -> list[str]:
    """Write what a sentence asks for without its verbs: they differ, and mean the same."""
    return [", ".join(map(str, root.children)) for root in parse(text, NAMES).clauses]


@pytest.mark.parametrize(
    ("said", "plain"),
    [
        ("would it be at all possible for somebody to go to the barn", "go to the barn"),
        ("my cousin from lyon has been so angry, go to the gate", "go to the gate"),
        ("could you zip to the barn, oops, my mistake, to the silo", "go to the silo"),
        ("go to the barn, sorry, go to the silo", "go to the silo"),
        ("can you go look for it, the statue", "look for the statue"),
    ],
)  # fmt: skip
def test_words_are_left_out_by_their_class(said, plain):
    assert goals(said) == goals(plain)


@pytest.mark.parametrize(
    ("said", "kept"),
    [
        ("honestly, zip to the barn and stay away from the gate", "avoid"),
        ("my legs hurt, mosey over to the second statue on the left", "second"),
    ],
)
def test_what_tells_how_or_which_stays(said, kept):
    words = [word for root in parse(said, NAMES).clauses for word in root.all_words()]
    senses = {sense for word in words for sense in word.senses}
    assert kept in {word.text for word in words} or (kept == "avoid" and "constraint" in senses)


@pytest.mark.parametrize(
    "text",
    [
        # leaving it out would choose another thing
        "the red statue is broken. go to the statue",
        "go to the tree, i mean, go to the barn",
        "i lost my dog, mosey to the tree and look for it",
        "mosey back to the place where we were this morning",
        "go to gate 3",
        "counting from the left, go to the second tree",
        "mosey 3 lengths past the barn",
        "go minus two metres forward",
        "mosey to the tree behind the barn, i mean in front of it",
        "go to the tree the barn should be left of",
        # or what is to be avoided
        "avoid going to the barn, go to the tree",
        "go to the tree but avoid the barn, the bench and the statue",
        "go forward 3 metres, sorry, 4 metres",
        # or turn the meaning round
        "i told him never to go to the tree",
        "go to the tree the barn is behind",
        "if you see a dog, mosey to the tree",
        "mosey to the tree or the barn",
        "mosey closer to the barn, but not too close",
        # or leave out an order that the robot cannot follow
        "grab my coat, then mosey to the tree",
        "let's do the statue first and after that the barn",
        "turn left at the tree and mosey to the barn",
        "ok now please turn and mosey to the tree",
    ],
)  # fmt: skip
def test_what_could_choose_or_turn_round_is_never_left_out(text):
    with pytest.raises(LanguageError):
        parse(text, NAMES)


def test_what_can_be_read_is_not_changed():
    assert parse("zip over to the tree", NAMES).rewrites == ()
    (clause,) = parse("go to the bench behind the tree", NAMES).clauses
    assert str(clause) == "VP[go]{PP[to]{NP[]{NP[the bench], PP[behind]{NP[the tree]}}}}"


def test_a_turn_before_a_goal_is_kept():
    assert len(parse("uh so like turn around and um go to the gate", NAMES).clauses) == 2


STEPS, SIZE, FEATURES = 4, 3, 5


def chain(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(STEPS, SIZE)), rng.normal(size=(SIZE, SIZE))


def enumerated(scores: np.ndarray, transition: np.ndarray) -> dict[tuple[int, ...], float]:
    """Score every labelling."""
    return {
        path: sum(scores[t, y] for t, y in enumerate(path))
        + sum(transition[a, b] for a, b in itertools.pairwise(path))
        for path in itertools.product(range(SIZE), repeat=STEPS)
    }


@pytest.mark.parametrize("seed", range(3))
def test_sums_and_best_labellings_are_those_of_enumeration(seed):
    scores, transition = chain(seed)
    every = enumerated(scores, transition)
    total = np.logaddexp.reduce(list(every.values()))
    assert crf.log_partition(scores, transition) == pytest.approx(total, abs=1e-9)
    best = sorted(every.items(), key=lambda one: -one[1])[:7]
    found = crf.find_best(scores, transition, 7)
    assert [path for _, path in found] == [path for path, _ in best]
    np.testing.assert_allclose([score for score, _ in found], [score for _, score in best])


def test_the_likelihood_is_that_of_enumeration():
    rng = np.random.default_rng(3)
    weights = ReaderWeights(
        emission=jnp.asarray(rng.normal(size=(FEATURES + 1, SIZE)), jnp.float32),
        transition=jnp.asarray(rng.normal(size=(SIZE, SIZE)), jnp.float32),
        begin=jnp.asarray(rng.normal(size=SIZE), jnp.float32),
        end=jnp.asarray(rng.normal(size=SIZE), jnp.float32),
    )
    features = rng.integers(0, FEATURES + 1, size=(1, STEPS + 2, 2))
    labels = rng.integers(0, SIZE, size=(1, STEPS + 2))
    is_word = (np.arange(STEPS + 2) < STEPS)[None].astype(np.float32)
    batch = Batch(features.astype(np.int32), labels.astype(np.int32), is_word, np.ones(1, "f4"))
    emission = np.array(weights.emission)
    emission[0] = 0.0
    scores = emission[features[0, :STEPS]].sum(axis=1)
    scores[0] += weights.begin
    scores[-1] += weights.end
    every = enumerated(scores, np.asarray(weights.transition))
    own = every[tuple(labels[0, :STEPS].tolist())]
    expected = np.logaddexp.reduce(list(every.values())) - own
    assert float(negative_log_likelihood(weights, batch)) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize(
    ("said", "read", "labels"),
    [
        ("um go to the cone", "go to the cone", "D K K K K"),
        ("mosey over to the cone", "go to the cone", "=go D K K K"),
        ("go to cone", "go to the cone", None),
        ("go to the cone", "go to the cone quickly", ""),
    ],
)
def test_labels_come_from_aligning_words(said, read, labels):
    found = align(said.split(), read.split())
    if labels is None:
        assert any(label.startswith("K>") for label in found)
    else:
        assert found == (tuple(labels.split()) or None)


def test_acceptance_is_the_share_that_was_right():
    """One feature tells two kinds of rewritings apart: each is accepted as often as it is right."""
    is_odd = np.arange(4000) % 2
    is_right = np.random.default_rng(0).random(4000) < np.where(is_odd, 0.2, 0.9)
    rows = [{"bias": 1.0, "odd": float(odd)} for odd in is_odd]
    weights = fit_acceptance([*rows, {"rare": 1.0}], np.append(is_right, True))
    assert weights.keys() == {"bias", "odd"}
    for odd in (0, 1):
        accepted = 1 / (1 + np.exp(-weights["bias"] - odd * weights["odd"]))
        assert accepted == pytest.approx(is_right[is_odd == odd].mean(), abs=0.03)


def test_a_reader_learns_what_is_left_out_and_is_written_and_read(tmp_path: Path, monkeypatch):
    names = ["cone", "tree", "car", "bench", "box", "barrel"]
    rows = [
        {"text": f"{verb} to the {name}, {talk} {other}", "read": f"{verb} to the {name}"}
        for verb, name in itertools.product(["go", "drive"], names)
        for talk in ("thanks dear", "thanks a", "much obliged dear")
        for other in ("friend", "mate", "fellow", "soul")
    ]
    file = tmp_path / "own.jsonl"
    file.write_text("\n".join(map(json.dumps, rows)))
    config = ReaderConfig(epochs=10, batch=48, least_features=1)
    model, report = train_reader(label_lines(read_reader_corpus(file)), config=config)
    assert report["sentences"] >= len(rows)
    again, _ = train_reader(label_lines(read_reader_corpus(file)), config=config)
    np.testing.assert_array_equal(model.emission, again.emission)
    path = tmp_path / "own.npz"
    crf.save_reader(path, model, command="test")
    monkeypatch.setenv(crf.READER_ENV, str(path))
    crf.load_reader.cache_clear()
    try:
        assert crf.load_reader().labels == model.labels
        first = propose_readings(Sentence("walk to the tree, thanks dear friend", ()).tokens)[0]
        assert [token.text for token in first.tokens] == ["walk", "to", "the", "tree"]
        assert first.left_out == ("thanks dear friend",)
        path.write_bytes(b"none")
        crf.load_reader.cache_clear()
        with pytest.raises(LanguageError, match="no reader can be read"):
            crf.load_reader()
    finally:
        crf.load_reader.cache_clear()


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ('{"text": "go"}', "line 1: read is missing"),
        ('{"text": 3, "read": null}', "line 1: text is 3"),
        ('{"text": "go", "read": null, "names": 5}', "line 1: names is 5"),
        ("[]", "line 1: the document is"),
        ("{", "line 1: "),
    ],
)
def test_a_bad_line_of_the_corpus_is_named(tmp_path: Path, line: str, says: str) -> None:
    file = tmp_path / "own.jsonl"
    file.write_text(line)
    with pytest.raises(ValueError, match=says):
        read_reader_corpus(file)
