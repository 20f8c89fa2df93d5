"""Things that are called by no type: what they are said to be is all that tells them (ours).

Of "the hydrant behind the cone" the words may be wrong, and a hydrant that stands elsewhere may be
the one that is meant. Of "the thing behind the cone" nothing is left then: what does not stand
where it is said to is no such thing, and where nothing does there is none.
"""

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.kinds import is_anything
from jaxlangnav.messages import NONE, Behavior, Readings, Told
from jaxlangnav.numerics.batching import pick, rarely
from jaxlangnav.pytree import replace
from jaxlangnav.relations import RelationModel
from jaxlangnav.semantic_map.particle import SemanticMap
from jaxlangnav.semantic_map.said import FIGURE, LANDMARK, Said, hear, listen


def placed(
    behavior: Behavior,
    particles: SemanticMap,
    readings: Readings,
    told: Told,
    relations: RelationModel,
) -> Behavior:
    """Take for goals, of what is called by no type, only what stands where it is said to.

    Limits: of sentences that call everything by its type nothing changes, and nothing is computed.

    Args:
        behavior: of every particle, leaves [..., P].
        particles: leaves [..., P].
        readings: what is said.
        told: how it was said.
        relations: prepared relations.

    Returns:
        The behavior, without goals at observed slots that are taken for such a thing and stand
        elsewhere.
    """
    num_objects, number = particles.object_type.shape[0], particles.reading.shape[0]
    is_any = jnp.broadcast_to(jnp.any(is_anything(readings.mention_type)), (number,))

    def look_up(given: tuple[Array, SemanticMap, Readings, Told]) -> Array:
        _, held, said, how = given
        heard = hear(listen(said, how, relations, jnp.float32(0.0)), held.reading)
        return _misplaced(held, heard)

    nowhere = jnp.zeros_like(particles.mean_x[:num_objects])
    is_out = rarely(is_any, look_up, (nowhere, particles, readings, told))
    room = behavior.goal.shape[1] - num_objects
    is_out = jnp.pad(is_out, ((0, room), (0, 0)))
    return replace(behavior, goal=jnp.where(is_out[None] > 0.0, 0.0, behavior.goal))


def _misplaced(particles: SemanticMap, heard: Said) -> Array:
    """Mark the observed slots that are taken for a thing and stand elsewhere, f32[O, P] 1 or 0."""
    num_objects = particles.object_type.shape[0]
    slots = jnp.arange(num_objects)[:, None]
    is_open = particles.referent == NONE
    x, y = (
        jnp.where(is_open, thought, pick(seen[:num_objects, None], particles.referent))
        for thought, seen in (
            (particles.hypothesis_x, particles.mean_x),
            (particles.hypothesis_y, particles.mean_y),
        )
    )

    def of_one(said: Said) -> Array:
        figure, landmark = said.mention[FIGURE], said.mention[LANDMARK]
        viewer_x, viewer_y, _ = jnp.unstack(said.viewer)
        # The second relation of "between" is seen from the other landmark.
        other = said.is_between, pick(x, said.other), pick(y, said.other)
        viewer_x, viewer_y = (
            jnp.where(other[0], place, own)
            for place, own in zip(other[1:], (viewer_x, viewer_y), strict=True)
        )
        said = said._replace(viewer=jnp.stack([viewer_x, viewer_y, said.viewer[2]]))
        landmark_x = jnp.where(said.is_by_object, pick(x, landmark), viewer_x)
        landmark_y = jnp.where(said.is_by_object, pick(y, landmark), viewer_y)
        at = (one[None] for one in (pick(x, figure), pick(y, figure), landmark_x, landmark_y))
        is_out = is_anything(said.kind[FIGURE]) & ~said.holds(*at)[0]
        return is_out[None] & (slots == pick(particles.referent, figure)[None])

    is_out = jax.lax.map(of_one, heard)
    return jnp.any(is_out, axis=0).astype(jnp.float32)
