"""Sentences of ``spoken.txt``, driven in random worlds; ``hand_geometry`` says what is right."""

import os
import random
import zlib
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hand_geometry import (
    ROBOT,
    SPOKEN,
    Command,
    Place,
    Thing,
    find_things,
    goals_of,
    holds,
    kinds_in,
    read_label,
)
from placed import placed
from readings import repeat, stack

from jaxlangnav import Navigator, episode
from jaxlangnav.episode import EpisodeState, Task, lanes
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.grounding.binding import Detector
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import Status, default_motion, default_sensor
from jaxlangnav.navigator import NavigatorConfig, NavigatorParams
from jaxlangnav.world.motion import HOLONOMIC
from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.state import NUM_SLOTS, Scenario

NUM_WORLDS, ROUND, LANES, STEPS = 3, 256, 32, 120
MOST_THINGS, RANGE, EXTENT = 6, 8.0, 10.0
AVOIDED = 1.2  # metres within which a thing to be avoided has been approached
SENTENCES = [(text, read_label(label)) for text, label in SPOKEN if label != "REFUSED"]
COMMANDS = [(text, told) for text, told in SENTENCES if told and "between" not in text]
"""Sentences that send somewhere; ``test_follow_between`` drives those of two landmarks."""
SPARE = ("bench", "box", "tree", "car")
KINDS = sorted({kind for _, told in COMMANDS for kind in kinds_in(told)} | set(SPARE))


def scatter(told: list[Command], kinds: list[str], draw: np.random.Generator) -> np.ndarray:
    """Throw things into the area, those that a label relates about where it has them."""
    at = draw.uniform(-EXTENT + 1.0, EXTENT - 1.0, (len(kinds), 2))
    free = list(range(len(kinds)))

    def put(thing: Thing) -> np.ndarray | None:
        if thing.kind == ROBOT:
            return None
        slot = next((n for n in free if kinds[n] == thing.kind), None)
        marks = [(name, put(mark)) for name, rank, mark in thing.relations if rank == 0]
        if slot is None:
            return draw.uniform(-5.0, 5.0, 2)
        free.remove(slot)
        if marks:
            name, landmark = marks[0]
            spots = draw.uniform(-6.0, 6.0, (200, 2)) + (0.0 if landmark is None else landmark)
            core = (one for one in spots if holds(name, one, landmark, is_core=True))
            at[slot] = next(core, at[slot])
        return at[slot]

    for command in told:
        for one in (command.thing, *command.avoided):
            put(one)
    return at


def is_clear(told: list[Command], world: Place) -> bool:
    """Tell whether nothing is in the way, and what is to be avoided is known and can be."""
    away = np.hypot(*(world.at[:, None] - world.at[None]).transpose(2, 0, 1))
    if (away + 9.0 * np.eye(len(away)) < 1.5).any() or (np.hypot(*world.at.T) < 2.5).any():
        return False
    meant = goals_of(told, world)
    margin = 4.0 if any(one.region for one in told) else 0.5
    # Other than which? And a place beside a thing lies in the area.
    if "'other'" in repr(told[0].thing) or np.abs(world.at).max() > EXTENT - margin:
        return False
    if meant is None:
        return False
    for out in avoided_in(told, world):
        near = [n for found in meant for n in found]
        if out in near or np.hypot(*world.at[out]) < 3.5 or (away[out, near] < 5.0).any():
            return False
    return True


def avoided_in(told: list[Command], world: Place) -> set[int]:
    return {
        n
        for command in told
        for one in command.avoided
        if "same" not in one.marks
        for n in find_things(one, world, set(), is_core=True)
    }


def draw_world(told: list[Command], seed: int) -> Place | None:
    """Draw a world in which it is clear what is meant; None where none was found."""
    draw, kinds = np.random.default_rng(seed), kinds_in(told)
    if len(kinds) > MOST_THINGS:
        return None
    extra = [told[-1].thing.kind] if told[-1].thing.relations and len(kinds) < MOST_THINGS else []
    extra += [one for one in SPARE if one not in kinds][:1]
    kinds = (kinds + [one for one in extra if one not in ("one", "place")])[:MOST_THINGS]
    for _ in range(400):
        world = Place(tuple(kinds), scatter(told, kinds, draw))
        if is_clear(told, world):
            return world
    return None


def scenario_of(world: Place, names: tuple[str, ...]) -> Scenario:
    rows = [(names.index(kind), *at) for kind, at in zip(world.kinds, world.at, strict=True)]
    return placed(rows, slots=NUM_SLOTS, area=[-EXTENT, EXTENT] * 2)


class Way(NamedTuple):
    """An episode that keeps where it has been."""

    progress: EpisodeState
    at: jax.Array  # f32[STEPS + 1, 2] metres; NaN where it has not come to


def _begin(task: Task, instructions: Instruction, *, config: NavigatorConfig) -> Way:
    at = jnp.full((STEPS + 1, 2), jnp.nan).at[0].set(task.scenario.start[:2])
    return Way(episode.begin(task, instructions, config=config), at)


def _advance(way: Way, *, params: NavigatorParams, config: NavigatorConfig) -> tuple[Way, None]:
    after, *_ = episode.advance(way.progress, params=params, config=config)
    return Way(after, way.at.at[after.steps].set(after.world.position)), None


COURSE = lanes.EpisodeProgram(
    _begin, _advance, lambda way: (way.at, way.progress.navigator.status, way.progress.steps),
    lambda way: way.progress, lambda way: way.progress.navigator.is_done,
)  # fmt: skip


def follow(cases: list[tuple[str, Place]]) -> list[tuple[np.ndarray, Status, int]]:
    """Follow sentences in worlds: the way of each, how it ended, and after how many steps."""
    model = load_shipped()
    labels = tuple(dict.fromkeys([*model.type_names, *KINDS]))
    told = {text: understand(text, model, Detector(labels)).instruction for text, _ in cases}
    robot, found = Navigator.pretrained(), []
    for first in range(0, len(cases), ROUND):
        number = min(ROUND, len(cases) - first)
        some = [cases[first + n % number] for n in range(ROUND)]
        tasks = Task(
            key=jax.random.split(jax.random.key(0), ROUND),
            scenario=stack([scenario_of(world, labels) for _, world in some]),
            instruction_index=jnp.arange(ROUND, dtype=jnp.int32),
            sensor=repeat(default_sensor(RANGE), ROUND),
            motion=repeat(default_motion(), ROUND),
            body=HOLONOMIC,
        )
        ways = lanes.run_batch(
            tasks, stack([told[text] for text, _ in some]), params=robot.params,
            config=robot.config, num_lanes=LANES, max_steps=STEPS, count=number, program=COURSE,
        )  # fmt: skip
        found += [
            (path[~np.isnan(path[:, 0])], Status(int(ended)), int(steps))
            for path, ended, steps in zip(*jax.device_get(ways), strict=True)
        ][:number]
    return found


def what_is_wrong(
    told: list[Command], world: Place, path: np.ndarray, ended: Status, steps: int
) -> str:
    """Hold an episode against plain geometry; empty where it is right."""
    meant, end, last = goals_of(told, world), path[-1], told[-1]
    if ended != Status.ARRIVED:
        return f"ended {ended.word}"
    if last.region is not None and not last.is_find:
        marks = [None] if last.thing.kind == ROBOT else [world.at[n] for n in meant[-1]]
        if not any(holds(last.region, end, mark, is_core=False) for mark in marks):
            return f"ended at {end.round(1)}, not {last.region}"
    else:
        away = min(np.hypot(*(end - world.at[n])) for n in meant[-1])
        if away > (RANGE if last.is_find else SUCCESS_RADIUS):
            return f"ended {away:.1f} m from what is meant, at {end.round(1)}"
    for command, found in zip(told[:-1], meant[:-1], strict=True):
        if command.region is None and not command.is_find:
            way = max(np.hypot(*(path - world.at[n]).T).min() for n in found)
            if way > SUCCESS_RADIUS:
                return f"passed {way:.1f} m from what came before"
    for out in avoided_in(told, world):
        way = float(np.hypot(*(path - world.at[out]).T).min())
        if way < AVOIDED:
            return f"approached what is to be avoided, {way:.1f} m"
    if steps == 1 and not last.is_find and last.region is None:
        return "stopped where it stood"
    return ""


def test_the_geometry_is_what_people_mean() -> None:
    world = Place(
        ("cone", "hydrant", "hydrant", "car"), np.array([[5, 0], [7, 0], [5, 2.5], [1, -4]])
    )
    for label, expected in (
        ("nav hydrant[behind cone]", {1}), ("nav hydrant[left cone]", {2}),
        ("nav car[right robot]", {3}), ("nav hydrant[near1 cone]", {1}),
        ("nav cone[front hydrant[behind cone]]", {0}), ("nav cone ; nav hydrant[left1 robot]", {2}),
        ("find:carefully one[behind cone] avoid car", {1}),
    ):  # fmt: skip
        found = find_things(read_label(label)[-1].thing, world, set(), is_core=True)
        assert found == expected, label
    assert goals_of(read_label("nav cone ; nav @behind same cone"), world) == [{0}, {0}]


def test_most_sentences_have_worlds_in_which_they_are_clear() -> None:
    some = COMMANDS[::40]
    assert len(COMMANDS) > 500
    drawn = [draw_world(told, index) is not None for index, (_, told) in enumerate(some)]
    assert np.mean(drawn) > 0.8


KNOWN = {
    "does not look on for one that is nearer to the thing": (
        "closest tree to the house", "the hydrant nearest the cone", "nearest hydrant to the tree",
        "go to whichever cone is nearest to the bench", "go to the cone nearest the car",
        "go to the hydrant that is nearest the bench",
    ),
    "settles before one that would come before is found": ("the second tree from the left",),
    "stops farther off than 'in front' reaches": ("wait in front of the leftmost building",),
}  # fmt: skip
"""Sentences that go wrong in some world, by why: none may be added (docs/limits.md)."""
MAX_WRONG = 1
"""Worlds of the first two rounds in which they do; may only shrink."""


@pytest.mark.slow
def test_every_sentence_leads_where_it_says() -> None:
    """Two rounds of worlds drawn from all; ``SPOKEN_ROUNDS=9`` drives every one."""
    rounds = int(os.environ.get("SPOKEN_ROUNDS", "2"))
    cases = [
        (text, told, world)
        for text, told in COMMANDS
        for index in range(NUM_WORLDS)
        if (world := draw_world(told, zlib.crc32(f"{index} {text}".encode()))) is not None
    ]
    random.Random(0).shuffle(cases)
    cases = cases[: rounds * ROUND]
    found, wrong = follow([(text, world) for text, _, world in cases]), []
    for (text, told, world), one in zip(cases, found, strict=True):
        if why := what_is_wrong(told, world, *one):
            things = list(zip(world.kinds, world.at.round(1).tolist(), strict=True))
            wrong.append((text, f"{why}; {things}"))
    known = {text for texts in KNOWN.values() for text in texts}
    said = "\n".join(f"{text!r}: {why}" for text, why in wrong)
    assert not {text for text, _ in wrong} - known, f"{len(wrong)} of {len(cases)}:\n{said}"
    assert rounds > 2 or len(wrong) <= MAX_WRONG, said
