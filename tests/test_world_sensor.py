"""Sensing by hand and by statistics."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from placed import placed

from jaxlangnav.messages import NONE, Observation
from jaxlangnav.pytree import replace
from jaxlangnav.world.sensor import sense as sense_eagerly, visible
from jaxlangnav.world.state import Scenario, WorldState

PI = np.pi
sense = jax.jit(sense_eagerly, static_argnames="num_detections")


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
    return WorldState(
        position=jnp.array([x, y]),
        heading=jnp.float32(heading),
        odometry=jnp.array([x + 9.0, y - 9.0, heading]),
        distance=jnp.float32(0.0),
    )


def seen(observation: Observation) -> list[tuple[int, float, float]]:
    """List type, range and bearing of what was detected."""
    slots = np.flatnonzero(observation.is_detection)
    return [
        (
            int(observation.detection_type[slot]),
            round(float(observation.detection_range[slot]), 4),
            round(float(observation.detection_bearing[slot]), 4),
        )
        for slot in slots
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
    np.testing.assert_allclose(observation.pose, [10.0, -7.0, 0.3], rtol=1e-6)


def test_range_is_inclusive() -> None:
    places = [(3.0, 0.0), (3.01, 0.0), (0.0, -2.99)]
    assert [kind for kind, *_ in seen(sense(KEY, robot(), world(places), sensor(3.0)))] == [2, 0]


@pytest.mark.parametrize(
    ("view", "expected"),
    [(2 * PI, {0, 1, 2, 3}), (PI, {0, 1, 2}), (PI / 2, {0, 1}), (PI / 3, {0})],
)
def test_field_of_view_is_the_full_opening_angle(view: float, expected: set[int]) -> None:
    # Bearings 0°, 45°, -90° and 180°, the second at the very edge of a view of 90°.
    places = [(2.0, 0.0), (2.0, 2.0), (0.0, -2.0), (-2.0, 0.0)]
    found = seen(sense(KEY, robot(), world(places), sensor(view=view)))
    assert {kind for kind, *_ in found} == expected


def test_the_view_turns_with_the_robot() -> None:
    scene, narrow = world([(2.0, 0.0), (-2.0, 0.0)]), sensor(view=PI / 2)
    for heading, kind in ((0.0, 0), (PI, 1), (-PI, 1), (4 * PI, 0)):
        assert [found[0] for found in seen(sense(KEY, robot(heading=heading), scene, narrow))] == [
            kind
        ]


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
    count = 4000
    keys = jax.random.split(jax.random.key(3), count)
    scene = world([(2.0, 0.0), (0.0, 3.0)])
    for probability in (0.0, 0.3, 0.95, 1.0):
        spec = sensor(probability=probability)
        observation = jax.vmap(lambda key, spec=spec: sense(key, robot(), scene, spec))(keys)
        rate = np.asarray(observation.is_detection).sum() / (2 * count)
        tolerance = 5 * np.sqrt(probability * (1 - probability) / (2 * count))
        assert abs(rate - probability) <= tolerance


def test_noise_is_isotropic_in_relative_position() -> None:
    count, sigma = 8000, 0.2
    keys = jax.random.split(jax.random.key(4), count)
    scene, spec = world([(3.0, 4.0)]), sensor(noise=sigma)
    observation = jax.vmap(lambda key: sense(key, robot(0, 0, 0.5), scene, spec))(keys)
    distance, bearing = observation.detection_range[:, 0], observation.detection_bearing[:, 0]
    x, y = (
        np.asarray(distance * jnp.cos(bearing + 0.5)),
        np.asarray(distance * jnp.sin(bearing + 0.5)),
    )
    standard_error = sigma / np.sqrt(count)
    assert abs(x.mean() - 3.0) < 5 * standard_error
    assert abs(y.mean() - 4.0) < 5 * standard_error
    assert abs(x.std() - sigma) < 5 * standard_error / np.sqrt(2)
    assert abs(y.std() - sigma) < 5 * standard_error / np.sqrt(2)
    assert abs(np.corrcoef(x, y)[0, 1]) < 5 / np.sqrt(count)


def test_whether_something_is_in_view_is_decided_by_truth() -> None:
    x, y, is_visible = visible(robot(0, 0, PI / 2), world([(0.0, 2.0)]), sensor(2.0))
    np.testing.assert_allclose([x[0], y[0]], [2.0, 0.0], atol=1e-6)
    np.testing.assert_array_equal(is_visible, [True] + [False] * 7)


def test_vmap_equals_a_loop() -> None:
    keys = jax.random.split(jax.random.key(5), 4)
    scene, spec = world([(2.0, 0.0), (1.0, 1.0)]), sensor(noise=0.1, probability=0.7)
    batch = jax.vmap(lambda key: sense(key, robot(), scene, spec))(keys)
    loop = [sense(key, robot(), scene, spec) for key in keys]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *loop)
    chex.assert_trees_all_close(batch, stacked, atol=1e-6)


def test_a_sweep_of_specifications_traces_once() -> None:
    chex.clear_trace_counter()
    traced = jax.jit(chex.assert_max_traces(sense_eagerly, n=1))
    for distance in (2.0, 3.0, 5.0):
        for noise in (0.0, 0.1):
            traced(KEY, robot(distance), world([(2.0, 0.0)]), sensor(distance, noise=noise))
