"""Worlds of known objects as input of the behavior model (section 3.3), on host and device.

Whether a relation holds is geometric (``relations.holds``); which object is the nearest, the second
or the leftmost is a comparison of degrees among the objects of one type.
"""

import dataclasses
from collections.abc import Iterable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.grounding.symbols import NUM_RELATIONS
from jaxlangnav.inputs.object_types import is_type, label_of, name_of, type_code
from jaxlangnav.inputs.program_cache import cached_jit
from jaxlangnav.language.corpus import PlacedWorld
from jaxlangnav.messages import BETWEEN, NONE, ROBOT, BehaviorWorld, Readings
from jaxlangnav.relations import holds
from jaxlangnav.relations.between import lies_between
from jaxlangnav.relations.strength import count_before, degree
from jaxlangnav.relations.table import NUM_RANKS, REGISTRY, SIDES, SYMBOL_OF

SIDE_RANGE = 5.0
"""Maximum distance in metres of "on your left" in the corpus."""


Edges = Iterable[Sequence[int]]


@cached_jit()
def _all_relations(positions: Array, viewer: Array, heading: Array) -> Array:
    """Evaluate all relations for all pairs, bool[6, N, N + 1]; landmark N is the robot."""

    def table(relation: int) -> Array:
        pairs = holds(relation, positions[:, None], positions[None, :], viewer)
        to_robot = holds(relation, positions, viewer, viewer, heading)
        return jnp.concatenate([pairs, to_robot[:, None]], axis=1)

    return jnp.stack([table(relation) for relation in range(NUM_RELATIONS)])


class Geometry:
    """Relations between the objects of a world, as booleans and degrees."""

    def __init__(self, world: PlacedWorld, *, side_range: float = SIDE_RANGE) -> None:
        """Evaluate all six relations over all pairs; index ``len(objects)`` is the robot.

        ``side_range`` is the maximum distance in metres of "left" and "right" of the robot.
        """
        count = len(world.objects)
        positions = np.array([[x, y] for _, x, y in world.objects], np.float32).reshape(-1, 2)
        viewer = np.array(world.robot[:2], np.float32)
        heading = world.robot[2]
        inputs = jax.device_put((positions, viewer, np.float32(heading)))
        self.holds = np.array(_all_relations(*inputs))
        offset = positions[:, None] - np.concatenate([positions, viewer[None]])[None]
        distance = np.linalg.norm(offset, axis=-1)
        self.holds[np.ix_(SIDES, range(count), [count])] &= distance[:, -1:] <= side_range
        lateral = offset @ np.array([-np.sin(heading), np.cos(heading)])
        # Degree of each relation, f64[6, N, N + 1]; larger is stronger.
        self.strength = np.stack([degree(r, distance, lateral) for r in range(NUM_RELATIONS)])


@dataclasses.dataclass(frozen=True)
class World:
    """A world on the host: objects and the relations that hold; the last slot is the robot."""

    object_type: np.ndarray  # i32[N] type index; ROBOT last
    is_object: np.ndarray  # bool[N]
    is_related: np.ndarray  # bool[6, N, N] relation, figure, landmark
    is_ranked: np.ndarray  # bool[4, 6, N, N] by rank: extreme of its type, second, ...
    is_previous: np.ndarray  # bool[N] goal of the previous command

    @classmethod
    def of_edges(cls, object_type: Sequence[int], related: Edges, ranked: Edges = ()) -> "World":
        """Build a world in which only these relations hold; all slots filled, none previous.

        Args:
            object_type: types of the N slots, ``ROBOT`` last.
            related: (relation, figure, landmark).
            ranked: (rank, relation, figure, landmark), the extreme of its type is rank 0.
        """
        size = len(object_type)
        is_related = np.zeros((NUM_RELATIONS, size, size), bool)
        is_ranked = np.zeros((NUM_RANKS, *is_related.shape), bool)
        for table, edges in ((is_related, related), (is_ranked, ranked)):
            for edge in edges:
                table[tuple(edge)] = True
        types, none = np.array(object_type, np.int32), np.zeros(size, bool)
        return cls(types, ~none, is_related, is_ranked, none)


def to_world(
    placed: PlacedWorld, type_names: tuple[str, ...], *, side_range: float = SIDE_RANGE
) -> World:
    """Compute the world of n placed objects, with n + 1 slots, the robot in the last.

    ``side_range``: maximum distance in metres of "on the left" of the robot; as in the corpus.
    """
    count = len(placed.objects)
    types = [
        type_code(type_names.index(name), code)
        for (name, _, _), code in zip(placed.objects, placed.attributes or [0] * count, strict=True)
    ]
    world = World.of_edges([*types, ROBOT], ())
    if count:
        geometry = Geometry(placed, side_range=side_range)
        other = ~np.eye(count, count + 1, dtype=bool)
        world.is_related[:, :count] = geometry.holds & other
        # Number of objects of its type ranked before each figure, by landmark: i[6, n, n + 1].
        label = label_of(world.object_type[:count])
        is_same = (label[:, None] == label[None, :]) & ~np.eye(count, dtype=bool)  # [figure, other]
        is_rival = is_same[None] & ~np.eye(count + 1, count, dtype=bool)[:, None, :]
        rank_of = count_before(geometry.strength.swapaxes(1, 2), is_rival).swapaxes(1, 2)
        for rank in range(NUM_RANKS):
            world.is_ranked[rank, :, :count] = (rank_of == rank) & other
    if placed.previous is not None:
        world.is_previous[placed.previous] = True
    return world


def reading_world(placed: PlacedWorld, type_names: tuple[str, ...], readings: Readings) -> World:
    """Compute the world of placed objects, with the ranks and "between" of a sentence's reading.

    "The second cone on your left" is the second of those on the left. The device has one rank
    beyond the first, so the second table holds the one that the sentence means, by its likeliest
    reading. A figure between two landmarks is encoded as near each of them, and no other object of
    its type is.
    """
    world = to_world(placed, type_names, side_range=np.inf)
    edges = readings.edges()
    edges = edges[edges[:, 1] != NONE]
    if not placed.objects or not ((edges[:, 1] == BETWEEN) | (edges[:, 3] > 0)).any():
        return world
    strength = Geometry(placed).strength
    is_referent = [is_type(world.object_type, c) for c in np.asarray(readings.mention_type[0])]
    _encode_between(world, placed, is_referent, edges)
    for figure, relation, landmark, rank in edges[edges[:, 3] > 0]:
        is_figure = is_allowed = is_referent[figure][:-1]
        for _, symbol, end, _ in edges[(edges[:, 0] == figure) & (edges[:, 3] == 0)]:
            related = world.is_related[SYMBOL_OF[symbol]]
            is_allowed = is_allowed & related[:-1, is_referent[end]].any(1)
        table = world.is_ranked[min(rank, 2) - 1, relation]
        for index in np.flatnonzero(is_referent[landmark]):
            rivals = is_allowed & (np.arange(len(is_figure)) != index)
            is_ranked = rivals & (count_before(strength[relation, :, index], rivals) == rank - 1)
            table[:-1, index] = np.where(is_figure, is_ranked, table[:-1, index])
    return world


def explain_mismatch(
    placed: PlacedWorld, type_names: tuple[str, ...], readings: Readings
) -> list[str]:
    """Explain why no object of a world satisfies the likeliest reading.

    One phrase per cause ("no hydrant is behind the robot"); empty if all annotations hold.
    """
    world, types = reading_world(placed, type_names, readings), np.asarray(readings.mention_type[0])
    names = ["robot" if code == ROBOT else name_of(code, type_names) for code in types]
    is_referent = [is_type(world.object_type, code) for code in types]
    missing = [
        f"there is no {name}"
        for code, name, mask in zip(types, names, is_referent, strict=True)
        if code >= 0 and not mask.any()
    ]
    if missing:
        return missing
    for figure, relation, landmark, rank in readings.edges():
        if relation == NONE:
            continue
        table = world.is_ranked[min(rank, 2) - 1] if rank > 0 else world.is_related
        if table[SYMBOL_OF[relation]][np.ix_(is_referent[figure], is_referent[landmark])].any():
            continue
        if relation == BETWEEN:
            return [f"no {names[figure]} is between two things as is said"]
        return [f"no {names[figure]} is {REGISTRY[relation].words} the {names[landmark]}"]
    return []


def _encode_between(
    world: World, placed: PlacedWorld, is_referent: Sequence[np.ndarray], edges: np.ndarray
) -> None:
    """Replace "near" by "between" for the figures of "between", given bool[n + 1] of mentions."""
    between = edges[edges[:, 1] == BETWEEN]
    x, y = np.array([[x, y] for _, x, y in placed.objects]).T
    is_between_ends = lies_between(*((x[ends], y[ends]) for ends in np.ix_(*[range(len(x))] * 3)))
    for figure, relation, landmark, _ in between:
        others = between[(between[:, 0] == figure) & (between[:, 2] != landmark), 2]
        is_other = np.any([is_referent[other][:-1] for other in others], axis=0)
        is_between = np.any(is_between_ends & is_other, axis=-1)
        is_figure, is_landmark = is_referent[figure][:-1], is_referent[landmark][:-1]
        ends = np.ix_([SYMBOL_OF[relation]], np.flatnonzero(is_figure), np.flatnonzero(is_landmark))
        world.is_related[ends] = is_between[is_figure][:, is_landmark]


def to_device(world: World, num_slots: int | None = None) -> BehaviorWorld:
    """Pad a world to ``num_slots`` for ``infer_behavior``; its last slot, the robot, stays last.

    Raises:
        ValueError: the world has more objects than there are slots.
    """
    size = len(world.object_type)
    num_slots = size if num_slots is None else num_slots
    if size > num_slots:
        raise ValueError(f"the world has {size - 1} objects; at most {num_slots - 1} are held")
    slots = np.append(np.arange(size - 1), num_slots - 1)

    def pad(values: np.ndarray, axes: int, fill: int | bool) -> jnp.ndarray:
        shape = (*values.shape[: values.ndim - axes], *(num_slots,) * axes)
        padded = np.full(shape, fill, values.dtype)
        padded[(..., *np.ix_(*(slots,) * axes))] = values
        return jnp.asarray(padded)

    return BehaviorWorld(
        object_type=pad(world.object_type, 1, NONE),
        is_object=pad(world.is_object, 1, False),
        is_related=pad(world.is_related, 2, False),
        is_superlative=pad(world.is_ranked[0], 2, False),
        is_ordinal=pad(world.is_ranked[1], 2, False),
        is_previous=pad(world.is_previous, 1, False),
    )
