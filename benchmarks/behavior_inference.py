"""Behavior inference, 256 particles × 64 episodes at once: against the paper and a NumPy twin.

    python benchmarks/behavior_inference.py [--quick] [--json]

Eight sentences, eight episodes each; every particle has a world of its own, eight objects of random
types in random relations. The paper states 0.05 s for one inference in one world (Table 1). The
twin (``behavior_twin``) does the same inference with the same answer, 256 worlds of an episode at
once, or one world after the other; where hypotheses at the end of the beam are equally likely, the
two may keep different ones. The words are contracted beforehand for all of them.
"""

import pinning  # noqa: I001 - before JAX and NumPy start their threads

from collections.abc import Callable

import behavior_twin
import jax
import jax.numpy as jnp
import numpy as np
import record

from jaxlangnav.speed.measuring import Measurement, entry, measure
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


def draw(random: np.random.Generator, number: int, num_types: int) -> behavior_twin.Worlds:
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
    return behavior_twin.Worlds(
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
    stacked = (np.stack(leaves) for leaves in zip(*worlds, strict=True))  # [E, P, ...]
    fields = {
        name: jnp.moveaxis(jnp.asarray(leaf), 1, -1)
        for name, leaf in zip(behavior_twin.Worlds._fields, stacked, strict=True)
    }
    world = BehaviorWorld(**fields)

    @jax.jit
    def infer(program: BehaviorProgram, world: BehaviorWorld) -> Behavior:
        one = jax.vmap(lambda p, w: infer_behaviors(p, w, num_phrases=p.num_phrases))
        return one(program, world)

    found = jax.block_until_ready(infer(program, world))
    number = episodes * PARTICLES
    ours = 1e6 * measure(lambda: infer(program, world), repetitions).cpu / number
    plain = [jax.tree.map(np.asarray, one) for one in programs]

    def twin() -> list[tuple[np.ndarray, np.ndarray]]:
        return [behavior_twin.infer(p, w) for p, w in zip(plain, worlds, strict=True)]

    some = range(0, PARTICLES, 16)

    def loop() -> None:
        for p, w in zip(plain, worlds, strict=True):
            for index in some:
                behavior_twin.infer(p, behavior_twin.Worlds(*(x[index : index + 1] for x in w)))

    theirs = twin()
    goals = np.moveaxis(np.asarray(found.goal), -1, 1) - [goal for goal, _ in theirs]
    constraints = np.moveaxis(np.asarray(found.constraint), -1, 1) - [own for _, own in theirs]
    gap = np.maximum(np.abs(goals).max(axis=(2, 3)), np.abs(constraints).max(axis=(2, 3)))

    def row(title: str, baseline: float, target: float | None) -> Measurement:
        name = f"behavior inference, a world, {PARTICLES} particles × {episodes} episodes: {title}"
        return entry(name, ours, "µs CPU", baseline=baseline, ratio=baseline / ours, target=target)

    def cost(work: Callable[[], object], count: int) -> float:
        return 1e6 * measure(work, min(repetitions, 3)).cpu / count

    return [
        row("against the paper's 0.05 s", 1e6 * TABLE_1["behavior"]["infer_s"], 1.0),
        row("against NumPy, the worlds of an episode at once", cost(twin, number), None),
        row("against NumPy, one world at a time", cost(loop, episodes * len(some)), None),
        entry(
            "behavior inference: share of worlds that differ from the twin by more than 1e-4",
            float((gap > 1e-4).mean()),
            "",
            target=0.002,
            is_limit=True,
        ),
    ]


if __name__ == "__main__":
    record.main(entries, __doc__, pinning.CORE)
