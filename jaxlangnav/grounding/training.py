"""Training of the log-linear model by full-batch L-BFGS (section 4.1).

The objective is the regularised negative log-likelihood of the correspondences,

    J(W) = Σ_e Σ_g Σ_φ n_egφ softplus(−(2φ − 1) x_eᵀ W y_eg) + λ/2 ‖W‖²

which is convex, with exact gradients by automatic differentiation of the bilinear form. Several
hold-out splits train at once by ``vmap`` over the weights of the instructions.
"""

import dataclasses
import time
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array

from jaxlangnav.grounding.blocks import Block, build_block
from jaxlangnav.grounding.examples import Example
from jaxlangnav.grounding.model import CorrespondenceModel, Vocabulary, build_vocabulary
from jaxlangnav.pytree import pytree


@pytree
class Factors:
    """All factors of one kind of symbol, on the device."""

    words: Array  # f32[H, W]
    properties: Array  # f32[H, G, F]
    count: Array  # f32[H, G, 2]


@dataclasses.dataclass(frozen=True)
class TrainingConfig:
    """How a model is trained."""

    l2: float = 0.01
    max_steps: int = 300
    tolerance: float = 1e-3  # of the largest gradient component


@dataclasses.dataclass(frozen=True)
class Fit:
    """What training measured."""

    loss: np.ndarray  # f32[K] objective at the end
    steps: np.ndarray  # i32[K]
    seconds: float
    compile_seconds: float


def loss(
    weights: Mapping[str, Array],
    factors: Mapping[str, Factors],
    shares: Mapping[str, Array],
    l2: Array,
) -> Array:
    """Evaluate the objective.

    Args:
        weights: kind → f32[W, F].
        factors: kind → factors.
        shares: kind → f32[H], how often each example counts.
        l2: f32[], λ.

    Returns:
        f32[], J(W).
    """
    total = jnp.zeros((), jnp.float32)
    for kind, weight in weights.items():
        block = factors[kind]
        contracted = block.words @ weight
        log_odds = jnp.einsum("hgf,hf->hg", block.properties, contracted)
        each = block.count[..., 0] * jax.nn.softplus(log_odds)
        each = each + block.count[..., 1] * jax.nn.softplus(-log_odds)
        total = total + jnp.dot(shares[kind], each.sum(1)) + 0.5 * l2 * jnp.sum(weight * weight)
    return total


def _minimise(
    factors: Mapping[str, Factors],
    shares: Mapping[str, Array],
    l2: Array,
    tolerance: Array,
    max_steps: Array,
) -> tuple[dict[str, Array], Array, Array]:
    """Run L-BFGS from zero; returns the weights, the objective and the number of steps."""

    def objective(weights: dict[str, Array]) -> Array:
        return loss(weights, factors, shares, l2)

    start = {
        kind: jnp.zeros((block.words.shape[1], block.properties.shape[2]), jnp.float32)
        for kind, block in factors.items()
    }
    solver = optax.lbfgs(memory_size=10)
    value_and_grad = optax.value_and_grad_from_state(objective)

    def step(carry: tuple) -> tuple:
        weights, state, _, count = carry
        value, gradient = value_and_grad(weights, state=state)
        updates, state = solver.update(
            gradient, state, weights, value=value, grad=gradient, value_fn=objective
        )
        largest = optax.tree.norm(gradient, ord=jnp.inf)
        return optax.apply_updates(weights, updates), state, largest, count + 1

    def is_open(carry: tuple) -> Array:
        return (carry[2] > tolerance) & (carry[3] < max_steps)

    carry = (start, solver.init(start), jnp.float32(jnp.inf), jnp.int32(0))
    weights, _, _, count = jax.lax.while_loop(is_open, step, carry)
    return weights, objective(weights), count


_fit_splits = jax.jit(jax.vmap(_minimise, in_axes=(None, 0, None, None, None)))
_fit_one = jax.jit(_minimise)


def build_blocks(
    examples: list[Example],
    kinds: tuple[str, ...],
    num_instructions: int,
    without: frozenset[str] = frozenset(),
) -> tuple[Vocabulary, dict[str, Block]]:
    """Prepare the examples of a model.

    Args:
        examples: one per phrase (and world).
        kinds: kinds of symbol of the model.
        num_instructions: I.
        without: groups of word features to leave out.

    Returns:
        The word side and the factors of each kind.
    """
    vocabulary = build_vocabulary([example.phrase for example in examples], without)
    blocks = {kind: build_block(examples, kind, vocabulary, num_instructions) for kind in kinds}
    return vocabulary, blocks


def fit(
    blocks: Mapping[str, Block],
    instruction_weights: np.ndarray,
    config: TrainingConfig | None = None,
) -> tuple[list[dict[str, np.ndarray]], Fit]:
    """Train one model per row of instruction weights, all at once.

    Args:
        blocks: kind → factors.
        instruction_weights: f32[K, I], how much each instruction counts in each of K fits.
        config: regularisation and stopping; the default is that of the shipped weights.

    Returns:
        K times kind → f32[W, F], and what was measured.
    """
    config = config or TrainingConfig()
    factors = {
        kind: Factors(
            words=jnp.asarray(block.words),
            properties=jnp.asarray(block.properties),
            count=jnp.asarray(block.count),
        )
        for kind, block in blocks.items()
    }
    shares = {
        kind: jnp.asarray(instruction_weights @ block.instructions, jnp.float32)
        for kind, block in blocks.items()
    }
    num_fits = instruction_weights.shape[0]
    options = (jnp.float32(config.l2), jnp.float32(config.tolerance), jnp.int32(config.max_steps))
    solve = _fit_splits
    if num_fits == 1:
        solve = _fit_one
        shares = {kind: share[0] for kind, share in shares.items()}
    begin = time.perf_counter()
    compiled = solve.lower(factors, shares, *options).compile()
    compile_seconds = time.perf_counter() - begin
    begin = time.perf_counter()
    weights, value, steps = jax.block_until_ready(compiled(factors, shares, *options))
    seconds = time.perf_counter() - begin
    rows = {kind: np.asarray(w).reshape(num_fits, *w.shape[-2:]) for kind, w in weights.items()}
    models = [{kind: w[k] for kind, w in rows.items()} for k in range(num_fits)]
    measured = Fit(np.atleast_1d(value), np.atleast_1d(steps), seconds, compile_seconds)
    return models, measured


def train(
    examples: list[Example],
    kinds: tuple[str, ...],
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
    """
    vocabulary, blocks = build_blocks(examples, kinds, num_instructions, without)
    weights, measured = fit(blocks, np.ones((1, num_instructions), np.float32), config)
    return CorrespondenceModel(vocabulary, weights[0]), measured
