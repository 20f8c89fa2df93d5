"""Random worlds of a template (section 4.2; the geometry that the paper leaves open is ours).

Frame: the robot starts at the origin and faces +x. The operating area is
[0, D] x [-D/√2, D/√2], D = Known mean + 2.5 sd of the row of Table 2. The law:

- a hydrant stands at range N(Known mean, sd) and bearing U(-45°, 45°), whether goal or not;
- each cone stands by a point of that same law, 1.5-3.5 m from it on the robot's side, lateral
  sd 0.4 m ("behind", null), or 1.5-3 m from it in any direction ("nearest");
- the first cone's point is the *anchor* hydrant, the further cones' points are empty;
- but for the anchor and its cone all objects are 4 m apart, and the anchor is the only hydrant
  behind any cone (viewer at the start, a wedge of ±45°, at any distance);
- with a relation the anchor is the goal; without one the goal is any hydrant, by lot.

Every draw treats the hydrants alike: places for all of them, then for each of them the cone that
it would have as the anchor, then the free cones; the lot that makes one of them the anchor falls
last. So where the hydrants stand says nothing about which is meant, and whoever looks at
hydrants alone is right one time in the number of hydrants.
A null world has the geometry of "behind", as the paper issues both commands in one environment.
"""

import functools
import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import NONE
from jaxlangnav.world.placement import NULL, Placement, ScenarioLaw, area_depth, try_placement
from jaxlangnav.world.state import CONE, HYDRANT, Scenario
from jaxlangnav.world.templates import (
    MAX_CONES,
    MAX_HYDRANTS,
    Template,
    check_relation,
    known_range,
    parse_template,
)

__all__ = ["Scenario", "ScenarioLaw", "draw_scenario", "sample_scenario", "scenario_law"]

NUM_SLOTS = 8
NUM_ATTEMPTS = 16
"""Whole worlds tried at once; the first that meets the law is taken."""
NUM_CANDIDATES = 32
"""Places tried at once for each part of a world."""


def scenario_law(*, template: str | Template, relation: str) -> ScenarioLaw:
    """Build the law of a template's worlds.

    Args:
        template: a template or its name, such as "2H1C".
        relation: "null", "behind" or "nearest".

    Returns:
        The law, to be passed to ``draw_scenario``.

    Raises:
        ValueError: unknown template or relation, or a relation to a cone in a world without.
    """
    record = parse_template(template) if isinstance(template, str) else template
    relation_index = check_relation(relation)
    if record.num_cones == 0 and relation != "null":
        raise ValueError(
            f"world template {record.name!r} has no cone for the relation {relation!r}: "
            "choose one with 1 cone or more, or the relation 'null'"
        )
    mean, sd = known_range(record, relation)
    return ScenarioLaw(
        num_hydrants=jnp.int32(record.num_hydrants),
        num_cones=jnp.int32(record.num_cones),
        relation=jnp.int32(relation_index),
        range_mean=jnp.float32(mean),
        range_sd=jnp.float32(sd),
    )


def sample_scenario(
    key: Array, *, template: str | Template, relation: str, num_slots: int = NUM_SLOTS
) -> Scenario:
    """Draw one world of a template; ``vmap`` over keys draws many.

    Args:
        key: random key.
        template: a template or its name, such as "2H1C".
        relation: "null", "behind" or "nearest": what the command will say of the goal.
        num_slots: O, object slots of the scenario.

    Returns:
        The world. ``is_valid`` is False where no candidate met the law: count such worlds.

    Raises:
        ValueError: unknown template or relation, or more objects than slots.
    """
    record = parse_template(template) if isinstance(template, str) else template
    num_objects = record.num_hydrants + record.num_cones
    if num_objects > num_slots:
        raise ValueError(
            f"world template {record.name!r} has {num_objects} objects but num_slots is "
            f"{num_slots}: choose a smaller template or at least {num_objects} slots"
        )
    return draw_scenario(key, scenario_law(template=record, relation=relation), num_slots=num_slots)


def empty_scenario(number: int = NUM_SLOTS) -> Scenario:
    """Build a place without objects, on the host; of the shapes of one with so many slots."""
    fields: dict[str, Any] = {
        "object_type": np.full(number, NONE, np.int32),
        "object_x": np.zeros(number, np.float32),
        "object_y": np.zeros(number, np.float32),
        "is_object": np.zeros(number, bool),
        "goal": np.zeros(2, np.float32),
        "goal_index": np.asarray(NONE, np.int32),
        "start": np.zeros(3, np.float32),
        "area": np.zeros(4, np.float32),
        "is_valid": np.asarray(False),
    }
    return Scenario(**fields)


@functools.partial(jax.jit, static_argnames=("num_slots", "num_attempts", "num_candidates"))
def draw_scenario(
    key: Array,
    law: ScenarioLaw,
    *,
    num_slots: int = NUM_SLOTS,
    num_attempts: int = NUM_ATTEMPTS,
    num_candidates: int = NUM_CANDIDATES,
) -> Scenario:
    """Draw one world of a law: the first of a fixed number of attempts that meets it.

    Args:
        key: random key.
        law: what to draw; traced.
        num_slots: O, object slots; a law of more objects makes the world invalid.
        num_attempts: worlds tried at once.
        num_candidates: K, places tried at once for each part of a world.

    Returns:
        The world; where no attempt meets the law, the first attempt with ``is_valid`` False.
    """
    key_place, key_lot = jax.random.split(key)
    keys = jax.random.split(key_place, num_attempts)
    attempts = jax.vmap(try_placement, in_axes=(0, None, None))(keys, law, num_candidates)
    chosen = jax.tree.map(lambda leaf: leaf[jnp.argmax(attempts.is_met)], attempts)
    lots = (jax.random.uniform(key_lot, (2,)) * law.num_hydrants).astype(jnp.int32)
    anchor, other = jnp.minimum(lots, law.num_hydrants - 1)
    goal_index = jnp.where(law.relation == NULL, other, anchor)
    return _to_scenario(chosen, law, anchor, goal_index, num_slots)


def _to_scenario(
    chosen: Placement, law: ScenarioLaw, anchor: Array, goal_index: Array, num_slots: int
) -> Scenario:
    """Pack an attempt into slots: hydrants, then the anchor's cone, then the free cones."""
    cone = chosen.anchor_cone[:, anchor]
    place = jnp.concatenate([chosen.hydrant, cone[:, None], chosen.free_cone], axis=1)
    object_type = jnp.array([HYDRANT] * MAX_HYDRANTS + [CONE] * MAX_CONES, jnp.int32)
    is_object = jnp.concatenate(
        [jnp.arange(MAX_HYDRANTS) < law.num_hydrants, jnp.arange(MAX_CONES) < law.num_cones]
    )
    order = jnp.argsort(~is_object, stable=True)
    order = jnp.pad(order, (0, max(0, num_slots - order.size)))[:num_slots]
    is_slot = (jnp.arange(num_slots) < is_object.size) & is_object[order]
    far = area_depth(law)
    side = far / math.sqrt(2.0)
    return Scenario(
        object_type=jnp.where(is_slot, object_type[order], NONE),
        object_x=jnp.where(is_slot, place[0, order], 0.0),
        object_y=jnp.where(is_slot, place[1, order], 0.0),
        is_object=is_slot,
        goal=place[:, goal_index],
        goal_index=goal_index,
        start=jnp.zeros(3, jnp.float32),
        area=jnp.stack([jnp.zeros_like(far), far, -side, side]),
        is_valid=chosen.is_met & (law.num_hydrants + law.num_cones <= num_slots),
    )
