"""Train a small neural policy by evolution strategies, and compare it with the shipped ones.

    python examples/trained_policy.py 30  # steps of training, each of 16 times 64 episodes

The network corrects the log of the paper's QMDP value of each waypoint; with weights of zero it is
the paper's policy. Its arrays are traced: other weights compile nothing.
"""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from jax.flatten_util import ravel_pytree

from jaxlangnav import keep_compiled_programs
from jaxlangnav.episode import Task
from jaxlangnav.experiments.metrics import RowMetrics, summarize
from jaxlangnav.experiments.policies import run_policy
from jaxlangnav.experiments.tasks import Cell, ground_sentences, known_distances, make_tasks
from jaxlangnav.planner import qmdp
from jaxlangnav.planner.faithful import Faithful, WaypointKeeping, qmdp_value
from jaxlangnav.planner.graph import OBJECT_NODE, VISITED
from jaxlangnav.planner.policy import Decision, Policy, Situation, Valuation, Waypoint
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapParams

TEXT = "go to the hydrant behind the cone"
HIDDEN, FEATURES, PAIRS = 8, 5, 8
SIGMA, LEARNING_RATE = 0.1, 0.1  # perturbation of the weights; of Adam
PENALTY = 30.0  # metres, added for an episode without success


@pytree
class Learned(Policy):
    """Values a waypoint by log QMDP value + w · tanh(W features + b)."""

    inward: Array  # f32[FEATURES, HIDDEN]
    bias: Array  # f32[HIDDEN]
    outward: Array  # f32[HIDDEN]

    def init(self, belief: ParticleBelief) -> Waypoint:
        """Start without a waypoint."""
        return WaypointKeeping(self.value).init(belief)

    def step(self, key: Array, memory: Waypoint, situation: Situation) -> tuple[Waypoint, Decision]:
        """Keep the current waypoint, or choose the best of the paper's nodes."""
        return WaypointKeeping(self.value).step(key, memory, situation)

    def map_params(self, params: MapParams) -> MapParams:
        """Assume that every annotation is true, as the paper does."""
        return Faithful().map_params(params)

    def value(self, situation: Situation) -> Valuation:
        """Compute the values of the nodes; the stop rule is the paper's."""
        paper, nodes = qmdp_value(situation), situation.nodes

        def in_view(x: Array, y: Array) -> Array:
            return jnp.stack(qmdp.mass_within(x, y, situation.goals, situation.range_max))[0]

        log_value = jnp.log(paper.goal_value + 1e-6)
        is_visited, is_object = nodes.kind == VISITED, nodes.kind == OBJECT_NODE
        goal_in_view = jax.vmap(in_view)(nodes.x, nodes.y)
        inputs = [log_value / 5.0, situation.distance / 10.0, goal_in_view, is_visited, is_object]
        hidden = jnp.tanh(jnp.stack(inputs, axis=1) @ self.inward + self.bias[None])
        return replace(paper, goal_value=jnp.exp(log_value + hidden @ self.outward))


def evaluate(policy: Policy | str, tasks: Task) -> RowMetrics:
    """Run a policy on tasks, and summarise its episodes."""
    results = run_policy(policy, tasks, ground_sentences([TEXT]).instructions)
    return summarize(results, known_distances(tasks))


def train(tasks: Task, steps: int) -> Learned:
    """Descend the mean cost by antithetic evolution strategies and Adam."""
    rng = np.random.default_rng(0)
    inward = jnp.asarray(rng.normal(size=(FEATURES, HIDDEN)), jnp.float32)
    initial = Learned(inward=inward, bias=jnp.zeros(HIDDEN), outward=jnp.zeros(HIDDEN))
    weights, unravel = ravel_pytree(initial)
    optimizer = optax.adam(LEARNING_RATE)
    opt_state = optimizer.init(weights)
    for step in range(steps):
        noise = rng.normal(size=(PAIRS, weights.size)).astype(np.float32)
        rows = [evaluate(unravel(weights + SIGMA * eps), tasks) for eps in (*noise, *-noise)]
        costs = np.array([m.distance_mean + PENALTY * (1.0 - m.success_rate / 100) for m in rows])
        gradient = (costs[:PAIRS] - costs[PAIRS:]) @ noise / (2.0 * SIGMA * PAIRS)
        updates, opt_state = optimizer.update(jnp.asarray(gradient), opt_state)
        weights = optax.apply_updates(weights, updates)
        print(f"step {step}: {costs.mean():.2f} m", flush=True)
    return unravel(weights)


def main(steps: str = "30") -> dict[str, RowMetrics]:
    """Train, and compare in test worlds."""
    keep_compiled_programs()
    trained = train(make_tasks(Cell(world="1H1C", relation="behind", seed=1), 64), int(steps))
    tasks = make_tasks(Cell(world="1H1C", relation="behind", seed=2), 256)
    policies = {"learned": trained, "faithful": "faithful", "informed": "informed"}
    results = {name: evaluate(policy, tasks) for name, policy in policies.items()}
    for name, row in results.items():
        print(f"{name:<10}{row.success_rate:6.1f} % {row.distance_mean:6.2f} m")
    return results


if __name__ == "__main__":
    main(*sys.argv[1:])
