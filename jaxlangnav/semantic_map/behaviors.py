"""Behavior inference in the particles, once for each distinct topology (section 3.3).

Beyond the paper, goals without an object type: only their relations identify them. In "the hydrant
behind the cone" the relation may be wrong, and a hydrant elsewhere the referent. For "the thing
behind the cone" an object elsewhere is no referent, and if no object is there, there is none.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.grounding.behavior import infer_behaviors
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.inputs.object_types import is_anything
from jaxlangnav.messages import ACTIONS, MODES, NONE, REGIONS, Behavior, Readings, UtteranceContext
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

    The behavior model depends on a particle's topology only, so each distinct topology is inferred
    once, ``_BLOCK`` of them at a time, for all particles that share it. ``previous_goal`` is the
    observed slot at which the previous command ended, i32[]; NONE.
    """
    compiled = select_row(instruction.clauses, clause)
    num_particles = particles.reading.shape[-1]
    block = min(_BLOCK, num_particles)
    topology, representative, count = summary.distinct_topologies(particles)
    padding = jnp.full((-num_particles) % block, num_particles, representative.dtype)
    representative = jnp.append(representative, padding)

    num_slots = particles.object_type.shape[0] + particles.referent.shape[0] + 1

    def infer(index: Array, table: Array) -> Array:
        # Beyond the last topology the index is P, clipped to the last particle.
        indices = jax.lax.dynamic_slice_in_dim(representative, index * block, block)
        worlds = jax.vmap(summary.behavior_world, in_axes=(-1, None, None), out_axes=-1)(
            jax.tree.map(lambda leaf: jnp.take(leaf, indices, axis=-1, mode="clip"), particles),
            instruction.readings,
            previous_goal,
        )
        inferred = pack(infer_behaviors(compiled, worlds, num_phrases=compiled.num_phrases))
        offset_in_block = topology - index * block
        # Selects vectorise over particles, where a gather would go element by element.
        for row in range(block):
            table = jnp.where(offset_in_block == row, inferred[:, row : row + 1], table)
        return table

    zeros = Behavior(
        action=jnp.zeros((len(ACTIONS), num_particles), jnp.float32),
        mode=jnp.zeros((len(MODES), num_particles), jnp.float32),
        goal=jnp.zeros((len(REGIONS), num_slots, num_particles), jnp.float32),
        constraint=jnp.zeros((len(REGIONS), num_slots, num_particles), jnp.float32),
    )
    table = jax.lax.fori_loop(0, (count + block - 1) // block, infer, pack(zeros))
    return unpack(table, zeros)


def filter_untyped_goals(
    behavior: Behavior,
    particles: SemanticMap,
    readings: Readings,
    context: UtteranceContext,
    relations: RelationModel,
) -> Behavior:
    """Remove goals of untyped mentions that violate the stated relation.

    Limits: if all mentions of a sentence have a type nothing changes, and nothing is computed.
    """
    num_objects, num_particles = particles.object_type.shape[0], particles.reading.shape[0]
    is_any = jnp.broadcast_to(jnp.any(is_anything(readings.mention_type)), (num_particles,))

    def misplaced(args: tuple[SemanticMap, Readings, UtteranceContext]) -> Array:
        maps, words, context = args
        queries = build_queries(words, context, relations, jnp.float32(0.0))
        return _misplaced_referents(maps, pick_queries(queries, maps.reading))

    zeros = jnp.zeros_like(particles.mean_x[:num_objects])
    is_misplaced = skip_unless_any(is_any, misplaced, (particles, readings, context), zeros)
    is_misplaced = jnp.pad(is_misplaced, ((0, behavior.goal.shape[1] - num_objects), (0, 0)))
    return replace(behavior, goal=jnp.where(is_misplaced[None] > 0.0, 0.0, behavior.goal))


def _misplaced_referents(particles: SemanticMap, queries: Query) -> Array:
    """Find referents of untyped mentions that violate their relation, f32[O, P] 1 or 0."""
    num_objects = particles.object_type.shape[0]
    slots = jnp.arange(num_objects)[:, None]
    is_unobserved = particles.referent == NONE
    observed_x = lookup(particles.mean_x[:num_objects, None], particles.referent)
    x = jnp.where(is_unobserved, particles.hypothesis_x, observed_x)
    observed_y = lookup(particles.mean_y[:num_objects, None], particles.referent)
    y = jnp.where(is_unobserved, particles.hypothesis_y, observed_y)

    def check(query: Query) -> Array:
        figure, landmark = query.mention[FIGURE], query.mention[LANDMARK]
        viewer_x, viewer_y, _ = jnp.unstack(query.viewer)
        # The second relation of "between" has the other landmark as its viewer.
        viewer_x = jnp.where(query.is_between, lookup(x, query.other), viewer_x)
        viewer_y = jnp.where(query.is_between, lookup(y, query.other), viewer_y)
        query = query._replace(viewer=jnp.stack([viewer_x, viewer_y, query.viewer[2]]))
        landmark_x = jnp.where(query.is_by_object, lookup(x, landmark), viewer_x)
        landmark_y = jnp.where(query.is_by_object, lookup(y, landmark), viewer_y)
        xy = (v[None] for v in (lookup(x, figure), lookup(y, figure), landmark_x, landmark_y))
        is_misplaced = is_anything(query.types[FIGURE]) & ~query.holds(*xy)[0]
        return is_misplaced[None] & (slots == lookup(particles.referent, figure)[None])

    is_misplaced = jax.lax.map(check, queries)
    return jnp.any(is_misplaced, axis=0).astype(jnp.float32)
