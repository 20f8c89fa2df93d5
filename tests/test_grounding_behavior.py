"""The device kernel against the host's search, padding and batch laws.

The search is held against enumeration in test_grounding_correspondence, and what commands ask for
in test_grounding_form_program.
"""

import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from grounding_fixture import TYPES, random_topology, zeroed_model

from jaxlangnav.grounding import infer_behavior, infer_behaviors, understand
from jaxlangnav.grounding.behavior import MAX_SLOTS
from jaxlangnav.grounding.behavior_properties import choice_tables
from jaxlangnav.grounding.correspondence import CorrespondenceGraph
from jaxlangnav.grounding.model import senses_of
from jaxlangnav.grounding.program import CompiledClause
from jaxlangnav.grounding.properties import Behaviors
from jaxlangnav.grounding.symbols import CONSTRAINT, GOAL, BehaviorSpace
from jaxlangnav.grounding.worlds import World, to_device, to_world
from jaxlangnav.language.corpus import PlacedWorld
from jaxlangnav.messages import AT, BEHIND, NEAR, ROBOT

BEHIND_CONE = "go to the hydrant behind the cone"
SENTENCES = (
    BEHIND_CONE,
    "go to the hydrant",
    "go to the hydrant nearest to the cone",
    "move behind the cone",
    "move to a spot behind the cone",
    "find the other cone quickly",
    "go to the hydrant that is near the cone but stay away from the car",
    "go to the hydrant behind the cone near the car",
)
SLOTS = 9
"""Of all worlds here, that they share one program; those of ``random_topology``, and the robot."""
infer = jax.jit(infer_behavior)


def compiled_clause(text, model, clause=0) -> CompiledClause:
    understood = understand(text, model)
    return jax.tree.map(lambda leaf: leaf[clause], understood.instruction.clauses)


def world_of(kinds, edges=(), previous=None, extremes=()):
    """A world of object types with directed edges (relation, figure, landmark)."""
    types = [*(TYPES.index(k) for k in kinds), ROBOT]
    world = World.of_edges(types, edges, [(0, *edge) for edge in extremes])
    is_previous = np.arange(len(types)) == (len(types) if previous is None else previous)
    return dataclasses.replace(world, is_previous=is_previous)


def test_action_and_mode_follow_the_odds_of_the_verb_phrase(model):
    understood = understand("find the other cone quickly", model)
    (root,), clauses = understood.parse.clauses, understood.instruction.clauses
    for name, choices in choice_tables(senses_of(root, TYPES)).items():
        odds = np.exp(choices @ model.behavior.coefficients(root)[name])
        np.testing.assert_allclose(getattr(clauses, name)[0], odds / odds.sum(), rtol=1e-4)


def test_a_model_that_knows_nothing_prefers_no_goal():
    program = compiled_clause(BEHIND_CONE, zeroed_model())
    world = world_of(["hydrant", "hydrant", "cone"], [(BEHIND, 1, 2)])
    goal = infer(program, to_device(world, SLOTS), num_phrases=program.num_phrases).goal
    assert goal.max() - goal[AT, 1] >= -1e-6  # no goal is singled out
    assert goal[AT, 1] < 0.2


@pytest.mark.parametrize("text", SENTENCES)
def test_kernel_agrees_with_the_host_search(model, text):
    rng = np.random.default_rng(7)
    space = BehaviorSpace(9)
    understood = understand(text, model)
    program = compiled_clause(text, model)
    for _ in range(4):
        world = random_topology(rng)
        graph = CorrespondenceGraph(Behaviors(TYPES, understood.belief.rank), model.behavior)
        beam = graph.score(understood.parse.clauses[0], world).search(16)
        goal, constraint = np.zeros((7, 9)), np.zeros((7, 9))
        for hypothesis in beam:
            chance = np.exp(hypothesis.log_probability)
            expressed = space.part(hypothesis.expressed, GOAL)
            goal += chance * expressed / max(expressed.sum(), 1)
            constraint += chance * space.part(hypothesis.expressed, CONSTRAINT)
        got = infer(program, to_device(world), num_phrases=program.num_phrases)
        # Sharing is by marginals on the device and by sets here; both beams cut a little.
        np.testing.assert_allclose(got.goal, goal, atol=0.03)
        np.testing.assert_allclose(got.constraint, constraint, atol=0.03)


@pytest.mark.parametrize(
    ("text", "slots"), [*((text, SLOTS) for text in SENTENCES), (SENTENCES[0], MAX_SLOTS + 9)]
)
def test_empty_slots_and_spare_phrases_change_nothing(model, text, slots):
    program = compiled_clause(text, model)
    world = random_topology(np.random.default_rng(1), num_objects=5)
    plain = infer(program, to_device(world), num_phrases=program.num_phrases)
    padded = to_device(world, slots)
    rng = np.random.default_rng(2)
    empty = ~np.asarray(padded.is_object)
    both = empty[:, None] | empty[None, :]
    noise = jnp.asarray(rng.random((6, slots, slots)) < 0.5) & jnp.asarray(both)[None]
    dirty = dataclasses.replace(
        padded,
        object_type=jnp.where(jnp.asarray(empty), 3, padded.object_type),
        is_related=padded.is_related | noise,
        is_superlative=padded.is_superlative | noise,
        is_previous=padded.is_previous | jnp.asarray(empty),
    )
    got = infer(program, dirty, num_phrases=program.num_phrases + 9)
    kept = [*range(5), slots - 1]
    np.testing.assert_allclose(got.goal[:, kept], plain.goal, atol=1e-5)
    np.testing.assert_allclose(got.constraint[:, kept], plain.constraint, atol=1e-5)
    assert got.goal[:, 5 : slots - 1].max() < 1e-6


def test_batches_equal_a_loop(model):
    """Different sentences in one batch of episodes, different worlds in their particles."""
    rng = np.random.default_rng(11)
    texts = SENTENCES[:4]
    compiled = [compiled_clause(text, model) for text in texts]
    worlds = [[to_device(random_topology(rng)) for _ in range(3)] for _ in texts]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *compiled)
    particles = [jax.tree.map(lambda *leaves: jnp.stack(leaves, -1), *row) for row in worlds]
    episodes = jax.tree.map(lambda *leaves: jnp.stack(leaves), *particles)
    batch = jax.jit(jax.vmap(lambda p, w: infer_behaviors(p, w, num_phrases=p.num_phrases)))
    together = batch(stacked, episodes)
    shared = jax.jit(jax.vmap(lambda p, w: infer_behaviors(p, w, num_phrases=24), (None, 0)))
    same_words = shared(compiled[0], episodes)
    for e, program in enumerate(compiled):
        for p in range(3):
            alone = infer(program, worlds[e][p], num_phrases=program.num_phrases)
            np.testing.assert_allclose(together.goal[e, ..., p], alone.goal, atol=1e-5)
            np.testing.assert_allclose(together.constraint[e, ..., p], alone.constraint, atol=1e-5)
            first = infer(compiled[0], worlds[e][p], num_phrases=compiled[0].num_phrases)
            np.testing.assert_allclose(same_words.goal[e, ..., p], first.goal, atol=1e-5)


def test_a_new_sentence_is_not_a_new_program(model):
    chex.clear_trace_counter()
    traced = jax.jit(chex.assert_max_traces(infer_behavior, n=1))
    world = to_device(random_topology(np.random.default_rng(0)))
    for text in SENTENCES:
        program = compiled_clause(text, model)
        traced(program, world, num_phrases=program.num_phrases)


def test_a_clause_that_does_not_exist_asks_for_nothing(model):
    program = compiled_clause("go to the hydrant", model, clause=2)
    behavior = infer(program, to_device(world_of(["hydrant"]), SLOTS), num_phrases=jnp.int32(6))
    assert behavior.goal.sum() == 0.0
    assert behavior.constraint.sum() == 0.0


def test_worlds_of_other_shapes_and_types_are_refused(model):
    program, world = compiled_clause("go to the hydrant", model), to_device(world_of(["hydrant"]))
    for wrong, said in (
        (dataclasses.replace(world, object_type=world.object_type.astype(jnp.float32)), "type"),
        (dataclasses.replace(world, is_object=world.is_object[:-1]), "shape"),
        (dataclasses.replace(world, is_ordinal=world.is_ordinal[:5]), "shape"),
    ):
        with pytest.raises(AssertionError, match=said):
            infer_behavior(program, wrong, num_phrases=3)


def test_geometry_gives_the_edges():
    placed = PlacedWorld(
        objects=(("hydrant", 8.0, 0.0), ("cone", 6.0, 0.0), ("cone", 0.0, 3.0)),
        robot=(0.0, 0.0, 0.0),
        previous=1,
    )
    world = to_world(placed, TYPES)
    assert world.is_related[BEHIND, 0, 1]
    assert not world.is_related[BEHIND, 1, 0]
    assert world.is_related[2, 2, 3]  # the second cone is on the robot's left
    assert world.is_ranked[0][NEAR][2, 3]
    assert world.is_ranked[1][NEAR][1, 3]
    assert world.is_previous.tolist() == [False, True, False, False]
    assert not world.is_related[:, 3].any()
    with pytest.raises(ValueError, match="at most 2"):
        to_device(world, 3)
