"""Type codes: an object's type label and attributes in one integer (sections 3.1 and 3.2).

The low ``LABEL_BITS`` hold the index of the detector's label, the bits above them one value for
each group of attributes: colour, material, size, height; 0 where unknown. Both together take 24
bits, which float32 represents exactly: tables of particles are such numbers. The map stores type
codes of observed objects, a sentence has type codes of its referents, and ``is_type`` compares
them. A type code without attributes is the index of its label. ``ANYTHING`` is the label of "the
thing": no observed object has it, and every observed object matches it.

All functions take NumPy arrays, JAX arrays and integers; ``NONE`` and ``ROBOT`` are type codes that
match only themselves.
"""

from collections.abc import Sequence
from itertools import accumulate
from typing import Any

LABEL_BITS = 13
ANYTHING = 2**LABEL_BITS - 1
"""Label of an object described without a type: "the one on your left"."""
MAX_LABELS = ANYTHING
"""Limit of distinct labels: those of the detector, and other nouns."""
ATTRIBUTES = {
    "colour": (
        "red", "orange", "yellow", "green", "blue", "purple", "pink", "brown",
        "white", "black", "gray", "silver", "gold", "beige", "striped",
    ),
    "material": ("wooden", "metal", "plastic", "glass", "stone", "brick", "paper"),
    "size": ("small", "big"),
    "height": ("short", "tall"),
}  # fmt: skip
"""Groups and their values; a value is encoded by its index in the tuple, from 1."""
_WIDTHS = {"colour": 4, "material": 3, "size": 2, "height": 2}
ATTRIBUTE_BITS = sum(_WIDTHS.values())
_OFFSETS = tuple(accumulate(_WIDTHS.values(), initial=0))
_BIT_FIELDS = {
    group: (first, ((1 << width) - 1) << first)
    for (group, width), first in zip(_WIDTHS.items(), _OFFSETS, strict=False)
}
"""Bit offset and mask of each group in an attribute code."""
_MASKS = tuple(mask << LABEL_BITS for _, mask in _BIT_FIELDS.values())
_HIGH_BITS = sum((mask + (mask & -mask)) >> 1 for mask in _MASKS)
"""The highest bit of each group."""
_LOW_BITS = sum(_MASKS) - _HIGH_BITS
_SIGN = -(2**31)


def group_of(word: str) -> str | None:
    """Return the group of an attribute; None for any other word."""
    return next((group for group, values in ATTRIBUTES.items() if word in values), None)


def attribute_code(*words: str) -> int:
    """Encode attributes, for ``Observation.detection_attribute``; 0 for none.

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
        first, mask = _BIT_FIELDS[group]
        if code & mask:
            raise ValueError(f"{word!r} is a second {group}: give one")
        code |= (ATTRIBUTES[group].index(word) + 1) << first
    return code


def attribute_words(code: int) -> tuple[str, ...]:
    """Decode the attributes of a code, the inverse of ``attribute_code``."""
    values = (
        ((code & mask) >> first, ATTRIBUTES[group]) for group, (first, mask) in _BIT_FIELDS.items()
    )
    return tuple(words[value - 1] for value, words in values if 0 < value <= len(words))


def type_code(label: Any, attributes: Any) -> Any:
    """Combine a label and an attribute code."""
    return label | (attributes << LABEL_BITS)


def label_of(code: Any) -> Any:
    """Extract the label of a type code; ``NONE`` and ``ROBOT`` are returned unchanged."""
    # All bits of a negative number are kept, since its low bits alone would be a label.
    return code & (ANYTHING | (code >> 31))


def is_anything(code: Any) -> Any:
    """Tell whether type codes have the label ``ANYTHING``, which matches every label."""
    return (code & (_SIGN | ANYTHING)) == ANYTHING


def noun_of(code: int, names: Sequence[str]) -> str:
    """Return the noun of a type code's label; "thing" if it has no name."""
    label = int(label_of(code))
    return names[label] if 0 <= label < len(names) else "thing"


def name_of(code: int, names: Sequence[str]) -> str:
    """Format a type code, its attributes and its label among ``names``: "red ball"."""
    attributes = code >> LABEL_BITS if code >= 0 else 0
    return " ".join([*attribute_words(attributes), noun_of(code, names)])


def is_type(detected: Any, described: Any) -> Any:
    """Tell whether a detected object matches a description: equal labels, no conflicting attribute.

    Limits: without attributes on one side it is equality of labels; unknown attributes do not
    conflict; for ``ANYTHING`` only the attributes count. Type codes i32[...] of objects and
    descriptions give bool[...].
    """
    difference = detected ^ described
    # Negative codes differ from others in the sign, and from each other in the low bits.
    is_match = ((difference & (_SIGN | ANYTHING)) == 0) | (is_anything(described) & (detected >= 0))
    return is_match & ((_has_value(detected) & _has_value(described) & _has_value(difference)) == 0)


def _has_value(code: Any) -> Any:
    """Mark the attribute groups that have a value, by the top bit of each."""
    # Adding all lower bits of a group to them carries into its top bit unless they are all 0.
    return (((code & _LOW_BITS) + _LOW_BITS) | code) & _HIGH_BITS


def merge_types(old: Any, new: Any) -> Any:
    """Update the attributes of an object from a detection, whose values take precedence.

    ``old``, i32[...], is its type code, ``new`` that of a detection of it with the same label.
    """
    for mask in _MASKS:
        field = new & mask
        # A mask has no sign bit, so this leaves all other bits unchanged.
        old = old + (field - (old & mask)) * (field != 0)
    return old
