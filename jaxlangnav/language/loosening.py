"""Plainer words for a sentence that is refused as it stands (section 3.1).

People say more than is to be done: politeness, wishes, where they point, how the robot is to move.
What the grammar and the rules of ``rewrites.toml`` read is read by them alone. Only where they
refuse, the rules of ``data/loose.toml`` take out what selects nothing, bring wishes and verbs of a
class to one, and the sentence is read once more; what they change is reported. So they may be
broader than the others, and cannot turn what is read into something else.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from functools import cache
from importlib import resources

from jaxlangnav.language.chatter import leave_out_remarks
from jaxlangnav.language.describing import leave_out_descriptions
from jaxlangnav.language.lexicon import TYPE_CLASS, load_lexicon
from jaxlangnav.language.nouns import command_verbs, singular, words_in_classes
from jaxlangnav.language.rewriting import Rewrites, apply_rules, load_rewrites, read_rewrites
from jaxlangnav.language.tokens import MARKS, SpokenToken

_NO_NAMES = ("opener", "closer", "adv", "conn")
"""Classes whose words begin something else, whatever may be called so: "well, go on"."""


@cache
def load_loose() -> Rewrites:
    """Read the rules of the package; the same object at every call."""
    file = resources.files("jaxlangnav.language").joinpath("data/loose.toml")
    return read_rewrites(file.read_text("utf-8"), load_rewrites().sets)


def loosen(
    tokens: Sequence[SpokenToken], labels: Collection[str] = ()
) -> tuple[list[SpokenToken], list[str], list[tuple[str, str]]]:
    """Put a refused sentence into plainer words.

    Args:
        tokens: words and marks, typing errors repaired.
        labels: names of things that the detector tells apart.

    Returns:
        The words and marks that are to be read instead, remarks that are left out, and what has
        been read as what; the latter two empty where there are no plainer words.
    """
    kept, remarks = leave_out_remarks(tokens, labels)
    named, articles = _with_articles(kept, labels)
    left, changes = apply_rules(load_loose().rules, named)
    left, described = leave_out_descriptions(left, labels)
    left, later = leave_out_remarks(left, labels)  # what is a verb now may be called to
    return left, [*remarks, *described, *later], [*articles, *changes]


def _with_articles(
    tokens: Sequence[SpokenToken], labels: Collection[str]
) -> tuple[list[SpokenToken], list[tuple[str, str]]]:
    """Put an article before a bare name that a part of a sentence begins with.

    "Trough by the fence. Go.", "rusty plough, go": so a thing that the detector tells apart is one
    whatever else its name may be ("shelter next to the mast").
    """
    names = {tuple(label.split()) for label in labels} | load_lexicon().entries[TYPE_CLASS].keys()
    left, changes = [], []
    for index, token in enumerate(tokens):
        before = tokens[index - 1].text if index else MARKS[0]
        name = _bare_name(tokens, index, names) if before in (*MARKS, "then") else ()
        if name:
            left.append(replace(token, text="the"))
            changes.append((" ".join(name), " ".join(["the", *name])))
        left.append(token)
    return left, changes


def _bare_name(
    tokens: Sequence[SpokenToken], index: int, names: Collection[tuple[str, ...]]
) -> tuple[str, ...]:
    """Find the name that begins at a word, adjectives before it; empty for none."""
    words = [token.text for token in tokens[index : index + 6]]
    first = next((i for i, w in enumerate(words) if w not in words_in_classes("adj")), 0)
    if first == 0 and words[0] in command_verbs() | words_in_classes(*_NO_NAMES):
        return ()
    for size in range(min(len(words) - first, 4), 0, -1):
        name = tuple(words[first : first + size])
        if {name, tuple(singular(" ".join(name)).split())} & set(names):
            return tuple(words[: first + size])
    return ()
