"""Training of the log-linear model by full-batch L-BFGS (section 4.1).

The objective is the regularised negative log-likelihood of the correspondences,

    J(W) = Σ_e Σ_g Σ_φ n_egφ softplus(−(2φ − 1) x_eᵀ W y_eg) + λ/2 ‖W‖²

which is convex, with gradients in closed form. Several hold-out splits train at once by ``vmap``
over the counts n. At the minimum W lies in the span of the data: W = Q V Rᵀ with Q and R bases of
the word features and properties that occur, and ‖W‖ = ‖V‖; V is what is searched, a quarter of W.
"""

import dataclasses
import time
from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.grounding.blocks import Design, flatten, pool
from jaxlangnav.grounding.examples import Example
from jaxlangnav.grounding.minimise import Problem, minimise, objective
from jaxlangnav.grounding.model import CorrespondenceModel, Vocabulary, build_vocabulary


@dataclasses.dataclass(frozen=True)
class TrainingConfig:
    """How a model is trained."""

    l2: float = 0.01
    max_steps: int = 300
    tolerance: float = 5e-3  # length of the gradient


@dataclasses.dataclass(frozen=True)
class Fit:
    """What training measured."""

    loss: np.ndarray  # f32[K] objective at the end
    steps: np.ndarray  # i32[K]
    seconds: float  # counting, fitting and reading back, compilation left out
    compile_seconds: float
    cpu_seconds: float  # as ``seconds``, CPU time of the process


@jax.jit
def _fit_splits(
    problem: Problem, l2: Array, tolerance: Array, max_steps: Array
) -> tuple[Array, Array, Array]:
    """Fit K sets of counts f32[K, U, G, 2] to the same words and properties."""

    def one(times: Array) -> tuple[Array, Array, Array]:
        return minimise(problem._replace(times=times), l2, tolerance, max_steps)

    return jax.vmap(one)(problem.times)


_fit_one = jax.jit(minimise)


def loss(weights: Mapping[str, Array], design: Design, counts: Array, l2: Array | float) -> Array:
    """Evaluate the objective; differentiable by the weights and by the counts.

    Args:
        weights: kind → f32[W, F].
        design: the factors.
        counts: f32[U, G, 2], a row of ``design.counts``.
        l2: f32[], λ.

    Returns:
        f32[], J(W).
    """
    problem = Problem(jnp.asarray(design.words), jnp.asarray(design.properties), counts)
    joined = jnp.concatenate([jnp.asarray(weights[kind]) for kind in design.columns], axis=1)
    return objective(problem, joined, jnp.asarray(l2, jnp.float32))


def build_design(
    examples: Sequence[Example],
    kinds: Sequence[str],
    num_instructions: int,
    without: frozenset[str] = frozenset(),
) -> tuple[Vocabulary, Design]:
    """Prepare the examples of a model.

    Args:
        examples: one per phrase (and world).
        kinds: kinds of symbol of the model.
        num_instructions: I.
        without: groups of word features to leave out.

    Returns:
        The word side, and the distinct factors with their counts.

    Raises:
        ValueError: a kind has no example.
    """
    vocabulary = build_vocabulary([example.phrase for example in examples], without)
    return vocabulary, pool(*flatten(examples, kinds, vocabulary), num_instructions)


def _rotated(rows: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Write rows f32[..., D] in a basis f64[D, rank], f32[..., rank]."""
    if np.array_equal(basis, np.eye(len(basis))):
        return rows
    return (rows @ basis).astype(np.float32)


def _basis(rows: np.ndarray) -> np.ndarray:
    """Build an orthonormal basis of the span of rows f32[N, D], f64[D, rank ≤ D]."""
    size = rows.shape[1]
    is_wide = rows.shape[0] < size
    # Where a sample of tall rows has full rank, so have all, and there is nothing to gain.
    sample = rows[:: max(rows.shape[0] // (8 * size), 1)].astype(np.float64)
    if not is_wide and _spectrum(sample.T @ sample)[0].all():
        return np.eye(size)
    rows = rows.astype(np.float64)
    is_kept, value, vector = _spectrum(rows @ rows.T if is_wide else rows.T @ rows)
    if is_wide:
        return rows.T @ (vector[:, is_kept] / np.sqrt(value[is_kept]))
    return vector[:, is_kept]


def _spectrum(gram: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decompose a matrix of inner products; which eigenvalues are not zero, values, vectors."""
    value, vector = np.linalg.eigh(gram)
    return value > 1e-10 * value[-1], value, vector


def fit(
    design: Design,
    instruction_weights: np.ndarray,
    config: TrainingConfig | None = None,
) -> tuple[list[dict[str, np.ndarray]], Fit]:
    """Train one model per row of instruction weights, all at once.

    Args:
        design: the factors.
        instruction_weights: f32[K, I], how much each instruction counts in each of K fits.
        config: regularisation and stopping; the default is that of the shipped weights.

    Returns:
        K times kind → f32[W, F], and what was measured.

    Raises:
        ValueError: the regularisation is not above zero: the minimum would not be unique.
    """
    config = config or TrainingConfig()
    if config.l2 <= 0.0:
        raise ValueError(f"l2 is {config.l2}, but must be above 0")
    begin, begin_cpu = time.perf_counter(), time.process_time()
    num_fits, width = len(instruction_weights), design.properties.shape[2]
    word_basis = _basis(design.words)
    property_basis = _basis(design.properties.reshape(-1, width))
    counts = design.counts(instruction_weights)
    problem = Problem(
        words=jnp.asarray(_rotated(design.words, word_basis)),
        properties=jnp.asarray(_rotated(design.properties, property_basis)),
        times=jnp.asarray(counts if num_fits > 1 else counts[0]),
    )
    options = (jnp.float32(config.l2), jnp.float32(config.tolerance), jnp.int32(config.max_steps))
    prepared, prepared_cpu = time.perf_counter() - begin, time.process_time() - begin_cpu
    begin = time.perf_counter()
    compiled = (_fit_splits if num_fits > 1 else _fit_one).lower(problem, *options).compile()
    compile_seconds = time.perf_counter() - begin
    begin, begin_cpu = time.perf_counter(), time.process_time()
    found, value, steps = jax.block_until_ready(compiled(problem, *options))
    found = np.asarray(found, np.float64).reshape(num_fits, *found.shape[-2:])
    weights = (word_basis @ found @ property_basis.T).astype(np.float32)
    # What never met has a weight of zero but for rounding; a zero takes no place in a file.
    weights[np.abs(weights) < 1e-6 * np.abs(weights).max()] = 0.0
    models = [{kind: w[:, columns] for kind, columns in design.columns.items()} for w in weights]
    measured = Fit(
        loss=np.atleast_1d(value),
        steps=np.atleast_1d(steps),
        seconds=prepared + time.perf_counter() - begin,
        compile_seconds=compile_seconds,
        cpu_seconds=prepared_cpu + time.process_time() - begin_cpu,
    )
    return models, measured


def train(
    examples: Sequence[Example],
    kinds: Sequence[str],
    num_instructions: int,
    config: TrainingConfig | None = None,
    without: frozenset[str] = frozenset(),
) -> tuple[CorrespondenceModel, Fit]:
    """Train one model on all examples.

    Args:
        examples: one per phrase (and world).
        kinds: kinds of symbol of the model.
        num_instructions: how many instructions they come from.
        config: regularisation and stopping.
        without: groups of word features to leave out.

    Returns:
        The model, and what was measured.

    Raises:
        ValueError: a kind has no example.
    """
    vocabulary, design = build_design(examples, kinds, num_instructions, without)
    weights, measured = fit(design, np.ones((1, num_instructions), np.float32), config)
    return CorrespondenceModel(vocabulary, weights[0]), measured
