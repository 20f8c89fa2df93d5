"""Whether what was detected exists, and how surprising a look is: by hand, and by enumeration."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand

from jaxlangnav.messages import LEFT, NONE, ROBOT
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import association, counts, observe, particle
from jaxlangnav.semantic_map.observe import LOG_CONTRADICTION, prune_objects, surprise
from jaxlangnav.semantic_map.proposal.sparse_regrounding import reground
from jaxlangnav.terrain import OPEN, RANGING

HYDRANT, CONE = by_hand.HYDRANT, by_hand.CONE
LOG_THING, RATE, DETECTION, TYPES = np.log(2e-3), 0.05, 0.8, 8


def sensor(**values: float):
    known = {"false_detections": 0.0, "mislabelled": 0.0} | values
    return replace(
        by_hand.sensor(3.0, 2 * np.pi, DETECTION, 0.1),
        **{name: jnp.float32(value) for name, value in known.items()},
    )


@jax.jit
def look(one, kind, x, is_detection, specification, growth, exposure):
    """One look of one particle at one place: the particle, and log p(look)."""
    doubt = association.clutter_odds(specification, jnp.int32(TYPES), RANGING)
    seen = association.Detections(
        kind[None], x[None], jnp.zeros(1), jnp.full(1, LOG_THING), is_detection[None]
    )
    grounded = association.associate(one, seen, jnp.full(1, 0.5), specification, growth, doubt)
    after = observe.condition(one, grounded, specification)
    log_missed, _, existence = observe.log_absence(
        after, grounded.is_hit, jnp.float32(0.0), jnp.float32(0.1), specification, OPEN.view
    )
    log_exposed, existence = counts.lower_existence(existence, exposure)
    return replace(after, existence=existence), grounded.log_weight + log_missed + log_exposed


def see(one, specification, kind: int | None, x: float = 1.0, *, growth=0.0, exposure: float = 0.0):
    told = jnp.int32(kind or 0), jnp.float32(x), jnp.asarray(kind is not None)
    return look(one, *told, specification, jnp.float32(growth), jnp.float32(exposure))


def nothing():
    return particle.empty(3, 1, jnp.float32(0.0), jnp.float32(0.0), has_doubts=True)


def test_all_is_as_without_doubt_where_the_detector_invents_nothing() -> None:
    one, log_weight = see(nothing(), sensor(), HYDRANT)
    np.testing.assert_allclose(log_weight, LOG_THING, rtol=1e-6)
    np.testing.assert_array_equal(one.existence, [1.0, 0.0, 0.0])
    one, log_weight = see(one, sensor(), None)
    np.testing.assert_allclose(log_weight, np.log(1 - DETECTION), rtol=1e-5)
    assert one.existence[0] == 1.0


def enumerated(looks: list[tuple[int | None, float, float]], growth: float):
    """Sum over which places hold things: the density of all looks, and P(each thing exists)."""
    false = RATE / (np.pi * 9.0) / DETECTION
    places = sorted({x for kind, x, _ in looks if kind is not None})
    weights = np.zeros((2,) * len(places))
    for there in np.ndindex(weights.shape):
        exists, weight = dict(zip(places, there, strict=True)), 1.0
        entered: list[float] = []
        for kind, x, exposure in looks:
            if kind is not None:
                number = sum(exists[one] for one in entered)
                weight *= np.exp(LOG_THING) * (1.0 + growth * number) if exists[x] else false
                entered.append(x)
            missed = sum(exists[one] for one in entered if kind is None or one != x)
            number = sum(exists[one] for one in entered)
            weight *= (1.0 - DETECTION) ** missed * np.exp(-exposure * number)
        weights[there] = weight
    total = weights.sum()
    marginal = [np.take(weights, 1, axis).sum() / total for axis in range(len(places))]
    return total, np.array(marginal)


ONCE = [(HYDRANT, 1.0, 0.0), *[(None, 0.0, 0.0)] * 3]
TWO = [(HYDRANT, 1.0, 0.2), (None, 0.0, 0.4), (HYDRANT, 2.5, 0.0)]


@pytest.mark.parametrize(("looks", "growth"), [(ONCE, 0.0), (TWO, 10.0 / 3.0)])
def test_existence_equals_a_sum_over_what_can_have_been(looks: list, growth: float) -> None:
    """A false hydrant is no sign of many hydrants: against all ways in which each may be false."""
    specification, one, total = sensor(false_detections=RATE), nothing(), 0.0
    for number, (kind, x, exposure) in enumerate(looks, start=1):
        one, log_weight = see(one, specification, kind, x, growth=growth, exposure=exposure)
        total += float(log_weight)
        exact, existence = enumerated(looks[:number], growth)
        np.testing.assert_allclose(np.exp(total), exact, rtol=1e-4)
        np.testing.assert_allclose(one.existence[0], existence[0], rtol=1e-4)
    # That the other one was missed tells a little of this one, too, which is let go: 0.54 for 0.49.
    np.testing.assert_allclose(one.existence[1 : len(existence)], existence[1:], rtol=0.12)


def test_what_is_seen_twice_in_one_place_is_there_and_a_whole_sign_of_more() -> None:
    """False detections are scattered."""
    specification, sure, growth = sensor(false_detections=RATE), nothing(), 10.0 / 3.0
    for x in (1.0, 1.0, 2.5):
        sure, _ = see(sure, specification, HYDRANT, x, growth=growth)
    assert sure.existence[0] == 1.0
    more, false = np.exp(LOG_THING) * (1.0 + growth), RATE / (np.pi * 9.0) / DETECTION
    np.testing.assert_allclose(sure.existence[1], more / (more + false), rtol=1e-4)


def test_mislabelled_thing_is_told_by_its_other_labels() -> None:
    """A box that was called a hydrant once or twice is called so rarely: odds by enumeration."""
    wrong = 0.1
    specification = sensor(mislabelled=wrong)
    as_this = wrong / (TYPES - 1) / (1 - wrong)
    one, _ = see(nothing(), specification, HYDRANT)
    # Things of seven other types, each as frequent, may have been called a hydrant.
    odds = 1.0 / ((TYPES - 1) * as_this)
    np.testing.assert_allclose(one.existence[0], odds / (1 + odds), rtol=1e-5)
    one, _ = see(one, specification, HYDRANT)
    odds /= as_this
    np.testing.assert_allclose(one.existence[0], odds / (1 + odds), rtol=1e-5)


def test_known_thing_explains_a_wrong_label() -> None:
    specification = sensor(mislabelled=0.1)
    one, _ = see(nothing(), specification, HYDRANT)
    one, _ = see(one, specification, HYDRANT)
    one, _ = see(one, specification, CONE)
    np.testing.assert_array_equal(one.object_type, [HYDRANT, CONE, NONE])
    assert one.existence[0] > 0.9
    assert one.existence[1] < 0.05


def test_what_hardly_exists_is_forgotten_and_its_words_are_lost() -> None:
    belief = by_hand.with_objects(
        by_hand.begin(), [(HYDRANT, 3.0, 1.0), (CONE, 2.0, 0.0), (CONE, 4.0, 0.0)]
    )
    number = belief.log_weight.shape[0]
    existence = np.zeros((by_hand.CONFIG.num_objects, number), np.float32)
    existence[0], existence[1], existence[2] = 1e-5, 0.9, 1e-5
    existence[2, 5] = 0.5  # one particle still takes it to be there
    referent = np.full((by_hand.M, number), NONE, np.int32)
    referent[0, :10], referent[0, 10:] = 0, 1
    particles = replace(
        belief.particles,
        existence=jnp.asarray(existence),
        referent=jnp.asarray(referent),
        is_mentioned=jnp.asarray(np.arange(by_hand.M)[:, None] < np.full(number, 1)),
    )
    after, is_lost = jax.jit(prune_objects)(particles)
    np.testing.assert_array_equal(after.object_type[:3, 0], [NONE, CONE, CONE])
    np.testing.assert_array_equal(is_lost, np.arange(number) < 10)
    assert float(jnp.abs(after.covariance[0]).max()) == 0.0


@pytest.mark.parametrize("rank", [0, 1])
def test_a_rank_is_grounded_anew_where_an_object_turns_out_to_exist(rank: int) -> None:
    belief = by_hand.with_objects(by_hand.begin(), [(CONE, 2.0, 0.0)])
    none, is_new = jnp.zeros(P), jnp.zeros((by_hand.CONFIG.num_objects, P), bool)
    is_flipped = is_new.at[0, :10].set(True)
    update = observe.MeasurementUpdate(none, none, is_new, is_new, is_flipped, None, none, none)
    words = by_hand.readings([[CONE, ROBOT]], [[(0, LEFT, 1, rank)]])
    belief = replace(belief, must_ground=jnp.asarray(False))
    regrounded = reground(
        jax.random.key(0), jnp.zeros((2, P)), belief, words, update,
        lambda key, belief, readings, is_asked: (belief.particles, none),
    )  # fmt: skip
    np.testing.assert_array_equal(regrounded.is_fresh, (np.arange(P) < 10) & (rank > 0))


CAR = by_hand.CAR
P, D = by_hand.CONFIG.num_particles, by_hand.D
SENSOR = by_hand.sensor(noise=0.1)
LOG_NEW = float(np.log(0.3 / 100.0))
MISS = float(-np.log(0.05))  # nats of a miss by the default detector


@jax.jit
def look_at_hydrant(belief, types, x, y, log_missed, is_detection):
    """Look from the origin at a hydrant two metres ahead and at whatever else there is."""
    grounded = association.associate(
        belief.particles,
        association.Detections(types, x, y, LOG_NEW + log_missed, is_detection),
        jnp.full((D, P), 0.5),
        SENSOR,
    )
    particles = observe.condition(belief.particles, grounded, SENSOR)
    log_objects, _, _ = observe.log_absence(
        particles, grounded.is_hit, jnp.float32(0.0), jnp.float32(0.25), by_hand.sensor(), OPEN.view
    )
    log_map = grounded.log_weight + log_objects
    log_fit = RANGING.log_fit(SENSOR)
    return surprise(belief.log_weight, grounded, log_map, jnp.float32(LOG_NEW), log_fit)


def surprise_of(*detections: tuple[int, float, float, float]) -> float:
    """Measure the surprise of detections (type, x, y, nats by which they were missed before)."""
    padded = [*detections, *[(CONE, 0.0, 0.0, 0.0)] * (D - len(detections))]
    types, x, y, missed = (np.array(column) for column in zip(*padded, strict=True))
    belief = by_hand.with_objects(by_hand.begin(), [(HYDRANT, 2.0, 0.0)])
    told = types.astype(np.int32), *np.float32([x, y, -missed]), np.arange(D) < len(detections)
    return float(look_at_hydrant(belief, *told))


SEEN = (HYDRANT, 2.0, 0.0, 0.0)
EXPECTED = -1.0
"""Nats of a thing seen exactly where it is: the noise takes it one nat away on average."""


@pytest.mark.parametrize("number", [0, 1, 5])
def test_new_things_where_nobody_has_looked_surprise_nobody(number: int) -> None:
    new = [(CONE, 2.0 * np.cos(turn), 2.0 * np.sin(turn), 0.0) for turn in range(number)]
    assert surprise_of(SEEN, *new) == pytest.approx(EXPECTED, abs=0.05)


def test_what_is_missed_now_or_was_before_surprises_by_its_misses() -> None:
    assert surprise_of() == pytest.approx(MISS, abs=0.05)
    expected = pytest.approx(EXPECTED + 3 * MISS, abs=0.05)
    assert surprise_of(SEEN, (CONE, 1.0, 1.0, 3 * MISS)) == expected


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
