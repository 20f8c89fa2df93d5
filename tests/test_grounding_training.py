"""The objective, its gradient and its minimum."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grounding_fixture import TYPES, corpus
from oracles.dcg import objective

from jaxlangnav.grounding.examples import annotation_examples, behavior_examples
from jaxlangnav.grounding.features import word_features
from jaxlangnav.grounding.model import ANNOTATION_KINDS, BEHAVIOR_KINDS, CorrespondenceModel
from jaxlangnav.grounding.training import Factors, TrainingConfig, build_blocks, fit, loss, train

SMALL = ("walk to the barrel", "find the car behind the tree", "park near the box")


@pytest.fixture(scope="module")
def small():
    instructions = corpus(num_worlds=1, sentences=SMALL)
    examples = behavior_examples(instructions, TYPES)
    return examples, *build_blocks(examples, BEHAVIOR_KINDS, len(instructions))


def on_device(blocks):
    return {
        kind: Factors(
            words=jnp.asarray(b.words),
            properties=jnp.asarray(b.properties),
            count=jnp.asarray(b.count),
        )
        for kind, b in blocks.items()
    }


def random_weights(blocks, scale=0.3):
    rng = np.random.default_rng(3)
    return {
        kind: rng.normal(0, scale, (b.words.shape[1], b.properties.shape[2])).astype(np.float32)
        for kind, b in blocks.items()
    }


def test_bilinear_score_is_the_sum_of_products_of_features(small):
    _, _, blocks = small
    weights = random_weights(blocks)
    shares = {kind: b.instructions.sum(0) for kind, b in blocks.items()}
    got = loss(weights, on_device(blocks), shares, jnp.float32(0.1))
    assert float(got) == pytest.approx(objective(weights, blocks, shares, 0.1), rel=1e-4)


def test_joining_equal_factors_leaves_the_objective(small):
    examples, vocabulary, blocks = small
    weights = random_weights(blocks)
    shares = {kind: b.instructions.sum(0) for kind, b in blocks.items()}
    model = CorrespondenceModel(vocabulary, weights)
    total = 0.0
    for example in examples:
        coefficients = model.coefficients(example.phrase)
        for kind, rows in example.rows.items():
            odds = (rows.properties @ coefficients[kind]).astype(np.float64)
            total += np.logaddexp(0, np.where(rows.labels, -odds, odds)).sum()
    got = loss(weights, on_device(blocks), shares, jnp.float32(0.0))
    assert float(got) == pytest.approx(total, rel=1e-4)


def test_gradient_equals_finite_differences(small):
    _, _, blocks = small
    weights = random_weights(blocks)
    shares = {kind: b.instructions.sum(0) for kind, b in blocks.items()}
    gradient = jax.grad(loss)(weights, on_device(blocks), shares, jnp.float32(0.1))
    rng = np.random.default_rng(0)
    for kind in ("object", "goal"):
        for _ in range(3):
            used = np.argwhere(np.abs(np.asarray(gradient[kind])) > 1e-2)
            w, f = used[rng.integers(len(used))]
            step = 1e-3
            values = []
            for sign in (1, -1):
                moved = {k: v.astype(np.float64) for k, v in weights.items()}
                moved[kind][w, f] += sign * step
                values.append(objective(moved, blocks, shares, 0.1))
            numeric = (values[0] - values[1]) / (2 * step)
            # Central differences err by O(step²); float32 gradients by about 1e-5 relative.
            assert float(gradient[kind][w, f]) == pytest.approx(numeric, rel=2e-3, abs=1e-3)


def test_fit_reaches_the_minimum(small):
    _, _, blocks = small
    config = TrainingConfig(l2=0.1)
    count = next(iter(blocks.values())).instructions.shape[0]
    (weights,), measured = fit(blocks, np.ones((1, count), np.float32), config)
    shares = {kind: b.instructions.sum(0) for kind, b in blocks.items()}
    gradient = jax.grad(loss)(weights, on_device(blocks), shares, jnp.float32(0.1))
    assert max(float(jnp.abs(g).max()) for g in gradient.values()) < 5e-3
    assert measured.steps[0] < config.max_steps


def test_splits_at_once_equal_splits_alone(small):
    _, _, blocks = small
    shares = np.array([[1, 1, 0], [0, 1, 1]], np.float32)
    together, _ = fit(blocks, shares)
    for k in range(2):
        (alone,), _ = fit(blocks, shares[k : k + 1])
        for kind, weight in alone.items():
            np.testing.assert_allclose(together[k][kind], weight, atol=0.02)


def test_training_fits_its_own_labels():
    instructions = corpus(num_worlds=1, sentences=SMALL)
    examples = annotation_examples(instructions, TYPES)
    model, _ = train(examples, ANNOTATION_KINDS, len(instructions))
    for example in examples:
        coefficients = model.coefficients(example.phrase)
        for kind, rows in example.rows.items():
            assert ((rows.properties @ coefficients[kind] > 0) == rows.labels).all()


def test_features_left_out_are_gone():
    phrase = corpus(num_worlds=0, sentences=SMALL)[0].parse.clauses[0]
    assert any(name.startswith("word=") for name in word_features(phrase))
    assert not any(n.startswith("word=") for n in word_features(phrase, frozenset({"word"})))
