"""Worlds drawn from the belief's own prior: what the robot assumes before it has looked.

The semantic map's model of a world (section 3.2, eq. 7a; ``semantic_map.proposal.sample`` has it):
the sentence has one reading, drawn by its probability; every thing it mentions exists once, one of
them anywhere in the operating area and the others where the relations place them; further objects
of each type mentioned are a Poisson process of α expected in the area; a relation misleads with
probability ε, and then says nothing of where its figure is. Belief held against the truth in such
worlds must be calibrated, whatever the policy, for nothing in it is then mistaken but its
arithmetic.

A superlative weighs a whole world by how far another object of the figure's type beats it. The
filter weighs it by the rivals that have been *seen*, which tends to the same as the search ends.
"""

import functools
from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.episode import Task
from jaxlangnav.experiments.calibration import Tally
from jaxlangnav.experiments.reliability import TALLY_PROGRAM
from jaxlangnav.experiments.monte_carlo import run_tasks
from jaxlangnav.experiments.policies import DEFAULT_PARTICLES, navigator_config
from jaxlangnav.experiments.rows import RowSpec
from jaxlangnav.experiments.tasks import SENTENCES, Cell, GroundedSentences, concatenate
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import NONE, ROBOT, Readings
from jaxlangnav.navigator import NavigatorParams, default_params
from jaxlangnav.relations import (
    SIDES,
    density_of,
    robot_frame,
    sample_pdf,
    to_map,
    viewer_frame,
)
from jaxlangnav.relations.density import SIDE_CONCENTRATION
from jaxlangnav.relations.strength import degree
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.world.state import Scenario

_NUM_SLOTS = 8
"""O, object slots of a world, as many as the filter has."""
_NUM_ATTEMPTS = 64
"""Worlds tried at once; the first that fits the area and the slots is taken."""
OWN_AREA = (0.0, 13.0, -9.2, 9.2)
"""Metres; the operating area of the template 1H1C."""


def check_readings(readings: Readings) -> None:
    """Refuse what cannot be drawn thing by thing (host only).

    Relations are drawn from the last to the first, each placing its figure against a landmark
    that stands by then: chains such as "the hydrant behind the cone near the car", not two
    relations of one figure.

    Args:
        readings: of one sentence, leaves [K, …].

    Raises:
        ValueError: a reading places one figure twice, uses a figure as a later landmark, or
            states an order ("the second").
    """
    figure, landmark = np.asarray(readings.figure), np.asarray(readings.landmark)
    rank, types = np.asarray(readings.rank), np.asarray(readings.mention_type)
    to_robot = np.take_along_axis(types, np.maximum(landmark, 0), axis=1) == ROBOT
    if (rank > np.where(to_robot & (landmark != NONE), 0, 1)).any():
        raise ValueError(
            'worlds cannot be drawn for an order ("the second", "the leftmost"): use a relation'
        )
    for reading in np.flatnonzero(np.asarray(readings.log_probability) > -np.inf):
        placed: set[int] = set()
        for index in range(figure.shape[1] - 1, -1, -1):
            one, against = int(figure[reading, index]), int(landmark[reading, index])
            if one == NONE:
                continue
            if one in placed:
                raise ValueError(
                    f"reading {reading} places mention {one} more than once: worlds can be drawn "
                    "for chains of relations only, with one relation for each figure"
                )
            placed |= {one, against}


def _place_mentions(
    key: Array,
    readings: Readings,
    reading: Array,
    is_told: Array,
    area: Array,
    start: Array,
    params: MapParams,
) -> tuple[Array, Array]:
    """Place what one reading mentions: f32[M] x and y, metres, map frame; bool[J] ``is_told``."""
    num_mentions, num_relations = readings.mention_type.shape[1], readings.figure.shape[1]
    uniform_key, normal_key = jax.random.split(key)
    uniform = jax.random.uniform(uniform_key, (2, num_mentions))
    x = area[0] + (area[1] - area[0]) * uniform[0]
    y = area[2] + (area[3] - area[2]) * uniform[1]
    normals = jax.random.normal(normal_key, (num_relations, 2))
    for index in range(num_relations - 1, -1, -1):
        relation = readings.relation[reading, index]
        figure, landmark = readings.figure[reading, index], readings.landmark[reading, index]
        is_robot = readings.mention_type[reading, landmark] == ROBOT
        from_x = jnp.where(is_robot, start[0], x[landmark])
        from_y = jnp.where(is_robot, start[1], y[landmark])
        model, used = params.relations, jnp.maximum(relation, 0)
        along, lateral = sample_pdf(density_of(model, used), model, used, *normals[index])
        frame = viewer_frame(start[0], start[1], from_x, from_y)
        offset_x, offset_y = to_map(frame, along, lateral)
        # A side of the robot is any place of the area, weighed by its direction later.
        is_side = is_robot & jnp.isin(relation, jnp.asarray(SIDES))
        is_placed = (jnp.arange(num_mentions) == figure) & (relation != NONE) & is_told[index]
        x = jnp.where(is_placed & ~is_side, from_x + offset_x, x)
        y = jnp.where(is_placed & ~is_side, from_y + offset_y, y)
    return x, y


def _draw_once(
    key: Array, readings: Readings, area: Array, start: Array, params: MapParams, num_slots: int
) -> Scenario:
    """Try once: ``is_valid`` says whether the world fits the area, the slots and the sentence."""
    reading_key, told_key, place_key, count_key, other_key, keep_key = jax.random.split(key, 6)
    reading = jax.random.categorical(reading_key, readings.log_probability)
    is_told = jax.random.uniform(told_key, readings.figure.shape[1:]) >= params.misleading
    mention_type = readings.mention_type[reading]
    num_mentions = mention_type.shape[0]
    is_mentioned = mention_type >= 0
    x, y = _place_mentions(place_key, readings, reading, is_told, area, start, params)
    is_inside = (x >= area[0]) & (x <= area[1]) & (y >= area[2]) & (y <= area[3])

    # Further objects of every type mentioned; a type mentioned twice has them once.
    mentions = jnp.arange(num_mentions)
    same = (mention_type[:, None] == mention_type[None, :]) & (mentions[:, None] > mentions[None])
    is_type = is_mentioned & ~jnp.any(same & is_mentioned[None, :], axis=1)
    counts = jax.random.poisson(count_key, params.concentration, (num_mentions,)) * is_type
    ends = jnp.cumsum(counts)
    slots = jnp.arange(num_slots)
    owner = jnp.sum(ends[:, None] <= slots[None, :], axis=0)
    other_type = mention_type[jnp.minimum(owner, num_mentions - 1)]
    is_other = slots < ends[-1]
    uniform = jax.random.uniform(other_key, (2, num_slots))
    other_x = area[0] + (area[1] - area[0]) * uniform[0]
    other_y = area[2] + (area[3] - area[2]) * uniform[1]

    types = jnp.concatenate([mention_type, jnp.where(is_other, other_type, NONE)])
    all_x, all_y = jnp.concatenate([x, other_x]), jnp.concatenate([y, other_y])
    is_object = jnp.concatenate([is_mentioned, is_other])
    goal = readings.figure[reading, 0]
    log_keep = _log_fit(readings, reading, is_told, types, is_object, all_x, all_y, start, params)
    is_kept = jnp.log(jax.random.uniform(keep_key, minval=1e-30)) < log_keep
    order = jnp.argsort(~is_object, stable=True)[:num_slots]
    return Scenario(
        object_type=jnp.where(is_object[order], types[order], NONE),
        object_x=jnp.where(is_object[order], all_x[order], 0.0),
        object_y=jnp.where(is_object[order], all_y[order], 0.0),
        is_object=is_object[order],
        goal=jnp.stack([x[goal], y[goal]]),
        goal_index=jnp.argmax(order == goal).astype(jnp.int32),
        start=start,
        area=area,
        is_valid=jnp.all(is_inside | ~is_mentioned)
        & (jnp.sum(is_object) <= num_slots)
        & (goal != NONE)
        & is_kept,
    )


def _log_fit(
    readings: Readings,
    reading: Array,
    is_told: Array,
    types: Array,
    is_object: Array,
    x: Array,
    y: Array,
    start: Array,
    params: MapParams,
) -> Array:
    """Weigh a world by superlatives (rivals that beat the figure) and sides of the robot, ≤ 0."""
    log_weight, own = jnp.float32(0.0), robot_frame(start[2])
    for index in range(readings.figure.shape[1]):
        figure, landmark = readings.figure[reading, index], readings.landmark[reading, index]
        is_robot = readings.mention_type[reading, landmark] == ROBOT
        from_x = jnp.where(is_robot, start[0], x[landmark])
        from_y = jnp.where(is_robot, start[1], y[landmark])
        away = jnp.hypot(x - from_x, y - from_y)
        gap = -degree(readings.relation[reading, index], away, jnp.zeros_like(away))
        is_rival = is_object & (types == types[figure]) & (jnp.arange(x.shape[0]) != landmark)
        excess = gap[figure] - jnp.min(jnp.where(is_rival, gap, gap[figure]))
        applies = (readings.rank[reading, index] == 1) & (figure != NONE) & (landmark != NONE)
        applies = applies & is_told[index]
        log_weight = log_weight - jnp.where(applies, excess / params.superlative_softness, 0.0)
        relation = readings.relation[reading, index]
        off_x, off_y = x[figure] - from_x, y[figure] - from_y
        along = off_x * own.along_x + off_y * own.along_y
        lateral = off_x * own.lateral_x + off_y * own.lateral_y
        axis_x, axis_y = params.relations.axis_along, params.relations.axis_lateral
        cosine = (along * axis_x[relation] + lateral * axis_y[relation]) / jnp.hypot(off_x, off_y)
        is_side = is_robot & jnp.isin(relation, jnp.asarray(SIDES)) & is_told[index]
        # Relative to the side's own axis, so that it may decide whether a world is kept.
        log_weight = log_weight + jnp.where(is_side, SIDE_CONCENTRATION * (cosine - 1.0), 0.0)
    return log_weight


@functools.partial(jax.jit, static_argnames=("num_slots", "num_attempts"))
def draw_own_world(
    key: Array,
    readings: Readings,
    area: Array,
    start: Array,
    *,
    params: MapParams,
    num_slots: int = _NUM_SLOTS,
    num_attempts: int = _NUM_ATTEMPTS,
) -> Scenario:
    """Draw one world of which the sentence is true in the sense of the belief.

    The goal is the figure of the sentence's first relation.

    Args:
        key: random key.
        readings: of one sentence, leaves [K, …]; see ``check_readings``.
        area: f32[4], operating area x_min, x_max, y_min, y_max, metres.
        start: f32[3], x, y, heading of robot and speaker, metres and radians, map frame.
        params: relations, concentration.
        num_slots: O.
        num_attempts: worlds tried at once.

    Returns:
        The world; ``is_valid`` is False where no attempt fitted the area and the slots.
    """
    draw = functools.partial(_draw_once, num_slots=num_slots)
    attempts = jax.vmap(draw, in_axes=(0, None, None, None, None))(
        jax.random.split(key, num_attempts), readings, area, start, params
    )
    return jax.tree.map(lambda leaf: leaf[jnp.argmax(attempts.is_valid)], attempts)


def own_tasks(
    one: Cell, runs: int, instructions: Instruction, area: Array, start: Array, *, params: MapParams
) -> Task:
    """Draw the episodes of a cell in worlds of the belief's own prior.

    Args:
        one: seed, sentence, sensor and odometry; ``world`` and ``relation`` are not read.
        runs: number of episodes.
        instructions: leaves [I, …].
        area: f32[4], operating area, metres.
        start: f32[3], x, y, heading, metres and radians, map frame.
        params: of the belief.

    Returns:
        Tasks, leaves [E, …].

    Raises:
        ValueError: a sentence whose worlds cannot be drawn; see ``check_readings``.
    """
    readings = jax.tree.map(lambda leaf: leaf[one.instruction_index], instructions.readings)
    check_readings(readings)
    numbers = jnp.arange(runs, dtype=jnp.uint32)

    @jax.jit
    def draw(number: Array) -> tuple[Array, Scenario]:
        keys = jax.random.split(jax.random.fold_in(jax.random.key(one.seed), number))
        return keys[1], draw_own_world(keys[0], readings, area, start, params=params)

    parts = []
    for begin in range(0, runs, 256):
        keys, scenario = jax.vmap(draw)(numbers[begin : begin + 256])
        size = keys.shape[0]
        parts.append(
            Task(
                key=keys,
                scenario=scenario,
                instruction_index=jnp.full(size, one.instruction_index, jnp.int32),
                sensor=jax.tree.map(lambda leaf, n=size: jnp.broadcast_to(leaf, (n,)), one.sensor),
                motion=jax.tree.map(lambda leaf, n=size: jnp.broadcast_to(leaf, (n,)), one.motion),
            )
        )
    return concatenate(parts)


def judge_own_worlds(
    sentences: GroundedSentences,
    ranges: Mapping[str, float],
    *,
    policy: str,
    episodes: int,
    seed: int,
    area: tuple[float, float, float, float] = OWN_AREA,
    num_particles: int = DEFAULT_PARTICLES,
    params: NavigatorParams | None = None,
    max_steps: int = 50,
) -> dict[str, Tally]:
    """Judge the belief step by step in worlds of its own prior.

    Args:
        sentences: grounded, in the order of ``SENTENCES``.
        ranges: which of them, by name, and how far the robot sees in metres.
        policy: "informed" or "faithful".
        episodes: of each sentence.
        seed: root seed of worlds and noise.
        area: operating area x_min, x_max, y_min, y_max, metres; the robot starts at the origin.
        num_particles: P.
        params: the navigator's numbers; its defaults if None.
        max_steps: cycles that are judged; all episodes of a batch wait for the longest.

    Returns:
        Sums of every sentence by name, leaves [E, S, …]; see ``calibration.scores``.
    """
    numbers = default_params() if params is None else params
    bounds, start = jnp.asarray(area, jnp.float32), jnp.zeros(3, jnp.float32)
    found = {}
    for name, reach in ranges.items():
        one = RowSpec(world="own", range=reach, relation=name).setting(seed=seed)
        tasks = own_tasks(one, episodes, sentences.instructions, bounds, start, params=numbers.map)
        if not bool(np.all(np.asarray(tasks.scenario.is_valid))):
            raise ValueError(f'no world fits "{SENTENCES[name]}" in the area {area}: enlarge it')
        _, found[name] = run_tasks(
            tasks,
            sentences.instructions,
            params=numbers,
            config=navigator_config(policy, num_particles),
            max_steps=max_steps,
            program=TALLY_PROGRAM,
        )
    return found
