"""How probable the words of whole episodes are, as a differentiable function of relations.

The model of ``semantic_map`` factors: what was seen and not seen is probable by the map alone, and
the words are probable given the map and where the robot has looked,

    log p(z, words) = log p(z) + log p(words | map, m)
    p(words | map, m) = (1/A) Σ_{f, l} f(x_f − x_l; θ) w_f w_l

with candidates f, l: what has been observed (w = A / α) and every cell of the area (w = its size
times its miss probability m); log p(z) is ``map_evidence.log_map``. This scores the relation
against worlds drawn by it, of which only those that fit the area are ever met. Their share falls
as the relation reaches farther, so relations are compared by

    log p(map | words; θ) = log p(words | map, m; θ) − log Z(θ) + constant
    Z(θ) = (1/A) ∫_A ∫_A f(x_f − x_l; θ) dx_f dx_l = p(words | nothing observed, m = 1; θ)

(``log_fit``). Left out, every unit of f that falls outside the area counts against θ, and the
fitted distance comes out short. For a belief of fixed θ, Z is a constant.

The filter sums the words' evidence by sampling places. Its samples move with θ and fall from
one cell of m into another, or out of the area, in steps that have no derivative: the gradient of
the sampled evidence leaves those out (in a small area half of it is missing). Here places are
summed over on the grid itself, so value and gradient are exact but for the grid.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.messages import NONE, ROBOT, Readings
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.relations import RelationParams, density_of, log_density, prepare, viewer_frame
from jaxlangnav.relations.strength import degree
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.coverage import area_size, cell_centres
from jaxlangnav.semantic_map.params import MapParams

_NEVER = -1e4
"""Log-weight of what cannot be; finite, so that its gradient is nothing rather than NaN."""
_TINY = 1e-30
"""Density that counts as none, per square metre; above the smallest float32."""
GROUP_SIZE = 64
"""Episodes whose pairs are in memory at a time: 0.2 MB each in a map of 18 × 18 cells."""


@pytree
class WordsEvidence:
    """What an episode leaves behind that the words are held against."""

    object_type: Array  # i32[O] observed objects of the likeliest particle; NONE in empty slots
    object_x: Array  # f32[O] metres, map frame
    object_y: Array  # f32[O]
    miss: Array  # f32[C] probability of having missed an object in each cell
    cell_x: Array  # f32[C] centres, metres
    cell_y: Array  # f32[C]
    area: Array  # f32[] square metres
    viewer: Array  # f32[3] pose at the utterance
    readings: Readings  # of the sentence, leaves [K, …]


def remember(
    belief: ParticleBelief,
    readings: Readings,
    *,
    blocks: int = 2,
    num_readings: int | None = None,
) -> WordsEvidence:
    """Keep of a belief what the words' evidence depends on.

    Args:
        belief: at the end of an episode.
        readings: of its sentence; each of at most one relation, none of them an order.
        blocks: cells of the coverage a side that become one; must divide them.
        num_readings: how many of the likeliest readings are kept; all if None.

    Returns:
        The observed map of the likeliest particle, and where the robot has looked.
    """
    particles, cells = belief.particles, belief.coverage.log_miss.shape[-1]
    best = jnp.argmax(belief.log_weight)
    likeliest = jnp.argsort(-readings.log_probability)[:num_readings]
    readings = jax.tree.map(lambda leaf: leaf[likeliest], readings)
    num_objects = particles.object_type.shape[0]
    coarse = cells // blocks
    miss = jnp.exp(belief.coverage.log_miss).reshape(coarse, blocks, coarse, blocks)
    x, y = cell_centres(belief.coverage)
    x, y = jnp.mean(x.reshape(coarse, blocks), axis=1), jnp.mean(y.reshape(coarse, blocks), axis=1)
    return WordsEvidence(
        object_type=particles.object_type[:, best],
        object_x=particles.mean_x[:num_objects, best],
        object_y=particles.mean_y[:num_objects, best],
        miss=jnp.mean(miss, axis=(1, 3)).reshape(-1),
        cell_x=jnp.tile(x, coarse),
        cell_y=jnp.repeat(y, coarse),
        area=area_size(belief.coverage),
        viewer=belief.viewer,
        readings=readings,
    )


def _candidates(one: WordsEvidence, kind: Array, params: MapParams) -> tuple[Array, Array, Array]:
    """List places, f32[O + C] x and y, and their log-weights, for a thing of a type."""
    log_seen = jnp.log(one.area) - jnp.log(params.concentration)
    is_robot = kind == ROBOT
    known = jnp.where((one.object_type == kind) & (kind >= 0), log_seen, _NEVER)
    # The robot itself is known: it takes the first slot.
    first = jnp.arange(known.shape[0]) == 0
    known = jnp.where(is_robot, jnp.where(first, 0.0, _NEVER), known)
    x = jnp.where(is_robot, one.viewer[0], one.object_x)
    y = jnp.where(is_robot, one.viewer[1], one.object_y)
    size = one.area / one.miss.shape[0]
    unseen = jnp.where(is_robot, _NEVER, jnp.log(size * one.miss))
    return (
        jnp.concatenate([x, one.cell_x]),
        jnp.concatenate([y, one.cell_y]),
        jnp.concatenate([known, unseen]),
    )


def _log_told(
    one: WordsEvidence,
    reading: Array,
    figures: tuple[Array, Array],
    landmarks: tuple[Array, Array],
    params: MapParams,
) -> Array:
    """Compute what the words say of figures f32[F] at landmarks f32[L]: log density, f32[F, L]."""
    relation = one.readings.relation[reading, 0]
    frame = viewer_frame(one.viewer[0], one.viewer[1], *landmarks)
    frame = jax.tree.map(lambda leaf: leaf[None, :], frame)
    x, y = (f[:, None] - k[None, :] for f, k in zip(figures, landmarks, strict=True))
    told = log_density(density_of(params.relations, jnp.maximum(relation, 0)), x, y, frame)
    told = told + _log_superlative(one, reading, _distance(figures, landmarks), landmarks, params)
    return jnp.logaddexp(
        jnp.log1p(-params.misleading) + told, jnp.log(params.misleading) - jnp.log(one.area)
    )


def _between_cells(one: WordsEvidence, params: MapParams) -> Array:
    """Compute what the words say of all pairs of cells: densities, f32[K, C, C].

    Without a superlative they are the same for every episode of a setting.
    """
    cells = one.cell_x, one.cell_y

    def of(reading: Array) -> Array:
        return jnp.exp(_log_told(one, reading, cells, cells, params))

    return jax.vmap(of)(jnp.arange(one.readings.relation.shape[0]))


def _log_figures(
    one: WordsEvidence, reading: Array, between_cells: Array, params: MapParams
) -> Array:
    """Sum one reading's groundings by the place of their figure, f32[O + C]."""
    readings, slots = one.readings, one.object_type.shape[0]
    relation = readings.relation[reading, 0]
    kind = readings.mention_type[reading, readings.figure[reading, 0]]
    other = readings.mention_type[reading, jnp.maximum(readings.landmark[reading, 0], 0)]
    figure_x, figure_y, log_figure = _candidates(one, kind, params)
    landmark_x, landmark_y, log_landmark = _candidates(one, other, params)
    seen = landmark_x[:slots], landmark_y[:slots]

    # Of what has been seen, or relates to it, every pair is computed; of all the other cells, a
    # product with what is known between them.
    of_seen = (figure_x[:slots], figure_y[:slots]), (landmark_x, landmark_y)
    same = jnp.eye(slots, slots + one.miss.shape[0], dtype=bool) & (kind == other)
    table = _log_told(one, reading, *of_seen, params) + log_landmark[None, :]
    figures_seen = jax.nn.logsumexp(jnp.where(same, _NEVER, table), axis=1)

    unseen = figure_x[slots:], figure_y[slots:]
    at_seen = jax.nn.logsumexp(
        _log_told(one, reading, unseen, seen, params) + log_landmark[None, :slots], axis=1
    )
    among_unseen = jnp.matmul(
        between_cells[reading], jnp.exp(log_landmark[slots:]), precision=jax.lax.Precision.HIGHEST
    )
    figures_unseen = jnp.logaddexp(at_seen, jnp.log(jnp.maximum(among_unseen, _TINY)))

    log_area = jnp.log(one.area)
    related = log_figure + jnp.concatenate([figures_seen, figures_unseen])
    related = related - jnp.where(other == ROBOT, 0.0, log_area)
    return jnp.where(relation == NONE, log_figure - log_area, related)


def _log_superlative(
    one: WordsEvidence,
    reading: Array,
    distance: Array,
    landmarks: tuple[Array, Array],
    params: MapParams,
) -> Array:
    """Penalise figures that an observed one of their type beats, f32[F, L]."""
    readings = one.readings
    sign = -degree(readings.relation[reading, 0], jnp.float32(1.0), jnp.float32(0.0))
    kind = readings.mention_type[reading, readings.figure[reading, 0]]
    is_rival = (one.object_type == kind) & (kind >= 0)
    rivals = _distance((one.object_x, one.object_y), landmarks)
    rivals = jnp.min(jnp.where(is_rival[:, None], sign * rivals, jnp.inf), axis=0)
    gap = sign * distance
    excess = gap - jnp.minimum(rivals[None, :], gap)
    return jnp.where(readings.rank[reading, 0] == 1, -excess / params.superlative_softness, 0.0)


def _distance(figures: tuple[Array, Array], landmarks: tuple[Array, Array]) -> Array:
    """Compute distances f32[F, L], metres; the small number keeps the slope at zero finite."""
    x, y = (f[:, None] - k[None, :] for f, k in zip(figures, landmarks, strict=True))
    return jnp.sqrt(x * x + y * y + 1e-9)


def log_words(one: WordsEvidence, *, params: MapParams) -> Array:
    """Compute log p(words | observed map, where the robot has looked).

    Args:
        one: of one episode.
        params: relations and concentration; differentiable in the relations.

    Returns:
        f32[]. Relative to all observed objects unreferenced: as ``semantic_map.proposal.sample``.
    """
    return _log_words(one, _between_cells(one, params), params)


def _nothing_seen(one: WordsEvidence) -> WordsEvidence:
    """Build what an episode has left before its first look."""
    return replace(
        one,
        object_type=jnp.full_like(one.object_type, NONE),
        miss=jnp.ones_like(one.miss),
    )


def log_fit(one: WordsEvidence, *, params: MapParams) -> Array:
    """Compute log p(map | words) but for a constant: how well relations fit an episode.

    The words' evidence, less log Z: that of an area where nothing has been seen. Limits: 0 where
    nothing has been seen whatever the relations, so that nothing is learned from nothing.

    Args:
        one: of one episode. A superlative is weighed against the rivals that have been seen, of
            which Z knows none: for relations without one.
        params: relations and concentration; differentiable in the relations.

    Returns:
        f32[], nats.
    """
    between_cells = _between_cells(one, params)
    log_z = _log_words(_nothing_seen(one), between_cells, params)
    return _log_words(one, between_cells, params) - log_z


def _log_words(one: WordsEvidence, between_cells: Array, params: MapParams) -> Array:
    """Compute ``log_words`` where ``_between_cells`` is known, f32[]."""
    return jax.nn.logsumexp(_log_all_figures(one, between_cells, params))


def _log_all_figures(one: WordsEvidence, between_cells: Array, params: MapParams) -> Array:
    """Sum all readings' groundings by the place of their figure, f32[O + C]."""
    number = one.readings.log_probability.shape[0]
    each = jax.vmap(lambda reading: _log_figures(one, reading, between_cells, params))(
        jnp.arange(number)
    )
    log_share = one.readings.log_probability
    is_used = (one.readings.figure[:, 0] != NONE) & (log_share > -20.0)
    each = jnp.where(is_used[:, None], each + log_share[:, None], _NEVER)
    return jax.nn.logsumexp(each, axis=0)


def figure_posterior(one: WordsEvidence, *, params: MapParams) -> tuple[Array, Array]:
    """Compute exactly what the words' figure is: enumeration, to hold the filter against.

    Args:
        one: of one episode.
        params: relations and concentration.

    Returns:
        f32[O], the probability of each observed object, and f32[C], of each cell of the area.
    """
    share = jax.nn.softmax(_log_all_figures(one, _between_cells(one, params), params))
    num_objects = one.object_type.shape[0]
    return share[:num_objects], share[num_objects:]


@pytree
class EpisodeGroup:
    """Episodes of one setting: the same area, viewer and sentence."""

    episodes: WordsEvidence  # leaves [M, …]
    is_used: Array  # bool[M]; the rest repeats episodes of the group


def by_setting(episodes: WordsEvidence) -> list[EpisodeGroup]:
    """Gather episodes that share all but what was seen and where was looked.

    What a sentence says of two unseen places, nearly all of the work, is then computed once for
    a group and not for every episode.

    Args:
        episodes: leaves [E, …].

    Returns:
        Groups, all of the same M, at most ``GROUP_SIZE``.
    """
    setting = replace(episodes, object_type=None, object_x=None, object_y=None, miss=None)
    leaves = [np.asarray(leaf) for leaf in jax.tree.leaves(setting)]
    rows = np.concatenate([leaf.reshape(len(leaf), -1) for leaf in leaves], axis=1)
    _, setting_of = np.unique(rows, axis=0, return_inverse=True)
    members = []
    for one in range(setting_of.max() + 1):
        shared = np.flatnonzero(setting_of == one)
        members += np.array_split(shared, -(-len(shared) // GROUP_SIZE))
    size = max(map(len, members))

    def gather(index: np.ndarray) -> EpisodeGroup:
        padded = np.resize(index, size)
        return EpisodeGroup(
            episodes=jax.tree.map(lambda leaf: jnp.asarray(leaf)[padded], episodes),
            is_used=jnp.arange(size) < len(index),
        )

    return [gather(index) for index in members]


def log_fit_of(group: EpisodeGroup, relations: RelationParams, *, params: MapParams) -> Array:
    """Sum ``log_fit`` of the episodes of a group under relations, f32[].

    Args:
        group: of ``by_setting``; no superlatives, which make every pair of places depend on
            what an episode has seen.
        relations: what is differentiated.
        params: the rest.

    Returns:
        f32[], nats.
    """
    numbers = replace(params, relations=prepare(relations))
    first = jax.tree.map(lambda leaf: leaf[0], group.episodes)
    between_cells = _between_cells(first, numbers)
    log_z = _log_words(_nothing_seen(first), between_cells, numbers)
    each = jax.vmap(lambda one: _log_words(one, between_cells, numbers))(group.episodes)
    return jnp.sum(jnp.where(group.is_used, each - log_z, 0.0))
