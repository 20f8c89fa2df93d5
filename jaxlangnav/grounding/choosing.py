"""Grounders made of grounders: one after the other, and one whose readings a person picks from."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxlangnav import pytree
from jaxlangnav.grounding.annotation import annotation_document
from jaxlangnav.grounding.grounder import Alternative, Context, Grounded, Grounder, names_of
from jaxlangnav.grounding.readings import Reading, pad_readings, unpad_readings
from jaxlangnav.kinds import name_of
from jaxlangnav.messages import NONE, ROBOT

Chooser = Callable[[str, Sequence[Alternative]], int | None]
"""Told what was said and the ways to understand it, likeliest first; answers with the index of one,
or None where it is none of them."""
LEAST_ASKED = 0.05
"""Ways less probable than this are not asked about."""


class FirstGrounder:
    """Asks one grounder, and another where the first refuses."""

    def __init__(self, first: Grounder, then: Grounder) -> None:
        """Join two grounders of one detector: where ``first`` refuses, ``then`` is asked."""
        if first.type_names != then.type_names:
            raise ValueError("the grounders have different type_names: give both one detector's")
        self.first = first
        self.then = then

    @property
    def type_names(self) -> tuple[str, ...]:
        """Those of both."""
        return self.first.type_names

    @property
    def names(self) -> tuple[str, ...]:
        """The types, and nouns that there was none for."""
        return names_of(self.first)

    def ground(self, text: str, context: Context) -> Grounded:
        """Understand an instruction; where both refuse, the first's reason is given."""
        try:
            return self.first.ground(text, context)
        except ValueError as error:
            refusal = error
        try:
            found = self.then.ground(text, context)
        except ValueError as error:
            raise refusal from error
        return replace(found, notes=(f"not read as it stands: {refusal}", *found.notes))


class ChoosingGrounder:
    """Lets a person pick among the ways to understand an instruction."""

    def __init__(self, grounder: Grounder, choose: Chooser, *, least: float = LEAST_ASKED) -> None:
        """Wrap a grounder.

        Args:
            grounder: tells the ways.
            choose: asks the person; not called where there is one way only.
            least: ways less probable than this are not asked about.
        """
        self.grounder = grounder
        self.choose = choose
        self.least = least

    @property
    def type_names(self) -> tuple[str, ...]:
        """The wrapped grounder's."""
        return self.grounder.type_names

    @property
    def names(self) -> tuple[str, ...]:
        """The types, and nouns that there was none for."""
        return names_of(self.grounder)

    def ground(self, text: str, context: Context) -> Grounded:
        """Understand an instruction, and ask which way; see ``Grounder.ground``."""
        found = self.grounder.ground(text, context)
        ways = found.alternatives or tuple(_by_reading(found, self.names))
        ways = [one for one in ways if one.probability >= self.least]
        if len(ways) < 2:
            return found
        answer = self.choose(text, ways)
        if answer is None:
            raise ValueError(
                f"none of the {len(ways)} ways to understand it is meant: say it in other words"
            )
        if not 0 <= answer < len(ways):
            raise ValueError(f"the answer is {answer}, but there are ways 0 to {len(ways) - 1}")
        chosen = ways[answer]
        note = f"chosen: '{chosen.says}'"
        return replace(chosen.grounded, notes=(note, *chosen.grounded.notes))


def _by_reading(grounded: Grounded, names: Sequence[str]) -> Iterator[Alternative]:
    """Take each reading for a way; the commands are those of the sentence."""
    ranked = sorted(unpad_readings(grounded.instruction.readings), key=lambda item: -item[1])
    for reading, score in ranked:
        alone = pytree.replace(grounded.instruction, readings=pad_readings([(reading, 0.0)]))
        told = list(_annotations(reading, names))
        yield Alternative(
            says="; ".join(_worded(one) for one in told),
            probability=float(np.exp(score)),
            grounded=replace(grounded, instruction=alone, annotations=tuple(told)),
        )


def _annotations(reading: Reading, names: Sequence[str]) -> Iterator[Mapping[str, Any]]:
    """List what one reading says, as ``Grounded.annotations`` has it."""

    def name(mention: int) -> str | None:
        if mention == NONE:
            return None
        kind = reading.mentions[mention]
        return "robot" if kind == ROBOT else name_of(kind, names)

    for figure, relation, landmark, rank in reading.relations:
        yield annotation_document(name(figure), name(landmark), relation, rank, 1.0)


def _worded(said: Mapping[str, Any]) -> str:
    """Write an annotation for people: "cone near car, rank 1"."""
    if said["relation"] is None:
        return f"there is a {said['figure']}"
    rank = said.get("rank", int(said["superlative"]))
    ranked = f", number {rank} of its kind" if rank else ""
    return f"{said['figure']} {said['relation']} {said['landmark']}{ranked}"
