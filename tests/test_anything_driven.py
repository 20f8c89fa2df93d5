"""Goals of any type driven in unknown places: "the thing behind the cone" (design, section 8).

What is right is said by plain geometry (``hand_geometry``). The things have types of their own in
every world, the one that is meant too, and it is not in the first view.
"""

import zlib

import numpy as np
import pytest
from hand_geometry import Place, find_things, goals_of, read_label
from test_spoken_driven import (
    follow,
    is_clear,
    scatter,
    what_is_wrong,
)

RANGE, WORLDS = 4.0, 4
SENTENCES = {
    "go to the thing behind the cone": "nav one[behind cone]",
    "drive to the object near the car": "nav one[near car]",
    "go to the one on your left": "nav one[left robot]",
    "find the object that is in front of the hydrant": "find one[front hydrant]",
    "go to the item to the right of the bench": "nav one[right bench]",
    "go to the cone, then to the thing behind it": "nav cone ; nav one[behind same cone]",
    "go to the thing behind the cone near the car": "nav one[behind cone[near car]]",
    "go to the object closest to the hydrant": "nav one[near1 hydrant]",
    "go to whatever is next to the bench": "nav one[near bench]",
}
TYPES = ("barrel", "bench", "box", "tree", "car", "cone", "hydrant")


def draw_world(label: str, seed: int) -> Place | None:
    """Draw a world in which it is clear what is meant, and two things are there besides."""
    told, draw = read_label(label), np.random.default_rng(seed)
    named = [kind for kind in TYPES if kind in label]
    for _ in range(400):
        own, *others = draw.permutation([kind for kind in TYPES if kind not in named])[:3]
        # ``scatter`` places the thing of kind "one" about where the label has it.
        at = scatter(told, [*named, "one", *others], draw)
        world = Place((*named, str(own), *map(str, others)), at)
        meant = goals_of(told, world)
        if meant is None or not is_clear(told, world):
            continue
        if all(np.hypot(*at[n]) > RANGE + 0.5 for n in meant[-1]):
            return world
    return None


def cases() -> list[tuple[str, str, Place]]:
    drawn = [
        (text, label, draw_world(label, zlib.crc32(f"{index} {text}".encode())))
        for text, label in SENTENCES.items()
        for index in range(WORLDS)
    ]
    return [(text, label, world) for text, label, world in drawn if world is not None]


def test_worlds_are_of_many_types() -> None:
    found = cases()
    assert len(found) == WORLDS * len(SENTENCES)
    meant = {
        world.kinds[n]
        for _, label, world in found
        for n in find_things(read_label(label)[-1].thing, world, set(), is_core=True)
    }
    assert len(meant) >= 5


@pytest.mark.slow
def test_the_thing_is_found_whatever_it_is() -> None:
    some = cases()
    found = follow([(text, world) for text, _, world in some], range_max=RANGE)
    wrong = [
        f"{text!r}: {why}; {list(zip(world.kinds, world.at.round(1).tolist(), strict=True))}"
        for (text, label, world), one in zip(some, found, strict=True)
        if (why := what_is_wrong(read_label(label), world, *one, range_max=RANGE))
    ]
    # One may stop a centimetre too far away: odometry is out by 2 % of the way.
    assert len(wrong) <= 1, f"{len(wrong)} of {len(some)}:\n" + "\n".join(wrong)
