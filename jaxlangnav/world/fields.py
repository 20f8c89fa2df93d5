"""Checked reading of a file's tables: every complaint names file, key, value, limit and remedy.

Serves the world files (section 4.2's environments, brought by people).
"""

import difflib
import math
from collections.abc import Mapping, Sequence
from typing import Any

from jaxlangnav.files.limits import FARTHEST
from jaxlangnav.plain_text import LONGEST_NAME, cut, fault_of_name, printable, shown


class WorldFileError(ValueError):
    """A world file cannot be used; the message is one line for the person who wrote it."""


class Fields:
    """One table of a file, read key by key; ``close`` complains of keys that nobody read."""

    def __init__(self, table: Any, *, file: str, where: str) -> None:
        """Wrap a table.

        Args:
            table: what the file holds at this place.
            file: the file's name, for messages.
            where: the key that leads here, such as "objects[1]"; empty at the top.

        Raises:
            WorldFileError: it is no table.
        """
        self._file, self._where = file, where
        if not isinstance(table, Mapping):
            raise WorldFileError(
                f"{file}: {where or 'the file'} is {shown(table)} but must be a table of keys and "
                "values"
            )
        self._table = table
        self._read: set[str] = set()

    def key(self, name: str) -> str:
        """Name a key of this table in full, such as "objects[1].x"."""
        name = cut(printable(name))
        return f"{self._where}.{name}" if self._where else name

    def fail(self, name: str, problem: str) -> WorldFileError:
        """Build the error for a key: one line, to be raised."""
        return WorldFileError(f"{self._file}: {self.key(name)} {problem}")

    def has(self, name: str) -> bool:
        """Tell whether the table has a key."""
        return name in self._table

    def get(self, name: str) -> Any:
        """Read a required key as it stands.

        Raises:
            WorldFileError: the key is missing.
        """
        self._read.add(name)
        if name not in self._table:
            raise self.fail(name, "is missing: add it")
        return self._table[name]

    def number(
        self,
        name: str,
        *,
        low: float = -FARTHEST,
        high: float = FARTHEST,
        default: float | None = None,
    ) -> float:
        """Read a finite number within limits.

        Args:
            name: the key.
            low: least value; as far as single precision tells centimetres apart if not given.
            high: greatest value; likewise.
            default: value where the key is missing; None requires the key.

        Returns:
            The number.

        Raises:
            WorldFileError: missing, no number, or outside the limits.
        """
        if default is not None and name not in self._table:
            return default
        value = self.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float):
            problem = f"is {shown(value)} but must be a number: write it without quotes"
            raise self.fail(name, problem)
        if isinstance(value, float) and not math.isfinite(value):
            raise self.fail(name, f"is {value!r} but must be a finite number")
        if not low <= value <= high:
            limits = f"{low:g} or more and {high:g} or less"
            raise self.fail(name, f"is {shown(value)} but must be {limits}")
        return float(value)

    def text(self, name: str, *, default: str | None = None, longest: int = LONGEST_NAME) -> str:
        """Read a text that is not empty and can be shown to people.

        Args:
            name: the key.
            default: value where the key is missing; None requires the key.
            longest: characters it may have.

        Returns:
            The text.

        Raises:
            WorldFileError: missing, no text, empty, too long, or with a control character.
        """
        if default is not None and name not in self._table:
            return default
        value = self.get(name)
        if not isinstance(value, str) or not value.strip():
            raise self.fail(name, f"is {shown(value)} but must be a text that is not empty")
        if fault := fault_of_name(value, longest=longest):
            raise self.fail(name, fault)
        return value

    def choice(self, name: str, choices: Sequence[str], *, what: str) -> str:
        """Read one of a few words.

        Args:
            name: the key.
            choices: the words.
            what: what they are, for the message.

        Returns:
            The word.

        Raises:
            WorldFileError: missing or none of them; the message suggests the closest.
        """
        value = self.text(name)
        if value not in choices:
            known = ", ".join(choices) or "none so far"
            raise self.fail(
                name,
                f"is {shown(value)} but must be {what}: {known}{closest_choice(value, choices)}",
            )
        return value

    def table(self, name: str) -> "Fields":
        """Read a required table below this one."""
        return Fields(self.get(name), file=self._file, where=self.key(name))

    def tables(self, name: str, *, least: int, most: int) -> list["Fields"]:
        """Read a required list of tables.

        Args:
            name: the key.
            least: fewest tables.
            most: most tables.

        Returns:
            One record of fields each.

        Raises:
            WorldFileError: missing, no list, or of another length.
        """
        value = self.get(name)
        if not isinstance(value, list):
            problem = f"is {shown(value)} but must be a list of tables: write [[{name}]]"
            raise self.fail(name, problem)
        # Counted before any is opened: there may be millions.
        if not least <= len(value) <= most:
            raise self.fail(
                name, f"has {len(value)} entries but must have {least} to {most}: add or remove"
            )
        return [
            Fields(entry, file=self._file, where=f"{self.key(name)}[{index}]")
            for index, entry in enumerate(value)
        ]

    def close(self, *known: str) -> None:
        """Complain of unknown keys.

        Args:
            *known: keys that are allowed though they were not read.

        Raises:
            WorldFileError: a key is unknown; the message suggests the closest known one.
        """
        allowed = sorted(self._read | set(known))
        for name in self._table:
            if name not in allowed:
                hint = closest_choice(cut(name), allowed)
                raise self.fail(name, f"is unknown: known keys are {', '.join(allowed)}{hint}")


def closest_choice(value: str, choices: Sequence[str]) -> str:
    """Suggest the closest choice, or nothing.

    Args:
        value: what was written.
        choices: what could have been meant.

    Returns:
        ". Did you mean 'hydrant'?" or an empty text.
    """
    close = difflib.get_close_matches(value, choices, n=1)
    return f". Did you mean {close[0]!r}?" if close else ""
