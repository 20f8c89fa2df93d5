"""Each construct of the language changes what the robot does: one world, one seed, one program."""

import functools
from typing import NamedTuple

import numpy as np
import pytest
from placed import placed

from jaxlangnav.episode import Task
from jaxlangnav.episode.recorder import play
from jaxlangnav.experiments.policies import navigator_config
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.navigator import default_params
from jaxlangnav.pytree import replace
from jaxlangnav.task.follow import batched
from jaxlangnav.task.loading import load_task
from jaxlangnav.world.files import open_world
from jaxlangnav.world.simulator import SUCCESS_RADIUS

PLACES = {
    "left cone": ("cone", 1.0, 3.0),
    "right cone": ("cone", 1.5, -4.0),
    "far cone": ("cone", 7.0, 0.5),
    "hydrant behind": ("hydrant", 9.2, 0.8),
    "hydrant at the tree": ("hydrant", -4.0, 2.0),
    "car": ("car", 8.5, -3.0),
    "tree": ("tree", -6.0, 3.0),
    "bench": ("bench", 11.6, 0.9),
}
"""The robot stands at the origin and looks along x. Nearest cone: left, right, far."""
AREA = (-9.0, 15.0, -9.0, 9.0)
STEPS, REACH, TYPICAL = 40, SUCCESS_RADIUS, 2.4
# Command → what it ends at.
ENDS = {
    "go to the cone": "left cone",
    "go to the hydrant": "hydrant at the tree",
    "go to the car": "car",
    # relations to a landmark, and relative clauses
    "go to the hydrant behind the cone": "hydrant behind",
    "go to the hydrant in front of the bench": "hydrant behind",
    # the robot as landmark
    "go to the cone on your left": "left cone",
    "go to the cone on your right": "right cone",
    "go to the cone in front of you": "far cone",
    "go to the hydrant behind you": "hydrant at the tree",
    # two landmarks
    "go to the hydrant between the cone and the bench": "hydrant behind",
    "go to the hydrant that is between the tree and the cone": "hydrant at the tree",
    # superlatives, ordinals, the other
    "go to the nearest cone": "left cone",
    "go to the farthest cone": "far cone",
    "go to the rightmost cone": "right cone",
    "go to the cone nearest to the car": "far cone",
    "go to the second cone": "right cone",
    "go to the second hydrant": "hydrant behind",
    "go to the nearest cone then go to the other cone on your right": "right cone",
    "go to the second cone then go to the first cone": "left cone",
    # nested relations, and two steps
    "go to the hydrant behind the cone in front of you": "hydrant behind",
    "go to the car then go to the tree": "tree",
    # statements inform, and words refer back
    "the hydrant is behind the cone. go to the hydrant": "hydrant behind",
    "there is a hydrant behind the cone. go to it": "hydrant behind",
}
# Region goals without a figure → the object, and the way from it (seen from the robot) in metres.
REGIONS = {
    "move behind the car": ("car", "along", TYPICAL),
    "stop in front of the car": ("car", "along", -TYPICAL),
    "park to the right of the car": ("car", "lateral", -TYPICAL),
    "stop to the right of the cone near the car": ("far cone", "lateral", -TYPICAL),
    "go to the second cone then stop behind it": ("right cone", "along", TYPICAL),
    "the car is behind the bench. move behind the bench": ("bench", "along", TYPICAL),
}


class Followed(NamedTuple):
    """What one command led to."""

    path: np.ndarray
    steps: int
    speed: float
    clearance: float

    def away(self, place: str) -> float:
        return float(np.hypot(*(self.path[-1] - PLACES[place][1:])))

    def closest(self, place: str) -> float:
        """Measure how close the way came to an object."""
        ends = zip(self.path[:-1], self.path[1:], strict=True)
        fine = np.concatenate([np.linspace(a, b, 10) for a, b in ends])
        return float(np.hypot(*(fine - PLACES[place][1:]).T).min())


@functools.cache
def task() -> Task:
    model, source = load_shipped(), open_world("1H1C")
    things = [(model.type_names.index(kind), x, y) for kind, x, y in PLACES.values()]
    prepared = load_task(source, understand("go to the cone", model), sensing_range=25.0, seed=0)
    return replace(prepared.task, scenario=placed(things, slots=len(things), area=AREA))


@functools.cache
def followed(text: str) -> Followed:
    config, params = navigator_config("informed"), default_params()
    told = batched(understand(text, load_shipped()))
    shown = list(play(task(), told, params=params, config=config, max_steps=STEPS))
    frames, results = zip(*shown, strict=True)
    path = np.array([*(frame.position for frame in frames), results[-1].final])
    mode = int(frames[0].mode.argmax())
    speed, clearance = params.mode_speed[mode], params.mode_clearance[mode]
    return Followed(path, len(frames), float(speed), float(clearance))


@pytest.mark.parametrize("text", ENDS)
def test_the_robot_stops_at_what_is_meant(text):
    assert followed(text).steps < STEPS, "it has not stopped"
    assert followed(text).away(ENDS[text]) <= REACH


@pytest.mark.parametrize("text", REGIONS)
def test_the_robot_stops_in_the_region(text):
    name, way, length = REGIONS[text]
    thing = np.array(PLACES[name][1:])
    along = thing / np.linalg.norm(thing)
    direction = along if way == "along" else np.array([-along[1], along[0]])
    assert followed(text).steps < STEPS, "it has not stopped"
    assert np.linalg.norm(followed(text).path[-1] - (thing + length * direction)) <= REACH


def test_manner_changes_speed_and_clearance():
    plain = followed("go to the car")
    quick, slow = followed("go quickly to the car"), followed("go slowly to the car")
    careful = followed("carefully go to the car")
    assert quick.steps < plain.steps < slow.steps == careful.steps
    assert quick.speed > plain.speed > slow.speed == careful.speed
    assert careful.clearance > plain.clearance > quick.clearance
    for one in (quick, slow, careful):
        assert np.linalg.norm(one.path[-1] - plain.path[-1]) < 0.5


def test_to_find_is_to_have_it_in_view():
    """The car is in view from the start: nothing is left to do."""
    assert followed("find the car").steps == 1
    assert followed("go to the car").steps > 5


def test_what_is_to_be_avoided_is_passed_at_a_distance():
    avoiding = followed("go to the bench while avoiding the cone")
    assert followed("go to the bench").closest("far cone") < 0.5
    assert avoiding.closest("far cone") > 2.0
    assert avoiding.away("bench") <= REACH


def test_far_is_far():
    assert followed("stop far from the car").steps < STEPS
    assert followed("stop far from the car").away("car") > 5.0
