"""What a label means against what the trained graph makes of its sentence (section 4.1).

The label is grounded too, as a form, without words. They agree where both say the same of the
world, and where each of their commands asks for the same, nothing asked twice. That is tried in a
world of the label's things, related as the label has it, and of one more of each type of which
something is said, which is not.
"""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np

from jaxlangnav.grounding.annotated import form_instruction
from jaxlangnav.grounding.asked import infer_commands
from jaxlangnav.grounding.form import Form, FormReading
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.grounding.worlds import World
from jaxlangnav.inputs.object_types import noun_of
from jaxlangnav.messages import ACTIONS, MODES, NEAR, NONE, REGIONS, ROBOT
from jaxlangnav.relations.table import REGISTRY, SYMBOL
from jaxlangnav.task.labelled import ALIKE, LEAST, Meaning

_EXACT = 0.01
"""Metres by which a distance may differ from the label's, which may leave it out."""


@dataclasses.dataclass(frozen=True)
class _Asked:
    """What one command asks for in a world."""

    action: str
    mode: str
    ends: frozenset[tuple[int, int]]  # region and slot of each goal that fits as well as any
    avoided: frozenset[int]
    metres: float  # from its landmark, where they are told
    frame: tuple[float, ...]  # from where it is meant, in the robot's frame


def difference(meaning: Meaning, instruction: Instruction, names: tuple[str, ...]) -> str:
    """Say how an instruction differs first from what its label means; empty where nothing does."""
    try:
        types = tuple(
            names.index(meaning.type_of(one)) for one in range(len(meaning.reading.types))
        )
    except ValueError:
        return "speaks of other types"
    reading = dataclasses.replace(meaning.reading, types=types)
    label = form_instruction(Form((reading,), ()))
    for said, wanted in zip(_said(instruction, names), _said(label, names), strict=True):
        if said != wanted:
            return f"says {_listed(said)}, not {_listed(wanted)}"
    world = _world(reading)
    asked, meant = _asked(instruction, world), _asked(label, world)
    if len(asked) != len(reading.commands):
        return f"gives {len(asked)} commands, not {len(reading.commands)}"
    for index, (one, wanted) in enumerate(zip(asked, meant, strict=True), start=1):
        if why := _difference(one, wanted, world, names):
            return f"command {index} {why}"
    return ""


def _difference(one: _Asked, wanted: _Asked, world: World, names: tuple[str, ...]) -> str:
    """Say how one command differs; empty where it does not."""

    def places(ends: Iterable[tuple[int, int]]) -> set[tuple[Any, ...]]:
        """Describe where a command ends: of two things that nothing tells apart either will do."""
        kinds, related, ranked = world.object_type, world.is_related, world.is_ranked
        return {
            (region, kinds[slot], related[:, slot].tobytes(), ranked[:, :, slot].tobytes())
            for region, slot in ends
        }

    for given, meant in ((one.action, wanted.action), (one.mode, wanted.mode)):
        if given != meant:
            return f"asks for {given}, not {meant}"
    if not one.ends or not places(one.ends) <= places(wanted.ends):
        kinds = [noun_of(kind, names) if kind >= 0 else "robot" for kind in world.object_type]
        ends, end = (
            ", ".join(f"{REGIONS[region]} {kinds[slot]} ({slot})" for region, slot in sorted(of))
            for of in (one.ends, wanted.ends)
        )
        return f"ends {ends or 'nowhere'}, not {end}"
    if wanted.metres and abs(one.metres - wanted.metres) > _EXACT:
        return f"goes {one.metres:.3g} m, not {wanted.metres:.3g} m"
    if one.avoided != wanted.avoided:
        return f"keeps away from {len(one.avoided)} things, not {len(wanted.avoided)}"
    return ""


def _said(instruction: Instruction, names: tuple[str, ...]) -> tuple[set[str], set[str]]:
    """Collect the types and relations of the likeliest reading."""
    fields = instruction.readings
    kinds = np.asarray(fields.mention_type[0])

    def name(mention: int) -> str:
        kind = kinds[mention]
        return "robot" if kind == ROBOT else noun_of(kind, names)

    relations = set()
    for figure, relation, landmark, rank in fields.edges():
        if relation == NONE:
            continue
        own, other = name(figure), name(landmark)
        converse = REGISTRY[relation].converse
        # A tree behind a cone is the same as a cone before it.
        if other < own and not rank and "robot" not in (own, other) and converse is not None:
            own, relation, other = other, converse, own
        at = f", rank {rank}" if rank else ""
        relations.add(f"{own} {REGISTRY[relation].name} {other}{at}")
    return {noun_of(kind, names) for kind in kinds if kind >= 0}, relations


def _listed(parts: Iterable[str]) -> str:
    return "; ".join(sorted(parts)) or "nothing"


def _asked(instruction: Instruction, world: World) -> list[_Asked]:
    """Infer what each command asks for; one that asks for what is done already is left out."""
    found: list[_Asked] = []
    for clause, behavior in enumerate(infer_commands(instruction, world)):
        goal = behavior.goal
        least = max(LEAST, ALIKE * float(goal.max()))
        asked = _Asked(
            action=ACTIONS[int(behavior.action.argmax())],
            mode=MODES[int(behavior.mode.argmax())],
            ends=frozenset((region, slot) for region, slot in np.argwhere(goal >= least).tolist()),
            avoided=frozenset(np.flatnonzero(behavior.constraint.max(axis=0) > 0.5).tolist()),
            metres=float(instruction.metres[clause]),
            frame=tuple(np.asarray(instruction.frame)[clause].tolist()),
        )
        if not found or asked != found[-1]:
            found.append(asked)
    return found


def _world(reading: FormReading) -> World:
    """Build a world in which exactly what the label says holds; the robot has the last slot."""
    # Each thing has a slot, and so has another one of it if something is said.
    figures = dict.fromkeys(reading.types[one.figure] for one in reading.relations)
    kinds, related, ranked = [*reading.types, *figures], [], []
    for figure, relation, landmark, rank in reading.relations:
        edge = SYMBOL[relation], figure, len(kinds) if landmark == ROBOT else landmark
        converse = REGISTRY[relation].converse
        if rank == 0 or relation == NEAR:
            related.append(edge)
        if rank > 0:  # the device has one table of later ranks: whichever the sentence means
            ranked.append((min(rank, 2) - 1, *edge))
        elif converse is not None and landmark != ROBOT:
            related.append((SYMBOL[converse], landmark, figure))
    return World.of_edges([*kinds, ROBOT], related, ranked)
