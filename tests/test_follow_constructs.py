"""Each construct of the language changes what the robot does: one world, one seed, one program.

Every command below is followed in the same place, beside the plain command that it refines. What
must differ is where the robot ends, how long it takes, or what it keeps away from. All of them are
lanes of one compiled program.
"""

import functools
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from placed import placed

from jaxlangnav import episode
from jaxlangnav.episode import Task
from jaxlangnav.grounding import load_shipped, understand
from jaxlangnav.messages import default_motion, default_sensor
from jaxlangnav.navigator import NavigatorConfig, default_params
from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.state import Scenario

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
STEPS, REACH, TYPICAL = 70, SUCCESS_RADIUS, 2.4
# Command → what it ends at.
ENDS = {
    "go to the cone": "left cone",
    "go to the hydrant": "hydrant at the tree",
    "go to the car": "car",
    # relations to a landmark, and relative clauses
    "go to the hydrant behind the cone": "hydrant behind",
    "go to the hydrant in back of the cone": "hydrant behind",
    "go to the hydrant that is behind the cone": "hydrant behind",
    "go to the hydrant next to the tree": "hydrant at the tree",
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
    "go to the leftmost cone": "left cone",
    "go to the cone nearest to the car": "far cone",
    "go to the hydrant closest to the bench": "hydrant behind",
    "go to the second cone": "right cone",
    "go to the third cone": "far cone",
    "go to the second hydrant": "hydrant behind",
    "go to the nearest cone then go to the other cone on your right": "right cone",
    "go to the cone on your left then go to the cone on your right": "right cone",
    "go to the second cone then go to the first cone": "left cone",
    "go to the hydrant near the tree then go to the hydrant behind the cone": "hydrant behind",
    # nested relations, and two steps
    "go to the hydrant behind the cone in front of you": "hydrant behind",
    "go to the car then go to the tree": "tree",
    "go to the tree then go to the car": "car",
    # statements inform, and words refer back
    "the hydrant is behind the cone. go to the hydrant": "hydrant behind",
    "there is a hydrant behind the cone. go to it": "hydrant behind",
    "the hydrant is next to the tree. go to the hydrant": "hydrant at the tree",
    "the hydrant is between the cone and the bench. go to the hydrant": "hydrant behind",
}
# Region goals without a figure → the object, and the way from it (seen from the robot) in metres.
REGIONS = {
    "move behind the car": ("car", "along", TYPICAL),
    "stop in front of the car": ("car", "along", -TYPICAL),
    "park to the left of the car": ("car", "lateral", TYPICAL),
    "park to the right of the car": ("car", "lateral", -TYPICAL),
    "get closer to the car": ("car", "along", -2.2),
    "stop to the right of the cone near the car": ("far cone", "lateral", -TYPICAL),
    "park behind the second cone": ("right cone", "along", TYPICAL),
    "go to the second cone then stop behind it": ("right cone", "along", TYPICAL),
    "the car is behind the bench. move behind the bench": ("bench", "along", TYPICAL),
}
OTHERS = (
    "go quickly to the car",
    "go slowly to the car",
    "carefully go to the car",
    "find the car",
    "look for the car",
    "go to the bench",
    "go to the bench while avoiding the cone",
    "go to the bench but stay away from the cone",
    "stop far from the car",
    "move away from the car",
)


def make_scenario() -> Scenario:
    names = load_shipped().type_names
    things = [(names.index(kind), x, y) for kind, x, y in PLACES.values()]
    return placed(things, slots=len(things), area=AREA)


class Followed:
    """What one command led to."""

    def __init__(self, path: np.ndarray, steps: int, speed: float, clearance: float) -> None:
        self.path, self.steps, self.speed, self.clearance = path, steps, speed, clearance

    @property
    def end(self) -> np.ndarray:
        return self.path[-1]

    def closest(self, place: str) -> float:
        """Measure how close the way came to an object."""
        point = np.array(PLACES[place][1:])
        fine = np.concatenate(
            [np.linspace(a, b, 10) for a, b in zip(self.path[:-1], self.path[1:], strict=True)]
        )
        return float(np.linalg.norm(fine - point, axis=1).min())


@pytest.fixture(scope="module")
def followed() -> Mapping[str, Followed]:
    """Follow all commands side by side."""
    texts = (*ENDS, *REGIONS, *OTHERS)
    model = load_shipped()
    instructions = jax.tree.map(
        lambda *leaves: jnp.stack(leaves), *(understand(t, model).instruction for t in texts)
    )
    config, params = NavigatorConfig(), default_params()

    def task(index: jax.Array) -> Task:
        return Task(
            key=jax.random.key(0),
            scenario=jax.tree.map(jnp.asarray, make_scenario()),
            instruction_index=index,
            sensor=default_sensor(25.0),
            motion=default_motion(),
        )

    def begin(index: jax.Array) -> episode.EpisodeState:
        return episode.begin(task(index), instructions, config=config)

    def body(progress: episode.EpisodeState, _: None) -> tuple:
        after, info = episode.advance(progress, params=params, config=config)
        return after, (after.world.position, after.navigator.is_done, info.behavior.mode)

    @functools.partial(jax.jit, compiler_options=by_hand.OFTEN)
    def run(lanes: jax.Array) -> tuple:
        def one(index: jax.Array) -> tuple:
            return jax.lax.scan(body, begin(index), None, length=STEPS)[1]

        return jax.vmap(one)(lanes)

    position, is_done, mode = jax.device_get(run(jnp.arange(len(texts), dtype=jnp.int32)))
    speed, clearance = np.asarray(params.mode_speed), np.asarray(params.mode_clearance)
    found = {}
    for lane, text in enumerate(texts):
        steps = int(is_done[lane].argmax()) + 1 if is_done[lane].any() else STEPS + 1
        path = np.concatenate([np.zeros((1, 2)), position[lane, :steps]])
        chosen = int(mode[lane, 0].argmax())
        found[text] = Followed(path, steps, float(speed[chosen]), float(clearance[chosen]))
    return found


@pytest.mark.parametrize("text", ENDS)
def test_the_robot_stops_at_what_is_meant(followed, text):
    assert followed[text].steps <= STEPS, "it has not stopped"
    assert np.linalg.norm(followed[text].end - np.array(PLACES[ENDS[text]][1:])) <= REACH


@pytest.mark.parametrize("text", REGIONS)
def test_the_robot_stops_in_the_region(followed, text):
    name, way, length = REGIONS[text]
    thing = np.array(PLACES[name][1:])
    along = thing / np.linalg.norm(thing)
    direction = along if way == "along" else np.array([-along[1], along[0]])
    assert followed[text].steps <= STEPS, "it has not stopped"
    assert np.linalg.norm(followed[text].end - (thing + length * direction)) <= REACH


def test_each_refinement_ends_elsewhere_than_the_plain_command(followed):
    """No construct of one noun is followed like another that means something else."""
    for noun in ("cone", "hydrant"):
        ends = {ENDS[text] for text in ENDS if text.startswith(f"go to the {noun}")}
        assert len(ends) >= 2
    plain = followed["go to the cone"].end
    for text in ("on your right", "in front of you"):
        assert np.linalg.norm(followed[f"go to the cone {text}"].end - plain) > 2.0


def test_manner_changes_speed_and_clearance(followed):
    plain = followed["go to the car"]
    quick, slow = followed["go quickly to the car"], followed["go slowly to the car"]
    careful = followed["carefully go to the car"]
    assert quick.steps < plain.steps < slow.steps == careful.steps
    assert quick.speed > plain.speed > slow.speed == careful.speed
    assert careful.clearance > plain.clearance > quick.clearance
    for one in (quick, slow, careful):
        assert np.linalg.norm(one.end - plain.end) < 0.5


@pytest.mark.parametrize("text", ["find the car", "look for the car"])
def test_to_find_is_to_have_it_in_view(followed, text):
    """The car is in view from the start: nothing is left to do."""
    assert followed[text].steps == 1
    assert followed["go to the car"].steps > 5


@pytest.mark.parametrize(
    "text",
    ["go to the bench while avoiding the cone", "go to the bench but stay away from the cone"],
)
def test_what_is_to_be_avoided_is_passed_at_a_distance(followed, text):
    assert followed["go to the bench"].closest("far cone") < 0.5
    assert followed[text].closest("far cone") > 2.0
    assert np.linalg.norm(followed[text].end - np.array(PLACES["bench"][1:])) <= REACH


@pytest.mark.parametrize("text", ["stop far from the car", "move away from the car"])
def test_far_is_far(followed, text):
    assert followed[text].steps <= STEPS
    assert np.linalg.norm(followed[text].end - np.array(PLACES["car"][1:])) > 5.0
