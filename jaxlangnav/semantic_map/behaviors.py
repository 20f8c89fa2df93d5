"""The behavior in every particle: one inference for all that share a topology (section 3.3).

Beyond the paper, goals without an object type: what is said of them is all that tells them. Of
"the hydrant behind the cone" the words may be wrong, and a hydrant that stands elsewhere may be
the one that is meant. Of "the thing behind the cone" nothing is left then: what does not stand
where it is said to is no such thing, and where nothing does there is none.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.grounding import behavior as grounding
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.object_types import is_anything, label_of
from jaxlangnav.messages import (
    ACTIONS,
    MODES,
    NONE,
    REGIONS,
    Behavior,
    BehaviorWorld,
    Readings,
    UtteranceContext,
)
from jaxlangnav.numerics.batching import lookup, pack, select_row, skip_unless_any, unpack
from jaxlangnav.pytree import replace
from jaxlangnav.relations import RelationModel
from jaxlangnav.semantic_map import summary
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.proposal.relation_query import (
    FIGURE,
    LANDMARK,
    Query,
    build_queries,
    pick_queries,
)

_BLOCK = 8  # topologies whose behavior is inferred at a time


def infer_clause_behaviors(
    particles: SemanticMap, instruction: Instruction, clause: Array, previous_goal: Array
) -> Behavior:
    """Infer the behavior of one clause in every particle.

    The behavior model sees a particle's topology only, so each distinct topology is inferred
    once, ``_BLOCK`` of them at a time, and handed to all particles that share it. ``previous_goal``
    is the observed slot at which the command before ended, i32[]; NONE.
    """
    program = select_row(instruction.program, clause)
    number = particles.reading.shape[-1]
    block = min(_BLOCK, number)
    topology, representative, count = summary.distinct_topologies(particles)
    padding = jnp.full((-number) % block, number, representative.dtype)
    representative = jnp.append(representative, padding)

    num_slots = particles.object_type.shape[0] + particles.referent.shape[0] + 1
    is_crowded = num_slots > grounding.MAX_SLOTS
    named = label_of(program.own.reshape(-1))

    def infer(index: Array, table: Array) -> Array:
        # Beyond the last topology it is P, and the last particle stands in.
        chosen = jax.lax.dynamic_slice_in_dim(representative, index * block, block)
        worlds = jax.vmap(summary.behavior_world, in_axes=(-1, None, None), out_axes=-1)(
            jax.tree.map(lambda leaf: jnp.take(leaf, chosen, axis=-1, mode="clip"), particles),
            instruction.readings,
            previous_goal,
        )
        slots = None
        if is_crowded:
            choose = jax.vmap(likeliest_slots, in_axes=(-1, None), out_axes=-1)
            worlds, slots = choose(worlds, named)
        behaviors = grounding.infer_behaviors(program, worlds, num_phrases=program.num_phrases)
        if slots is not None:
            behaviors = _spread(behaviors, slots, num_slots)
        inferred = pack(behaviors)
        place = topology - index * block
        # Selects vectorise over particles, where a gather would go element by element.
        for own in range(block):
            table = jnp.where(place == own, inferred[:, own : own + 1], table)
        return table

    nothing = Behavior(
        action=jnp.zeros((len(ACTIONS), number), jnp.float32),
        mode=jnp.zeros((len(MODES), number), jnp.float32),
        goal=jnp.zeros((len(REGIONS), num_slots, number), jnp.float32),
        constraint=jnp.zeros((len(REGIONS), num_slots, number), jnp.float32),
    )
    table = jax.lax.fori_loop(0, (count + block - 1) // block, infer, pack(nothing))
    return unpack(table, nothing)


def likeliest_slots(world: BehaviorWorld, named: Array) -> tuple[BehaviorWorld, Array]:
    """Leave out the slots that a behavior hardly speaks of, where masks of bits hold fewer.

    What the words refer to and the last goal come first, then what they name, i32[n] labels, then
    the rest; the robot stays the last. i32[MAX_SLOTS] tells which slots they are.
    """
    kind = world.object_type
    is_meant = jnp.any(world.is_related, axis=(0, 1)) | jnp.any(world.is_related, axis=(0, 2))
    is_named = (kind >= 0) & jnp.any(label_of(kind)[:, None] == named[None], axis=1)
    rank = jnp.where(world.is_object, 1, 0) + 2 * is_named + 4 * (is_meant | world.is_previous)
    order = jnp.argsort(-rank[:-1], stable=True)[: grounding.MAX_SLOTS - 1]
    slots = jnp.append(jnp.sort(order), kind.shape[0] - 1)

    def kept(leaf: Array) -> Array:  # of objects [N + 1], or of edges [6, N + 1, N + 1]
        return leaf[slots] if leaf.ndim == 1 else leaf[:, slots][:, :, slots]

    return jax.tree.map(kept, world), slots


def _spread(behavior: Behavior, slots: Array, num_slots: int) -> Behavior:
    """Put behaviors over chosen slots, [MAX_SLOTS, block], back where they belong; 0 elsewhere."""

    def put(values: Array, chosen: Array) -> Array:
        return jnp.zeros((values.shape[0], num_slots)).at[:, chosen].set(values)

    spread = jax.vmap(put, in_axes=(-1, -1), out_axes=-1)
    return replace(
        behavior, goal=spread(behavior.goal, slots), constraint=spread(behavior.constraint, slots)
    )


def filter_untyped_goals(
    behavior: Behavior,
    particles: SemanticMap,
    readings: Readings,
    context: UtteranceContext,
    relations: RelationModel,
) -> Behavior:
    """For a goal without an object type, keep only observed objects that satisfy its relation.

    Limits: of sentences that call everything by its type nothing changes, and nothing is computed.
    """
    num_objects, number = particles.object_type.shape[0], particles.reading.shape[0]
    is_any = jnp.broadcast_to(jnp.any(is_anything(readings.mention_type)), (number,))

    def look_up(given: tuple[Array, SemanticMap, Readings, UtteranceContext]) -> Array:
        _, held, words, how = given
        queries = pick_queries(build_queries(words, how, relations, jnp.float32(0.0)), held.reading)
        return _misplaced(held, queries)

    nowhere = jnp.zeros_like(particles.mean_x[:num_objects])
    is_out = skip_unless_any(is_any, look_up, (nowhere, particles, readings, context))
    is_out = jnp.pad(is_out, ((0, behavior.goal.shape[1] - num_objects), (0, 0)))
    return replace(behavior, goal=jnp.where(is_out[None] > 0.0, 0.0, behavior.goal))


def _misplaced(particles: SemanticMap, queries: Query) -> Array:
    """Mark the observed slots that are taken for a thing and stand elsewhere, f32[O, P] 1 or 0."""
    num_objects = particles.object_type.shape[0]
    slots = jnp.arange(num_objects)[:, None]
    is_open = particles.referent == NONE
    seen_x = lookup(particles.mean_x[:num_objects, None], particles.referent)
    x = jnp.where(is_open, particles.hypothesis_x, seen_x)
    seen_y = lookup(particles.mean_y[:num_objects, None], particles.referent)
    y = jnp.where(is_open, particles.hypothesis_y, seen_y)

    def of_one(query: Query) -> Array:
        figure, landmark = query.mention[FIGURE], query.mention[LANDMARK]
        viewer_x, viewer_y, _ = jnp.unstack(query.viewer)
        # The second relation of "between" is seen from the other landmark.
        viewer_x = jnp.where(query.is_between, lookup(x, query.other), viewer_x)
        viewer_y = jnp.where(query.is_between, lookup(y, query.other), viewer_y)
        query = query._replace(viewer=jnp.stack([viewer_x, viewer_y, query.viewer[2]]))
        landmark_x = jnp.where(query.is_by_object, lookup(x, landmark), viewer_x)
        landmark_y = jnp.where(query.is_by_object, lookup(y, landmark), viewer_y)
        at = (one[None] for one in (lookup(x, figure), lookup(y, figure), landmark_x, landmark_y))
        is_out = is_anything(query.types[FIGURE]) & ~query.holds(*at)[0]
        return is_out[None] & (slots == lookup(particles.referent, figure)[None])

    is_out = jax.lax.map(of_one, queries)
    return jnp.any(is_out, axis=0).astype(jnp.float32)
