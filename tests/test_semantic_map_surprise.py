"""How surprising an observation is, by hand: what fits, what was missed, what cannot be."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

from jaxlangnav.semantic_map import association, update
from jaxlangnav.semantic_map.observe import LOG_CONTRADICTION, surprise
from jaxlangnav.terrain import OPEN

CONE, CAR, HYDRANT = by_hand.CONE, by_hand.CAR, by_hand.HYDRANT
P, D = by_hand.CONFIG.num_particles, by_hand.D
VARIANCE = 0.1**2
LOG_NEW = float(np.log(0.3 / 100.0))
MISS = float(-np.log(0.05))
"""Nats of a miss by the default detector."""


BELIEF = by_hand.with_objects(by_hand.begin(), [(HYDRANT, 2.0, 0.0)])


@jax.jit
def look(types, x, y, log_missed, is_detection):
    """Look from the origin at a hydrant two metres ahead and at whatever else there is."""
    grounded = association.associate(
        BELIEF.particles,
        association.Detections(types, x, y, LOG_NEW + log_missed, is_detection),
        jnp.full((D, P), 0.5),
        jnp.float32(VARIANCE),
    )
    particles = update.condition(BELIEF.particles, grounded, jnp.float32(VARIANCE))
    log_objects, _, _ = update.log_absence(
        particles, grounded.is_hit, jnp.float32(0.0), jnp.float32(0.25), by_hand.sensor(), OPEN.view
    )
    log_map = grounded.log_weight + log_objects
    return surprise(
        BELIEF.log_weight, grounded, log_map, jnp.float32(LOG_NEW), jnp.float32(VARIANCE)
    )


def surprise_of(*detections: tuple[int, float, float, float]) -> float:
    """Measure the surprise of detections (type, x, y, nats by which they were missed before)."""
    padded = [*detections, *[(CONE, 0.0, 0.0, 0.0)] * (D - len(detections))]
    types, x, y, missed = (np.array(column) for column in zip(*padded, strict=True))
    return float(
        look(
            jnp.asarray(types, jnp.int32),
            jnp.asarray(x, jnp.float32),
            jnp.asarray(y, jnp.float32),
            -jnp.asarray(missed, jnp.float32),
            jnp.arange(D) < len(detections),
        )
    )


SEEN = (HYDRANT, 2.0, 0.0, 0.0)
EXPECTED = -1.0
"""Nats of a thing seen exactly where it is: the noise takes it one nat away on average."""


@pytest.mark.parametrize("number", [0, 1, 5])
def test_new_things_where_nobody_has_looked_surprise_nobody(number: int) -> None:
    new = [(CONE, 2.0 * np.cos(turn), 2.0 * np.sin(turn), 0.0) for turn in range(number)]
    assert surprise_of(SEEN, *new) == pytest.approx(EXPECTED, abs=0.05)


def test_what_is_missed_now_or_was_before_surprises_by_its_misses() -> None:
    assert surprise_of() == pytest.approx(MISS, abs=0.05)
    assert surprise_of(SEEN, (CONE, 1.0, 1.0, 3 * MISS)) == pytest.approx(
        EXPECTED + 3 * MISS, abs=0.05
    )


def test_a_thing_off_its_place_surprises_by_the_square() -> None:
    """Half a metre at 0.1 m of noise: 25 / 2 nats, and less than a new hydrant beside it."""
    assert surprise_of((HYDRANT, 2.5, 0.0, 0.0)) < MISS + 0.1  # it may be another one
    off = surprise_of((HYDRANT, 2.5, 0.0, 30.0))
    assert off == pytest.approx(EXPECTED + 12.5, rel=0.03)


def test_false_things_contradict_and_many_true_ones_do_not_hide_it() -> None:
    false = (CAR, 1.0, -1.0, 7 * MISS)
    assert surprise_of(SEEN, false) > surprise_of(false) - MISS - 1.1
    assert surprise_of(false) > LOG_CONTRADICTION
    new = [(CONE, 2.0 * np.cos(turn), 2.0 * np.sin(turn), 0.0) for turn in range(3)]
    assert surprise_of(SEEN, false, *new) == pytest.approx(surprise_of(SEEN, false), abs=0.05)


def by_particle(log_map: np.ndarray, overflow: int = 0) -> float:
    """Measure the surprise of nothing seen, with what each particle makes of it."""
    none = jnp.zeros((1, P), bool)
    grounded = association.Association(
        object_type=jnp.zeros((1, P), jnp.int32),
        is_hit=none,
        is_new=none,
        offset_x=jnp.zeros((1, P)),
        offset_y=jnp.zeros((1, P)),
        log_weight=jnp.zeros(P),
        overflow=jnp.full(P, overflow, jnp.int32),
        existence=jnp.zeros((0, P)),
    )
    uniform = jnp.full(P, -np.log(P), jnp.float32)
    found = surprise(
        uniform, grounded, jnp.asarray(log_map, jnp.float32), jnp.float32(LOG_NEW), jnp.float32(1)
    )
    return float(found)


def test_one_particle_that_expected_it_is_enough() -> None:
    log_map = np.full(P, -50.0)
    assert by_particle(log_map) == pytest.approx(50.0)
    log_map[3] = 0.0
    assert by_particle(log_map) == pytest.approx(np.log(P), rel=1e-4)


def test_full_maps_and_dead_weights_are_counted_elsewhere() -> None:
    assert by_particle(np.full(P, -50.0), overflow=1) == 0.0
    assert by_particle(np.full(P, -np.inf)) == 0.0
    assert by_particle(np.full(P, np.nan)) == 0.0
