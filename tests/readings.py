"""Readings, observations and beliefs by hand, and compiled programs of one set of sizes."""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from jaxlangnav.messages import NONE, MotionParams, Observation, Readings, SensorParams
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.coverage import Coverage
from jaxlangnav.semantic_map.filter import FilterInfo
from jaxlangnav.semantic_map.params import MapConfig, MapParams, default_map_params
from jaxlangnav.semantic_map.proposal.utterance import ground_words

K, M, J, D = 2, 3, 2, 6
"""Readings, mentions, relations, detections."""
CONFIG = MapConfig(num_particles=64, num_objects=6, num_cells=32)
SEEDS = 128  # lanes of the shared programs
STEPS = 8  # steps of one call of the shared programs
HYDRANT, CONE, CAR = 0, 1, 2
AREA = (0.0, 10.0, -5.0, 5.0)
OFTEN = {"xla_backend_optimization_level": 1, "xla_llvm_disable_expensive_passes": False}
"""For programs that run long, where others are compiled briefly (conftest). They run as fast as
those of users, at the third level, and take a sixth less to compile."""

Relation = tuple[int, int, int, bool]
"""Figure mention, relation, landmark mention, superlative."""


def readings(
    mention_types: list[list[int]],
    relations: list[list[Relation]],
    probabilities: list[float] | None = None,
    *,
    sizes: tuple[int, int, int] = (K, M, J),
) -> Readings:
    """Build readings, one list entry for each; empty slots are padded."""
    k, m, j = sizes
    types, figure = np.full((k, m), NONE, np.int32), np.full((k, j), NONE, np.int32)
    relation, landmark = figure.copy(), figure.copy()
    rank, probability = np.zeros((k, j), np.int32), np.zeros(k)
    probability[: len(mention_types)] = probabilities or [1.0 / len(mention_types)] * len(
        mention_types
    )
    for index, (names, edges) in enumerate(zip(mention_types, relations, strict=True)):
        types[index, : len(names)] = names
        for edge, (fig, rel, land, extreme) in enumerate(edges):
            figure[index, edge], relation[index, edge] = fig, rel
            landmark[index, edge], rank[index, edge] = land, extreme
    with np.errstate(divide="ignore"):
        log_probability = np.log(probability)
    return Readings(
        mention_type=jnp.asarray(types),
        figure=jnp.asarray(figure),
        relation=jnp.asarray(relation),
        landmark=jnp.asarray(landmark),
        rank=jnp.asarray(rank),
        log_probability=jnp.asarray(log_probability, jnp.float32),
    )


def sensor(
    range_max: float = 3.0, view: float = 2 * np.pi, probability: float = 0.95, noise: float = 0.1
) -> SensorParams:
    return SensorParams(
        range_max=jnp.float32(range_max),
        field_of_view=jnp.float32(view),
        detection_probability=jnp.float32(probability),
        noise=jnp.float32(noise),
    )


def params(
    *,
    concentration: float = 0.3,
    odometry_noise: float = 0.02,
    threshold: float = 0.5,
    clumping: float = 0.0,
    softness: float = 0.3,
) -> MapParams:
    motion = MotionParams(step_length=jnp.float32(1.0), odometry_noise=jnp.float32(odometry_noise))
    return replace(
        default_map_params(),
        concentration=jnp.float32(concentration),
        clumping=jnp.float32(clumping),
        superlative_softness=jnp.float32(softness),
        resample_threshold=jnp.float32(threshold),
        motion=motion,
    )


def observation(
    pose: np.ndarray,
    detections: list[tuple[int, float, float]],
    specification: SensorParams | None = None,
    *,
    size: int = D,
) -> Observation:
    """Build an observation from (type, x, y) offsets from the robot in map axes; NumPy leaves."""
    types, is_detection = np.full(size, NONE, np.int32), np.zeros(size, bool)
    ranges, bearings = np.zeros(size, np.float32), np.zeros(size, np.float32)
    for index, (name, x, y) in enumerate(detections):
        types[index], is_detection[index] = name, True
        ranges[index], bearings[index] = np.hypot(x, y), np.arctan2(y, x) - pose[2]
    chosen = specification or sensor()
    return Observation(
        pose=np.asarray(pose, np.float32),
        detection_type=types,
        detection_range=ranges,
        detection_bearing=bearings,
        is_detection=is_detection,
        sensor=jax.tree.map(np.asarray, chosen),
    )


def stack(records: list) -> object:
    """Stack records along a new leading axis (NumPy leaves)."""
    return jax.tree.map(lambda *leaves: np.stack(leaves), *records)


def repeat(record: object, number: int) -> object:
    """Repeat a record along a new leading axis; nothing is copied on the host."""
    return jax.tree.map(
        lambda leaf: np.broadcast_to(np.asarray(leaf), (number, *np.shape(leaf))), record
    )


def begin(
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    config: MapConfig = CONFIG,
    area: tuple[float, float, float, float] = AREA,
    num_mentions: int = M,
) -> ParticleBelief:
    return semantic_filter.start(
        jnp.asarray(pose, jnp.float32),
        jnp.asarray(area, jnp.float32),
        num_mentions,
        config=config,
        num_types=15,
    )


def with_objects(belief: ParticleBelief, objects: list[tuple[int, float, float]]) -> ParticleBelief:
    """Enter objects (type, x, y) into every particle as if seen and known well."""
    particles = belief.particles
    object_type, matrix = np.array(particles.object_type), np.array(particles.covariance)
    mean = np.zeros((2, *particles.mean_x.shape), np.float32)
    mean[:] = np.stack([particles.mean_x, particles.mean_y])
    for slot, (name, x, y) in enumerate(objects):
        object_type[slot], matrix[slot, slot] = name, 1e-6
        mean[0, slot], mean[1, slot] = x, y
    return replace(
        belief,
        particles=replace(
            particles,
            object_type=jnp.asarray(object_type),
            covariance=jnp.asarray(matrix),
            mean_x=jnp.asarray(mean[0]),
            mean_y=jnp.asarray(mean[1]),
        ),
    )


def with_coverage(belief: ParticleBelief, log_miss: np.ndarray) -> ParticleBelief:
    coverage = Coverage(log_miss=jnp.asarray(log_miss, jnp.float32), area=belief.coverage.area)
    return replace(belief, coverage=coverage)


@functools.partial(jax.jit, compiler_options=OFTEN)
def ground_many(
    keys: jax.Array,
    belief: ParticleBelief,
    sentence: Readings,
    numbers: MapParams,
    num_pooled: jax.Array | None = None,
) -> tuple[object, jax.Array]:
    """Ground the words of one belief under S keys: particles [S, ..., P], log-weights [S, P]."""
    return jax.vmap(
        lambda key: ground_words(key, belief, sentence, params=numbers, num_pooled=num_pooled)
    )(keys)


@functools.partial(jax.jit, compiler_options=OFTEN, static_argnames=("pools_counts",))
def run_many(
    keys: jax.Array,
    beliefs: ParticleBelief,
    sentences: Readings,
    observations: Observation,
    numbers: MapParams,
    *,
    spoken: jax.Array | None = None,
    pools_counts: bool = False,
) -> tuple[ParticleBelief, FilterInfo]:
    """Run STEPS filter steps in S lanes: leaves [S, ...], observations [S, STEPS, ...]."""

    told = {"params": numbers, "mentioned": spoken, "pools_counts": pools_counts}

    def one(key, belief, sentence, seen):
        def body(now, step):
            return semantic_filter.step(step[0], now, sentence, step[1], **told)

        return jax.lax.scan(body, belief, (jax.random.split(key, STEPS), seen))

    return jax.vmap(one)(keys, beliefs, sentences, observations)


def run_lanes(
    looks: list[Observation],
    sentence: Readings,
    numbers: MapParams,
    belief: ParticleBelief | None = None,
    *,
    seed: int = 0,
) -> tuple[ParticleBelief, FilterInfo]:
    """Give all lanes the same looks, STEPS at a time, each lane under a key of its own."""
    beliefs, sentences, infos = repeat(belief or begin(), SEEDS), repeat(sentence, SEEDS), []
    for call in range(len(looks) // STEPS):
        keys = jax.random.split(jax.random.key(seed + call), SEEDS)
        part = repeat(stack(looks[call * STEPS : (call + 1) * STEPS]), SEEDS)
        beliefs, info = run_many(keys, beliefs, sentences, part, numbers)
        infos.append(jax.tree.map(np.asarray, info))
    return beliefs, jax.tree.map(lambda *leaves: np.concatenate(leaves, 1), *infos)


step_one = jax.jit(semantic_filter.step)
"""One filter step of one belief."""
NULL = readings([[HYDRANT]], [[(0, NONE, NONE, False)]])


def central(value: Callable[[float], jax.Array | float], step: float) -> tuple[float, float]:
    """Difference quotient at 0, and its error.

    A central difference of step h is off by c h² + O(h⁴). Those of h and 2 h differ by 3 c h²,
    three times what the finer one is off, which leaves room for the next order. On top come
    roundings of a value's size, of which it may have gone through 32.
    """
    ends = [float(value(offset * step)) for offset in (1.0, -1.0, 2.0, -2.0)]
    fine, coarse = (ends[0] - ends[1]) / (2 * step), (ends[2] - ends[3]) / (4 * step)
    rounding = 32 * 2.0**-24 * max(abs(end) for end in ends) / step
    return fine, abs(coarse - fine) + rounding
