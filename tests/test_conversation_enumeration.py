"""The posterior after streams of utterances and looks, against exact enumeration (eq. 7a, A^t)."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
from oracles import enumeration as exact
from test_semantic_map_enumeration import ALPHA, OBJECTS, compare, small_world

from jaxlangnav.messages import NONE, ROBOT
from jaxlangnav.navigator import NavigatorConfig, api, speech_acts
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import filter as semantic_filter
from jaxlangnav.semantic_map.params import MapConfig

HYDRANT = by_hand.HYDRANT
SEEDS, RANGE = 100, 4.0
NOT_THAT = "not the hydrant at which the robot is"
POSES = ((0.0, 0.0, 0.3), (2.0, -1.0, 0.8), (4.0, -0.5, -0.6), (4.5, 0.8, 2.0))
"""Where the robot is as it hears each utterance; it looks round there after it."""
HYDRANT_BEHIND, NEAR_CAR = "go to the hydrant behind the cone", "the hydrant is near the car"
STREAMS = (
    (HYDRANT_BEHIND, NEAR_CAR, NOT_THAT),
    (HYDRANT_BEHIND, "the cone is on your left", NEAR_CAR, NOT_THAT),
    ("go to the hydrant", "the hydrant is in front of the car",
     "there is a cone near the hydrant", NOT_THAT),
    ("go to the car on your left", "the cone is behind the car", "go to the hydrant",
     "the hydrant is right of the cone"),
)  # fmt: skip
SLOW = [pytest.param(one, marks=pytest.mark.slow) for one in STREAMS[1:]]


@functools.cache
def robot() -> api.Navigator:
    one = api.Navigator.pretrained("faithful")
    config = NavigatorConfig(map=MapConfig(num_particles=256, num_objects=6, num_cells=24))
    return api.Navigator(grounder=one.grounder, params=one.params, config=config)


@functools.cache
def looking():
    """Build one filter step of many beliefs that have heard the same."""

    def step(key, belief, readings, told, look, numbers):
        return semantic_filter.step(key, belief, readings, look, params=numbers, context=told)[0]

    many = jax.vmap(step, in_axes=(0, 0, None, None, None, None))
    return jax.jit(many)


def see(pose):
    found = [
        (kind, x - pose[0], y - pose[1])
        for kind, x, y in OBJECTS
        if np.hypot(x - pose[0], y - pose[1]) <= RANGE
    ]
    return by_hand.observation(np.array(pose), found, by_hand.sensor(RANGE, noise=0.02))


def converse(texts):
    """Say one thing after the other, with a look after each; the words, and beliefs [S, ...]."""
    state = robot().start(texts[0], pose=POSES[0], area=by_hand.AREA)
    beliefs = jax.tree.map(lambda leaf: jnp.stack([leaf] * SEEDS), state.belief)
    numbers = by_hand.params(concentration=ALPHA, odometry_noise=1e-3)
    for index, (text, pose) in enumerate(zip(texts, POSES, strict=False)):
        if index:
            here = replace(state.belief, last_pose=jnp.asarray(pose, jnp.float32))
            state = replace(state, belief=here)
            state = correct(state, beliefs) if text == NOT_THAT else robot().hear(state, text)
            asked = jnp.ones_like(beliefs.must_ground)
            beliefs = replace(beliefs, must_ground=asked)
        keys = jax.random.split(jax.random.fold_in(jax.random.key(11), index), SEEDS)
        readings, told = state.instruction.readings, state.talk.context
        beliefs = looking()(keys, beliefs, readings, told, see(pose), numbers)
    return state, beliefs


def correct(state, beliefs):
    """Rule out the hydrant that was seen first."""
    types = np.asarray(beliefs.particles.object_type)[0, :, 0]
    slot = jnp.int32(np.flatnonzero(types == HYDRANT)[0])
    return speech_acts.correct(replace(state, talk=replace(state.talk, approached=slot)))


def said_in(state, reading: int = 0):
    """Read off what was said: mentions but the robot, relations, from where, and what is not."""
    table, told = jax.device_get((state.instruction.readings, state.talk.context))
    types = table.mention_type[reading]
    things = [m for m, kind in enumerate(types) if kind >= 0]
    place = {m: index for index, m in enumerate(things)}
    edges, viewers = [], []
    for j, figure in enumerate(table.figure[reading]):
        if figure == NONE:
            continue
        landmark = table.landmark[reading, j]
        end = ROBOT if types[landmark] == ROBOT else place.get(int(landmark), NONE)
        end = NONE if landmark == NONE else end
        edges.append((place[int(figure)], int(table.relation[reading, j]), end, False))
        viewers.append(tuple(told.viewer[reading, j].tolist()))
    bits = told.excluded[reading]
    excluded = {place[m]: [s for s in range(6) if bits[m] >> s & 1] for m in things if bits[m]}
    return things, [int(types[m]) for m in things], edges, viewers, excluded


@pytest.mark.parametrize("texts", [STREAMS[0], *SLOW])
def test_a_stream_equals_enumeration(texts) -> None:
    state, beliefs = converse(texts)
    particles = jax.tree.map(np.asarray, beliefs.particles)
    weight = np.exp(np.asarray(beliefs.log_weight, float))
    types = particles.object_type
    assert (types == types[:1, :, :1]).all()
    number = int((types[0, :, 0] != NONE).sum())
    seen = [
        (int(types[0, s, 0]), float(particles.mean_x[:, s].mean()),
         float(particles.mean_y[:, s].mean()))
        for s in range(number)
    ]  # fmt: skip
    assert len(seen) >= 4
    miss = np.exp(np.asarray(beliefs.coverage.log_miss, float)).mean(0)
    world = small_world(seen, miss, fineness=2)
    things, kinds, edges, viewers, excluded = said_in(state)
    assert len(set(viewers)) == len(texts) - (NOT_THAT in texts) or "go to the hydrant" in texts
    assert bool(excluded) == (NOT_THAT in texts)
    truth = exact.stream(world, kinds, edges, viewers, excluded)
    is_first = particles.reading == 0
    for index, mention in enumerate(things):
        category = particles.referent[:, mention]
        category = np.where(category == NONE, number, category)
        hot = (category[..., None] == np.arange(number + 1)) & is_first[..., None]
        samples = (hot * weight[..., None]).sum(1)
        marginal = truth.sum(tuple(m for m in range(len(things)) if m != index))
        compare(samples, marginal)
