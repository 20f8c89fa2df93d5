"""Labelled sentences, each with its meaning or the label "refuse" (section 4.1).

A file of JSON lines. Each line is an object with

- ``text``: the sentence;
- ``label``: ``"refuse"``, or one interpretation in the published form (``grounding.form``) without
  its probability: ``things``, ``relations`` among them, and ``commands`` in order;
- ``construction``: grammatical construction of the sentence; optional.
- ``set``: subset of the file, such as its annotator; optional.

    {"text": "stop behind the car", "label": {"things": [{"id": "c", "type": "car"}],
     "commands": [{"goal": {"region": "behind", "thing": "c"}}]}, "construction": "regions"}
"""

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from msgspec import Meta

from jaxlangnav.dialogue import compose_poses
from jaxlangnav.grounding.annotated import reading_of_form
from jaxlangnav.grounding.command_summary import infer_commands
from jaxlangnav.grounding.form import FormReading, read_meaning
from jaxlangnav.grounding.instruction import Instruction, Understanding
from jaxlangnav.grounding.worlds import reading_world
from jaxlangnav.inputs.documents import error_prefix, parse_json, read_lines
from jaxlangnav.inputs.sanitize import quote
from jaxlangnav.inputs.schema import Schema, convert
from jaxlangnav.language.corpus import PlacedWorld
from jaxlangnav.language.lexicon import find_type
from jaxlangnav.messages import ACTIONS, AT, MODES, NONE, REGIONS, Behavior
from jaxlangnav.planner.goals import region_offset
from jaxlangnav.pytree import replace
from jaxlangnav.relations import default_params, prepare
from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.state import Scenario

MIN_MEANT_PROB = 0.05
"""Minimum probability of a goal that the sentence may mean."""
TIE_RATIO = 0.8
"""Minimum ratio of a goal's probability to the best one's for a tie."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Goal:
    """A goal position that a sentence may mean."""

    region: int  # index into messages.REGIONS
    index: int  # slot of the scenario; NONE for the robot itself
    position: tuple[float, float]  # metres, map frame: typical position in the region


def intended_goals(understood: Understanding, scenario: Scenario) -> tuple[list[list[Goal]], bool]:
    """List the most probable goals of each command in a fully known world.

    The second value tells whether the last command is to find, not to navigate.
    """
    instruction = understood.instruction
    placed = placed_world(scenario, understood.type_names)
    world = reading_world(placed, understood.type_names, instruction.readings)
    behaviors = infer_commands(instruction, world)
    goals = [
        _best_goals(instruction, clause, behavior, placed, scenario)
        for clause, behavior in enumerate(behaviors)
    ]
    is_find_task = bool(goals and goals[-1]) and ACTIONS[behaviors[-1].action.argmax()] == "find"
    return goals or [[]], is_find_task


def _best_goals(
    parsed: Instruction, clause: int, behavior: Behavior, placed: PlacedWorld, scenario: Scenario
) -> list[Goal]:
    """List the goals of one command that are tied with the most probable one."""
    best = float(behavior.goal.max())
    if best < MIN_MEANT_PROB:
        return []
    metres, frame = (np.asarray(field)[clause] for field in (parsed.metres, parsed.frame))
    viewer = np.asarray(compose_poses(jnp.asarray(placed.robot, jnp.float32), frame[None]))[0]
    slots = np.flatnonzero(np.asarray(scenario.is_object))
    goals = []
    for region, slot in np.argwhere(behavior.goal >= TIE_RATIO * best).tolist():
        is_robot = slot == len(slots)
        x, y = viewer[:2].tolist() if is_robot else placed.objects[slot][1:]
        if region != AT:
            origin = np.int32(region), np.float32(x), np.float32(y)
            offset = _offset(*origin, viewer, np.bool_(is_robot), metres)
            x, y = x + float(offset[0]), y + float(offset[1])
        index = NONE if is_robot else int(slots[slot])
        goals.append(Goal(region=region, index=index, position=(x, y)))
    return goals


def is_among(scenario: Scenario, goals: list[Goal]) -> bool:
    """Test whether the goal of a world is among the goals of a sentence.

    A goal object has to be a goal itself, a goal position within the success radius of one.
    """
    slot = int(scenario.goal_index)
    if slot != NONE:
        return any(goal.region == AT and goal.index == slot for goal in goals)
    x, y = np.asarray(scenario.goal).tolist()
    return any(math.dist((x, y), goal.position) <= SUCCESS_RADIUS for goal in goals)


def with_goal(scenario: Scenario, goal: Goal) -> Scenario:
    """Set the goal of a world."""
    index = jnp.int32(goal.index if goal.region == AT else NONE)
    return replace(scenario, goal=jnp.asarray(goal.position, jnp.float32), goal_index=index)


@jax.jit
def _offset(
    region: Array, x: Array, y: Array, viewer: Array, is_robot: Array, metres: Array
) -> tuple:
    """Compute the offset of the goal position in a region, by the planner's function."""
    return region_offset(prepare(default_params()), region, x, y, viewer, is_robot, metres)


REFUSE = "refuse"
MAX_SENTENCES = 20_000
"""Maximum number of lines of a file."""
_MAX_BYTES = 32 * 1024 * 1024
"""Maximum size of a file."""
_MAX_NAME = 60
"""Maximum number of characters of a construction's name."""


class Meaning(NamedTuple):
    """Labelled meaning of a sentence."""

    reading: FormReading
    type_names: tuple[str, ...]  # object types by index; those of the lexicon by their own names


class LabelledSentence(NamedTuple):
    """One line of a file of labelled sentences."""

    line: int  # 1-based
    text: str
    construction: str
    set: str  # subset of the file
    meaning: Meaning | None  # None: it must be refused


def read_sentences(path: Path) -> list[LabelledSentence]:
    """Read a file of labelled sentences, in order; empty lines are left out.

    Raises:
        ValueError: no such file, or a line cannot be; one line that names file, line and remedy.
    """
    lines = read_lines(path, max_bytes=_MAX_BYTES)
    if not lines:
        raise ValueError(f"{path}: holds no sentence: write one JSON object a line")
    if len(lines) > MAX_SENTENCES:
        raise ValueError(
            f"{path}: holds {len(lines)} sentences; at most {MAX_SENTENCES} are read: split it"
        )
    sentences = []
    for line_number, line in lines:
        with error_prefix(f"{path}:{line_number}"):
            sentences.append(_to_sentence(line_number, convert(parse_json(line), _Line)))
    return sentences


class _Line(Schema):
    text: str
    label: Any
    construction: Annotated[str, Meta(max_length=_MAX_NAME)] = ""
    set: str = ""

    def __post_init__(self) -> None:
        """Accept any characters, unlike the base class."""


def _to_sentence(line_number: int, line: _Line) -> LabelledSentence:
    meaning = None
    if line.label != REFUSE:
        if isinstance(line.label, str):
            raise ValueError(f"label is {quote(line.label)}, but must be 'refuse' or an object")
        reading, types = read_meaning(line.label, path="label")
        reading_of_form(reading, "label")  # refuses what the arrays do not hold
        meaning = Meaning(reading, tuple(find_type(name.lower()) or name for name in types))
    return LabelledSentence(line_number, line.text, line.construction, line.set, meaning)


_MIN_LISTED_PROB = 1e-3
"""Minimum probability of a listed behavior."""


def placed_world(scenario: Scenario, names: Sequence[str]) -> PlacedWorld:
    """List the true objects of a scenario by slot, and the robot's start pose."""
    slots = np.flatnonzero(np.asarray(scenario.is_object))
    fields = (scenario.object_type, scenario.object_x, scenario.object_y)
    objects = zip(*(np.asarray(field)[slots].tolist() for field in fields), strict=True)
    x, y, heading = np.asarray(scenario.start).tolist()
    attributes = scenario.object_attribute
    return PlacedWorld(
        objects=tuple((names[int(object_type)], x, y) for object_type, x, y in objects),
        robot=(x, y, heading),
        attributes=() if attributes is None else tuple(np.asarray(attributes)[slots].tolist()),
    )


def list_behaviors(
    instruction: Instruction, placed: PlacedWorld, names: tuple[str, ...]
) -> list[dict[str, Any]]:
    """List the behavior distribution of each command in a fully known world.

    Action, mode and goal are independent given the sentence and the world, so the probability of
    a behavior is the product of theirs. The remainder to 1 is the probability that no goal there
    fits the command.

    Args:
        instruction: the grounded sentence.
        placed: the world.
        names: object types by index.

    Returns:
        Clause by clause, likeliest first: ``clause``, ``action``, ``mode``, ``goal``,
        ``probability``.
    """
    rows: list[dict[str, Any]] = []
    world = reading_world(placed, names, instruction.readings)
    for clause, behavior in enumerate(infer_commands(instruction, world)):
        joint = np.einsum("a,m,rs->amrs", behavior.action, behavior.mode, behavior.goal)
        for index in map(tuple, np.argwhere(joint >= _MIN_LISTED_PROB).tolist()):
            action, mode, region, slot = index
            is_robot = slot == len(placed.objects)
            name, x, y = ("robot", *placed.robot[:2]) if is_robot else placed.objects[slot]
            goal = {"region": REGIONS[region], "object": name, "index": slot, "position": [x, y]}
            row = {"clause": clause, "action": ACTIONS[action], "mode": MODES[mode], "goal": goal}
            rows.append({**row, "probability": float(joint[index])})
    return sorted(rows, key=lambda row: (row["clause"], -row["probability"]))
