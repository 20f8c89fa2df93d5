"""Robots to compare with: known map, nearest frontier, lawnmower (section 4.2 and its limits).

All run in the same worlds with the same noise as the navigator: whatever differs is the policy.

- ``known``: the whole map and its own true position. The column *Known* of Table 2.
- ``frontier``: the operating area, and that the goal is of the sentence's figure type. It goes to
  the nearest edge of what it has seen, and to the first object of that type that it sees.
- ``lawnmower``: the same, but it sweeps the operating area in lanes as wide as it sees.
- ``arc``: the same, but it knows the law of the worlds: hydrants stand within ±45° ahead, about 0.7
  of the area's depth away. It sweeps along that arc, then along one farther out and one nearer.

None of the last three reads the relation; of two hydrants they are right half of the time.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.episode import EpisodeResult, Task
from jaxlangnav.episode.lanes import EpisodeProgram
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import Observation, SensorParams, Status
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.planner.graph import frontiers
from jaxlangnav.planner.params import default_planner_params
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.coverage import Coverage, add_view, log_miss_at, unexplored
from jaxlangnav.terrain import OPEN
from jaxlangnav.terrain.view import eye_of
from jaxlangnav.world import simulator
from jaxlangnav.world.motion import plain_action as plain_action
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.simulator import drive_known_map
from jaxlangnav.world.state import WorldState

NextPlace = Callable[[Array, Array, Array], Array]
"""From area, range and waypoints reached to the next waypoint, f32[2]."""
_LANE_MARGINS = (1.0, 0.3)
"""How far from the edge a lane ends, as a share of the range: on the first pass and later on. The
first pass turns as early as it can and leaves corners out of view; later ones look there."""
_ARC_POINTS = 8
_ARC_RADII = (0.0, 1.6, -1.6)  # of the passes: metres from the likeliest range, in sensing ranges
_ARC_DEPTH, _ARC_MARGIN = 0.66, 0.8
"""Likeliest range as a share of the area's depth; how much of its range it stays from the edge."""
_ARRIVAL = 0.5  # metres from a waypoint of the search at which it counts as reached
_NUM_CELLS, _NUM_BLOCKS = 32, 8
_FRONTIER_MISS = 0.5


def _lane_waypoint(area: Array, range_max: Array, leg: Array) -> Array:
    """Compute a waypoint of the sweep of an area; after the last it begins anew."""
    depth, width = area[1] - area[0], area[3] - area[2]
    num_lanes = jnp.maximum(jnp.ceil(depth / (2.0 * range_max)).astype(jnp.int32), 1)
    at = leg % (2 * num_lanes)
    lane = at // 2
    is_far = ((at + 1) // 2) % 2 == 1  # near, far, far, near, near, far, ...
    share = jnp.where(leg < 2 * num_lanes, _LANE_MARGINS[0], _LANE_MARGINS[1])
    margin = jnp.minimum(share * range_max, 0.5 * width)
    x = area[0] + (lane.astype(jnp.float32) + 0.5) * depth / num_lanes.astype(jnp.float32)
    return jnp.stack([x, jnp.where(is_far, area[3] - margin, area[2] + margin)])


def _arc_waypoint(area: Array, range_max: Array, leg: Array) -> Array:
    """Compute a waypoint of the sweep by the worlds' law; after three arcs it goes on in lanes."""
    depth = area[1] - area[0]
    sweep, point = leg // _ARC_POINTS, leg % _ARC_POINTS
    offset = jnp.asarray(_ARC_RADII)[jnp.minimum(sweep, len(_ARC_RADII) - 1)]
    radius = jnp.clip(_ARC_DEPTH * depth + offset * range_max, 0.2 * depth, 0.95 * depth)
    reach = jnp.clip(
        jnp.pi / 4 - jnp.arcsin(jnp.minimum(_ARC_MARGIN * range_max / radius, 0.99)), 0
    )
    share = point.astype(jnp.float32) / (_ARC_POINTS - 1)
    angle = reach * (2.0 * share - 1.0) * jnp.where(sweep % 2 == 0, 1.0, -1.0)
    lane = _lane_waypoint(area, range_max, leg - _ARC_POINTS * len(_ARC_RADII))
    middle = 0.5 * (area[2] + area[3])
    arc = jnp.stack([area[0] + radius * jnp.cos(angle), middle + radius * jnp.sin(angle)])
    return jnp.where(sweep < len(_ARC_RADII), arc, lane)


@pytree
class Explorer:
    """What a baseline remembers; positions by its own dead reckoning, metres."""

    coverage: Coverage
    target: Array  # f32[2] the object it makes for
    has_target: Array  # bool[]
    waypoint: Array  # f32[2] where it is exploring to
    leg: Array  # i32[] waypoints reached


@pytree
class _Run:
    task: Task
    figure_type: Array  # i32[] of the sentence
    explorer: Explorer
    world: WorldState
    steps: Array  # i32[]
    is_stopped: Array  # bool[]


def _figure_type(instruction: Instruction) -> Array:
    """Read from the most probable reading which type of object a sentence asks for, i32[]."""
    readings = instruction.readings
    best = jnp.argmax(readings.log_probability)
    return readings.mention_type[best, jnp.maximum(readings.figure[best, 0], 0)]


def _notice(explorer: Explorer, observation: Observation, figure_type: Array) -> Explorer:
    """Take in what is seen: coverage, and the object to make for."""
    # The first object of the type becomes the target, of several the nearest; then it is put where
    # the detection nearest to it says.
    pose = observation.pose
    bearing = observation.detection_bearing + pose[2]
    x = pose[0] + observation.detection_range * jnp.cos(bearing)
    y = pose[1] + observation.detection_range * jnp.sin(bearing)
    is_figure = observation.is_detection & (observation.detection_type == figure_type)
    from_target = (x - explorer.target[0]) ** 2 + (y - explorer.target[1]) ** 2
    # Another object of the type, metres away, is not the target seen again.
    is_target = is_figure & (~explorer.has_target | (from_target < 4.0))
    rank = jnp.where(explorer.has_target, from_target, observation.detection_range)
    nearest = jnp.argmin(jnp.where(is_target, rank, jnp.inf))
    is_seen, sensor = jnp.any(is_target), observation.sensor
    eye = eye_of(pose[0], pose[1], pose[2], sensor)
    return replace(
        explorer,
        coverage=add_view(explorer.coverage, eye, sensor, OPEN.view),
        target=jnp.where(is_seen, jnp.stack([x[nearest], y[nearest]]), explorer.target),
        has_target=explorer.has_target | is_seen,
    )


def _explore_sweep(
    explorer: Explorer, pose: Array, sensor: SensorParams, waypoint: NextPlace
) -> Explorer:
    """Go on to the next waypoint of a sweep once this one is reached."""
    area = explorer.coverage.area
    left = waypoint(area, sensor.range_max, explorer.leg) - pose[:2]
    leg = explorer.leg + (jnp.hypot(left[0], left[1]) < _ARRIVAL).astype(jnp.int32)
    return replace(explorer, waypoint=waypoint(area, sensor.range_max, leg), leg=leg)


def _explore_frontiers(explorer: Explorer, pose: Array, sensor: SensorParams) -> Explorer:
    """Keep the chosen frontier until it has been looked at; then take the nearest one."""
    coverage, former = explorer.coverage, explorer.waypoint
    x, y, is_frontier = frontiers(coverage, _NUM_BLOCKS, jnp.float32(_FRONTIER_MISS))
    squared = (x - pose[0]) ** 2 + (y - pose[1]) ** 2
    is_open = is_frontier & (squared > (0.5 * _ARRIVAL) ** 2)
    nearest = jnp.argmin(jnp.where(is_open, squared, jnp.inf))
    worst = jnp.max(coverage.log_miss)
    there = log_miss_at(coverage, former[0], former[1])
    remaining = jnp.hypot(former[0] - pose[0], former[1] - pose[1])
    keeps = (explorer.leg > 0) & (remaining > _ARRIVAL)
    keeps = keeps & (there > worst + jnp.log(jnp.float32(_FRONTIER_MISS)))
    return replace(
        explorer,
        waypoint=jnp.where(keeps, former, jnp.stack([x[nearest], y[nearest]])),
        leg=explorer.leg + (~keeps).astype(jnp.int32),
    )


def _begin(task: Task, instructions: Instruction, *, config: NavigatorConfig) -> _Run:
    """Put an episode at its start; of a sentence only the type of its first figure is read."""
    nowhere, no = jnp.zeros(2), jnp.asarray(False)
    explorer = Explorer(
        coverage=unexplored(task.scenario.area, _NUM_CELLS),
        target=nowhere,
        has_target=no,
        waypoint=nowhere,
        leg=jnp.int32(0),
    )
    return _Run(
        task=task,
        figure_type=jax.vmap(_figure_type)(instructions)[task.instruction_index],
        explorer=explorer,
        world=simulator.reset(task.scenario),
        steps=jnp.int32(0),
        is_stopped=no,
    )


def _advance(
    run: _Run, *, params: object, config: NavigatorConfig, explore_on: Callable[..., Explorer]
) -> tuple[_Run, None]:
    task = run.task
    # The very keys of episode.advance: common random numbers for all policies.
    sense_key, _, move_key = jax.random.split(jax.random.fold_in(task.key, run.steps), 3)
    observation = sense(sense_key, run.world, task.scenario, task.sensor, task.told)
    explorer = _notice(run.explorer, observation, run.figure_type)
    explorer = explore_on(explorer, observation.pose, task.sensor)
    # It makes for the target if there is one, and stops where the navigator would.
    has_target = explorer.has_target
    place = jnp.where(has_target, explorer.target, explorer.waypoint)
    step = place - observation.pose[:2]
    is_near = jnp.hypot(step[0], step[1]) <= default_planner_params().reach
    action = plain_action(place, step, has_target & is_near)
    world = task.body.move(move_key, run.world, action, task.motion)
    return replace(
        run, explorer=explorer, world=world, steps=run.steps + 1, is_stopped=action.is_stop
    ), None


def _drive_known(run: _Run, *, params: object, config: NavigatorConfig) -> tuple[_Run, None]:
    """Run a whole episode of a robot that knows the map."""
    task = run.task
    world, is_there = drive_known_map(task.key, task.scenario, task.motion)
    steps = jnp.ceil(world.distance / task.motion.step_length).astype(jnp.int32)
    return replace(run, world=world, steps=steps, is_stopped=is_there), None


def _finish(run: _Run) -> EpisodeResult:
    """Judge an episode; a baseline has no particles to lose."""
    world, scenario = run.world, run.task.scenario
    counts: dict[str, Any] = dict.fromkeys(
        ("overflow", "degenerate", "contradictions", "faults"), jnp.int32(0)
    )
    return EpisodeResult(
        is_success=simulator.is_success(world, scenario, run.is_stopped),
        is_stopped=run.is_stopped,
        ending=jnp.where(run.is_stopped, int(Status.ARRIVED), int(Status.SEARCHING)),
        distance=world.distance,
        steps=run.steps,
        final=world.position,
        goal_distance=simulator.goal_distance(world, scenario),
        **counts,
        mean_effective_sample_size=jnp.float32(0.0),
        is_valid=scenario.is_valid,
    )


def _course(explore_on: Callable[..., Explorer]) -> EpisodeProgram:
    return EpisodeProgram(
        begin=_begin,
        advance=functools.partial(_advance, explore_on=explore_on),
        finish=_finish,
        progress=lambda run: run,
        is_done=lambda run: run.is_stopped,
    )


BASELINES = {
    "frontier": _course(_explore_frontiers),
    "lawnmower": _course(functools.partial(_explore_sweep, waypoint=_lane_waypoint)),
    "arc": _course(functools.partial(_explore_sweep, waypoint=_arc_waypoint)),
    "known": _course(_explore_frontiers)._replace(
        advance=_drive_known, is_done=lambda run: jnp.ones_like(run.is_stopped)
    ),
}
"""Of ``run_tasks``, by name; they read neither params nor configuration."""
