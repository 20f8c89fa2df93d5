# ---
# jupyter:
#   jupytext:
#     formats: py:percent,ipynb
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # The correspondence graph by itself: a kitchen
#
# The Distributed Correspondence Graph says what each phrase of a sentence stands for, given what
# its child phrases stand for. Nothing in it is about hydrants: here are someone else's symbols,
# worlds, trees and corpus. A robot in a kitchen is told to *fetch the red mug left of the
# kettle*.
#
# First the world, a few things on a counter, and the trees. `read_tree` reads them from text, so
# any parser will do.

# %%
# %matplotlib inline
import itertools
from types import MappingProxyType
from typing import NamedTuple

import jax
import numpy as np

import jaxlangnav
from jaxlangnav.grounding import Block, Described, Labelled, SymbolDomain, read_tree
from jaxlangnav.training import train_graph
from jaxlangnav.training.examples import examples_of
from jaxlangnav.training.fit import TrainingConfig, build_design, loss
from jaxlangnav.viz.graph import beliefs_figure

jaxlangnav.keep_compiled_programs()

KIND = "symbol"  # all symbols have weights in common
KINDS, COLOURS = ("mug", "plate", "bowl", "kettle"), ("red", "blue", "white")
RELATIONS, ACTIONS = ("left of", "right of", "next to"), ("fetch", "wipe")


class Thing(NamedTuple):
    """Something on the counter."""

    kind: str
    colour: str
    place: float  # metres from the left end


def holds(relation, figure, landmark):
    """Whether a relation holds between two places on the counter."""
    offset = figure - landmark
    return {
        "left of": offset < 0,
        "right of": offset > 0,
        "next to": 0 < abs(offset) < 0.3,
    }[relation]


COUNTER = (
    Thing("mug", "red", 0.1),
    Thing("kettle", "white", 0.5),
    Thing("mug", "red", 0.7),
    Thing("mug", "blue", 0.3),
    Thing("plate", "white", 0.9),
)
sentence = read_tree("VP[fetch]{NP[]{NP[the red mug], PP[left of]{NP[the kettle]}}}")
print(sentence)

# %% [markdown]
# ## The symbols
#
# A `SymbolSpace` says which symbols a phrase may express in a world, here every thing, every
# region of a thing and both actions, and what is seen of each symbol. A feature of the model is a
# word feature times such a property. Words need no meaning beforehand: that *cup* goes with *is a
# mug* is learned.

# %%
PROPERTIES = (
    "is a thing",
    *(f"is a {kind}" for kind in KINDS),
    *(f"is {colour}" for colour in COLOURS),
    "thing that a child means",
    "thing a child means, in its region",
    "thing a child means, outside",
    "is a region",
    *(f"is {relation} what a child means" for relation in RELATIONS),
    "is a region of something else",
    *(f"is the action {action}" for action in ACTIONS),
)


class Kitchen:
    """Symbols of a counter; a world is a tuple of things."""

    columns = MappingProxyType({KIND: PROPERTIES})

    def symbols_in(self, world):
        """Name the things, their regions and the actions."""
        things = [f"{i}: {thing.colour} {thing.kind}" for i, thing in enumerate(world)]
        regions = [f"{relation} {thing}" for relation in RELATIONS for thing in things]
        return SymbolDomain([*things, *regions, *ACTIONS])

    def describe(self, phrase, path, world):
        """Describe each symbol, given bool[S] for each child."""
        return Described(lambda children: {KIND: Block(slice(None), seen(children, world))})


def seen(children, world):
    """Describe each symbol, given bool[S] for each child."""
    size = len(world)
    meant = np.any([child[:size] for child in children] or [np.zeros(size)], axis=0)
    regions = np.zeros((len(RELATIONS), size), bool)
    for child in children:
        regions |= child[size : size + regions.size].reshape(regions.shape)
    inside = np.array(
        [
            any(holds(RELATIONS[r], one.place, world[i].place) for r, i in np.argwhere(regions))
            for one in world
        ]
    )
    limited = regions.any()
    rows = [
        dict.fromkeys(("is a thing", f"is a {one.kind}", f"is {one.colour}"), 1)
        | {"thing that a child means": meant[i]}
        | {"thing a child means, in its region": limited and meant[i] and inside[i]}
        | {"thing a child means, outside": limited and meant[i] and not inside[i]}
        for i, one in enumerate(world)
    ]
    for relation, i in itertools.product(RELATIONS, range(size)):
        where = f"is {relation} what a child means" if meant[i] else PROPERTIES[-3]
        rows.append({"is a region": 1, where: 1})
    rows += [{f"is the action {action}": 1} for action in ACTIONS]
    return np.array([[row.get(name, 0) for name in PROPERTIES] for row in rows], np.float32)


space = Kitchen()
print(space.symbols_in(COUNTER).size, "symbols,", len(PROPERTIES), "properties")

# %% [markdown]
# ## The corpus
#
# Sentences in random kitchens, each phrase labelled with what it expresses. People say *cup* and
# *bring* too. Every third sentence is kept for testing, in a kitchen of its own.

# %%
NAMES = {
    "mug": ("mug", "cup"),
    "plate": ("plate", "dish"),
    "bowl": ("bowl",),
    "kettle": ("kettle",),
}
VERBS = {"fetch": ("fetch", "bring"), "wipe": ("wipe", "clean")}


def label(phrase, world, means):
    """Label a phrase and all below it; returns what it expresses."""
    below = [label(child, world, means) for child in phrase.children]
    names, said = space.symbols_in(world).symbols, {word.text for word in phrase.words}
    size, text = len(world), " ".join(word.text for word in phrase.words)
    if phrase.label == "PP":
        expressed = {f"{text} {thing}" for thing in below[0]}
    elif phrase.label == "VP":
        own = {action for action in ACTIONS if said & set(VERBS[action])}
        expressed = own | set().union(*below)
    elif phrase.children:
        regions = [
            (relation, world[i].place)
            for relation, i in itertools.product(RELATIONS, range(size))
            if f"{relation} {names[i]}" in below[1]
        ]
        expressed = {
            name
            for name, one in zip(names[:size], world, strict=True)
            if name in below[0] and any(holds(r, one.place, place) for r, place in regions)
        }
    else:
        colours = said & set(COLOURS) or set(COLOURS)
        expressed = {
            name
            for name, one in zip(names[:size], world, strict=True)
            if said & set(NAMES[one.kind]) and one.colour in colours
        }
    means.append(frozenset(expressed))
    return expressed


def noun(random):
    """Draw a noun phrase."""
    colour = random.choice([f"{one} " for one in COLOURS] + [""] * 2)
    return f"NP[the {colour}{random.choice(NAMES[random.choice(KINDS)])}]"


def draw(random):
    """Draw a sentence in a kitchen where it means something."""
    while True:
        world = tuple(
            Thing(str(random.choice(KINDS)), str(random.choice(COLOURS)), float(place))
            for place in random.random(random.integers(4, 8))
        )
        what = noun(random)
        if random.random() < 0.6:
            what = f"NP[]{{{what}, PP[{random.choice(RELATIONS)}]{{{noun(random)}}}}}"
        verb = random.choice(VERBS[random.choice(ACTIONS)])
        root, means = read_tree(f"VP[{verb}]{{{what}}}"), []
        label(root, world, means)
        if all(means):
            return Labelled(root=root, world=world, expressed=means)


random = np.random.default_rng(0)
corpus = [draw(random) for _ in range(240)]
train = [one for i, one in enumerate(corpus) if i % 3]
test = corpus[::3]
for one in train[:4]:
    print(one.root, sorted(one.expressed[-1]))

# %% [markdown]
# ## Training
#
# A convex problem, solved to its minimum. Character n-grams, which help with words never seen, are
# left out, so that the weights below are easier to read. A sentence counts as right where every
# symbol at its root is.

# %%
config = TrainingConfig(l2=0.01)
graph, measured = train_graph(space, train, config=config, without=frozenset({"gram"}))
weights = graph.model.weights[KIND]


def accuracy(labelled):
    """Share of trees whose likeliest set at the root is exactly the labelled one."""
    best = [graph.ground(one.root, one.world)[0].symbols for one in labelled]
    return np.mean([set(b) == one.expressed[-1] for b, one in zip(best, labelled, strict=True)])


print(
    f"{weights.size:,} weights, {measured.steps[0]} steps, {1e3 * measured.seconds:.0f} ms, "
    f"and {measured.compile_seconds:.1f} s to compile"
)
print(f"right: {accuracy(train):.0%} of training, {accuracy(test):.0%} held out")

# %% [markdown]
# ## What a sentence means
#
# Two of the mugs are red, one stands left of the kettle. The picture is Figure 3 of the paper: a
# factor (black) joins the phrase, a symbol and what the child phrases express; its correspondence
# variable is filled by its probability.

# %%
for meaning in graph.ground(sentence, COUNTER)[:2]:
    print(f"{meaning.probability:.1%}", ", ".join(meaning.symbols))
figure = beliefs_figure(
    graph.score(sentence, COUNTER).beliefs(),
    space.symbols_in(COUNTER).symbols,
    title="fetch the red mug left of the kettle",
)
figure

# %% [markdown]
# A synonym that training has seen, in a sentence that it has not:

# %%
for text in (
    "VP[bring]{NP[]{NP[the blue cup], PP[next to]{NP[the kettle]}}}",
    "VP[clean]{NP[the dish]}",
):
    best = graph.ground(read_tree(text), COUNTER)[0]
    print(f"{text:64} {best.probability:.1%}", ", ".join(best.symbols))

# %% [markdown]
# ## The weights
#
# The largest, and all weights of the words for things.

# %%
for place in np.argsort(-np.abs(weights), axis=None, kind="stable")[:8]:
    word, column = np.unravel_index(place, weights.shape)
    name = graph.model.vocabulary.names[word]
    print(f"{weights[word, column]:+6.2f}  {name:22} × {PROPERTIES[column]}")

words = [name for name in graph.model.vocabulary.names if name.startswith("word=")]
rows = [graph.model.vocabulary.names.index(name) for name in words]
table = weights[rows]
limit = np.abs(table).max()

import matplotlib.pyplot as plt

figure, axes = plt.subplots(figsize=(9, 6), layout="constrained")
picture = axes.imshow(table, cmap="RdBu", vmin=-limit, vmax=limit, aspect="auto")
axes.set_yticks(range(len(words)), [name.removeprefix("word=") for name in words])
axes.set_xticks(range(len(PROPERTIES)), PROPERTIES, rotation=45, ha="right")
axes.set_title("What the words weigh", loc="left")
figure.colorbar(picture, label="weight")
plt.show()

# %% [markdown]
# ## Differentiating the loss
#
# The loss is a JAX function of the weights. At its minimum the gradient is zero, up to the
# tolerance; away from it, it agrees with finite differences. So a graph can be a part of
# something larger that is trained end to end.

# %%
_, design = build_design(examples_of(space, train), (KIND,), len(train), frozenset({"gram"}))
counts = design.counts(np.ones((1, len(train)), np.float32))[0]
gradient = jax.grad(loss)
trained, zero = {KIND: weights}, {KIND: np.zeros_like(weights)}
for name, at in (("at zero", zero), ("trained", trained)):
    value = float(loss(at, design, counts, config.l2))
    length = float(np.linalg.norm(gradient(at, design, counts, config.l2)[KIND]))
    print(f"{name}: loss {value:9.3f}, length of the gradient {length:9.4f}")

slope = np.asarray(gradient(zero, design, counts, config.l2)[KIND])
place = np.unravel_index(np.argmax(np.abs(slope)), slope.shape)
ends = []
for step in (0.01, -0.01):
    moved = zero[KIND].copy()
    moved[place] += step
    ends.append(float(loss({KIND: moved}, design, counts, config.l2)))
print(f"steepest: {slope[place]:.2f} by gradient, {(ends[0] - ends[1]) / 0.02:.2f} by differences")
