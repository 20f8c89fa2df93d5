"""dynamax's Rao-Blackwellized particle filter on the same drive.

A switching linear dynamical system whose state is the robot and all landmarks, [2 L + 2], and
whose measurement is all relative positions, [2 L]. As the association is known there is one
discrete state only, the least work that ``rbpfilter`` can be given.
"""

import types
from collections.abc import Callable
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from dynamax.slds import DiscreteParamsSLDS, LGParamsSLDS, ParamsSLDS, inference
from slam_scenario import LANDMARKS, ODOMETRY_NOISE, SENSOR_NOISE, STEP, Drive

NUM_LANDMARKS = len(LANDMARKS)
_MAP_DIM = 2 * NUM_LANDMARKS
FAR = 10.0
"""Prior standard deviation of a landmark, metres."""


def model() -> ParamsSLDS:
    """Build the switching linear dynamical system."""
    size = _MAP_DIM + 2
    emission = np.zeros((_MAP_DIM, size), np.float32)
    emission[:, :_MAP_DIM] = np.eye(_MAP_DIM)
    emission[0::2, _MAP_DIM] = emission[1::2, _MAP_DIM + 1] = -1.0
    input_weights = np.zeros((1, size, 2), np.float32)
    input_weights[0, _MAP_DIM:] = np.eye(2)
    initial_variance = np.full(size, FAR**2, np.float32)
    initial_variance[_MAP_DIM:] = 1e-4
    process_variance = np.zeros(size, np.float32)
    process_variance[_MAP_DIM:] = (ODOMETRY_NOISE * STEP) ** 2
    gaussian = LGParamsSLDS(
        initial_mean=jnp.zeros(size),
        initial_cov=jnp.diag(jnp.asarray(initial_variance)),
        dynamics_weights=jnp.eye(size),
        dynamics_cov=jnp.diag(jnp.asarray(process_variance)),
        dynamics_bias=None,
        dynamics_input_weights=jnp.asarray(input_weights),
        emission_weights=jnp.asarray(emission),
        emission_cov=SENSOR_NOISE**2 * jnp.eye(_MAP_DIM),
        emission_bias=None,
        emission_input_weights=jnp.zeros((1, _MAP_DIM, 2)),
    )
    discrete = DiscreteParamsSLDS(jnp.ones(1), jnp.ones((1, 1)), jnp.ones((1, 1)))
    return ParamsSLDS(discrete, gaussian).initialize(1, size, _MAP_DIM, 2)


def prepare(drive: Drive, num_particles: int, seed: int) -> Callable[[], dict[str, jax.Array]]:
    """Compile the filter's loop over a drive.

    ``rbpfilter`` draws its first particles one by one in Python, which takes minutes to compile
    and no time to run; its scan is therefore taken out of it, unchanged, and compiled alone.

    Args:
        drive: T steps.
        num_particles: P.
        seed: of its draws.

    Returns:
        A function that runs the loop and gives what ``rbpfilter`` gives.
    """
    captured = {}

    def capture(step, start, steps):
        captured.update(step=step, start=start, steps=steps)
        return None, None

    emissions = jnp.asarray(drive.offsets.reshape(len(drive.offsets), -1), jnp.float32)
    inputs = jnp.asarray(drive.odometry, jnp.float32)
    fake_lax = types.SimpleNamespace(scan=capture, cond=jax.lax.cond)
    with mock.patch.object(inference, "lax", fake_lax):
        inference.rbpfilter(num_particles, model(), emissions, jax.random.PRNGKey(seed), inputs)
    # The step looks up lax when it is traced, after the patch has been taken back.
    compiled = jax.jit(lambda start: jax.lax.scan(captured["step"], start, captured["steps"])[1])
    return lambda: compiled(captured["start"])


def estimate(filtered: dict[str, jax.Array]) -> tuple[np.ndarray, np.ndarray]:
    """Compute the weighted mean over the final particles.

    Args:
        filtered: of ``prepare``'s function.

    Returns:
        Mean position of the robot f64[2] and of the landmarks f64[L, 2], metres.
    """
    weight = np.asarray(filtered["weights"][-1], np.float64)
    mean = weight @ np.asarray(filtered["means"][-1], np.float64)
    return mean[_MAP_DIM:], mean[:_MAP_DIM].reshape(NUM_LANDMARKS, 2)
