"""Kinds: what a thing is and what it looks like, in one integer (sections 3.1 and 3.2).

The low ``LABEL_BITS`` hold the index of the detector's label, the bits above them one value for
each group of attributes: colour, material, size, height; 0 where it is not known. Both together
take 24 bits, as float32 holds them exactly: tables of particles are such numbers. The map keeps the
kind of what was seen, a sentence says the kind of what it means, and ``is_type`` compares them. A
kind without attributes is the bare index of its label. ``ANYTHING`` is the label of what is called
"the thing": nothing seen has it, and everything seen fits it.

Everything takes NumPy arrays, JAX arrays and plain integers; ``NONE`` and ``ROBOT`` are kinds that
only fit themselves.
"""

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

LABEL_BITS = 13
ANYTHING = 2**LABEL_BITS - 1
"""Label of a thing that a sentence calls by no type: "the one on your left"."""
MOST_LABELS = ANYTHING
"""Labels that are told apart: those of the detector, and nouns that it has no label for."""
ATTRIBUTES = {
    "colour": (
        "red", "orange", "yellow", "green", "blue", "purple", "pink", "brown",
        "white", "black", "gray", "silver", "gold", "beige", "striped",
    ),
    "material": ("wooden", "metal", "plastic", "glass", "stone", "brick", "paper"),
    "size": ("small", "big"),
    "height": ("short", "tall"),
}  # fmt: skip
"""Groups and their values; the value of a group is a place in its tuple, counted from 1."""
_WIDTHS = {"colour": 4, "material": 3, "size": 2, "height": 2}
ATTRIBUTE_BITS = sum(_WIDTHS.values())


_FIRSTS = tuple(accumulate(_WIDTHS.values(), initial=0))
_PLACES = {
    group: (first, ((1 << width) - 1) << first)
    for (group, width), first in zip(_WIDTHS.items(), _FIRSTS, strict=False)
}
"""Of each group its first bit in an attribute code, and a mask of its bits."""
_MASKS = tuple(mask << LABEL_BITS for _, mask in _PLACES.values())
_TOPS = sum((mask + (mask & -mask)) >> 1 for mask in _MASKS)
"""The highest bit of each group."""
_LOWER = sum(_MASKS) - _TOPS
_SIGN = -(2**31)


def group_of(word: str) -> str | None:
    """Find the group of an attribute; None of any other word."""
    return next((group for group, values in ATTRIBUTES.items() if word in values), None)


def attribute_code(*words: str) -> int:
    """Build the code of attributes, for ``Observation.detection_attribute``; 0 of none.

    Args:
        *words: values of ``ATTRIBUTES``, at most one of each group.

    Raises:
        ValueError: a word is no attribute, or two are of one group.
    """
    code = 0
    for word in words:
        group = group_of(word)
        if group is None:
            known = ", ".join(value for values in ATTRIBUTES.values() for value in values)
            raise ValueError(f"{word[:30]!r} is no attribute that is compared: use {known}")
        first, mask = _PLACES[group]
        if code & mask:
            raise ValueError(f"{word!r} is a second {group}: give one")
        code |= (ATTRIBUTES[group].index(word) + 1) << first
    return code


def attribute_words(code: int) -> tuple[str, ...]:
    """Name the attributes of a code, the inverse of ``attribute_code``."""
    values = (
        ((code & mask) >> first, ATTRIBUTES[group]) for group, (first, mask) in _PLACES.items()
    )
    return tuple(words[value - 1] for value, words in values if 0 < value <= len(words))


def kind_of(label: Any, code: Any) -> Any:
    """Put a label and a code of attributes together."""
    return label | (code << LABEL_BITS)


def label_of(kind: Any) -> Any:
    """Take the label of a kind; ``NONE`` and ``ROBOT`` stay what they are."""
    # Of a negative number all bits are kept: its low ones alone would be a label.
    return kind & (ANYTHING | (kind >> 31))


def is_anything(kind: Any) -> Any:
    """Tell which kinds are of no type: things of every label fit them."""
    return (kind & (_SIGN | ANYTHING)) == ANYTHING


def code_of(kind: int) -> int:
    """Take the attributes of a kind, on the host."""
    return kind >> LABEL_BITS if kind >= 0 else 0


def noun_of(kind: int, names: Sequence[str]) -> str:
    """Name the label of a kind, whatever it looks like; "thing" for one that has no name."""
    label = int(label_of(kind))
    return names[label] if 0 <= label < len(names) else "thing"


def name_of(kind: int, names: Sequence[str]) -> str:
    """Name a kind for people, its attributes and its label among ``names``: "red ball"."""
    return " ".join([*attribute_words(code_of(kind)), noun_of(kind, names)])


def is_type(thing: Any, kind: Any) -> Any:
    """Tell whether a thing may be of a kind: the same label, and no attribute speaks against it.

    Limits: without attributes on one side it is equality of labels; what is not known of a thing
    does not speak against it; of ``ANYTHING`` the attributes alone count. Kinds i32[...] of things
    and of what is asked for give bool[...].
    """
    other = thing ^ kind
    # Negative kinds differ from the others in the sign, and from each other in the low bits.
    may_be = ((other & (_SIGN | ANYTHING)) == 0) | (is_anything(kind) & (thing >= 0))
    return may_be & ((_told(thing) & _told(kind) & _told(other)) == 0)


def _told(kind: Any) -> Any:
    """Mark the groups of attributes that a kind has a value of: the top bit of each, no other."""
    # Adding all lower bits of a group to them carries into its top bit unless they are all 0.
    return (((kind & _LOWER) + _LOWER) | kind) & _TOPS


def merge_types(known: Any, seen: Any) -> Any:
    """Add what one more look shows to what is known of a thing: the last word counts.

    ``known``, i32[...], is its kind, ``seen`` that of a detection of it, of the same label.
    """
    for mask in _MASKS:
        own = seen & mask
        # A mask has no sign bit, so that this leaves every other bit as it is.
        known = known + (own - (known & mask)) * (own != 0)
    return known
