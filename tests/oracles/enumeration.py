"""Exact enumeration of what words refer to in a small world (section 3.2, eq. 7a).

The model. Every thing mentioned exists once, in the operating area A, one of the things a relation
ties together anywhere in it and the others where the relation places them; further objects of each
type are scattered as a Poisson process of density λ = α / A. A relation misleads with probability
ε: its figure and landmark then have nothing to do with each other (f is 1 / A). An object at x has
been missed by every look so far with probability m(x). Given what has been seen, a grounding that
takes things to be observed objects o and the rest to be unseen weighs, against "nothing seen is
what is meant",

    (1 / A) ∏_relations f · ∏_observed 1/λ · ∏_unseen ∫ m(x) dx

Where the number of things of a type is itself not known, but Gamma-Poisson with mean α and variance
of the rate α κ, ∏ 1/λ over k observed things of a type of which n have been seen is the ratio of
how probable n − k and n bystanders in the share s of the area that has been looked at are. Where T
types have one rate, k and n count things of any of them, and T s has been looked at.

A thing that is called by no type ("the thing behind the cone") is of one of the k types that have
been seen or of one that has not, each as probable, and is none of the other things mentioned. So a
seen thing of any type weighs 1 / (k + 1) of what it would as a thing called by that type.

This module sums over all assignments, and over a fine grid of places for what is unseen. NumPy,
float64; nothing is shared with the package.
"""

import dataclasses
import itertools
import math

import numpy as np
from oracles import relations

ROBOT, NONE = -2, -1
ANYTHING = 8191
SIDES, SIDE_KAPPA = range(4), 4.0
PLURAL = 10.0  # so much likelier are unseen figures of an order
FRONT, BEHIND, LEFT, RIGHT, NEAR = range(5)


@dataclasses.dataclass
class World:
    objects: list[tuple[int, float, float]]  # type, x, y of what has been seen
    area: tuple[float, float, float, float]
    miss: np.ndarray  # [G, G] probability of having missed an object, rows are y cells
    viewer: tuple[float, float, float]
    alpha: float
    softness: float  # metres, of a superlative
    median: np.ndarray  # [6] metres, median distance of each relation
    spread: np.ndarray  # [6] of log distance
    axis: np.ndarray  # [6] radians from the line of sight
    concentration: np.ndarray  # [6]
    misleading: float  # ε
    clumping: float = 0.0  # κ
    pooled: int = 0  # T, types that have one rate; 0: each has its own
    fineness: int = 3  # grid points a side in each cell

    @property
    def size(self) -> float:
        return (self.area[1] - self.area[0]) * (self.area[3] - self.area[2])


def may_be(kind: int, name: int) -> bool:
    return kind in (ANYTHING, name)


def seen_odds(world: World, kind: int, name: int) -> float:
    """Weigh a seen thing of type ``name`` as what is called ``kind``, as a density over places."""
    types = {one for one, _, _ in world.objects}
    share = 1.0 / (len(types) + 1) if kind == ANYTHING else 1.0
    return share * bystander_odds(world, name, 1)


def bystander_odds(world: World, kind: int, meant: int) -> float:
    """Compute p(n − meant) / p(n) of bystanders of a type, as a density over places: negative
    binomial by its definition, and Poisson where κ is 0."""
    number = sum(name == kind or world.pooled > 0 for name, _, _ in world.objects)
    looked = max(1, world.pooled) * (1.0 - world.miss.mean())

    def log_density(count: int) -> float:
        if world.clumping == 0.0:
            return count * math.log(world.alpha / world.size)
        shape, rate = world.alpha / world.clumping, 1.0 / world.clumping
        grown = math.lgamma(shape + count) - math.lgamma(shape)
        return grown - count * math.log(world.size * (rate + looked))

    return math.exp(log_density(number - meant) - log_density(number))


def density(world: World, relation: int, figure: np.ndarray, landmark: np.ndarray, own: bool):
    """Log-normal distance times von Mises direction about the axis, per square metre.

    The direction turns from the line of sight, from the viewer to the landmark: 0 is behind, a
    quarter to the left is left. With the robot itself as the landmark (``own``) it counts from its
    heading: front is ahead, left is to its left.
    """
    offset = figure - landmark
    distance = np.hypot(offset[..., 0], offset[..., 1])
    names = "median", "spread", "axis", "concentration"
    law = {name: getattr(world, name)[relation] for name in names}
    sight = np.arctan2(landmark[..., 1] - world.viewer[1], landmark[..., 0] - world.viewer[0])
    if own:
        sight, law["axis"] = world.viewer[2] + math.pi, -law["axis"]
        if relation in SIDES:  # of the robot: however far
            turn = np.arctan2(offset[..., 1], offset[..., 0]) - sight - law["axis"]
            return np.exp(SIDE_KAPPA * np.cos(turn)) / np.i0(SIDE_KAPPA) / world.size
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(distance > 0, relations.density(offset, sight, **law), 0.0)


def superlative(world: World, kind: int, figure: np.ndarray, landmark: np.ndarray):
    """Price of a figure that another seen object of its type beats: exp(−excess / softness)."""
    gap = np.hypot(*np.moveaxis(figure - landmark, -1, 0))
    best = gap
    for name, x, y in world.objects:
        if may_be(kind, name):
            away = np.hypot(x - landmark[..., 0], y - landmark[..., 1])
            away = np.where((away == 0.0) & (kind == ANYTHING), np.inf, away)
            best = np.minimum(best, away)
    return np.exp(-(gap - best) / world.softness)


def ordered(world: World, kind: int, rank: int, score) -> np.ndarray:
    """Weigh the observed objects, all of one type, and all unseen ones as the one of a rank.

    It is the observed one of that rank if no unseen one comes before it; the number of these is
    enumerated, Poisson of a Gamma rate given all observed objects but the one meant.
    """
    place, weight, category = candidates(world, kind)
    is_unseen, key = category == len(world.objects), score(place)
    share, number = weight[is_unseen] / weight[is_unseen].sum(), (~is_unseen).sum()
    miss, shape = world.miss.mean(), world.alpha / world.clumping + number - 1
    rate, counts = 1.0 / world.clumping + 1.0 - miss, np.arange(500)
    grown = [math.lgamma(shape + n) - math.lgamma(shape) - math.lgamma(n + 1) for n in counts]
    probability = np.exp(grown + shape * np.log(rate) + counts * np.log(miss))
    probability /= (rate + miss) ** (shape + counts)
    target = np.sort(key[~is_unseen])[rank - 1]
    none_before = probability @ (1.0 - share[key[is_unseen] < target].sum()) ** counts
    holds = np.where(key[~is_unseen] == target, none_before, 0.0)
    expected, error = shape / rate, world.misleading
    seen = ((1.0 - error) * holds + error) / expected
    unseen = PLURAL * (1.0 - error) * (1.0 - none_before) / expected
    return np.append(seen, unseen + error * miss)


def candidates(world: World, kind: int):
    """List places [n, 2], weights [n] and categories [n] of what may be meant.

    A category is the index of a seen object, or their number for anything unseen.
    """
    if kind == ROBOT:
        return np.array([world.viewer[:2]]), np.ones(1), np.zeros(1, int)
    seen = [(index, x, y) for index, (name, x, y) in enumerate(world.objects) if may_be(kind, name)]
    cells = world.miss.shape[0]
    number = cells * world.fineness
    x_min, x_max, y_min, y_max = world.area
    step_x, step_y = (x_max - x_min) / number, (y_max - y_min) / number
    grid_x, grid_y = np.meshgrid(
        x_min + (np.arange(number) + 0.5) * step_x, y_min + (np.arange(number) + 0.5) * step_y
    )
    miss = np.kron(world.miss, np.ones((world.fineness, world.fineness)))
    place = np.concatenate(
        [
            np.array([[x, y] for _, x, y in seen]).reshape(-1, 2),
            np.stack([grid_x.ravel(), grid_y.ravel()], axis=1),
        ]
    )
    weight = np.concatenate(
        [
            np.array([seen_odds(world, kind, world.objects[index][0]) for index, _, _ in seen]),
            miss.ravel() * step_x * step_y,
        ]
    )
    category = [index for index, _, _ in seen] + [len(world.objects)] * number**2
    return place, weight, np.array(category)


def potential(world: World, kinds: list[int], edge: tuple[int, int, int, bool], places: list):
    """Tabulate f over all places of the figure (rows) and of the landmark (columns)."""
    figure, relation, landmark, is_extreme = edge
    rows, columns = places[figure][:, None, :], places[landmark][None, :, :]
    shape = (rows.shape[0], columns.shape[1], 2)
    rows, columns = np.broadcast_to(rows, shape), np.broadcast_to(columns, shape)
    table = density(world, relation, rows, columns, kinds[landmark] == ROBOT)
    if is_extreme:
        table = table * superlative(world, kinds[figure], rows, columns)
    table = (1.0 - world.misleading) * table + world.misleading / world.size
    if ANYTHING in (kinds[figure], kinds[landmark]):
        own, mark = ([name for name, _, _ in world.objects if may_be(kind, name)]
                     for kind in (kinds[figure], kinds[landmark]))  # fmt: skip
        for i, j in np.ndindex(len(own), len(mark)):
            if (places[figure][i] == places[landmark][j]).all():
                table[i, j] = 0.0
            elif own[i] == mark[j] and not world.pooled:
                both = bystander_odds(world, own[i], 2)
                table[i, j] *= both / bystander_odds(world, own[i], 1) ** 2
    elif kinds[figure] == kinds[landmark]:
        table = np.where((rows == columns).all(-1), 0.0, table)
        known = sum(name == kinds[figure] for name, _, _ in world.objects)
        if not world.pooled:
            both = bystander_odds(world, kinds[figure], 2) if known > 1 else 0.0
            table[:known, :known] *= both / bystander_odds(world, kinds[figure], 1) ** 2
    return table


def groundings(world: World, kinds: list[int], edges: list[tuple[int, int, int, bool]]):
    """Weigh all groundings of one reading whose relations form no circles.

    Weights f64[C, ...] over the categories of each mention, C = seen objects + 1, and the same
    weighed with x and with y of the first mention, f64[2, C, ...].
    """
    number = len(world.objects) + 1
    places, weights, categories = zip(*[candidates(world, kind) for kind in kinds], strict=True)
    weights, ties = tie(world, kinds, edges, [world.viewer] * len(edges), places, weights)
    # The first mention three times: plain, weighed with x, weighed with y.
    first = [weights[0] * one for one in (1.0, *places[0].T)]
    result = np.stack([contract([one, *weights[1:]], categories, ties, number) for one in first])
    result = result / (1.0 if ROBOT in kinds else world.size)
    for one, other in itertools.combinations(range(len(kinds)), 2):
        if ANYTHING in (kinds[one], kinds[other]) and ROBOT not in (kinds[one], kinds[other]):
            axes = np.moveaxis(result, (1 + one, 1 + other), (0, 1))
            for index in range(number - 1):
                axes[index, index] = 0.0
    result = result * _together(world, kinds, result.shape[1:])
    return result[0], result[1:]


def _together(world: World, kinds: list[int], shape: tuple[int, ...]) -> np.ndarray:
    """Weigh what k things are together above what each is by itself, where all types are pooled."""
    is_seen = np.zeros(shape, int)
    if world.pooled:
        for mention, kind in enumerate(kinds[: len(shape)]):
            axis = np.arange(shape[mention]) < len(world.objects)
            is_seen += np.expand_dims(
                axis & (kind != ROBOT), [one for one in range(len(shape)) if one != mention]
            )
    first = bystander_odds(world, NONE, 1) if is_seen.any() else 1.0
    odds = [1.0, first, *(bystander_odds(world, NONE, k) for k in range(2, is_seen.max() + 1))]
    return np.array([one / first**k for k, one in enumerate(odds)])[is_seen]


def stream(world: World, kinds: list[int], edges: list, viewers: list, excluded: dict):
    """Weigh all groundings of what several utterances have said together, f64[C, ...].

    No mention is the robot: the landmark of a relation may be ``ROBOT``; a relation is NONE where a
    thing merely exists. ``viewers`` are poses of the robot as it heard each relation; ``excluded``
    tells of mentions which seen objects they are not.
    """
    number = len(world.objects) + 1
    places, weights, categories = map(
        list, zip(*[candidates(world, kind) for kind in kinds], strict=True)
    )
    for mention, objects in excluded.items():
        weights[mention] = weights[mention] * ~np.isin(categories[mention], list(objects))
    weights, ties = tie(world, kinds, edges, viewers, places, weights)
    joint = contract(weights, categories, ties, number)
    return joint / joint.sum()


def tie(world: World, kinds: list[int], edges, viewers, places, weights):
    """Tabulate relations, each as its viewer sees it: of two mentions, or of one and the robot.

    Weights of places with those of relations to the robot; and mention, mention → f over both.
    """
    weights, ties = list(weights), {}
    for edge, viewer in zip(edges, viewers, strict=True):
        figure, relation, landmark, extreme = edge
        seen_from = dataclasses.replace(world, viewer=viewer)
        if landmark == ROBOT:
            told = potential(
                seen_from, [kinds[figure], ROBOT], (0, relation, 1, extreme),
                [places[figure], np.array([viewer[:2]])],
            )  # fmt: skip
            weights[figure] = weights[figure] * told[:, 0]
        elif relation != NONE:
            table = potential(seen_from, kinds, edge, places)
            ties[figure, landmark], ties[landmark, figure] = table, table.T
    return weights, ties


def contract(weights, categories, ties, number: int) -> np.ndarray:
    """Sum over the places of all mentions, each along the tree of its relations: f64[C, ...]."""
    order: list[int] = []

    def below(mention: int, parent: int) -> np.ndarray:
        order.append(mention)
        hot = weights[mention][:, None] * (categories[mention][:, None] == np.arange(number))
        for one, other in ties:
            if one == mention and other != parent:
                side = ties[one, other] @ below(other, mention)
                hot = (hot[:, :, None] * side[:, None, :]).reshape(hot.shape[0], -1)
        return hot

    joint = np.ones(1)
    for mention in range(len(weights)):
        if mention not in order:
            joint = np.multiply.outer(joint, below(mention, NONE).sum(0)).ravel()
    return np.transpose(joint.reshape((number,) * len(weights)), np.argsort(order))


BETWEEN_ALONG, BETWEEN_ACROSS = 0.2, 0.15


def between(world: World, kinds: tuple[int, int, int]) -> np.ndarray:
    """Weigh all groundings of a figure between two landmarks, f64[C, C, C], C = seen objects + 1.

    The landmarks are anywhere; given both, the figure is Gaussian about the middle of the way, with
    standard deviations that are shares of its length. One landmark after another.
    """
    number = len(world.objects) + 1
    (figures, weight, category), first, second = (candidates(world, kind) for kind in kinds)
    others, other_weight, other_category = second
    result = np.zeros((number, number, number))
    by_figure = weight[:, None] * (category[:, None] == np.arange(number))
    by_other = other_weight[:, None] * (other_category[:, None] == np.arange(number))
    cell = weight[-1] / max(world.miss.ravel()[-1], 1e-12)
    for one, one_weight, one_category in zip(*first, strict=True):
        way = (others - one)[None]
        square = np.maximum((way**2).sum(-1), 1e-12)
        offset = (figures - one)[:, None]
        u = (offset * way).sum(-1) / square - 0.5
        v = (offset[..., 1] * way[..., 0] - offset[..., 0] * way[..., 1]) / square
        density = np.exp(-0.5 * ((u / BETWEEN_ALONG) ** 2 + (v / BETWEEN_ACROSS) ** 2))
        density /= 2.0 * math.pi * BETWEEN_ALONG * BETWEEN_ACROSS * square
        # Two of one cell of the grid: so is what lies between.
        is_here = (figures == one).all(-1)[:, None]
        density = np.where(square < 1e-9, is_here / cell, density)
        density = (1.0 - world.misleading) * density + world.misleading / world.size
        is_one = one_category < number - 1
        density[is_one & (category == one_category)] = 0.0
        density[:, is_one & (other_category == one_category)] = 0.0
        density[(category[:, None] == other_category) & (category < number - 1)[:, None]] = 0.0
        result[:, one_category] += one_weight * by_figure.T @ density @ by_other
    return result / world.size**2
