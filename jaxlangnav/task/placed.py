"""A world of which everything is known, as the behavior model sees it (section 3.3)."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxlangnav.grounding.asked import LEAST_PREVIOUS_GOAL, infer_once
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.worlds import place_for, to_device
from jaxlangnav.language.labels import PlacedWorld
from jaxlangnav.messages import ACTIONS, MODES, REGIONS, Behavior
from jaxlangnav.world.scenario import NUM_SLOTS
from jaxlangnav.world.state import Scenario

_LEAST = 1e-3
"""Behaviors less probable than this are not listed."""


def place_scenario(scenario: Scenario, names: Sequence[str]) -> PlacedWorld:
    """Reveal a scenario.

    Args:
        scenario: ground truth; the robot stands at its start.
        names: object types by index.

    Returns:
        Its objects in the order of their slots, empty ones left out, and the robot.
    """
    kept = np.flatnonzero(np.asarray(scenario.is_object))
    types, xs, ys = (
        np.asarray(one)[kept]
        for one in (scenario.object_type, scenario.object_x, scenario.object_y)
    )
    x, y, heading = (float(one) for one in np.asarray(scenario.start))
    return PlacedWorld(
        objects=tuple(
            (names[int(kind)], float(x), float(y)) for kind, x, y in zip(types, xs, ys, strict=True)
        ),
        robot=(x, y, heading),
        attributes=()
        if scenario.object_attribute is None
        else tuple(np.asarray(scenario.object_attribute)[kept].tolist()),
    )


def infer_in(
    instruction: Instruction, placed: PlacedWorld, names: tuple[str, ...]
) -> list[Behavior]:
    """Infer what each command asks for in a world of which everything is known.

    Args:
        instruction: the grounded sentence.
        placed: the world; of at most as many objects as a scenario has slots.
        names: object types by index.

    Returns:
        One behavior a command, NumPy leaves; "the other one" is other than the likeliest goal
        of the command before it.
    """
    number, found = len(placed.objects), []
    # Padded like any other world, so that one compiled program serves them all.
    num_slots = max(NUM_SLOTS, number) + 1
    slots = np.append(np.arange(number), num_slots - 1)
    for clause in range(int(instruction.num_clauses)):
        program = jax.tree.map(
            lambda leaf, index=clause: np.asarray(leaf)[index], instruction.program
        )
        world = to_device(place_for(placed, names, instruction.readings), num_slots)
        behavior = jax.device_get(infer_once(program, world))
        behavior = dataclasses.replace(
            behavior, goal=behavior.goal[:, slots], constraint=behavior.constraint[:, slots]
        )
        found.append(behavior)
        best = behavior.goal.max(axis=0)
        previous = int(best.argmax()) if best.max() >= LEAST_PREVIOUS_GOAL else number
        placed = dataclasses.replace(placed, previous=previous if previous < number else None)
    return found


def list_behaviors(
    instruction: Instruction, placed: PlacedWorld, names: tuple[str, ...]
) -> list[dict[str, Any]]:
    """List what may be to be done in a world of which everything is known.

    Action, mode and goal are independent given the sentence and the world, so the probability of
    a behavior is the product of theirs. What is missing to 1 is the probability that nothing
    there fits the command.

    Args:
        instruction: the grounded sentence.
        placed: the world.
        names: object types by index.

    Returns:
        Clause by clause, likeliest first: ``clause``, ``action``, ``mode``, ``goal``,
        ``probability``.
    """
    found: list[dict[str, Any]] = []
    for clause, behavior in enumerate(infer_in(instruction, placed, names)):
        joint = (
            behavior.action[:, None, None, None]
            * behavior.mode[None, :, None, None]
            * behavior.goal[None, None]
        )
        for index in zip(*np.nonzero(joint >= _LEAST), strict=True):
            found.append(
                {
                    "clause": clause,
                    "action": ACTIONS[index[0]],
                    "mode": MODES[index[1]],
                    "goal": describe_goal(placed, int(index[2]), int(index[3])),
                    "probability": float(joint[index]),
                }
            )
    return sorted(found, key=lambda one: (one["clause"], -one["probability"]))


def describe_goal(placed: PlacedWorld, region: int, slot: int) -> dict[str, Any]:
    """Name a goal region.

    Args:
        placed: the world.
        region: index into ``messages.REGIONS``.
        slot: of the object; the one after the last object is the robot.

    Returns:
        ``region`` ("at" or a relation), ``object`` (its type), ``index`` (its slot) and where
        that object stands, ``position``.
    """
    is_robot = slot == len(placed.objects)
    name, x, y = ("robot", *placed.robot[:2]) if is_robot else placed.objects[slot]
    return {"region": REGIONS[region], "object": name, "index": slot, "position": [x, y]}
