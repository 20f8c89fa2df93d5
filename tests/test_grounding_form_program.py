"""The program of a form asks for what the trained graph hears in a sentence that says the same."""

import json
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import test_grounding_behavior
from grounding_fixture import TYPES, random_placed, random_topology

from jaxlangnav.grounding import (
    AnnotationGrounder,
    Context,
    GraphGrounder,
    Grounded,
    infer_behaviors,
    load_shipped,
)
from jaxlangnav.grounding.readings import CapacityError
from jaxlangnav.grounding.worlds import World, reading_world, to_device
from jaxlangnav.messages import ACTIONS, AT, MODES, NEAR, REGIONS, RELATIONS, ROBOT

START = Context(is_under_way=False)
SLOTS, WORLDS = 9, 48
DOUBT = 0.02  # by how much the trained graph may doubt what a form is sure of
Relation = tuple
"""Figure, relation, landmark and, where there is one, rank."""


def reading(types: str, *relations: Relation, commands: list, probability: float = 1.0) -> dict:
    """Build a reading; things are called a, b, c in the order of their types."""
    names = ("figure", "relation", "landmark", "rank")
    return {
        "probability": probability,
        "things": [
            {"id": name, "type": kind}
            for name, kind in zip("abcdef", types.split(), strict=False)
        ],
        "relations": [dict(zip(names, one, strict=False)) for one in relations],
        "commands": commands,
    }  # fmt: skip


def to(thing: str, region: str = "at", **more: object) -> dict:
    return {"goal": {"thing": thing, "region": region}, **more}


def ground(*readings: dict) -> Grounded:
    return AnnotationGrounder(TYPES).ground(json.dumps({"readings": readings}), START)


def one(types: str, *relations: Relation, probability: float = 1.0, **command: object) -> dict:
    """Build the reading of one command, to thing a."""
    return reading(types, *relations, commands=[to("a", **command)], probability=probability)


# Sentence → the form that says the same.
SAME = {
    "go to the hydrant": one("hydrant"),
    "quickly go to the box": one("box", mode="quickly"),
    "carefully go to the tree": one("tree", mode="carefully"),
    "go to the hydrant in front of the cone": one("hydrant cone", ("a", "front", "b")),
    "go to the hydrant behind the cone": one("hydrant cone", ("a", "behind", "b")),
    "go to the hydrant to the left of the cone": one("hydrant cone", ("a", "left", "b")),
    "go to the hydrant near the cone": one("hydrant cone", ("a", "near", "b")),
    "go to the hydrant far from the cone": one("hydrant cone", ("a", "far", "b")),
    "go to the hydrant behind the cone near the car": one(
        "hydrant cone car", ("a", "behind", "b"), ("b", "near", "c")
    ),
    "go to the hydrant between the cone and the car": one(
        "hydrant cone car", ("a", "between", "b"), ("a", "between", "c")
    ),
    "go to the nearest cone": one("cone", ("a", "near", "robot", 1)),
    "go to the leftmost tree": one("tree", ("a", "left", "robot", 1)),
    "go to the hydrant nearest to the cone": one("hydrant cone", ("a", "near", "b", 1)),
    "go to the second cone": one("cone", ("a", "near", "robot", 2)),
    "go to the cone on your left": one("cone", ("a", "left", "robot")),
    "go to the hydrant behind you": one("hydrant", ("a", "behind", "robot")),
    "go to the second cone on your left": one(
        "cone", ("a", "left", "robot"), ("a", "near", "robot", 2)
    ),
    "move behind the cone": one("cone", region="behind"),
    "stop in front of the car": one("car", region="front"),
    "stop to the right of the cone near the car": one(
        "cone car", ("a", "near", "b"), region="right"
    ),
    "go to the cone but stay away from the hydrant": one("cone hydrant", avoid=["b"]),
    "go to the cone then find the hydrant": reading(
        "cone hydrant", commands=[to("a"), to("b", action="find")]
    ),
    "go to the cone then go to the other cone": reading("cone cone", commands=[to("a"), to("b")]),
}


def crowded(text: str, rng: np.random.Generator) -> list[World]:
    """Draw worlds full of what a sentence speaks of: placed ones, and any topology."""
    graph = GraphGrounder(load_shipped()).ground(text, START)
    named = [kind for kind in TYPES if kind in text]
    worlds = []
    for count in range(WORLDS):
        if count % 2:
            placed = random_placed(rng, SLOTS - 1)
            objects = tuple((rng.choice([*named, "bench"]), x, y) for _, x, y in placed.objects)
            place = type(placed)(objects=objects, robot=placed.robot, previous=placed.previous)
            worlds.append(reading_world(place, TYPES, graph.instruction.readings))
        else:
            world = random_topology(rng, SLOTS - 1, p_relation=0.4)
            world.object_type[:-1] = rng.choice([TYPES.index(kind) for kind in named], SLOTS - 1)
            worlds.append(world)
    return worlds


def with_a_pair(world: World) -> World:
    """Let the first hydrant alone lie between the first cone and the first car, where they are."""
    world.is_related[NEAR] = False
    kinds = [TYPES.index(name) for name in ("hydrant", "cone", "car")]
    found = [np.flatnonzero((world.object_type == kind) & world.is_object) for kind in kinds]
    if all(one.size for one in found):
        figure, *landmarks = (one[0] for one in found)
        world.is_related[NEAR, figure, landmarks] = True
    return world


@jax.jit
def infer(program: object, worlds: object) -> object:
    return infer_behaviors(program, worlds, num_phrases=program.num_phrases)


def behaviors(grounded: Grounded, worlds: list[World], clause: int = 0) -> object:
    """Infer the behavior of a command in ``WORLDS`` worlds, leaves [..., WORLDS]."""
    program = jax.tree.map(lambda leaf: leaf[clause], grounded.instruction.clauses)
    padded = [to_device(world, SLOTS) for world in worlds]
    padded += [padded[-1]] * (WORLDS - len(padded))
    lanes = jax.tree.map(lambda *leaves: jnp.stack(leaves, axis=-1), *padded)
    return jax.tree.map(lambda leaf: np.asarray(leaf)[..., : len(worlds)], infer(program, lanes))


@pytest.mark.parametrize("text", SAME)
def test_a_form_asks_for_what_its_sentence_does(text: str) -> None:
    graph, form = GraphGrounder(load_shipped()).ground(text, START), ground(SAME[text])
    assert int(form.instruction.num_clauses) == int(graph.instruction.num_clauses)
    worlds = crowded(text, np.random.default_rng(5))
    if "between" in text:
        worlds = [with_a_pair(world) for world in worlds]
    for clause in range(int(form.instruction.num_clauses)):
        mine, theirs = (behaviors(grounded, worlds, clause) for grounded in (form, graph))
        assert (mine.goal.sum((0, 1)) > 0.9).sum() >= 8  # and these worlds have such a goal
        np.testing.assert_allclose(mine.goal, theirs.goal, atol=DOUBT)
        np.testing.assert_allclose(mine.constraint, theirs.constraint, atol=DOUBT)
        np.testing.assert_allclose(mine.action, theirs.action, atol=DOUBT)
        np.testing.assert_allclose(mine.mode, theirs.mode, atol=DOUBT)


# ---------------------------------------------------------------- an oracle that enumerates


def fitting(document: dict, world: World, thing: str, behind: tuple[str, ...] = ()) -> np.ndarray:
    """Find the objects that a thing of a reading may be, one relation after the other; bool[N]."""
    kinds = {own["id"]: TYPES.index(own["type"]) for own in document["things"]}
    found = (world.object_type == kinds.get(thing, ROBOT)) & world.is_object
    for own in document["relations"]:
        if own["figure"] != thing or own["landmark"] in (*behind, thing):
            continue
        rank = own.get("rank", 0)
        table = world.is_ranked[min(rank, 2) - 1] if rank else world.is_related
        landmarks = fitting(document, world, own["landmark"], (*behind, thing))
        found = found & (table[RELATIONS.index(own["relation"])] & landmarks[None]).any(1)
    return found


def random_forms(rng: np.random.Generator) -> Iterator[dict]:
    """Draw forms of one command, whatever they mean."""
    while True:
        names = "abcd"[: rng.integers(1, 5)]
        relations = []
        for _ in range(rng.integers(0, 5)):
            figure, landmark = rng.choice(list(names)), rng.choice([*names, "robot"])
            rank = int(rng.integers(0, 3)) if rng.random() < 0.5 else 0
            relation = rng.choice(RELATIONS[2:] if rank else RELATIONS)
            if figure != landmark:
                relations.append((figure, relation, landmark, rank))
        kinds = " ".join(rng.choice(["hydrant", "cone"], len(names)))
        avoid = [name for name in names[1:] if rng.random() < 0.5]
        yield reading(kinds, *relations, commands=[to("a", rng.choice(REGIONS), avoid=avoid)])


def test_any_form_asks_for_all_that_fits_it_and_nothing_else() -> None:
    rng = np.random.default_rng(3)
    worlds = []
    for _ in range(WORLDS):
        world = random_topology(rng, SLOTS - 1, p_relation=0.5)
        world.object_type[:-1] = rng.integers(0, 2, SLOTS - 1)
        worlds.append(world)
    checked = reached = 0
    for document in random_forms(rng):
        if checked == 40:
            break
        try:
            grounded = ground(document)
        except CapacityError:
            continue
        checked += 1
        found, command = behaviors(grounded, worlds), document["commands"][0]
        region = REGIONS.index(command["goal"]["region"])
        for lane, world in enumerate(worlds):
            fits = fitting(document, world, "a")
            goal = np.zeros((len(REGIONS), SLOTS))
            goal[region] = fits / max(fits.sum(), 1)
            reached += bool(fits.any())
            np.testing.assert_allclose(found.goal[..., lane], goal, atol=1e-3)
            avoid = [fitting(document, world, name) for name in command["avoid"]]
            keep = np.zeros((len(REGIONS), SLOTS))
            keep[NEAR] = np.any(avoid, axis=0) if avoid else False
            np.testing.assert_allclose(found.constraint[..., lane], keep, atol=1e-3)
    assert reached > 40 * WORLDS / 4


def world_of(kinds: str, *edges: tuple[str, int, int], previous: int | None = None) -> World:
    """Build a world of objects, and of relations between them by their numbers; −1 is the robot."""
    edges_at = [(RELATIONS.index(relation), *ends) for relation, *ends in edges]
    return test_grounding_behavior.world_of(kinds.split(), edges_at, previous)


def test_relations_tell_which_reading_a_particle_believes() -> None:
    """Which goal is meant is then a matter of the particles' weights, and sure in each of them."""
    grounded = ground(
        reading("hydrant cone", ("a", "behind", "b"), commands=[to("a")], probability=0.7),
        reading("hydrant cone", ("b", "left", "a"), commands=[to("b")], probability=0.3),
    )
    first, second = (
        behaviors(grounded, [world_of("hydrant cone hydrant", edge)]).goal[..., 0]
        for edge in (("behind", 2, 1), ("left", 1, 2))
    )
    assert first[AT, 2] > 0.99
    assert second[AT, 1] > 0.99


def test_goals_that_nothing_tells_apart_share_by_their_probabilities() -> None:
    grounded = ground(one("cone", probability=0.7), one("tree", probability=0.3))
    both = behaviors(grounded, [world_of("cone tree car")]).goal[AT, :, 0]
    # Apart, of four chances: the first alone, both, the second alone, none.
    np.testing.assert_allclose(both[:2], [0.49 + 0.21 / 2, 0.09 + 0.21 / 2], atol=1e-3)
    assert both[2] == pytest.approx(0.0, abs=1e-6)
    only = behaviors(grounded, [world_of("tree car")]).goal[AT, :, 0]
    np.testing.assert_allclose(only[0], 0.3, atol=1e-3)


def test_a_plain_relation_shows_in_a_reading_that_means_the_extreme_one() -> None:
    """The nearest cone is near, so that the first goal is no surer than its reading."""
    grounded = ground(
        reading("cone tree", ("a", "near", "robot"), commands=[to("a")], probability=0.7),
        reading("cone tree", ("a", "near", "robot", 1), commands=[to("b")], probability=0.3),
    )
    goal = behaviors(grounded, [world_of("cone tree", ("near", 0, -1))]).goal[AT, :, 0]
    np.testing.assert_allclose(goal[:2], [0.49 + 0.21 / 2, 0.09 + 0.21 / 2], atol=1e-3)


def test_readings_with_one_goal_leave_no_doubt_of_it() -> None:
    places = ("a", "near", "b"), ("a", "far", "b")
    readings = [one("cone tree", place, region="behind", probability=0.5) for place in places]
    for edge in ("near", "far"):
        goal = behaviors(ground(*readings), [world_of("cone tree", (edge, 0, 1))]).goal
        assert goal[REGIONS.index("behind"), 0, 0] > 0.99


def test_action_mode_and_region_are_mixed_by_the_readings() -> None:
    grounded = ground(
        one("cone", action="find", probability=0.75),
        one("cone", region="near", mode="quickly", probability=0.25),
    )
    behavior = behaviors(grounded, [world_of("cone")])
    np.testing.assert_allclose(behavior.action[:, 0], [0.25, 0.75], atol=1e-6)
    assert ACTIONS[1] == "find"
    np.testing.assert_allclose(behavior.mode[:, 0], [0.75, 0.25, 0.0], atol=1e-6)
    assert MODES[1] == "quickly"
    assert behavior.goal[AT, 0, 0] > 2 * behavior.goal[NEAR, 0, 0] > 0.1


def test_what_one_reading_avoids_is_avoided_as_far_as_it_is_believed() -> None:
    first, second = one("cone car", avoid=["b"], probability=0.6), one("cone car", probability=0.4)
    constraint = behaviors(ground(first, second), [world_of("cone car")]).constraint[NEAR, :2, 0]
    np.testing.assert_allclose(constraint, [0.0, 0.6], atol=1e-3)


def test_the_same_thing_again_is_where_the_last_command_ended() -> None:
    grounded = ground(reading("cone", commands=[to("a"), to("a", "behind")]))
    world = world_of("cone cone tree", previous=1)
    goal = behaviors(grounded, [world], clause=1).goal[REGIONS.index("behind"), :, 0]
    np.testing.assert_allclose(goal[:3], [0.0, 1.0, 0.0], atol=1e-3)


def test_a_region_of_the_robot_is_a_goal() -> None:
    grounded = ground(reading("cone", commands=[to("robot", "left")]))
    goal = behaviors(grounded, [world_of("cone")]).goal
    assert goal[REGIONS.index("left"), -1, 0] > 0.99


def test_four_relations_of_one_thing_all_count() -> None:
    """More than a phrase has children."""
    places = ("near", "left", "behind", "front")
    grounded = ground(one("cone tree", *((("a", place, "b")) for place in places)))
    full = [(place, 0, 1) for place in places]
    for left_out in range(5):
        edges = full[:left_out] + full[left_out + 1 :]
        goal = behaviors(grounded, [world_of("cone tree", *edges)]).goal
        assert goal[AT, 0, 0] == pytest.approx(1.0 if left_out == 4 else 0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("readings", "reason"),
    [
        (
            [one("cone", region=place, probability=1 / 3) for place in ("at", "near", "behind")],
            r"may end in 3 different regions \(behind, near, at\); at most 2",
        ),
        (
            [
                one("cone", *(("a", place, "robot") for place in places), probability=0.5)
                for places in (("near", "left", "right"), ("far", "front", "behind"))
            ],
            "needs 6 kinds of relations over all readings; at most 5 are held: leave",
        ),
        (
            [
                one(f"cone tree {kind}", ("a", "near", "b"), ("b", "near", "c"), probability=0.25)
                for kind in ("car", "box", "bench", "barrel")
            ],
            "command 1 needs 26 phrases over all readings; at most 24",
        ),
    ],
)
def test_what_a_program_cannot_hold_is_refused(readings: list[dict], reason: str) -> None:
    with pytest.raises(CapacityError, match=reason) as refused:
        ground(*readings)
    assert "\n" not in str(refused.value)
