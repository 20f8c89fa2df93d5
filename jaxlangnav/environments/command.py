"""A sentence as an agent takes it: an embedding of its readings, and the types that it names."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.experiments.tasks import SENTENCES
from jaxlangnav.grounding import Understanding
from jaxlangnav.inputs.object_types import ANYTHING
from jaxlangnav.messages import NONE, ROBOT
from jaxlangnav.pytree import pytree
from jaxlangnav.relations.table import REGISTRY
from jaxlangnav.world.files import WorldFile, open_world

COMMAND_SIZE = len(REGISTRY) + 4
DEFAULT_RELATION = "behind"


@pytree
class EmbeddedCommand:
    """A sentence as an agent takes it."""

    embedding: Array  # f32[COMMAND_SIZE] probabilities over its readings: see the module
    figure: Array  # i32[] type of the goal; NONE where it is a region; ANYTHING
    landmark: Array  # i32[] type of what it is placed against; NONE


def command_of(understood: Understanding, *, is_find: bool = False) -> EmbeddedCommand:
    """Embed a sentence: its readings' probabilities; the types are those of the likeliest."""
    embedding = np.zeros(COMMAND_SIZE, np.float32)
    names = [one.name for one in REGISTRY]
    types = {"robot": ROBOT, "thing": ANYTHING, None: NONE}
    types |= {name: kind for kind, name in enumerate(understood.type_names)}
    for said in understood.annotations:
        flags = (said["superlative"], said["landmark"] == "robot", said["figure"] is None, is_find)
        is_so = [name == said["relation"] for name in names] + [bool(flag) for flag in flags]
        embedding += said["probability"] * np.array(is_so, np.float32)
    best = max(understood.annotations, key=lambda said: said["probability"])
    return EmbeddedCommand(
        embedding=jnp.asarray(np.minimum(embedding, 1.0)),
        figure=jnp.int32(types[best["figure"]]),
        landmark=jnp.int32(types[best["landmark"]]),
    )


def text_of(
    *,
    world: str = "1H1C",
    relation: str = DEFAULT_RELATION,
    instruction: str | None = None,
    **_: Any,
) -> str:
    """Tell the sentence of an environment; arguments as of ``functional.default_params``."""
    place = open_world(world)
    if isinstance(place, WorldFile):
        return instruction or place.instruction or ""
    return SENTENCES[relation]
