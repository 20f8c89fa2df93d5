"""What the short meanings of ``spoken.txt`` come to in a world: plain geometry by hand.

Shares nothing with the package but names. The robot starts at the origin and looks along x;
"behind" and its kin are seen from there. Every relation has a core, in which anybody would use the
word, and an outskirts, in which somebody might; a world is taken for a sentence only if what is
meant in it is clear: the things in the outskirts are those in the core.
"""

import dataclasses
import re
from pathlib import Path

import numpy as np

_LINES = Path(__file__).with_name("spoken.txt").read_text("utf-8").splitlines()
SPOKEN = [line.split(" => ") for line in _LINES if " => " in line]
"""Sentences as people say them, and what each means in short, or ``REFUSED``."""
ROBOT, ANY = "robot", "one"
_TOKEN = re.compile(r"\[|\]|[^\[\]\s]+")


@dataclasses.dataclass(frozen=True)
class Thing:
    """A thing as a label has it: a type, marks, and relations to other things."""

    kind: str
    marks: tuple[str, ...] = ()
    relations: tuple[tuple[str, int, "Thing"], ...] = ()  # relation, rank, landmark


@dataclasses.dataclass(frozen=True)
class Command:
    """One command of a label."""

    is_find: bool
    region: str | None
    thing: Thing
    avoided: tuple[Thing, ...] = ()


def _read_thing(tokens: list[str]) -> Thing:
    marks = []
    while tokens and tokens[0] in ("other", "same"):
        marks.append(tokens.pop(0))
    kind = [tokens.pop(0)] if tokens and tokens[0] != "[" else [ANY]
    while tokens and tokens[0] not in ("[", "]"):
        kind.append(tokens.pop(0))
    relations = []
    while tokens and tokens[0] == "[":
        tokens.pop(0)
        name = tokens.pop(0)
        rank = int(name[-1]) if name[-1].isdigit() else 0
        relations.append((name.rstrip("0123456789"), rank, _read_thing(tokens)))
        tokens.pop(0)
    return Thing(" ".join(kind), tuple(marks), tuple(relations))


def read_label(label: str) -> list[Command]:
    """Read the commands of a meaning in short; statements and mere constraints are left out."""
    commands = []
    for clause in (one.strip() for one in label.split(";")):
        head, _, kept = clause.partition(" avoid ")
        action, _, goal = head.partition(" ")
        if action.split(":")[0] not in ("nav", "find"):
            continue
        tokens = _TOKEN.findall(goal)
        region = tokens.pop(0)[1:] if tokens[0].startswith("@") else None
        avoided = tuple(_read_thing(_TOKEN.findall(one)) for one in kept.split(",") if one)
        commands.append(Command(action.startswith("find"), region, _read_thing(tokens), avoided))
    return commands


@dataclasses.dataclass(frozen=True)
class Place:
    """A world: kinds and places, metres."""

    kinds: tuple[str, ...]
    at: np.ndarray  # f64[O, 2]


def _along(place: np.ndarray, landmark: np.ndarray | None) -> tuple[float, float]:
    """Split the way from a landmark into along the line of sight and to its left."""
    if landmark is None:
        return float(place[0]), float(place[1])
    ahead = landmark / max(np.hypot(*landmark), 1e-9)
    offset = place - landmark
    return float(offset @ ahead), float(ahead[0] * offset[1] - ahead[1] * offset[0])


def holds(name: str, place: np.ndarray, landmark: np.ndarray | None, *, is_core: bool) -> bool:
    """Tell whether a relation holds of a place; ``None`` is the robot at its start."""
    along, left = _along(place, landmark)
    away = np.hypot(along, left)
    if name == "near":
        core = 3.5 if landmark is None else 2.2  # nothing stands right where the robot does
        return away < (core if is_core else 5.0)
    if name == "far":
        return away > (8.0 if is_core else 4.0)
    if landmark is None:
        along = -along  # in front of the robot is ahead of it
    main, side = {
        "behind": (along, left), "front": (-along, left), "left": (left, along),
        "right": (-left, along),
    }[name]  # fmt: skip
    if is_core:
        return 0.8 < main < (9.0 if landmark is None else 3.2) and abs(side) < 0.4 * main
    reach = 12.0 if landmark is None else 6.0
    return 0.0 < main < reach and abs(side) < 2.0 * main


def find_things(thing: Thing, world: Place, gone: set[int], *, is_core: bool) -> set[int]:
    """Find the things of a world that a label may mean."""
    found = {n for n, own in enumerate(world.kinds) if thing.kind in (ANY, "place", "thing", own)}
    found -= gone if "other" in thing.marks else set()
    for name, rank, landmark in sorted(thing.relations, key=lambda one: one[1]):
        marks = [None]
        if landmark.kind != ROBOT:
            marks = sorted(find_things(landmark, world, set(), is_core=is_core))
        ends = {mark: None if mark is None else world.at[mark] for mark in marks}
        if rank == 0:
            found = {
                n for n in found
                if any(n != m and holds(name, world.at[n], end, is_core=is_core)
                       for m, end in ends.items())
            }  # fmt: skip
        else:
            found = {n for m in marks for n in _ranked(name, rank, world, found - {m}, m, is_core)}
    return found


def _ranked(
    name: str, rank: int, world: Place, found: set[int], mark: int | None, is_core: bool
) -> set[int]:
    """Take the n-th; in the outskirts also whatever is hardly less so than it."""

    def measure(n: int) -> float:
        along, left = _along(world.at[n], None if mark is None else world.at[mark])
        away = float(np.hypot(along, left))
        sideways = float(np.degrees(np.arctan2(left, max(along, 0.3)))) / 20.0
        return {"near": away, "far": -away, "left": -sideways, "right": sideways}.get(
            name, -along if name == "behind" else along
        )

    order = sorted(found, key=measure)
    if len(order) < rank:
        return set()
    best = measure(order[rank - 1])
    return {n for n in order if abs(measure(n) - best) < (1e-9 if is_core else 1.2)}


def goals_of(commands: list[Command], world: Place) -> list[set[int]] | None:
    """Find what each command means, nothing where it is the robot; None where it is left open.

    "The cone, then the other cone" is open only in which of the two comes first.
    """
    gone: set[int] = set()
    last: set[int] = set()
    meant = []
    for command, after in zip(commands, [*commands[1:], None], strict=True):
        thing = command.thing
        if "same" in thing.marks:
            found = last
        else:
            found = find_things(thing, world, gone, is_core=True)
            if found != find_things(thing, world, gone, is_core=False):
                return None
        is_either = after is not None and after.thing == Thing(thing.kind, ("other",))
        if is_either and not thing.relations and len(found) == 2:
            return [found, found] if len(commands) == 2 else None
        if thing.kind != ROBOT and (not found or (len(commands) > 1 and len(found) > 1)):
            return None
        gone, last = set(found), found
        meant.append(found)
    return meant


def kinds_in(commands: list[Command]) -> list[str]:
    """List the kinds of things that commands speak of, each as often as it has to be there."""
    needed: dict[str, int] = {}

    def walk(thing: Thing) -> None:
        if thing.kind != ROBOT:
            rank = max((rank for _, rank, _ in thing.relations), default=0)
            number = max(rank, 2 if "other" in thing.marks else 1)
            kind = "barrel" if thing.kind in (ANY, "place", "thing") else thing.kind
            needed[kind] = max(needed.get(kind, 0), number)
        for _, _, landmark in thing.relations:
            walk(landmark)

    for command in commands:
        for one in (command.thing, *command.avoided):
            walk(one)
    return [kind for kind, number in needed.items() for _ in range(number)]
