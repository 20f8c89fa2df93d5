"""What a robot reports: padded, cast, and refused in one line (the front door)."""

import math

import numpy as np
import pytest

from jaxlangnav import sensing
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.messages import NONE, Observation, default_sensor

SENSOR = default_sensor(4.0, field_of_view=math.pi / 2, noise=0.05)
HERE = (0.0, 0.0, 0.0)


def test_the_shipped_types_are_those_of_the_lexicon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JAXLANGNAV_LEXICON", raising=False)
    assert load_lexicon().type_names[: len(sensing.TYPES)] == sensing.TYPES


def test_an_observation_is_padded_and_cast() -> None:
    look = Observation.of(HERE, [("cone", 3, 0.5), (0, np.float64(1.5), -0.25)], SENSOR)
    assert look.detection_type.tolist() == [1, 0] + [NONE] * 6
    assert look.detection_range.tolist() == [3.0, 1.5] + [0.0] * 6
    assert look.detection_bearing.tolist() == [0.5, -0.25] + [0.0] * 6
    assert look.is_detection.tolist() == [True, True] + [False] * 6
    assert look.pose.dtype == look.detection_range.dtype == np.float32
    assert look.detection_type.dtype == np.int32


@pytest.mark.parametrize(("count", "slots"), [(0, 8), (8, 8), (9, 16), (33, 64), (64, 64)])
def test_few_sizes_hold_any_number_of_detections(count: int, slots: int) -> None:
    look = Observation.of(HERE, [("tree", 1.0, 0.0)] * count, SENSOR)
    assert look.detection_type.shape == (slots,)
    assert int(np.sum(look.is_detection)) == count


def test_types_of_ones_own_are_indexed_by_their_names() -> None:
    look = Observation.of(HERE, [("lamp", 1.0, 0.0)], types=("chair", "lamp"))
    assert look.detection_type[0] == 1


@pytest.mark.parametrize(
    ("detection", "words"),
    [
        (("hydrent", 3.0, 0.0), "did you mean 'hydrant'"),
        ((8, 3.0, 0.0), "0 to 7"),
        ((0.5, 3.0, 0.0), "0 to 7"),
        (("cone", 3000.0, 0.0), "metres"),
        (("cone", -1.0, 0.0), "metres"),
        (("cone", math.nan, 0.0), "finite"),
        (("cone", "far", 0.0), "must be a number"),
        (("cone", 3.0, 30.0), "radians"),
        (("cone", 3.0, 1.5), "field of view"),
        (("cone", 3.0), "(type, range, bearing)"),
        (7, "(type, range, bearing)"),
    ],
)
def test_a_detection_that_cannot_be_is_refused(detection: object, words: str) -> None:
    with pytest.raises(ValueError, match="detection 1") as refusal:
        Observation.of(HERE, [detection], SENSOR)  # pyright: ignore[reportArgumentType]
    assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("pose", [(0.0, 0.0), (0.0, 0.0, 90.0), (math.inf, 0.0, 0.0), None])
def test_a_pose_that_cannot_be_is_refused(pose: object) -> None:
    with pytest.raises(ValueError, match="pose"):
        Observation.of(pose, [], SENSOR)  # pyright: ignore[reportArgumentType]


def test_too_many_detections_are_refused() -> None:
    with pytest.raises(ValueError, match="at most 64"):
        Observation.of(HERE, [("tree", 1.0, 0.0)] * 65, SENSOR)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"range_max": -1.0}, "metres"),
        ({"field_of_view": 90.0}, "math.radians"),
        ({"detection_probability": 95.0}, "0.95 for 95 percent"),
        ({"noise": -0.1}, "metres"),
        ({"noise": math.nan}, "finite"),
    ],
)
def test_a_sensor_that_cannot_be_is_refused(numbers: dict[str, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        default_sensor(**numbers)


def test_what_is_sound_at_the_door_is_sound_to_the_belief() -> None:
    """At the very limits of range and view neither of the two refuses what the other takes."""
    from jaxlangnav.semantic_map.soundness import _is_detectable

    slack = sensing.DEVIATIONS * 0.05
    limits = [(4.0 + slack, 0.0), (1.0, math.pi / 4 + 0.3), (4.0, math.pi / 4)]
    look = Observation.of(HERE, [("cone", *one) for one in limits], SENSOR)
    assert np.asarray(_is_detectable(look, np.int32(8)))[:3].all()
