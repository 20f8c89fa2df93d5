"""False detections and wrong labels, by their frequencies."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from placed import placed

from jaxlangnav.messages import NONE, Observation, SensorParams, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.state import Errors, Scenario, WorldState

NUMBER = 4000
THINGS = ((2, 1.5, 0.5), (3, -1.0, 2.0), (5, 6.0, 0.0))
"""Type, x, y; the robot stands at (1, 1): the last is out of range."""
ROBOT = WorldState(
    position=jnp.array([1.0, 1.0]),
    heading=jnp.float32(0.4),
    odometry=jnp.array([1.0, 1.0, 0.4]),
    distance=jnp.float32(0.0),
)


def place(errors: Errors | None) -> Scenario:
    return placed(THINGS, area=(-9.0, 9.0, -9.0, 9.0), goal=0, errors=errors)


def errors(invented: tuple[int, ...] = (), haunted: float = 0.0) -> Errors:
    """Six of eight types are told apart; one place, 1 m from the robot, is taken for a cone."""
    types = jnp.arange(8)
    return Errors(
        is_type=types < 6,
        is_invented=jnp.isin(types, jnp.array(invented, jnp.int32)),
        haunt_type=jnp.array([1, NONE], jnp.int32),
        haunt_x=jnp.array([2.0, 1.0]),
        haunt_y=jnp.array([1.0, 1.0]),
        haunt_probability=jnp.float32(haunted),
    )


@functools.cache
def _looks() -> object:
    return jax.jit(jax.vmap(sense, in_axes=(0, None, None, None)))


def looks(scenario: Scenario, sensor: SensorParams) -> Observation:
    """Take NUMBER looks from one place, leaves [NUMBER, D] on the host."""
    keys = jax.random.split(jax.random.key(3), NUMBER)
    return jax.tree.map(np.asarray, _looks()(keys, ROBOT, scenario, sensor))  # pyright: ignore


def close(count: float, share: float, trials: int) -> bool:
    """Compare a count with its law, within five standard errors."""
    return abs(count - share * trials) <= 5.0 * math.sqrt(trials * share * (1.0 - share)) + 1e-9


def blind(sensor: SensorParams) -> SensorParams:
    """See nothing that is there, which no detector is specified to."""
    return replace(sensor, detection_probability=jnp.float32(0.0))


def test_a_detector_without_errors_is_the_papers_to_the_bit() -> None:
    sensor = default_sensor(3.0)
    plain, none = looks(place(None), sensor), looks(place(errors((0, 1))), sensor)
    for one, other in zip(jax.tree.leaves(plain), jax.tree.leaves(none), strict=True):
        np.testing.assert_array_equal(one, other)


def test_fresh_ghosts_are_poisson_of_each_type_and_even_over_the_view() -> None:
    sensor = blind(default_sensor(3.0, field_of_view=2.0, false_detections=0.3))
    seen = looks(place(errors((0, 4))), sensor)
    number = seen.is_detection.sum(axis=1)
    for count in range(4):
        share = math.exp(-0.6) * 0.6**count / math.factorial(count)
        assert close((number == count).sum(), share, NUMBER)
    kind = seen.detection_type[seen.is_detection]
    assert set(kind) == {0, 4}
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
    for other in (0, 1, 3, 4, 5):
        assert close((kind == other).sum(), 0.06, NUMBER)


def test_errors_leave_the_rest_of_a_look_as_it_is() -> None:
    told = default_sensor(3.0, false_detections=0.3, mislabelled=0.3)
    plain, erring = looks(place(None), told), looks(place(errors((0, 1), 0.5)), told)
    for look in range(200):
        here = set(plain.detection_range[look][plain.is_detection[look]])
        assert here <= set(erring.detection_range[look][erring.is_detection[look]])


def test_what_the_robot_is_told_of_its_detector_changes_no_look() -> None:
    told = default_sensor(3.0, false_detections=0.2)
    one = sense(jax.random.key(0), ROBOT, place(None), default_sensor(3.0), told)
    other = sense(jax.random.key(0), ROBOT, place(None), default_sensor(3.0))
    assert float(one.sensor.false_detections) == np.float32(0.2)
    np.testing.assert_array_equal(one.detection_range, other.detection_range)


def test_a_ghost_looks_like_nothing() -> None:
    scenario = replace(place(errors(haunted=1.0)), object_attribute=jnp.full(8, 7, jnp.int32))
    seen = looks(scenario, default_sensor(3.0, detection_probability=1.0))
    assert seen.detection_attribute is not None
    is_ghost = seen.is_detection & (seen.detection_type == 1)
    assert set(seen.detection_attribute[is_ghost]) == {0}
    assert set(seen.detection_attribute[seen.is_detection & ~is_ghost]) == {7}
