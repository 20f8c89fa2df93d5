"""The behavior in every particle: one inference for all that share a topology (section 3.3)."""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.grounding import behavior as grounding
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import ACTIONS, MODES, REGIONS, Behavior
from jaxlangnav.numerics.batching import pack, row_of, unpack
from jaxlangnav.semantic_map import summary
from jaxlangnav.semantic_map.particle import SemanticMap

BLOCK = 8
"""Topologies whose behavior is inferred at a time."""


def infer_behaviors(
    particles: SemanticMap, instruction: Instruction, clause: Array, previous_goal: Array
) -> Behavior:
    """Infer the behavior of one clause in every particle.

    The behavior model sees a particle's topology only, so each distinct topology is inferred
    once, ``BLOCK`` of them at a time, and handed to all particles that share it.

    Args:
        particles: leaves [..., P].
        instruction: grounded sentence.
        clause: i32[], which of its commands.
        previous_goal: i32[], observed slot at which the command before ended; NONE.

    Returns:
        Behaviors, leaves [..., P].
    """
    program = row_of(instruction.program, clause)
    number = particles.reading.shape[-1]
    block = min(BLOCK, number)
    topology, representative, count = summary.distinct_topologies(particles)
    padding = jnp.full((-number) % block, number, representative.dtype)
    representative = jnp.append(representative, padding)

    def infer(index: Array, table: Array) -> Array:
        # Beyond the last topology it is P, and the last particle stands in.
        chosen = jax.lax.dynamic_slice_in_dim(representative, index * block, block)
        worlds = jax.vmap(summary.behavior_world, in_axes=(-1, None, None), out_axes=-1)(
            jax.tree.map(lambda leaf: jnp.take(leaf, chosen, axis=-1, mode="clip"), particles),
            instruction.readings,
            previous_goal,
        )
        inferred = pack(grounding.infer_behaviors(program, worlds, num_phrases=program.num_phrases))
        place = topology - index * block
        # Selects vectorise over particles, where a gather would go element by element.
        for own in range(block):
            table = jnp.where(place == own, inferred[:, own : own + 1], table)
        return table

    num_slots = particles.object_type.shape[0] + particles.referent.shape[0] + 1
    nothing = Behavior(
        action=jnp.zeros((len(ACTIONS), number), jnp.float32),
        mode=jnp.zeros((len(MODES), number), jnp.float32),
        goal=jnp.zeros((len(REGIONS), num_slots, number), jnp.float32),
        constraint=jnp.zeros((len(REGIONS), num_slots, number), jnp.float32),
    )
    table = jax.lax.fori_loop(0, (count + block - 1) // block, infer, pack(nothing))
    return unpack(table, nothing)
