"""Measure the house: lines by floor, records and traced operations inside one decision.

    python scripts/house.py

Lines are those of Python files, docstrings and blank lines included. Records are the classes of
this package of which an instance is made while ``navigator.step`` is traced once. Operations are
the equations of that trace, nested programs included.
"""

import inspect
import sys
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any

import jax
import jax.numpy as jnp

import jaxlangnav
from jaxlangnav import navigator
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import Observation, default_sensor
from jaxlangnav.navigator import NavigatorConfig

PACKAGE = Path(jaxlangnav.__file__).parent
ENGINE = (
    "messages", "pytree", "numerics", "relations", "semantic_map", "planner", "navigator",
    "anywhere", "agent", "episode", "lanes", "recording", "recorder",
)  # fmt: skip
"""From messages to episode; ``grounding`` is read after lunch."""
NUM_DETECTIONS = 8


def lines_by_floor() -> Counter[str]:
    """Count the lines of every top-level module and package."""
    found: Counter[str] = Counter()
    for path in PACKAGE.rglob("*.py"):
        floor = path.relative_to(PACKAGE).with_suffix("").parts[0]
        found[floor] += path.read_text("utf-8").count("\n")
    return found


def arguments() -> tuple[Any, ...]:
    """Make what ``navigator.step`` is traced with."""
    config = NavigatorConfig()
    instruction = understand("go to the hydrant behind the cone", load_shipped()).instruction
    area = jnp.array([0.0, 13.0, -9.0, 9.0])
    state = navigator.start(instruction, jnp.zeros(3), area, config=config)
    observation = Observation(
        pose=jnp.zeros(3),
        detection_type=jnp.zeros(NUM_DETECTIONS, jnp.int32),
        detection_range=jnp.ones(NUM_DETECTIONS),
        detection_bearing=jnp.zeros(NUM_DETECTIONS),
        is_detection=jnp.zeros(NUM_DETECTIONS, bool),
        sensor=default_sensor(),
    )
    return jax.random.key(0), state, observation


def count_operations(jaxpr: Any) -> int:
    """Count the equations of a trace, those of nested programs included."""
    inner = 0
    for equation in jaxpr.eqns:
        for value in equation.params.values():
            for one in value if isinstance(value, tuple | list) else (value,):
                one = getattr(one, "jaxpr", one)
                inner += count_operations(one) if hasattr(one, "eqns") else 0
    return len(jaxpr.eqns) + inner


def traced() -> tuple[Any, set[str]]:
    """Trace one decision; return it, and the records made on the way."""
    params, config, records = navigator.default_params(), NavigatorConfig(), set[str]()

    def note(frame: FrameType, event: str, _: Any) -> None:
        names = frame.f_locals
        if event != "call" or not (frame.f_code.co_name == "__init__" or "_cls" in names):
            return
        # A NamedTuple is made by a function of its class, everything else by ``__init__``.
        first = next(iter(names.values()), None)
        made = first if inspect.isclass(first) else type(first)
        if made.__module__.startswith("jaxlangnav."):
            records.add(f"{made.__module__.removeprefix('jaxlangnav.')}.{made.__name__}")

    def step(key: Any, state: Any, observation: Any) -> Any:
        return navigator.step(key, state, observation, params=params, config=config)

    given = arguments()
    sys.setprofile(note)
    try:
        jaxpr = jax.make_jaxpr(step)(*given)
    finally:
        sys.setprofile(None)
    return jaxpr, records


def main() -> None:
    """Print the measures."""
    floors = lines_by_floor()
    for floor, number in sorted(floors.items(), key=lambda item: -item[1]):
        print(f"{number:6}  {floor}")
    print(f"{floors.total():6}  package")
    print(f"{sum(floors[floor] for floor in ENGINE):6}  engine: {', '.join(ENGINE)}")
    jaxpr, records = traced()
    print(f"{len(records):6}  records inside one navigator.step: {', '.join(sorted(records))}")
    print(f"{count_operations(jaxpr.jaxpr):6}  traced operations of one navigator.step")


if __name__ == "__main__":
    main()
