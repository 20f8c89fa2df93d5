"""A small labelled corpus in code: sentences, rule-made gold labels and random worlds.

The rules here label training data for tests; they are no part of the package.
"""

import numpy as np

from jaxlangnav.grounding.behavior_features import World
from jaxlangnav.grounding.examples import LabelledInstruction
from jaxlangnav.grounding.features import RESTRICTORS, senses_of
from jaxlangnav.grounding.graph import bottom_up
from jaxlangnav.grounding.symbols import (
    ACTION,
    CONSTRAINT,
    GOAL,
    MODE,
    OBJECT,
    REGION,
    BehaviorSymbol,
    object_symbol,
    region_symbol,
    relation_symbol,
)
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.language.parser import parse
from jaxlangnav.messages import AT, NEAR, NONE, ROBOT

TYPES = load_lexicon().type_names
_ACTIONS = {"navigate": 0, "find": 1}

SENTENCES = (
    "walk to the barrel", "move to the box behind the tree", "find the car",
    "quickly drive to the bench near the building", "go to the tree in front of the car",
    "please head to the cone to the left of the bench", "park behind the barrel",
    "locate the building on your left", "proceed to the car nearest to the tree",
    "approach the box", "carefully walk to the bench right of the barrel",
    "look for the hydrant far from the building", "go to the nearest tree",
    "move to the box farthest from the car", "stop in front of the hydrant",
    "drive to the cone that is behind the box", "go to the other car",
    "go to the bench behind the car near the tree", "navigate to the tree in front of you",
    "go to the box but stay away from the cone", "travel to the area behind the building",
    "the barrel is behind the bench", "there is a cone near the car",
    "drive slowly to the hydrant next to the bench", "find the barrel closest to the building",
    "go to the tree then go to the bench", "park near the box", "go to the farthest cone",
    "walk to the hydrant behind the box", "move to the cone left of the tree",
    "go toward the building", "run to the car", "head to the barrel near you",
)


def _annotate(nodes):
    gold, superlative = {}, set()
    for node in nodes:
        senses = senses_of(node.phrase, TYPES)
        own = {s for w in node.phrase.words for s in w.senses}
        if "superlative" in own:
            superlative.add(node.path)
        below = [(nodes[i].phrase, gold[nodes[i].path]) for i in node.children]
        regions = {s for _, g in below for s in g if s.kind == REGION}
        rest = {s for _, g in below for s in g if s.kind != REGION}
        relations = {r for r in senses.relations if r < 6}
        if relations:
            relation = min(relations)
            if below:
                figures = {s.figure for s in rest if s.kind == OBJECT}
                marks = {s.landmark for s in rest}
                figures |= {s.figure for s in rest if s.kind != OBJECT and s.figure not in marks}
                made = {region_symbol(relation, f) for f in figures}
                keep = {s for s in rest if s.kind != OBJECT}
            else:
                made, keep = {region_symbol(relation, ROBOT)}, set()
            gold[node.path] = frozenset(made | keep)
        elif senses.types:
            gold[node.path] = frozenset(object_symbol(t) for t in senses.types)
        elif regions and any(s.kind != REGION for p, g in below if p.label == "NP" for s in g):
            nouns = {s for p, g in below if p.label == "NP" for s in g}
            figures = {s.figure for s in nouns}
            made = {relation_symbol(f, r.relation, r.landmark) for f in figures for r in regions}
            keep = {s for s in rest if s.kind != OBJECT}
            gold[node.path] = frozenset(made | keep)
        else:
            gold[node.path] = frozenset(rest | regions)
    return gold, superlative


def random_world(rng, num_objects=8, p_relation=0.15):
    """Random types and edges; every topology a particle may have."""
    size = num_objects + 1
    object_type = rng.integers(0, len(TYPES), size).astype(np.int32)
    object_type[-1] = ROBOT
    is_object = rng.random(size) < 0.8
    is_object[-1] = True
    both = is_object[:, None] & is_object[None, :] & ~np.eye(size, dtype=bool)
    related = (rng.random((6, size, size)) < p_relation) & both
    distance = rng.random((size, size))
    near = np.zeros((6, size, size), bool)
    for figure in range(size):
        rivals = (object_type == object_type[figure]) & is_object
        for landmark in range(size):
            if both[figure, landmark]:
                others = rivals & both[:, landmark]
                near[4, figure, landmark] = distance[figure, landmark] <= distance[others, landmark].min()
                near[5, figure, landmark] = distance[figure, landmark] >= distance[others, landmark].max()
    previous = np.zeros(size, bool)
    if rng.random() < 0.5:
        previous[rng.integers(0, num_objects)] = True
    return World(object_type, is_object, related, near | (related & (rng.random(related.shape) < 0.5)),
                 previous & is_object)


def _behave(nodes, world, superlative):
    gold, lies = {}, {}
    for node in nodes:
        senses = senses_of(node.phrase, TYPES)
        own = {s for w in node.phrase.words for s in w.senses}
        below = [nodes[i] for i in node.children]
        objects = {s.index for b in below for s in gold[b.path] if s.kind == OBJECT}
        regions = {(s.relation, s.index) for b in below for s in gold[b.path] if s.kind == REGION}
        out = set()
        is_type = {i for i, t in enumerate(world.object_type) if world.is_object[i] and t in senses.types}
        if node.is_verb:
            if "constraint" in own and node.path[1:]:
                out = {BehaviorSymbol(CONSTRAINT, NEAR, i) for i in objects}
            else:
                goals = regions | {(AT, i) for i in objects}
                actions = senses.actions or {0}
                out = {BehaviorSymbol(GOAL, r, i) for r, i in goals}
                out |= {BehaviorSymbol(ACTION, NONE, a) for a in actions}
                out |= {BehaviorSymbol(MODE, NONE, m) for m in senses.modes or {0}}
                out |= {s for b in below for s in gold[b.path] if s.kind == CONSTRAINT}
        elif {r for r in senses.relations if r < 6}:
            relation = min(senses.relations)
            marks = objects if below else {len(world.object_type) - 1}
            out = {BehaviorSymbol(REGION, relation, i) for i in marks}
        elif node.phrase.label in ("PP",):
            out = {BehaviorSymbol(REGION, AT, i) for i in objects}
            out |= {BehaviorSymbol(REGION, r, i) for r, i in regions}
        elif senses.types:
            out = {BehaviorSymbol(OBJECT, NONE, i) for i in is_type
                   if not ("other" in own and world.is_previous[i])}
        elif node.phrase.label == "SBAR" or not any(b.phrase.label == "NP" and gold[b.path] for b in below):
            out = {BehaviorSymbol(REGION, r, i) for r, i in regions}
            if node.phrase.label == "NP" and any(
                senses_of(b.phrase, TYPES).types for b in below if b.phrase.label == "NP"
            ):
                out = set()
        else:
            limits = [lies[b.path] for b in below if b.phrase.label in RESTRICTORS]
            out = {BehaviorSymbol(OBJECT, NONE, i) for i in objects if all(i in x for x in limits)}
        gold[node.path] = frozenset(out)
        sup = node.path in superlative or any(b.path in superlative for b in below)
        table = world.is_superlative if sup else world.is_related
        inside = {(s.relation, s.index) for s in out if s.kind == REGION}
        lies[node.path] = {i for r, j in inside for i in range(len(world.object_type))
                           if (i == j if r == AT else table[r, i, j])}
    return gold


def label(text, rng, num_worlds=3):
    """Parse and label one sentence; statements get no worlds."""
    tree = parse(text)
    annotation, superlative = {}, set()
    clauses = [bottom_up(root, c) for c, root in enumerate(tree.clauses)]
    for nodes in clauses:
        gold, marked = _annotate(nodes)
        annotation |= gold
        superlative |= marked
    worlds, behavior = [], []
    if "statement" not in tree.kinds:
        for _ in range(num_worlds):
            world = random_world(rng)
            worlds.append(world)
            behavior.append({k: v for nodes in clauses for k, v in _behave(nodes, world, superlative).items()})
    return LabelledInstruction(tree, annotation, frozenset(superlative), tuple(worlds), tuple(behavior))


def corpus(num_worlds=3, seed=0, sentences=SENTENCES):
    """Label all sentences."""
    rng = np.random.default_rng(seed)
    return [label(text, rng, num_worlds) for text in sentences]
