"""A policy with a small network, trained by evolution strategies, beside the paper's and ours.

    python examples/trained_policy.py 30  # steps of training, each of 16 times 56 episodes

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
from jaxlangnav.experiments.tasks import cell, ground_sentences, known_distances, make_tasks
from jaxlangnav.planner import qmdp
from jaxlangnav.planner.faithful import Faithful, Keeping, qmdp_value
from jaxlangnav.planner.graph import OBJECT_NODE, VISITED
from jaxlangnav.planner.policy import Decision, Policy, Situation, Valuation, Waypoint
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapParams

TEXT = "go to the hydrant behind the cone"
HIDDEN, FEATURES, PAIRS = 8, 5, 8
SPREAD, RATE = 0.1, 0.1  # of the weights tried about the present ones; of Adam
FAILURE = 30.0  # metres that an episode without success costs besides


@pytree
class Learned(Policy):
    """Values a waypoint by log QMDP value + w · tanh(W features + b)."""

    inward: Array  # f32[FEATURES, HIDDEN]
    bias: Array  # f32[HIDDEN]
    outward: Array  # f32[HIDDEN]

    def init(self, belief: ParticleBelief) -> Waypoint:
        """Begin on the way to nowhere."""
        return Keeping(self.value).init(belief)

    def step(self, key: Array, memory: Waypoint, situation: Situation) -> tuple[Waypoint, Decision]:
        """Go on to the waypoint under way, or to the best of the paper's nodes."""
        return Keeping(self.value).step(key, memory, situation)

    def map_params(self, params: MapParams) -> MapParams:
        """Take every word to be true, as the paper does."""
        return Faithful().map_params(params)

    def value(self, situation: Situation) -> Valuation:
        """Value the nodes; the stop is the paper's."""
        paper, nodes = qmdp_value(situation), situation.nodes

        def in_view(x: Array, y: Array) -> Array:
            return jnp.stack(qmdp.mass_within(x, y, situation.goals, situation.range_max))[0]

        log_value = jnp.log(paper.goal_value + 1e-6)
        is_visited, is_object = nodes.kind == VISITED, nodes.kind == OBJECT_NODE
        seen = jax.vmap(in_view)(nodes.x, nodes.y)
        given = [log_value / 5.0, situation.distance / 10.0, seen, is_visited, is_object]
        hidden = jnp.tanh(jnp.stack(given, axis=1) @ self.inward + self.bias[None])
        return replace(paper, goal_value=jnp.exp(log_value + hidden @ self.outward))


def rows(policy: Policy | str, tasks: Task) -> RowMetrics:
    """Run a policy on tasks, and summarise its episodes."""
    found = run_policy(policy, tasks, ground_sentences([TEXT]).instructions)
    return summarize(found, known_distances(tasks))


def train(tasks: Task, steps: int) -> Learned:
    """Descend the mean cost by antithetic evolution strategies and Adam."""
    random = np.random.default_rng(0)
    inward = jnp.asarray(random.normal(size=(FEATURES, HIDDEN)), jnp.float32)
    begin = Learned(inward=inward, bias=jnp.zeros(HIDDEN), outward=jnp.zeros(HIDDEN))
    weights, unravel = ravel_pytree(begin)
    search = optax.adam(RATE)
    memory = search.init(weights)
    for step in range(steps):
        tried = random.normal(size=(PAIRS, weights.size)).astype(np.float32)
        found = [rows(unravel(weights + SPREAD * one), tasks) for one in (*tried, *-tried)]
        costs = np.array([f.distance_mean + FAILURE * (1.0 - f.success_rate / 100) for f in found])
        slope = (costs[:PAIRS] - costs[PAIRS:]) @ tried / (2.0 * SPREAD * PAIRS)
        change, memory = search.update(jnp.asarray(slope), memory)
        weights = optax.apply_updates(weights, change)
        print(f"step {step}: {costs.mean():.2f} m", flush=True)
    return unravel(weights)


def main(steps: str = "30") -> dict[str, RowMetrics]:
    """Train in some worlds, and compare in others."""
    keep_compiled_programs()
    trained = train(make_tasks(cell("1H1C", "behind", 0, 3.0, 64, seed=1)), int(steps))
    tasks = make_tasks(cell("1H1C", "behind", 0, 3.0, 256, seed=2))
    compared = {"learned": trained, "faithful": "faithful", "informed": "informed"}
    found = {name: rows(policy, tasks) for name, policy in compared.items()}
    for name, row in found.items():
        print(f"{name:<10}{row.success_rate:6.1f} % {row.distance_mean:6.2f} m")
    return found


if __name__ == "__main__":
    main(*sys.argv[1:])
