"""Clauses that only say what to keep away from: they constrain commands and are none themselves.

"Go to the car. Then avoid the cone" constrains the way to the car; "avoid the cone" alone asks for
nothing to be done. Only a sentence of its own makes such a clause: within one the grammar puts the
constraint below its command.
"""

from collections.abc import Sequence
from dataclasses import replace

from jaxlangnav.language.phrase import Phrase
from jaxlangnav.language.reference import SAME


def is_constraint(clause: Phrase) -> bool:
    """Tell whether a clause names nothing to do, only what to keep away from."""
    senses = {sense.split(":")[0] for word in clause.words for sense in word.senses}
    return clause.label == "VP" and "constraint" in senses and "action" not in senses


def join_constraints(clauses: Sequence[Phrase]) -> list[Phrase]:
    """Put constraints that stand alone below the commands they are said with.

    Args:
        clauses: roots, in order.

    Returns:
        The clauses, where each constraint has become a part of every command after it, or of the
        last command before it if none follows. Without any command they stay as they are; so does
        one on the very goal of the command before ("go to the car, then stay away from it").
    """
    commands = [i for i, one in enumerate(clauses) if one.label == "VP" and not is_constraint(one)]
    joined, done = list(clauses), set()
    for index, clause in enumerate(clauses):
        senses = {sense for word in clause.all_words() for sense in word.senses}
        if not commands or not is_constraint(clause) or SAME in senses:
            continue
        done.add(index)
        for command in [i for i in commands if i > index] or commands[-1:]:
            whole = joined[command]
            joined[command] = replace(whole, children=(*whole.children, clause))
    return [one for index, one in enumerate(joined) if index not in done]
