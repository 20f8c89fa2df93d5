"""Simulation-based calibration: worlds from the filter's own prior, ranks of the truth uniform."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import readings as by_hand
import scipy.stats

from jaxlangnav.inputs.object_types import MAX_LABELS
from jaxlangnav.messages import BEHIND, NEAR, NONE
from jaxlangnav.relations import default_params

HYDRANT, CONE = by_hand.HYDRANT, by_hand.CONE
ALPHA, DETECTION, NOISE, ODOMETRY = 0.5, 0.9, 0.1, 0.02
MISLEADING = float(by_hand.params().misleading)
X_MIN, X_MAX, Y_MIN, Y_MAX = by_hand.AREA
DRAWS = 7  # posterior draws a truth is ranked among: few, for particles share ancestors
SAME = 0.6  # metres within which a seen hydrant is the true one


@dataclasses.dataclass
class Truth:
    kind: np.ndarray  # [n]
    place: np.ndarray  # [n, 2], the figure first, then its landmark


def draw_offset(random: np.random.Generator, relation: int, landmark: np.ndarray) -> np.ndarray:
    free = default_params()
    distance = np.exp(
        random.normal(float(free.log_distance[relation]), float(free.log_distance_sd[relation]))
    )
    turn = random.vonmises(0.0, float(free.concentration[relation]))
    angle = np.arctan2(landmark[1], landmark[0]) + float(free.axis[relation]) + turn
    return distance * np.array([np.cos(angle), np.sin(angle)])


def draw_world(
    random: np.random.Generator, relation: int, clumping: float, is_pooled: bool
) -> Truth:
    """Draw a world; figure and landmark both lie in the area, or it is drawn again."""
    while True:
        landmark, figure = random.uniform([X_MIN, Y_MIN], [X_MAX, Y_MAX], (2, 2))
        if random.uniform() >= MISLEADING:
            figure = landmark + draw_offset(random, relation, landmark)
        if not (X_MIN < figure[0] < X_MAX and Y_MIN < figure[1] < Y_MAX):
            continue
        num_rates = 1 if is_pooled else 2
        rates = random.gamma(ALPHA / clumping, clumping, num_rates) if clumping else ALPHA
        counts = random.poisson(rates, 2)
        if counts.sum() > by_hand.CONFIG.num_objects - 2:
            continue
        others = random.uniform([X_MIN, Y_MIN], [X_MAX, Y_MAX], (counts.sum(), 2))
        kind = [HYDRANT, CONE] + [HYDRANT] * counts[0] + [CONE] * counts[1]
        return Truth(np.array(kind), np.concatenate([[figure], [landmark], others]))


def drive(random: np.random.Generator, world: Truth, reach: float, view: float):
    """Drive straight in a random direction; look at every step."""
    angle, position, odometry = random.uniform(-1.0, 1.0), np.zeros(2), np.zeros(2)
    step = random.uniform(0.5, 1.0) * np.array([np.cos(angle), np.sin(angle)])
    looks = []
    specification = by_hand.sensor(reach, view, DETECTION, NOISE)
    for _ in range(by_hand.STEPS):
        offset = world.place - position
        bearing = np.arctan2(offset[:, 1], offset[:, 0]) - angle
        is_seen = np.hypot(*offset.T) <= reach
        is_seen &= np.abs(np.angle(np.exp(1j * bearing))) <= 0.5 * view
        is_seen &= random.uniform(size=len(is_seen)) < DETECTION
        found = offset[is_seen] + random.normal(0.0, NOISE, (is_seen.sum(), 2))
        rows = [(int(name), *place) for name, place in zip(world.kind[is_seen], found, strict=True)]
        shuffled = [rows[index] for index in random.permutation(len(rows))]
        looks.append(by_hand.observation(np.array([*odometry, angle]), shuffled, specification))
        position = position + step + random.normal(0.0, ODOMETRY * np.hypot(*step), 2)
        odometry = odometry + step
    return by_hand.stack(looks)


def simulate(
    relation: int,
    rounds: int,
    seed: int,
    reach: float = 3.0,
    view: float = 2 * np.pi,
    clumping: float = 0.0,
    is_pooled: bool = False,
):
    """Run rounds × SEEDS episodes: truths f64[E, 2], draws of the posterior f64[E, DRAWS, 2].

    For each hydrant seen, and for none of them: P(it is the one meant), and whether it is.
    """
    random = np.random.default_rng(seed)
    sentence = by_hand.readings([[HYDRANT, CONE]], [[(0, relation, 1, False)]])
    numbers = by_hand.params(concentration=ALPHA, odometry_noise=ODOMETRY, clumping=clumping)
    spoken = jnp.arange(MAX_LABELS) < 2
    pooled = {"spoken": spoken, "pools_counts": True} if is_pooled else {}
    truths, draws, believed, happened, start = [], [], [], [], 0
    for index in range(rounds):
        worlds = [draw_world(random, relation, clumping, is_pooled) for _ in range(by_hand.SEEDS)]
        beliefs, _ = by_hand.run_many(
            jax.random.split(jax.random.key(seed + index), by_hand.SEEDS),
            by_hand.repeat(by_hand.begin(), by_hand.SEEDS),
            by_hand.repeat(sentence, by_hand.SEEDS),
            by_hand.stack([drive(random, world, reach, view) for world in worlds]),
            numbers,
            **pooled,
        )
        weight = np.exp(np.asarray(beliefs.log_weight, float))
        particles = jax.tree.map(np.asarray, beliefs.particles)
        for lane, world in enumerate(worlds):
            truth = world.place[0]
            share = weight[lane] / weight[lane].sum()
            chosen = random.choice(share.size, DRAWS, p=share)
            draws.append([place_of(random, particles, lane, one) for one in chosen])
            truths.append(truth)
            referent = particles.referent[lane, 0]
            for slot in np.flatnonzero(particles.object_type[lane, :, 0] == HYDRANT):
                place = particles.mean_x[lane, slot, 0], particles.mean_y[lane, slot, 0]
                believed.append((share * (referent == slot)).sum())
                happened.append(np.hypot(*(place - truth)) < SAME)
            believed.append((share * (referent == NONE)).sum())
            happened.append(not any(happened[start:]))
            start = len(happened)
    return tuple(np.array(part) for part in (truths, draws, believed, happened))


def place_of(random: np.random.Generator, particles, lane: int, index: int) -> np.ndarray:
    """Draw the figure's place from one particle: its hypothesis, or the seen object's Gaussian."""
    slot = particles.referent[lane, 0, index]
    if slot == NONE:
        return np.array(
            [particles.hypothesis_x[lane, 0, index], particles.hypothesis_y[lane, 0, index]]
        )
    variance = particles.covariance[lane, slot, slot, index]
    mean = particles.mean_x[lane, slot, index], particles.mean_y[lane, slot, index]
    return random.normal(mean, np.sqrt(variance))


def check_ranks(truth: np.ndarray, draws: np.ndarray, level: float) -> None:
    """Chi-square test that ranks are uniform on 0 … DRAWS."""
    rank = (draws < truth[:, None]).sum(1)
    count = np.bincount(rank, minlength=DRAWS + 1)
    assert scipy.stats.chisquare(count).pvalue > level, count


def check_events(believed: np.ndarray, happened: np.ndarray) -> None:
    """What is believed with probability p happens in a share p: five bins, 5 standard errors."""
    for low, high in ((-0.01, 0.02), (0.02, 0.25), (0.25, 0.75), (0.75, 0.98), (0.98, 1.01)):
        chosen = (believed > low) & (believed < high)
        # A belief of P particles is known to 1 / P at best, which matters at 0 and at 1.
        allowed = 5 * np.sqrt((believed * (1 - believed))[chosen].sum() + 1.0)
        allowed += chosen.sum() / by_hand.CONFIG.num_particles
        assert abs((believed - happened)[chosen].sum()) < allowed, (low, high)
    error = np.abs(believed - happened).mean() - 2 * (believed * (1 - believed)).mean()
    assert abs(error) < 0.03


def check(relation: int, rounds: int, seed: int, level: float, **sensor: Any) -> None:
    truths, draws, believed, happened = simulate(relation, rounds, seed, **sensor)
    assert happened.mean() > 0.1
    for axis in (0, 1):
        check_ranks(truths[:, axis], draws[..., axis], level)
    # Distance from the start: what the planner lives on.
    check_ranks(np.hypot(*truths.T), np.hypot(draws[..., 0], draws[..., 1]), level)
    check_events(believed, happened)


SLOW = pytest.mark.slow
CASES = {
    "its own worlds": ((2, 11, 0.001), {}, ()),
    "how many there are not known": ((4, 23, 0.001), {"clumping": 1.0}, ()),
    "one rate for all types": ((8, 29, 0.001), {"clumping": 2.0, "is_pooled": True}, SLOW),
    "thousands of worlds": ((18, 100 + BEHIND, 0.01), {}, SLOW),
    "thousands of worlds, near": ((18, 100 + NEAR, 0.01), {"relation": NEAR}, SLOW),
    "a sensor of 1.5 m": ((16, 500, 0.001), {"reach": 1.5}, SLOW),
    "a sensor of 6 m": ((16, 500, 0.001), {"reach": 6.0}, SLOW),
    "a view of 90 degrees": ((16, 500, 0.001), {"view": np.pi / 2}, SLOW),
}


@pytest.mark.parametrize(
    ("rounds", "seed", "level", "more"),
    [pytest.param(*drawn, more, marks=marks) for drawn, more, marks in CASES.values()],
    ids=CASES,
)
def test_calibrated(rounds: int, seed: int, level: float, more: dict[str, Any]) -> None:
    check(**({"relation": BEHIND} | more), rounds=rounds, seed=seed, level=level)
