"""Sensing by hand and by statistics; false detections and wrong labels, by their frequencies."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from placed import placed, standing

from jaxlangnav.messages import NONE, Observation, SensorParams, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.world.sensor import sense as sense_eagerly, visible
from jaxlangnav.world.state import Errors, Scenario, WorldState

PI = np.pi
sense = jax.jit(sense_eagerly, static_argnames="num_detections")
MANY = jax.jit(jax.vmap(sense_eagerly, in_axes=(0, None, None, None)))


def sensor(range_max: float = 10.0, *, probability: float = 1.0, noise: float = 0.0, **view: float):
    return by_hand.sensor(range_max, probability=probability, noise=noise, **view)


def world(places: list[tuple[float, float]], num_slots: int = 8) -> Scenario:
    """Place objects of types 0, 1, 2, ...; empty slots hold garbage."""
    scenario = placed([(0, *place) for place in places], slots=num_slots)
    x, y = (
        np.where(scenario.is_object, at, np.float32(0.5))
        for at in (scenario.object_x, scenario.object_y)
    )
    types = np.arange(num_slots, dtype=np.int32)
    return replace(scenario, object_type=types, object_x=x, object_y=y)


def robot(x: float = 0.0, y: float = 0.0, heading: float = 0.0) -> WorldState:
    return standing(x, y, heading, off=9.0)


def seen(observation: Observation) -> list[tuple[int, float, float]]:
    """List type, range and bearing of what was detected."""
    named = ("detection_type", "detection_range", "detection_bearing")
    found = (np.asarray(getattr(observation, one))[observation.is_detection] for one in named)
    return [
        (int(kind), round(float(far), 4), round(float(turn), 4))
        for kind, far, turn in zip(*found, strict=True)
    ]


KEY = jax.random.key(0)


def test_geometry_by_hand() -> None:
    # At (1, 2) facing +y: (1, 5) is 3 m ahead, (-3, 2) 4 m to the left, (1, 1) 1 m behind.
    places = [(1.0, 5.0), (-3.0, 2.0), (1.0, 1.0), (4.0, -2.0)]
    observation = sense(KEY, robot(1, 2, PI / 2), world(places), sensor())
    ahead, left, back = (0, 3.0, 0.0), (1, 4.0, round(PI / 2, 4)), (2, 1.0, round(PI, 4))
    # (4, -2) is 3 m to the right and 4 m back: 5 m at -(90° + atan 4/3).
    right = (3, 5.0, round(-(PI / 2 + np.arctan2(4, 3)), 4))
    found = seen(observation)
    assert [abs(bearing) for *_, bearing in found[:1]] == [back[2]]
    assert found[0][:2] == back[:2]
    assert found[1:] == [ahead, left, right]


def test_the_pose_is_dead_reckoning_not_truth() -> None:
    observation = sense(KEY, robot(1, 2, 0.3), world([(1.0, 5.0)]), sensor())
    np.testing.assert_allclose(observation.pose, [10.0, 11.0, 0.3], rtol=1e-6)


def test_range_is_inclusive() -> None:
    places = [(3.0, 0.0), (3.01, 0.0), (0.0, -2.99)]
    assert [kind for kind, *_ in seen(sense(KEY, robot(), world(places), sensor(3.0)))] == [2, 0]


@pytest.mark.parametrize(
    ("view", "expected"), [(2 * PI, {0, 1, 2, 3}), (PI, {0, 1, 2}), (PI / 2, {0, 1}), (PI / 3, {0})]
)
def test_field_of_view_is_the_full_opening_angle(view: float, expected: set[int]) -> None:
    # Bearings 0°, 45°, -90° and 180°, the second at the very edge of a view of 90°.
    places = [(2.0, 0.0), (2.0, 2.0), (0.0, -2.0), (-2.0, 0.0)]
    found = seen(sense(KEY, robot(), world(places), sensor(view=view)))
    assert {kind for kind, *_ in found} == expected


def test_the_view_turns_with_the_robot() -> None:
    scene, narrow = world([(2.0, 0.0), (-2.0, 0.0)]), sensor(view=PI / 2)
    for heading, kind in ((0.0, 0), (PI, 1), (-PI, 1), (4 * PI, 0)):
        found = seen(sense(KEY, robot(heading=heading), scene, narrow))
        assert [first for first, *_ in found] == [kind]


def test_empty_slots_are_not_seen_and_padding_is_clean() -> None:
    observation = sense(KEY, robot(), world([(2.0, 0.0)]), sensor(probability=1.0))
    assert int(observation.is_detection.sum()) == 1
    assert (np.asarray(observation.detection_type)[1:] == NONE).all()
    assert (np.asarray(observation.detection_range)[1:] == 0).all()
    assert (np.asarray(observation.detection_bearing)[1:] == 0).all()


def test_more_or_fewer_detections_than_objects() -> None:
    places = [(5.0, 0.0), (1.0, 0.0), (3.0, 0.0)]
    few = sense(KEY, robot(), world(places), sensor(), num_detections=2)
    assert [kind for kind, *_ in seen(few)] == [1, 2]  # the nearest two
    # What is left out must not count as looked for: the look ends where the third would be.
    assert float(few.sensor.range_max) == pytest.approx(5.0, abs=1e-5)
    all_three = sense(KEY, robot(), world(places), sensor(), num_detections=3)
    assert float(all_three.sensor.range_max) == float(sensor().range_max)
    many = sense(KEY, robot(), world(places, num_slots=3), sensor(), num_detections=6)
    assert many.is_detection.shape == (6,)
    assert [kind for kind, *_ in seen(many)] == [1, 2, 0]


def test_misses_have_the_given_rate() -> None:
    scene = world([(2.0, 0.0), (0.0, 3.0)])
    for probability in (0.0, 0.3, 0.95, 1.0):
        seen = looks(scene, sensor(probability=probability), robot())
        assert close(seen.is_detection.sum(), probability, 2 * NUMBER)


def test_noise_is_isotropic_in_relative_position() -> None:
    sigma = 0.2
    seen = looks(world([(3.0, 4.0)]), sensor(noise=sigma), robot(0, 0, 0.5))
    distance, turn = seen.detection_range[:, 0], seen.detection_bearing[:, 0] + 0.5
    place, error = distance * np.stack([np.cos(turn), np.sin(turn)]), sigma / np.sqrt(NUMBER)
    assert (np.abs(place.mean(axis=1) - [3.0, 4.0]) < 5 * error).all()
    assert (np.abs(place.std(axis=1) - sigma) < 5 * error / np.sqrt(2)).all()
    assert abs(np.corrcoef(place)[0, 1]) < 5 / np.sqrt(NUMBER)


def test_whether_something_is_in_view_is_decided_by_truth() -> None:
    x, y, is_visible = visible(robot(0, 0, PI / 2), world([(0.0, 2.0)]), sensor(2.0))
    np.testing.assert_allclose([x[0], y[0]], [2.0, 0.0], atol=1e-6)
    np.testing.assert_array_equal(is_visible, [True] + [False] * 7)


NUMBER = 8000
THINGS = ((2, 1.5, 0.5), (3, -1.0, 2.0), (5, 6.0, 0.0))
"""Type, x, y; the robot stands at (1, 1): the last is out of range."""
ROBOT = standing(1.0, 1.0, 0.4)


def place(errors: Errors | None) -> Scenario:
    return placed(THINGS, area=(-9.0, 9.0, -9.0, 9.0), goal=0, errors=errors)


def errors(haunted: float = 0.0) -> Errors:
    """One place, 1 m from the robot, is taken for a cone."""
    kinds, share = jnp.array([1, NONE], jnp.int32), jnp.float32(haunted)
    x, y = jnp.array([[2.0, 1.0], [1.0, 1.0]])
    return Errors(clutter_type=kinds, clutter_x=x, clutter_y=y, clutter_probability=share)


def looks(scenario: Scenario, sensor: SensorParams, robot: WorldState = ROBOT) -> Observation:
    """Take NUMBER looks from one place, leaves [NUMBER, D] on the host."""
    keys = jax.random.split(jax.random.key(3), NUMBER)
    return jax.device_get(MANY(keys, robot, scenario, sensor))


def close(count: float, share: float, trials: int) -> bool:
    """Compare a count with its law, within five standard errors."""
    return abs(count - share * trials) <= 5.0 * math.sqrt(trials * share * (1.0 - share)) + 1e-9


def blind(sensor: SensorParams) -> SensorParams:
    """See nothing that is there, which no detector is specified to."""
    return replace(sensor, detection_probability=jnp.float32(0.0))


def test_a_detector_without_errors_is_the_papers() -> None:
    sensor = default_sensor(3.0)
    plain, none = looks(place(None), sensor), looks(place(errors()), sensor)
    for one, other in zip(jax.tree.leaves(plain), jax.tree.leaves(none), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)


def test_fresh_ghosts_are_poisson_of_each_type_and_even_over_the_view() -> None:
    sensor = blind(default_sensor(3.0, field_of_view=2.0, false_detections=0.3))
    seen = looks(place(errors()), sensor)
    number = seen.is_detection.sum(axis=1)
    for count in range(4):
        share = math.exp(-0.6) * 0.6**count / math.factorial(count)
        assert close((number == count).sum(), share, NUMBER)
    kind = seen.detection_type[seen.is_detection]
    assert set(kind) == {0, 1}
    assert close((kind == 0).sum(), 0.5, kind.size)
    metres, bearing = seen.detection_range[seen.is_detection], seen.detection_bearing
    assert metres.max() <= 3.0
    assert close((metres < 1.5).sum(), 0.25, metres.size)
    assert np.abs(bearing).max() <= 1.0
    assert close((bearing[seen.is_detection] > 0.5).sum(), 0.25, metres.size)


def test_a_haunted_place_is_seen_again_and_again() -> None:
    sensor = blind(default_sensor(3.0))
    seen = looks(place(errors(haunted=0.2)), sensor)
    assert close(seen.is_detection.sum(), 0.2, NUMBER)
    assert set(seen.detection_type[seen.is_detection]) == {1}
    x = 1.0 + seen.detection_range * np.cos(seen.detection_bearing + 0.4)
    y = 1.0 + seen.detection_range * np.sin(seen.detection_bearing + 0.4)
    off = np.stack([x - 2.0, y - 1.0])[:, seen.is_detection]
    assert np.abs(off.mean(axis=1)).max() < 5 * 0.1 / math.sqrt(off.shape[1])
    assert abs(off.std() - 0.1) < 5 * 0.1 / math.sqrt(2 * off.size)


def test_wrong_labels_are_any_other_type_equally_often() -> None:
    sensor = default_sensor(3.0, detection_probability=1.0, noise=0.0, mislabelled=0.3)
    seen = looks(place(errors()), sensor)
    assert seen.is_detection.sum() == 2 * NUMBER
    # The nearer thing is of type 2: things are told apart by their range.
    kind = seen.detection_type[:, 0]
    assert close((kind == 2).sum(), 0.7, NUMBER)
    for other in (0, 1, 3, 4, 5, 6, 7):
        assert close((kind == other).sum(), 0.3 / 7, NUMBER)


def test_errors_leave_the_rest_of_a_look_as_it_is() -> None:
    told = default_sensor(3.0, false_detections=0.3, mislabelled=0.3)
    plain, erring = looks(place(None), told), looks(place(errors(0.5)), told)
    for look in range(200):
        here, there = (it.detection_range[look][it.is_detection[look]] for it in (plain, erring))
        assert np.isclose(here[:, None], there, rtol=1e-6).any(axis=1).all()


def test_what_the_robot_is_told_of_its_detector_changes_no_look() -> None:
    told = default_sensor(3.0, false_detections=0.2)
    one = sense(jax.random.key(0), ROBOT, place(None), default_sensor(3.0), told)
    other = sense(jax.random.key(0), ROBOT, place(None), default_sensor(3.0))
    assert float(one.sensor.false_detections) == np.float32(0.2)
    np.testing.assert_array_equal(one.detection_range, other.detection_range)


def test_a_ghost_looks_like_nothing() -> None:
    scenario = replace(place(errors(haunted=1.0)), object_attribute=jnp.full(8, 7, jnp.int32))
    seen = looks(scenario, default_sensor(3.0, detection_probability=1.0))
    is_ghost = seen.is_detection & (seen.detection_type == 1)
    assert set(seen.detection_attribute[is_ghost]) == {0}
    assert set(seen.detection_attribute[seen.is_detection & ~is_ghost]) == {7}
