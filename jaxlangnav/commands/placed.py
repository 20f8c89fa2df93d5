"""A world of which everything is known, as the behavior model sees it (section 3.3)."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.grounding.behavior import infer_behavior
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.language.labels import Geometry, PlacedWorld
from jaxlangnav.messages import ACTIONS, MODES, REGIONS, RELATIONS, ROBOT, BehaviorWorld
from jaxlangnav.world.state import Scenario

_LEAST = 1e-3
"""Behaviors less probable than this are not listed."""


def place(scenario: Scenario, names: Sequence[str]) -> tuple[BehaviorWorld, PlacedWorld]:
    """Describe a scenario with all its objects known.

    Args:
        scenario: ground truth; the robot stands at its start.
        names: object types by index.

    Returns:
        Objects in the order of their slots, the robot last; and their places.
    """
    kept = np.flatnonzero(np.asarray(scenario.is_object))
    types = np.asarray(scenario.object_type)[kept]
    xs, ys = np.asarray(scenario.object_x)[kept], np.asarray(scenario.object_y)[kept]
    x, y, heading = (float(one) for one in np.asarray(scenario.start))
    placed = PlacedWorld(
        objects=tuple(
            (names[int(kind)], float(x), float(y)) for kind, x, y in zip(types, xs, ys, strict=True)
        ),
        robot=(x, y, heading),
    )
    size = len(kept) + 1
    related = np.zeros((len(RELATIONS), size, size), bool)
    extreme = np.zeros_like(related)
    geometry = Geometry(placed)
    for relation in range(len(RELATIONS)):
        for figure in range(size - 1):
            for landmark in range(size):
                if figure != landmark:
                    related[relation, figure, landmark] = geometry.holds[relation, figure, landmark]
                    extreme[relation, figure, landmark] = geometry.is_extreme(
                        relation, figure, landmark, 1
                    )
    world = BehaviorWorld(
        object_type=jnp.asarray([*types, ROBOT], jnp.int32),
        is_object=jnp.ones(size, bool),
        is_related=jnp.asarray(related),
        is_superlative=jnp.asarray(extreme),
        is_previous=jnp.zeros(size, bool),
    )
    return world, placed


def list_behaviors(
    instruction: Instruction, world: BehaviorWorld, placed: PlacedWorld
) -> list[dict[str, Any]]:
    """Infer what is to be done in a world of which everything is known.

    Action, mode and goal are independent given the sentence and the world, so the probability of
    a behavior is the product of theirs. What is missing to 1 is the probability that nothing
    there fits the command.

    Args:
        instruction: the grounded sentence.
        world: of ``place``.
        placed: of ``place``.

    Returns:
        Clause by clause, likeliest first: ``clause``, ``action``, ``mode``, ``goal``,
        ``probability``.
    """
    found: list[dict[str, Any]] = []
    for clause in range(int(instruction.num_clauses)):
        program = jax.tree.map(lambda leaf, index=clause: leaf[index], instruction.program)
        behavior = _infer(program, world, program.num_phrases)
        action, mode, goal = (
            np.asarray(one) for one in (behavior.action, behavior.mode, behavior.goal)
        )
        joint = action[:, None, None, None] * mode[None, :, None, None] * goal[None, None]
        for index in zip(*np.nonzero(joint >= _LEAST), strict=True):
            found.append(
                {
                    "clause": clause,
                    "action": ACTIONS[index[0]],
                    "mode": MODES[index[1]],
                    "goal": _describe_goal(placed, int(index[2]), int(index[3])),
                    "probability": float(joint[index]),
                }
            )
    return sorted(found, key=lambda one: (one["clause"], -one["probability"]))


def _describe_goal(placed: PlacedWorld, region: int, slot: int) -> dict[str, Any]:
    """Name a goal region: "at" or a relation, of which object, where that object stands."""
    is_robot = slot == len(placed.objects)
    name, x, y = ("robot", *placed.robot[:2]) if is_robot else placed.objects[slot]
    return {"region": REGIONS[region], "object": name, "index": slot, "position": [x, y]}


_infer = jax.jit(lambda program, world, number: infer_behavior(program, world, num_phrases=number))
