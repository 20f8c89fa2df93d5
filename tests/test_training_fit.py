"""The objective, its gradient and its minimum."""

import itertools

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grounding_fixture import TYPES, corpus

from jaxlangnav.grounding.model import (
    ANNOTATION_KINDS,
    BEHAVIOR_KINDS,
    FEATURE_GROUPS,
    CorrespondenceModel,
    Vocabulary,
    feature_group,
)
from jaxlangnav.training.examples import Design, Factors, model_examples, tabulate
from jaxlangnav.training.fit import (
    Problem,
    TrainingConfig,
    build_design,
    by_kind,
    fit,
    gradient,
    l2_vector,
    loss,
    minimise,
    on_device,
    train_weights,
)

SMALL = ("walk to the barrel", "find the car behind the tree", "park near the box")


@pytest.fixture(scope="module")
def small():
    instructions = corpus(num_worlds=1, sentences=SMALL)
    examples = model_examples("behavior", instructions, TYPES)
    return examples, *build_design(examples, BEHAVIOR_KINDS, len(instructions))


def all_counts(design: Design) -> np.ndarray:
    return design.counts(np.ones((1, design.occurrences.shape[0]), np.float32))[0]


def random_weights(design: Design, scale=0.3):
    rng = np.random.default_rng(3)
    return {
        kind: np.float32(rng.normal(0, scale, (design.words.shape[1], part.stop - part.start)))
        for kind, part in design.columns.items()
    }


@pytest.mark.parametrize(
    ("name", "kinds"), [("behavior", BEHAVIOR_KINDS), ("annotation", ANNOTATION_KINDS)]
)
def test_objective_is_the_sum_over_all_factors(name, kinds):
    """Joined and counted, side by side or not: the value is that of the examples one by one."""
    examples = model_examples(name, corpus(num_worlds=1, sentences=SMALL), TYPES)
    vocabulary, design = build_design(examples, kinds, len(SMALL))
    weights = random_weights(design)
    model, total = CorrespondenceModel(vocabulary, weights), 0.0
    for example in examples:
        coefficients = model.coefficients(example.phrase)
        for kind, block in example.blocks.items():
            odds = (block.properties @ coefficients[kind]).astype(np.float64)
            total += np.logaddexp(0, np.where(block.labels, -odds, odds)).sum()
    total += 0.05 * sum((w.astype(np.float64) ** 2).sum() for w in weights.values())
    count = sum(len(block.labels) for example in examples for block in example.blocks.values())
    assert all_counts(design).sum() == count
    assert float(loss(weights, design, all_counts(design), 0.1)) == pytest.approx(total, rel=1e-5)


def test_equal_factors_are_joined_and_split_by_instruction():
    """Random factors, often alike, of phrases that often say the same, against counting them."""
    rng, number = np.random.default_rng(0), 60
    words = rng.integers(0, 2, (6, 2)).astype(np.float32)
    factors = Factors(
        words=words,
        properties=rng.integers(0, 2, (number, 3)).astype(np.float32),
        label=rng.random(number) < 0.5,
        phrase=rng.integers(0, 6, number),
        instruction=rng.integers(0, 2, number),
        repeats=rng.integers(1, 4, number).astype(float),
    )
    shares, expected = np.array([[1, 0], [0, 1], [2, 1]], np.float32), {}
    for n in range(number):
        key = (*words[factors.phrase[n]], *factors.properties[n])
        counts = expected.setdefault(key, np.zeros((3, 2)))
        counts[:, int(factors.label[n])] += factors.repeats[n] * shares[:, factors.instruction[n]]
    design = tabulate(factors, {"symbol": slice(0, 3)}, 2)
    assert len(np.unique(design.occurrences.indices // 2)) == len(expected)
    for u, g in itertools.product(*map(range, design.properties.shape[:2])):
        counted = design.counts(shares)[:, u, g]
        if counted.any():
            key = (*design.words[u], *design.properties[u, g])
            np.testing.assert_array_equal(counted, expected.pop(key))
    assert not expected


def test_fit_reaches_the_minimum(small):
    """J is λ-strongly convex: J(W) − min J ≤ ‖∇J(W)‖² / 2 λ."""
    _, _, design = small
    config, ones = TrainingConfig(l2=0.1), np.ones((1, design.occurrences.shape[0]), np.float32)
    (weights,), measured = fit(design, ones, config=config)
    gradient = jax.grad(loss)(weights, design, all_counts(design), 0.1)
    length = np.sqrt(sum(float(jnp.sum(g * g)) for g in gradient.values()))
    # Rounding adds to the length: sums of a few thousand float32 slopes below one.
    assert length < np.sqrt(2.0 * 0.1 * config.gap) + 2e-3
    assert measured.steps[0] < config.max_steps
    at_end = float(loss(weights, design, all_counts(design), 0.1))
    assert measured.loss[0] == pytest.approx(at_end, rel=1e-5)


def separable(rng, number=100.0):
    """Factors that a plane tells apart by far: slopes vanish, curvature spans many decades."""
    words = rng.random((12, 9)) < 0.4
    properties = rng.random((12, 20, 6)) < 0.4
    plane = rng.normal(0, 8, (9, 6))
    is_true = np.einsum("uw,wf,ugf->ug", words, plane, properties) > 0
    times = number * np.stack([~is_true, is_true], -1)
    return Problem(*(jnp.asarray(x, jnp.float32) for x in (words, properties, times)))


def newton(words, properties, times, l2):
    """The minimum in float64, on the outer products: weights f64[A, B], J, its Hessian."""
    size = words.shape[1] * properties.shape[2]
    x = np.einsum("uw,ugf->ugwf", words, properties).reshape(-1, size)
    times, w = np.asarray(times, np.float64).reshape(-1, 2), np.zeros(size)
    strength = np.broadcast_to(np.reshape(l2, (-1, 1)), (words.shape[1], size // words.shape[1]))
    strength = strength.ravel()

    def evaluate(w):
        odds = x @ w
        each = times[:, 0] * np.logaddexp(0, odds) + times[:, 1] * np.logaddexp(0, -odds)
        return each.sum() + 0.5 * w @ (strength * w)

    for _ in range(200):
        chance = 0.5 + 0.5 * np.tanh(0.5 * (x @ w))
        slope = x.T @ (times.sum(1) * chance - times[:, 1]) + strength * w
        curve = (x.T * (times.sum(1) * chance * (1 - chance))) @ x + np.diag(strength)
        step, length = np.linalg.solve(curve, slope), 1.0
        while evaluate(w - length * step) > evaluate(w) - 1e-4 * length * slope @ step:
            length *= 0.5
            if length < 1e-12:
                break
        w = w - length * step
    return w.reshape(words.shape[1], -1), evaluate(w), curve


@pytest.mark.parametrize("l2", [1e-3, 1.0, 1e3])
def test_search_ends_at_the_minimum_of_hard_problems(l2):
    """Three problems at once: a lane whose search stagnates would run to the last step."""
    problems = [separable(np.random.default_rng(seed)) for seed in range(3)]
    scaled = [one._replace(words=one.words / np.sqrt(l2)) for one in problems]
    together = Problem(*(jnp.stack(parts) for parts in zip(*scaled, strict=True)))
    gap = 0.5e-4 / l2
    found, search = jax.jit(jax.vmap(lambda one: minimise(one, gap, 1000.0)))(together)
    for k, problem in enumerate(problems):
        assert int(search.num_steps[k]) < 1000
        weights, value, _ = newton(*problem, l2)
        assert float(search.value[k]) == pytest.approx(value, rel=1e-4, abs=gap)
        if l2 >= 1.0:
            own = np.asarray(found[k]) / np.sqrt(l2)
            np.testing.assert_allclose(own, weights, atol=1e-2 / l2 + 1e-4)


@pytest.mark.parametrize("gap", [1e-3, 0.0])
def test_search_ends_however_often_a_factor_occurs(gap):
    """A million equal factors; in float32 no bound is kept where none is asked for, but an end."""
    problem = separable(np.random.default_rng(0), 1e6)
    found, search = jax.jit(minimise, static_argnums=(1, 2))(problem, gap, 5000.0)
    _, value, _ = newton(*problem, 1.0)
    assert int(search.num_steps) < 500
    assert float(search.value) == pytest.approx(value, rel=1e-5)
    slope = np.asarray(gradient(problem, found), np.float64)
    assert 0.5 * (slope * slope).sum() < 1e-3


def test_derivative_by_every_strength_is_that_of_the_minimum():
    """Of a held-out loss, by log λ of each group, against differences of minima found in float64.

    Off by ‖∇J‖, by κ N 2⁻²⁴ of a linear system of condition κ with sums of N products, and by h².
    """
    rng = np.random.default_rng(5)
    names = ("bias", "word=a", "word=b", "tag=n", "sense=x", "class=x", "gram=1", "label=NP", "")
    vocabulary = Vocabulary((*names[:-1], "pair=NP>PP"))
    groups = ("bias", *FEATURE_GROUPS)
    problem = separable(rng)
    times = jnp.asarray(rng.integers(0, 3, problem.counts.shape), jnp.float32)
    held = jnp.asarray(rng.integers(0, 2, problem.counts.shape), jnp.float32)
    factors = np.asarray(problem.words), np.asarray(problem.properties)
    design = Design(*factors, {"symbol": slice(0, 6)}, None)
    factored, config = on_device(design), TrainingConfig(gap=1e-9, max_steps=200)
    at = np.log(np.linspace(0.5, 3.0, len(groups)))

    def held_out_loss(log_l2):
        l2 = l2_vector(vocabulary, dict(zip(groups, jnp.exp(log_l2), strict=True)))
        weights, _ = train_weights(factored, times, l2, config=config)
        return loss(by_kind(weights, design), design, held, 0.0)

    found = np.asarray(jax.jit(jax.grad(held_out_loss))(jnp.asarray(at, jnp.float32)))
    forwards = jax.jit(jax.jacfwd(held_out_loss))(jnp.asarray(at, jnp.float32))

    which = np.array([groups.index(feature_group(name)) for name in vocabulary.names])
    *data, new = (
        np.asarray(part, np.float64) for part in (problem.words, problem.properties, times, held)
    )

    def exact(log_l2):
        weights, _, curve = newton(*data, np.exp(log_l2)[which])
        odds = np.einsum("ugf,uf->ug", data[1], data[0] @ weights)
        each = new[..., 0] * np.logaddexp(0, odds) + new[..., 1] * np.logaddexp(0, -odds)
        return float(each.sum()), curve

    step, rounding, products = 1e-3, 2.0**-24, sum(design.properties.shape) + 54
    _, curve = exact(at)
    share = np.linalg.cond(curve) * products * rounding + np.sqrt(2 * config.gap) + step**2
    numeric = [
        (exact(at + step * axis)[0] - exact(at - step * axis)[0]) / (2 * step)
        for axis in np.eye(len(groups))
    ]
    np.testing.assert_allclose(found, numeric, rtol=0, atol=share * np.linalg.norm(numeric))
    np.testing.assert_allclose(forwards, numeric, rtol=0, atol=share * np.linalg.norm(numeric))


def test_training_is_traced_once_for_all_strengths(small):
    """New regularisation is new data, not a new program."""
    _, vocabulary, design = small
    factored, counts = on_device(design), jnp.asarray(all_counts(design))
    config = TrainingConfig(gap=0.1)

    @jax.jit
    @chex.assert_max_traces(n=1)
    def size(l2):
        weights, _ = train_weights(factored, counts, l2, config=config)
        return jnp.vdot(weights, weights)

    uniform = {group: 0.1 for group in ("bias", *FEATURE_GROUPS)}
    weak, strong = (size(l2_vector(vocabulary, uniform | {"word": l2})) for l2 in (0.01, 1.0))
    assert float(strong) < float(weak)


def test_splits_at_once_equal_splits_alone(small):
    _, _, design = small
    shares = np.array([[1, 1, 0], [0, 1, 1]], np.float32)
    together, _ = fit(design, shares)
    for k in range(2):
        (alone,), _ = fit(design, shares[k : k + 1])
        for kind, weight in alone.items():
            np.testing.assert_allclose(together[k][kind], weight, atol=0.02)


def test_bad_requests_are_refused(small):
    examples, _, design = small
    with pytest.raises(ValueError, match="l2 is 0"):
        fit(design, np.ones((1, 3), np.float32), config=TrainingConfig(l2=0.0))
    with pytest.raises(AssertionError, match="shape"):
        train_weights(
            on_device(design),
            jnp.asarray(all_counts(design)[:1]),
            jnp.ones(design.words.shape[1]),
            config=TrainingConfig(),
        )
    with pytest.raises(ValueError, match="no example has a symbol of kind 'smell'"):
        build_design(examples, ("object", "smell"), 3)
