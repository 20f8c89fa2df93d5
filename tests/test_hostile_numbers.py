"""Whatever stands where a number or a list is wanted: taken, or refused in one line at once."""

import contextlib
import dataclasses
import itertools
import math
from collections.abc import Callable, Iterator
from decimal import Decimal
from typing import Any

import numpy as np
import pytest

from jaxlangnav import sensing
from jaxlangnav.agent import Navigator
from jaxlangnav.experiments.sweep_config import config_from_dict
from jaxlangnav.grounding import AnnotationGrounder
from jaxlangnav.grounding.readings import Capacity
from jaxlangnav.messages import Observation, SensorParams, default_sensor
from jaxlangnav.pytree import replace
from jaxlangnav.quantities import FIELDS
from jaxlangnav.uniform import uniform

HERE = (0.0, 0.0, 0.0)
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


@pytest.fixture(scope="module")
def robot() -> Navigator:
    return Navigator.pretrained(grounder=AnnotationGrounder(["cone", "hydrant"]))


def entrances(robot: Navigator) -> Iterator[tuple[str, Callable[[Any], object]]]:
    """Everywhere that a number comes in, one at a time."""
    look = Observation.of(HERE, [ROW])

    def at(row: tuple[Any, ...], place: int, value: Any) -> tuple[Any, ...]:
        return (*row[:place], value, *row[place + 1 :])

    for place in range(3):
        yield "pose's", lambda one, n=place: robot.wait(at(HERE, n, one))
        yield "row's", lambda one, n=place: robot.observation(HERE, [at(ROW, n, one)])
    yield "looks", lambda one: robot.observation(HERE, [(*ROW, one)])
    yield "colour", lambda one: robot.observation(HERE, [(*ROW, {"colour": one})])
    yield "row", lambda one: robot.observation(HERE, [one])
    yield "detections", lambda one: robot.observation(HERE, one)
    yield "pose", lambda one: robot.observation(one)
    yield "sensor", lambda one: robot.observation(HERE, (), one)
    for place in range(4):
        yield "area's", lambda one, n=place: robot.wait(HERE, at((-9.0, 9.0, -9.0, 9.0), n, one))
    yield "area", lambda one: sensing.area_numbers(one)
    yield "warm_up", lambda one: refuse_only(robot, one)
    yield "labels", lambda one: Navigator.pretrained(labels=one)
    yield "attributes", lambda one: Navigator.pretrained(attributes=one)
    yield "mentions", lambda one: Capacity(num_mentions=one)
    for field in dataclasses.fields(SensorParams):
        yield field.name, lambda one, name=field.name: default_sensor(**{name: one})
        yield (
            field.name,
            lambda one, name=field.name: Observation.of(
                HERE, (), replace(look.sensor, **{name: one})
            ),
        )
        yield (
            field.name,
            lambda one, name=field.name: uniform(
                replace(look, sensor=replace(look.sensor, **{name: one}))
            ),
        )
    for field in dataclasses.fields(Observation):
        yield field.name, lambda one, name=field.name: uniform(replace(look, **{name: one}))
    for name in ("reach", "misleading", "clumping", "heading_noise"):
        yield (
            name,
            lambda one, name=name: Navigator.pretrained(grounder=robot.grounder, **{name: one}),
        )
    for table, fields in FIELDS.items():
        for name, quantity in fields.items():
            yield name, lambda one, name=name, read=quantity.read: read(one, name)
        first = next(iter(fields))
        yield table, lambda one, t=table, n=first: config_from_dict({**SWEEP, t: {n: one}})
    for key in ("episodes", "environments", "seeds", "ranges", "particles", "policies", "name"):
        yield key, lambda one, key=key: config_from_dict({**SWEEP, key: one})


def refuse_only(robot: Navigator, detections: Any) -> None:
    """Warm up for what cannot be; what can be is compiled elsewhere."""
    with contextlib.suppress(pytest.fail.Exception):
        robot.warm_up(detections)


def test_whatever_is_given_is_taken_or_refused_in_one_line(robot, monkeypatch) -> None:
    monkeypatch.setattr(Navigator, "_listener", property(lambda *args: pytest.fail("begun")))
    monkeypatch.setattr(Navigator, "step", lambda *args: pytest.fail("begun"))
    faults = []
    for name, enter in entrances(robot):
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


@pytest.mark.parametrize("detections", [65, 10**9, 10**400, -1, 2.5, "x", None, math.nan])
def test_no_more_is_warmed_up_than_is_held(robot, detections: Any) -> None:
    with pytest.raises(ValueError, match=r"detections is .*, but must"):
        robot.warm_up(detections)


def test_a_number_too_large_for_any_is_told_by_its_size() -> None:
    with pytest.raises(ValueError, match="range_max is a whole number of 16610 bits, but"):
        default_sensor(10**5000)
