"""Embedding of a command for agents: features of its readings, and the types it mentions."""

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
    """A command as a fixed-size vector, with the object types of goal and landmark."""

    embedding: Array  # f32[COMMAND_SIZE] probabilities over its readings: see ``functional``
    figure: Array  # i32[] type of the goal; NONE where it is a region; ANYTHING
    landmark: Array  # i32[] type of what it is placed against; NONE


def embed_command(understood: Understanding, *, is_find_task: bool = False) -> EmbeddedCommand:
    """Embed a command as expected features over its readings; types of the likeliest one."""
    embedding = np.zeros(COMMAND_SIZE, np.float32)
    names = [relation.name for relation in REGISTRY]
    types = {"robot": ROBOT, "thing": ANYTHING, None: NONE}
    types |= {name: type_id for type_id, name in enumerate(understood.type_names)}
    for row in understood.annotations:
        flags = row["superlative"], row["landmark"] == "robot", row["figure"] is None, is_find_task
        features = [name == row["relation"] for name in names] + [bool(flag) for flag in flags]
        embedding += row["probability"] * np.array(features, np.float32)
    best = max(understood.annotations, key=lambda row: row["probability"])
    return EmbeddedCommand(
        embedding=jnp.asarray(np.minimum(embedding, 1.0)),
        figure=jnp.int32(types[best["figure"]]),
        landmark=jnp.int32(types[best["landmark"]]),
    )


def command_text(
    *,
    world: str = "1H1C",
    relation: str = DEFAULT_RELATION,
    instruction: str | None = None,
    **_: Any,
) -> str:
    """Return the command text of an environment; arguments of ``functional.default_params``."""
    source = open_world(world)
    if isinstance(source, WorldFile):
        return instruction or source.instruction or ""
    return SENTENCES[relation]
