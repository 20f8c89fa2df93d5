"""A small labelled corpus in code: sentences in random worlds, labelled by the corpus' rules."""

import dataclasses

import numpy as np
from corpus_labels import annotate, behave

from jaxlangnav.grounding import GroundingModel, load_shipped
from jaxlangnav.grounding.worlds import World
from jaxlangnav.language.corpus import ClauseLabels, Example, PlacedWorld, WorldLabels
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.parser import parse
from jaxlangnav.messages import ROBOT
from jaxlangnav.training.examples import labelled_instruction

TYPES = load_lexicon().type_names


def zeroed_model() -> GroundingModel:
    """The shipped models with all weights zero: they know nothing."""
    model = load_shipped()
    parts = (
        dataclasses.replace(part, weights={kind: 0 * w for kind, w in part.weights.items()})
        for part in (model.annotation, model.behavior)
    )
    return GroundingModel(*parts, model.type_names)


def random_placed(rng, num_objects=8):
    """Objects of random types at random places near the robot."""
    count = rng.integers(1, num_objects + 1)
    objects = tuple(
        (TYPES[rng.integers(len(TYPES))], float(x), float(y))
        for x, y in rng.uniform(-8, 8, (count, 2))
    )
    previous = int(rng.integers(count)) if rng.random() < 0.5 else None
    robot = 0.0, 0.0, float(rng.uniform(-3, 3))
    return PlacedWorld(objects=objects, robot=robot, previous=previous)


def random_topology(rng, num_objects=8, p_relation=0.15):
    """Random types and edges, as a particle may have them; some slots empty."""
    size = num_objects + 1
    object_type = rng.integers(0, len(TYPES), size).astype(np.int32)
    object_type[-1] = ROBOT
    is_object = rng.random(size) < 0.8
    is_object[-1] = True
    both = is_object[:, None] & is_object[None, :] & ~np.eye(size, dtype=bool)
    both[-1] = False
    related = (rng.random((6, size, size)) < p_relation) & both
    extreme = (rng.random((6, size, size)) < p_relation) & both
    later = np.repeat(both[None], 6, 0) & ~extreme
    previous = np.zeros(size, bool)
    if rng.random() < 0.5:
        previous[rng.integers(0, num_objects)] = True
    ranked = np.stack([extreme, later, later, later])
    return World(object_type, is_object, related, ranked, previous & is_object)


def example(text, rng, num_worlds=3, split="train"):
    """Parse and label one sentence in random worlds."""
    tree = parse(text)
    marked = [annotate(root) for root in tree.clauses]
    worlds = [random_placed(rng) for _ in range(num_worlds)]
    return Example(
        text=text,
        template=text,
        split=split,
        parse=tree,
        clauses=tuple(ClauseLabels(annotation=a, rank=r) for a, r in marked),
        worlds=tuple(
            WorldLabels(world=w, behavior=tuple(behave(r, w) for r in tree.clauses)) for w in worlds
        ),
    )


def corpus(sentences, num_worlds=3, seed=0):
    """Label all sentences."""
    rng = np.random.default_rng(seed)
    return [labelled_instruction(example(text, rng, num_worlds), TYPES) for text in sentences]
