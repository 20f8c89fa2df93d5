"""Training of the log-linear model by full-batch L-BFGS, with implicit derivatives (section 4.1).

The objective is the regularised negative log-likelihood of the correspondences,

    J(W) = Σ_e Σ_g Σ_φ n_egφ softplus(−(2φ − 1) x_eᵀ W y_eg) + ½ Σ_w λ_w ‖W_w‖²

λ is a scalar, or one per group of word features. The optimised variable is V = √λ W, with words
x / √λ, so J is 1-strongly convex and J(V) − min J ≤ ½ ‖∇J(V)‖² bounds the remaining gap. The
minimum is differentiated with respect to words, properties and counts by the implicit function
theorem, from ∇J(V*(θ), θ) = 0. ``vmap`` over the counts n trains several hold-out splits at once.
"""

import functools
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeVar

import chex
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.scipy.sparse.linalg import cg

from jaxlangnav.grounding.correspondence import AnyWorld, CorrespondenceGraph, Labelled, SymbolSpace
from jaxlangnav.grounding.model import (
    FEATURE_GROUPS,
    CorrespondenceModel,
    Vocabulary,
    build_vocabulary,
    feature_group,
)
from jaxlangnav.numerics.descent import descend
from jaxlangnav.training.examples import Design, PhraseExample, examples_of, factors_of, tabulate

_Weights = TypeVar("_Weights", Array, np.ndarray)
_LINEAR_TOLERANCE, _LINEAR_STEPS = 1e-5, 500
"""Conjugate gradients of a derivative: relative residual and maximum number of steps."""


class Problem(NamedTuple):
    """Factors of one fit, whose words may be scaled."""

    words: Array  # f32[U, A]
    properties: Array  # f32[U, G, B]
    counts: Array  # f32[U, G, 2] number of factors with φ = 0, and φ = 1


class MinimiserInfo(NamedTuple):
    """Diagnostics of the minimisation."""

    value: Array  # f32[] J at the end
    num_steps: Array  # f32[], as derivatives need floats


def data_loss(problem: Problem, weights: Array) -> Array:
    """Evaluate the negative log-likelihood of all factors, f32[].

    Written as a sum of positive terms: in (n₀ + n₁) softplus(z) − n₁ z, the rounding errors of
    thousands of equal factors with small loss would keep a float32 search from converging.
    """
    log_odds = jnp.einsum("ugf,uf->ug", problem.properties, problem.words @ weights)
    loss_absent = problem.counts[..., 0] * jax.nn.softplus(log_odds)
    return (loss_absent + problem.counts[..., 1] * jax.nn.softplus(-log_odds)).sum()


def objective(problem: Problem, weights: Array) -> Array:
    """Evaluate J(V), f32[]."""
    return data_loss(problem, weights) + 0.5 * jnp.sum(weights * weights)


def gradient(problem: Problem, weights: Array) -> Array:
    """Evaluate ∇J(V), f32[A, B]."""
    return jax.grad(objective, argnums=1)(problem, weights)


@jax.custom_jvp
def minimise(problem: Problem, gap: Array, max_steps: Array) -> tuple[Array, MinimiserInfo]:
    """Minimise J by L-BFGS; differentiable in all of the problem, in forward and reverse mode.

    A derivative solves one linear system in the Hessian at the minimum, by conjugate gradients:
    ∂V*/∂θ = −H⁻¹ ∂∇J/∂θ, where H ⪰ 1. It is that of the minimum, not of the iterations.

    Args:
        problem: its factors; ``vmap`` over ``counts`` fits many splits at once.
        gap: f32[], nats; stops when J is guaranteed to be closer to its minimum than this, or when
            float32 makes no progress.
        max_steps: f32[].

    Returns:
        Weights f32[A, B], and diagnostics (with zero derivative).
    """
    chex.assert_rank((problem.words, problem.properties, problem.counts), (2, 3, 3))
    chex.assert_shape(problem.properties, (problem.words.shape[0], None, None))
    chex.assert_shape(problem.counts, (*problem.properties.shape[:2], 2))
    chex.assert_type(list(problem), jnp.float32)
    result = descend(
        lambda weights: objective(problem, weights),
        jnp.zeros((problem.words.shape[1], problem.properties.shape[2]), jnp.float32),
        gradient_norm=jnp.sqrt(2.0 * gap),
        max_steps=max_steps,
    )
    return result.point, MinimiserInfo(result.value, result.num_steps)


@minimise.defjvp
def _minimise_jvp(
    primals: tuple[Problem, Array, Array], tangents: tuple[Problem, Array, Array]
) -> tuple[tuple[Array, MinimiserInfo], tuple[Array, MinimiserInfo]]:
    """Differentiate the condition ∇J = 0 at the minimum."""
    problem, tangent = primals[0], tangents[0]
    weights, search = minimise(*primals)

    def hessian(direction: Array) -> Array:
        return jax.jvp(lambda w: gradient(problem, w), (weights,), (direction,))[1]

    def solve(matrix: Callable[[Array], Array], right: Array) -> Array:
        return cg(matrix, right, tol=_LINEAR_TOLERANCE, maxiter=_LINEAR_STEPS)[0]

    mixed = jax.jvp(lambda p: gradient(p, weights), (problem,), (tangent,))[1]
    change = jax.lax.custom_linear_solve(hessian, -mixed, solve, symmetric=True)
    return (weights, search), (change, jax.tree.map(jnp.zeros_like, search))


# ---------------------------------------------------------------- training of models

SPLITS_AT_ONCE = 8
"""Number of splits that are fitted in parallel; each batch takes as long as its slowest."""


class TrainingConfig(NamedTuple):
    """Hyperparameters of training: regularisation and stopping."""

    l2: float = 0.01
    max_steps: int = 300
    gap: float = 1.25e-3  # nats; guaranteed bound on J − min J at the end, if float32 allows


class Fit(NamedTuple):
    """Diagnostics of training: losses, steps and times."""

    loss: np.ndarray  # f32[K] objective at the end
    steps: np.ndarray  # i32[K]
    seconds: float  # of counting, fitting and transfers, without compilation
    compile_seconds: float  # near 0 if a fit of this size was compiled before


class DeviceFactors(NamedTuple):
    """The distinct factors of a design on the device."""

    words: Array  # f32[U, W]
    properties: Array  # f32[U, G, F]


def on_device(design: Design) -> DeviceFactors:
    """Copy the distinct factors of a design to the device."""
    return DeviceFactors(jnp.asarray(design.words), jnp.asarray(design.properties))


def l2_vector(vocabulary: Vocabulary, by_group: Mapping[str, Array | float]) -> Array:
    """Expand λ by group ("bias" and ``FEATURE_GROUPS``) to word features, f32[W]."""
    groups = tuple(by_group)
    group_index = np.array([groups.index(feature_group(name)) for name in vocabulary.names])
    return jnp.stack([jnp.asarray(by_group[group], jnp.float32) for group in groups])[group_index]


def train_weights(
    factors: DeviceFactors, counts: Array, l2: Array, *, config: TrainingConfig
) -> tuple[Array, MinimiserInfo]:
    """Train one model: a pure function, differentiable in the counts and the regularisation.

    Args:
        factors: of ``on_device``.
        counts: f32[U, G, 2], a row of ``design.counts``.
        l2: f32[W], λ of each word feature, above zero (``l2_vector``).
        config: stopping; its own ``l2`` is not read.

    Returns:
        f32[W, F], the weights of all kinds side by side (``by_kind``), and diagnostics.
    """
    chex.assert_shape(counts, (*factors.properties.shape[:2], 2))
    chex.assert_shape(factors.words, (factors.properties.shape[0], *l2.shape))
    chex.assert_type((counts, l2), jnp.float32)
    scale = 1.0 / jnp.sqrt(l2)
    problem = Problem(factors.words * scale[None], factors.properties, counts)
    scaled, search = minimise(problem, jnp.float32(config.gap), jnp.float32(config.max_steps))
    return scaled * scale[:, None], search


@functools.partial(jax.jit, static_argnames="config")
def _fit_splits(
    factors: DeviceFactors, counts: Array, l2: Array, config: TrainingConfig
) -> tuple[Array, MinimiserInfo]:
    """Fit K sets of counts f32[K, U, G, 2] to the same words and properties."""
    batch_size = min(SPLITS_AT_ONCE, counts.shape[0])
    return jax.lax.map(
        lambda n: train_weights(factors, n, l2, config=config),
        counts,
        batch_size=batch_size if batch_size > 1 else None,
    )


@functools.lru_cache(maxsize=8)
def _compile(shapes: tuple, config: TrainingConfig) -> jax.stages.Compiled:
    """Compile the fit for array shapes of designs and splits, cached."""
    return _fit_splits.lower(*shapes, config=config).compile()


def by_kind(weights: _Weights, design: Design) -> dict[str, _Weights]:
    """Split weights f32[W, F] of all kinds side by side, kind → f32[W, F of the kind]."""
    return {kind: weights[:, columns] for kind, columns in design.columns.items()}


def loss(weights: Mapping[str, Array], design: Design, counts: Array, l2: Array | float) -> Array:
    """Evaluate the objective J(W), f32[]; differentiable in the weights and the counts.

    Args:
        weights: kind → f32[W, F].
        design: the factors.
        counts: f32[U, G, 2], a row of ``design.counts``.
        l2: λ, f32[] or f32[W]; 0 for the loss on sentences held out.
    """
    chex.assert_shape(counts, (*design.properties.shape[:2], 2))
    problem = Problem(*on_device(design), counts)
    matrix = jnp.concatenate([jnp.asarray(weights[kind]) for kind in design.columns], axis=1)
    strength = jnp.broadcast_to(jnp.asarray(l2, jnp.float32), matrix.shape[:1])
    return data_loss(problem, matrix) + 0.5 * jnp.vdot(strength, jnp.sum(matrix * matrix, axis=1))


def build_design(
    examples: Sequence[PhraseExample],
    kinds: Sequence[str],
    num_instructions: int,
    without: frozenset[str] = frozenset(),
) -> tuple[Vocabulary, Design]:
    """Build vocabulary and design from a model's examples, one per phrase (and world).

    The vocabulary lacks the feature groups ``without``; the design counts the distinct factors.

    Raises:
        ValueError: a kind has no example.
    """
    vocabulary = build_vocabulary([example.phrase for example in examples], without)
    return vocabulary, tabulate(*factors_of(examples, kinds, vocabulary), num_instructions)


def fit(
    design: Design, instruction_weights: np.ndarray, *, config: TrainingConfig | None = None
) -> tuple[list[dict[str, np.ndarray]], Fit]:
    """Train one model per row of instruction weights, all at once.

    Args:
        design: the factors.
        instruction_weights: f32[K, I], weight of each instruction in each of K fits.
        config: regularisation and stopping; the default is that of the shipped weights.

    Returns:
        K times kind → f32[W, F], and diagnostics.

    Raises:
        ValueError: the regularisation is not above zero: the minimum would not be unique.
    """
    chex.assert_rank(instruction_weights, 2)
    config = config or TrainingConfig()
    if not config.l2 > 0.0:
        raise ValueError(f"l2 is {config.l2:g}, but must be above 0")
    start = time.perf_counter()
    factors, counts = on_device(design), jnp.asarray(design.counts(instruction_weights))
    inputs = (factors, counts, jnp.full(design.words.shape[1:], config.l2, jnp.float32))
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), inputs)
    compile_start = time.perf_counter()
    compiled = _compile(shapes, config)
    compile_seconds = time.perf_counter() - compile_start
    trained, search = jax.block_until_ready(compiled(*inputs))
    weights = np.array(trained)
    # Weights of pairs that never co-occur are zero up to rounding; exact zeros compress well.
    weights[np.abs(weights) < 1e-6 * np.abs(weights).max()] = 0.0
    info = Fit(
        loss=np.asarray(search.value),
        steps=np.asarray(search.num_steps, np.int32),
        seconds=time.perf_counter() - start - compile_seconds,
        compile_seconds=compile_seconds,
    )
    return [by_kind(model, design) for model in weights], info


def train_graph(
    space: SymbolSpace[AnyWorld],
    labelled: Sequence[Labelled[AnyWorld]],
    *,
    config: TrainingConfig | None = None,
    without: frozenset[str] = frozenset(),
) -> tuple[CorrespondenceGraph[AnyWorld], Fit]:
    """Train a correspondence graph on labelled trees.

    Args:
        space: the symbols.
        labelled: trees with labels.
        config: regularisation and stopping.
        without: groups of word features to leave out (``FEATURE_GROUPS``).

    Raises:
        ValueError: there is no tree, a label is wrong (``examples_of``), or a group is unknown.
    """
    if not labelled:
        raise ValueError("there is no tree to train on")
    if without - set(FEATURE_GROUPS):
        raise ValueError(f"groups of features are {', '.join(FEATURE_GROUPS)}, not {set(without)}")
    count = len(labelled)
    examples = examples_of(space, labelled)
    vocabulary, design = build_design(examples, tuple(space.columns), count, without)
    (weights,), info = fit(design, np.ones((1, count), np.float32), config=config)
    return CorrespondenceGraph(space, CorrespondenceModel(vocabulary, weights)), info
