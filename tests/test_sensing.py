"""What a robot reports: padded, cast, and whatever it is, taken or refused in one line."""

import contextlib
import dataclasses
import functools
import itertools
import math
import re
from collections.abc import Callable, Iterator
from decimal import Decimal
from typing import Any

import jax
import numpy as np
import pytest
from refusals import assert_refused

from jaxlangnav import Navigator
from jaxlangnav.experiments.sweep_config import config_from_dict
from jaxlangnav.grounding import AnnotationGrounder
from jaxlangnav.grounding.readings import Capacity
from jaxlangnav.inputs import observations
from jaxlangnav.inputs.limits import check_seed
from jaxlangnav.inputs.object_types import attribute_code
from jaxlangnav.language.lexicon import load_lexicon
from jaxlangnav.messages import NONE, Observation, SensorParams, default_sensor
from jaxlangnav.navigator.canonicalize import canonicalize, check_key
from jaxlangnav.navigator.deployment import FIELDS
from jaxlangnav.navigator.interpret import Listener
from jaxlangnav.pytree import replace

SENSOR = default_sensor(4.0, field_of_view=math.pi / 2, noise=0.05)
HERE = (0.0, 0.0, 0.0)


def test_the_shipped_types_are_those_of_the_lexicon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("JAXLANGNAV_LEXICON", raising=False)
    assert load_lexicon().type_names[: len(observations.TYPES)] == observations.TYPES


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


@pytest.fixture(scope="module")
def door() -> Navigator:
    return Navigator.pretrained(grounder=AnnotationGrounder(["cone", "hydrant"]))


DETECTIONS = [
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
    ("con", "(type, range, bearing)"),
    ({"type": "cone", "range": 3.0, "bearing": 0.0}, "(type, range, bearing)"),
    ((b"cone", 3.0, 0.0), "must be a name (a text) or the index of one"),
    (("co\x1bne", 3.0, 0.0), "'co\\x1bne'"),
    (("cone", 3.0, 0.0, "red"), '{"colour": "red"}'),
    (("cone", 3.0, 0.0, 5), '{"colour": "red"}'),
    (("cone", 3.0, 0.0, {"color": "red"}), "colour, material, size, height"),
    (("cone", 3.0, 0.0, {"colour": "tall"}), "one of red, orange"),
    (("cone", 3.0, 0.0, {"colour": 1}), "one of red, orange"),
    (("cone", 3.0, 0.0, {"colour": "red"}, 1), "(type, range, bearing)"),
]
POSES = (
    (0.0, 0.0), (0.0, 0.0, 90.0), (math.inf, 0.0, 0.0), None, 3, "abc", "abcd", (1e39, 0.0, 0.0),
    (np.zeros(2), 0.0, 0.0), ("a", 0.0, 0.0), np.zeros((3, 3)), np.float32(2.0),
)  # fmt: skip
AREAS = ("abcd", 4.0, (0.0, 1.0, 2.0), (0.0, 1.0, "a", 2.0), (0, 1, [], 2))
SENSORS = [
    ({"range_max": -1.0}, "metres"),
    ({"field_of_view": 90.0}, "math.radians"),
    ({"detection_probability": 95.0}, "0.95 for 95 percent"),
    ({"detection_probability": 0.0}, "above 0"),
    ({"noise": -0.1}, "metres"),
    ({"noise": math.nan}, "finite"),
]
PARTS = [
    ({"pose": np.zeros(2)}, r"pose has the shape \(2,\), but must have \(3,\)"),
    ({"pose": None}, r"pose has the shape \(\)"),
    ({"pose": "abc"}, "pose is 'abc', but must be numbers"),
    ({"detection_range": np.zeros(3)}, r"detection_range has the shape \(3,\)"),
    ({"is_detection": np.zeros((8, 1), bool)}, "is_detection has the shape"),
    ({"detection_attribute": np.zeros(2, np.int32)}, "detection_attribute has the shape"),
    ({"detection_type": np.int32(3)}, "detection_type has the shape"),
    ({"sensor": None}, "observation's sensor is None"),
    ({"sensor": replace(SENSOR, noise=np.zeros(2))}, r"sensor.noise has the shape \(2,\)"),
]


def refusals(door: Navigator) -> Iterator[tuple[Callable[[], object], str]]:
    """What cannot be, and what has to be said of it."""
    for one, words in DETECTIONS:
        told = rf"(?=.*detection 1).*{re.escape(words)}"
        yield lambda one=one: Observation.of(HERE, [one], SENSOR), told
    yield lambda: Observation.of(HERE, [("tree", 1.0, 0.0)] * 65, SENSOR), "at most 64"
    for one in POSES:
        yield lambda one=one: Observation.of(one, [], SENSOR), "^pose"
    for one in AREAS:
        yield lambda one=one: observations.validate_area(one), "^area"
    for one, words in SENSORS:
        yield lambda one=one: default_sensor(**one), words
    yield lambda: default_sensor(10**5000), "range_max is a whole number of 16610 bits, but"
    look = Observation.of(HERE, [("cone", 1.0, 0.0)], SENSOR)
    for one, words in PARTS:
        told = f"observation's .*{words}|^{words}"
        yield lambda one=one: canonicalize(replace(look, **one)), told
    for one in (None, HERE, "look"):
        yield lambda one=one: canonicalize(one), r"must be made by navigator\.observation"
    for one, words in (((0, 0, 90), "math.radians"), (None, "pose is None")):
        yield lambda one=one: door.wait(one), words
    yield lambda: door.wait(area="abcd"), "area is 'abcd'"
    for one in (65, 10**9, 10**400, -1, 2.5, "x", None, math.nan):
        yield lambda one=one: door.warm_up(one), r"detections is .*, but must"


def test_what_cannot_be_is_refused_in_one_line(door) -> None:
    assert_refused(refusals(door))


def test_how_a_thing_looks_is_a_fourth_entry() -> None:
    rows = [("cone", 3.0, 0.5, {"colour": "red", "height": "tall"}), ("tree", 1.0, 0.0)]
    look = Observation.of(HERE, [*rows, ("car", 1.0, 0.5, {}), ("car", 2.0, 0.5, None)], SENSOR)
    code = np.asarray(look.detection_attribute)
    assert code.tolist() == [attribute_code("red", "tall")] + [0] * 7
    assert code.dtype == np.int32


def test_a_row_of_numbers_is_a_detection() -> None:
    rows = np.array([[1.0, 3.2, 0.4], [0.0, 1.0, 0.0]])
    look = Observation.of(HERE, rows, SENSOR)
    assert np.asarray(look.detection_type)[:2].tolist() == [1, 0]


def test_a_range_in_millimetres_is_taken_and_said(caplog: pytest.LogCaptureFixture) -> None:
    default_sensor(1000.0)
    assert not caplog.records
    assert float(default_sensor(4000).range_max) == 4000.0
    assert "range_max is 4000 m" in caplog.text
    assert "counts as not there" in caplog.text


def test_warming_up_covers_looks_with_attributes() -> None:
    """With them or without, or given by hand: one structure, one set of shapes and dtypes."""

    def form(look: Observation) -> object:
        given = canonicalize(look)
        return jax.tree.structure(given), [(np.shape(x), x.dtype) for x in jax.tree.leaves(given)]

    plain = Observation.of(HERE, [(1, 1.0, 0.0)], SENSOR)
    coloured = Observation.of(HERE, [(1, 1.0, 0.0, {"colour": "red"})], SENSOR)
    by_hand = replace(plain, detection_attribute=[attribute_code("red")] + [0] * 7)
    for look in (coloured, by_hand, replace(plain, detection_attribute=None)):
        assert form(look) == form(plain)


def test_what_is_sound_at_the_door_is_sound_to_the_belief() -> None:
    """At the very limits of range and view neither of the two refuses what the other takes."""
    from jaxlangnav.semantic_map.gating import _is_detectable

    slack = observations.GATE_SIGMAS * 0.05
    limits = [(4.0 + slack, 0.0), (1.0, math.pi / 4 + 0.3), (4.0, math.pi / 4)]
    look = Observation.of(HERE, [("cone", *one) for one in limits], SENSOR)
    assert np.asarray(_is_detectable(look, np.int32(8)))[:3].all()


ROW = ("cone", 1.0, 0.0)
SWEEP = {"worlds": ["1H1C"], "commands": ["behind"]}


def endless() -> Iterator[Any]:
    """Rows without an end; who asks for a thousand would never stop asking."""
    yield from itertools.repeat(ROW, 1000)
    raise AssertionError("read on and on")


VALUES: tuple[Callable[[], Any], ...] = (
    *(lambda one=one: one for one in (
        10**400, -(10**400), 10**5000, range(10**9), math.nan, math.inf, -math.inf, 1e300, -1.0, 0,
        True, None, "x", "", "1e999", "9" * 10_000, b"3", [], {}, object(), 1j,
        np.complex128(1j), Decimal(5), Decimal("1e500"), np.array(2.0), np.array("x"),
        np.array([]), np.zeros((2, 2)), np.array(None), np.array(10**400),
        np.float64(np.inf), np.datetime64("2026-01-01"),
        (10**5000,) * 3, ([], [], []), np.int64(2**40),
    )),
    endless,
)  # fmt: skip


def entrances(door: Navigator) -> Iterator[tuple[str, Callable[[Any], object]]]:
    """Everywhere that a number comes in, one at a time."""
    look = Observation.of(HERE, [ROW])

    own = functools.partial(Navigator.pretrained, grounder=door.grounder)

    def at(row: tuple[Any, ...], place: int, value: Any) -> tuple[Any, ...]:
        return (*row[:place], value, *row[place + 1 :])

    def broken(name: str, value: Any) -> Any:
        return replace(look.sensor, **{name: value})

    for place in range(3):
        yield "pose's", lambda one, n=place: door.wait(at(HERE, n, one))
        yield "row's", lambda one, n=place: door.observation(HERE, [at(ROW, n, one)])
    yield "looks", lambda one: door.observation(HERE, [(*ROW, one)])
    yield "colour", lambda one: door.observation(HERE, [(*ROW, {"colour": one})])
    yield "row", lambda one: door.observation(HERE, [one])
    yield "detections", lambda one: door.observation(HERE, one)
    yield "pose", lambda one: door.observation(one)
    yield "sensor", lambda one: door.observation(HERE, (), one)
    for place in range(4):
        yield "area's", lambda one, n=place: door.wait(HERE, at((-9.0, 9.0, -9.0, 9.0), n, one))
    yield "area", lambda one: observations.validate_area(one)
    yield "warm_up", lambda one: refuse_only(door, one)
    yield "labels", lambda one: Navigator.pretrained(labels=one)
    yield "attributes", lambda one: Navigator.pretrained(attributes=one)
    yield "mentions", lambda one: Capacity(num_mentions=one)
    yield "seed", check_seed
    yield "grounder", lambda one: dataclasses.replace(door, grounder=one)
    yield "key", check_key
    for field in dataclasses.fields(SensorParams):
        yield field.name, lambda one, name=field.name: default_sensor(**{name: one})
        yield field.name, lambda one, name=field.name: Observation.of(HERE, (), broken(name, one))
        yield (
            field.name,
            lambda one, name=field.name: canonicalize(replace(look, sensor=broken(name, one))),
        )
    for field in dataclasses.fields(Observation):
        yield field.name, lambda one, name=field.name: canonicalize(replace(look, **{name: one}))
    for name in ("reach", "misleading", "clumping", "heading_noise"):
        yield name, lambda one, name=name: own(**{name: one})
    for table, fields in FIELDS.items():
        for name, quantity in fields.items():
            yield name, lambda one, name=name, read=quantity.read: read(one, name)
        first = next(iter(fields))
        yield table, lambda one, t=table, n=first: config_from_dict({**SWEEP, t: {n: one}})
    for key in ("episodes", "environments", "seeds", "ranges", "particles", "policies", "name"):
        yield key, lambda one, key=key: config_from_dict({**SWEEP, key: one})


def refuse_only(door: Navigator, detections: Any) -> None:
    """Warm up for what cannot be; what can be is compiled elsewhere."""
    with contextlib.suppress(pytest.fail.Exception):
        door.warm_up(detections)


def test_whatever_is_given_is_taken_or_refused_in_one_line(door, monkeypatch) -> None:
    monkeypatch.setattr(Listener, "warm_up", lambda *args: pytest.fail("begun"))
    monkeypatch.setattr(Navigator, "step", lambda *args: pytest.fail("begun"))
    faults = []
    for name, enter in entrances(door):
        for value in VALUES:
            try:
                enter(value())
            except ValueError as refusal:
                said = str(refusal)
                trace = refusal.__traceback__
                while trace.tb_next is not None:
                    trace = trace.tb_next
                is_ours = trace.tb_frame.f_globals["__name__"].startswith("jaxlangnav")
                if "\n" in said or len(said) > 600 or "Exceeds" in said or not is_ours:
                    faults.append((name, said[:200]))
            except (Exception, Warning, pytest.fail.Exception) as fault:
                faults.append((name, type(value()).__name__, repr(fault)[:200]))
    assert not faults, "\n".join(map(str, [len(faults), *faults[:400]]))
