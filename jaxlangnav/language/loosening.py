"""Plainer words for a sentence that is refused as it stands (section 3.1).

People say more than is to be done: politeness, wishes, where they point, how the robot is to move.
What the grammar and the rules of ``rewrites.toml`` read is read by them alone. Only where they
refuse, the rules of ``data/loose.toml`` take out what selects nothing, bring wishes and verbs of a
class to one, and the sentence is read once more; what they change is reported. So they may be
broader than the others, and cannot turn what is read into something else.
"""

from collections.abc import Sequence
from functools import cache
from importlib import resources

from jaxlangnav.language.chatter import leave_out_remarks
from jaxlangnav.language.rewriting import Rewrites, apply_rules, load_rewrites, read_rewrites
from jaxlangnav.language.tokens import SpokenToken


@cache
def load_loose() -> Rewrites:
    """Read the rules of the package; the same object at every call."""
    file = resources.files("jaxlangnav.language").joinpath("data/loose.toml")
    return read_rewrites(file.read_text("utf-8"), load_rewrites().sets)


def loosen(
    tokens: Sequence[SpokenToken],
) -> tuple[list[SpokenToken], list[str], list[tuple[str, str]]]:
    """Put a refused sentence into plainer words.

    Args:
        tokens: words and marks, typing errors repaired.

    Returns:
        The words and marks that are to be read instead, remarks that are left out, and what has
        been read as what; the latter two empty where there are no plainer words.
    """
    kept, remarks = leave_out_remarks(tokens)
    left, changes = apply_rules(load_loose().rules, kept)
    return left, remarks, changes
