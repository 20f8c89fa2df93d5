"""Behavior inference, 256 particles × 64 episodes at once, against the paper.

    python benchmarks/behavior_inference.py [--quick] [--json]

Eight sentences, eight episodes each; every particle has a world of its own, eight objects of random
types in random relations. The paper states 0.05 s for one inference in one world (Table 1). The
words are contracted beforehand. That the answers are right is tested (tests/oracles/dcg.py).
"""

import pinning  # noqa: I001 - before JAX and NumPy start their threads

import jax
import jax.numpy as jnp
import numpy as np
import record
from record import Measurement, entry

from jaxlangnav.experiments.timing import measure
from jaxlangnav.experiments.table1 import TABLE_1
from jaxlangnav.grounding import infer_behaviors, load_shipped, understand
from jaxlangnav.grounding.program import BehaviorProgram
from jaxlangnav.messages import ROBOT, Behavior, BehaviorWorld

PARTICLES, EPISODES, NUM_OBJECTS = 256, 64, 8
SENTENCES = (
    "go to the hydrant behind the cone",
    "go to the hydrant",
    "go to the hydrant nearest to the cone",
    "move behind the cone",
    "find the other cone quickly",
    "go to the hydrant that is near the cone but stay away from the car",
    "go to the hydrant behind the cone near the car",
    "drive to the barrel on your left",
)
P_RELATION = 0.2
"""How likely any two objects are in any relation."""


def draw(random: np.random.Generator, number: int, num_types: int) -> BehaviorWorld:
    """Draw worlds as particles have them."""
    size = NUM_OBJECTS + 1
    kind = random.integers(0, num_types, (number, size)).astype(np.int32)
    kind[:, -1] = ROBOT
    is_object = random.random((number, size)) < 0.8
    is_object[:, -1] = True
    both = is_object[:, :, None] & is_object[:, None, :] & ~np.eye(size, dtype=bool)
    both[:, -1] = False

    def edges() -> np.ndarray:
        return (random.random((number, 6, size, size)) < P_RELATION) & both[:, None]

    extreme = edges()
    previous = np.zeros((number, size), bool)
    previous[np.arange(number), random.integers(0, NUM_OBJECTS, number)] = True
    return BehaviorWorld(
        object_type=kind,
        is_object=is_object,
        is_related=edges(),
        is_superlative=extreme,
        is_later=both[:, None] & ~extreme,
        is_previous=previous & is_object,
    )


def entries(*, is_quick: bool) -> list[Measurement]:
    """Measure everything.

    Args:
        is_quick: fewer episodes and repetitions.

    Returns:
        Entries of the bench's document.
    """
    episodes, repetitions = (16, 3) if is_quick else (EPISODES, 9)
    model = load_shipped()
    random = np.random.default_rng(0)
    understood = [understand(text, model).instruction.program for text in SENTENCES]
    programs = [
        jax.tree.map(lambda leaf: leaf[0], understood[e % len(SENTENCES)]) for e in range(episodes)
    ]
    worlds = [draw(random, PARTICLES, len(model.type_names)) for _ in range(episodes)]
    program = jax.tree.map(lambda *leaves: jnp.stack(leaves), *programs)
    world = jax.tree.map(
        lambda *leaves: jnp.moveaxis(jnp.asarray(np.stack(leaves)), 1, -1), *worlds
    )

    @jax.jit
    def infer(program: BehaviorProgram, world: BehaviorWorld) -> Behavior:
        one = jax.vmap(lambda p, w: infer_behaviors(p, w, num_phrases=p.num_phrases))
        return one(program, world)

    jax.block_until_ready(infer(program, world))
    ours = 1e6 * measure(lambda: infer(program, world), repetitions).cpu / (episodes * PARTICLES)
    paper = 1e6 * TABLE_1["behavior"]["infer_s"]
    name = f"behavior inference, a world, {PARTICLES} particles × {episodes} episodes: "
    name += "against the paper's 0.05 s"
    return [entry(name, ours, "µs CPU", baseline=paper, ratio=paper / ours, target=1.0)]


if __name__ == "__main__":
    record.main(entries, __doc__, pinning.CORE)
