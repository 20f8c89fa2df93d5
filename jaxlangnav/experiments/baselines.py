"""Baseline policies: known map, nearest frontier, lawnmower and arc coverage (section 4.2).

All run in the same worlds with the same noise as the navigator: only the policy differs.

- ``known``: knows the map and its true position. The column *Known* of Table 2.
- ``frontier``: knows the operating area and the type of the sentence's figure. It goes to the
  nearest frontier, and to the first object of that type that it detects.
- ``lawnmower``: the same, but it covers the operating area in lanes as wide as its field of view.
- ``arc``: the same, but it knows the distribution of the worlds: hydrants within ±45° ahead, about
  0.7 of the area's depth away. It follows that arc, then one farther out and one nearer.

The last three ignore the relation; of two hydrants they choose the right one half of the time.
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.episode import COUNTS, EpisodeResult, Task
from jaxlangnav.episode.lanes import EpisodeProgram
from jaxlangnav.grounding.instruction import Instruction
from jaxlangnav.messages import Observation, Status
from jaxlangnav.navigator import NavigatorConfig
from jaxlangnav.planner.graph import frontiers
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.pytree import pytree, replace
from jaxlangnav.semantic_map.coverage import Coverage, add_view, empty_coverage, log_miss_at
from jaxlangnav.terrain import OPEN
from jaxlangnav.terrain.view import eye_of
from jaxlangnav.world import simulator
from jaxlangnav.world.motion import move_or_stop as move_or_stop
from jaxlangnav.world.sensor import sense
from jaxlangnav.world.simulator import drive_known_map
from jaxlangnav.world.state import WorldState

WaypointFn = Callable[[Array, Array, Array], Array]
"""Maps area, range and number of waypoints reached to the next waypoint, f32[2]."""
_LANE_MARGINS = (1.0, 0.3)
"""Distance of a lane's end from the edge, as a fraction of the range: on the first pass and later.
The first pass turns early and leaves corners unseen; later ones cover them."""
_ARC_POINTS = 8
_ARC_RADII = (0.0, 1.6, -1.6)  # of the passes: offset from the likeliest radius, in sensing ranges
_ARC_DEPTH, _ARC_MARGIN = 0.66, 0.8
"""Most likely radius as a fraction of the area's depth; margin to the edge, in sensing ranges."""
_ARRIVAL_RADIUS = 0.5  # metres within which a waypoint of the search counts as reached
_NUM_CELLS, _NUM_BLOCKS = 32, 8
_FRONTIER_MISS = 0.5


def _lane_waypoint(area: Array, range_max: Array, leg: Array) -> Array:
    """Compute a waypoint of the lawnmower path; after the last it starts again."""
    depth, width = area[1] - area[0], area[3] - area[2]
    num_lanes = jnp.maximum(jnp.ceil(depth / (2.0 * range_max)).astype(jnp.int32), 1)
    index = leg % (2 * num_lanes)
    lane = index // 2
    is_far = ((index + 1) // 2) % 2 == 1  # near, far, far, near, near, far, ...
    fraction = jnp.where(leg < 2 * num_lanes, _LANE_MARGINS[0], _LANE_MARGINS[1])
    margin = jnp.minimum(fraction * range_max, 0.5 * width)
    x = area[0] + (lane.astype(jnp.float32) + 0.5) * depth / num_lanes.astype(jnp.float32)
    return jnp.stack([x, jnp.where(is_far, area[3] - margin, area[2] + margin)])


def _arc_waypoint(area: Array, range_max: Array, leg: Array) -> Array:
    """Compute a waypoint of the arc path; after three arcs it continues as a lawnmower path."""
    depth = area[1] - area[0]
    sweep, point = leg // _ARC_POINTS, leg % _ARC_POINTS
    offset = jnp.asarray(_ARC_RADII)[jnp.minimum(sweep, len(_ARC_RADII) - 1)]
    radius = jnp.clip(_ARC_DEPTH * depth + offset * range_max, 0.2 * depth, 0.95 * depth)
    max_angle = jnp.clip(
        jnp.pi / 4 - jnp.arcsin(jnp.minimum(_ARC_MARGIN * range_max / radius, 0.99)), 0
    )
    fraction = point.astype(jnp.float32) / (_ARC_POINTS - 1)
    angle = max_angle * (2.0 * fraction - 1.0) * jnp.where(sweep % 2 == 0, 1.0, -1.0)
    lane = _lane_waypoint(area, range_max, leg - _ARC_POINTS * len(_ARC_RADII))
    middle = 0.5 * (area[2] + area[3])
    arc = jnp.stack([area[0] + radius * jnp.cos(angle), middle + radius * jnp.sin(angle)])
    return jnp.where(sweep < len(_ARC_RADII), arc, lane)


@pytree
class _Run:
    """State of an episode; positions by dead reckoning, metres."""

    task: Task
    figure_type: Array  # i32[] of the sentence
    world: WorldState
    coverage: Coverage
    target: Array  # f32[2] the object it drives to
    has_target: Array  # bool[] an object of the figure's type has been detected
    waypoint: Array  # f32[2] current waypoint of the search
    leg: Array  # i32[] waypoints reached
    steps: Array  # i32[] decision cycles so far
    is_stopped: Array  # bool[] it has reported arrival


def _figure_type(instruction: Instruction) -> Array:
    """Extract the figure's object type from the most probable reading, i32[]."""
    readings = instruction.readings
    best = jnp.argmax(readings.log_probability)
    return readings.mention_type[best, jnp.maximum(readings.figure[best, 0], 0)]


def _update_target(run: _Run, observation: Observation) -> _Run:
    # The first object of the type becomes the target, of several the nearest; later detections
    # update its position.
    pose = observation.pose
    bearing = observation.detection_bearing + pose[2]
    x = pose[0] + observation.detection_range * jnp.cos(bearing)
    y = pose[1] + observation.detection_range * jnp.sin(bearing)
    is_figure = observation.is_detection & (observation.detection_type == run.figure_type)
    squared_distance = (x - run.target[0]) ** 2 + (y - run.target[1]) ** 2
    # Gating: another object of the type, metres away, is not the target.
    is_target = is_figure & (~run.has_target | (squared_distance < 4.0))
    priority = jnp.where(run.has_target, squared_distance, observation.detection_range)
    nearest = jnp.argmin(jnp.where(is_target, priority, jnp.inf))
    is_observed, sensor = jnp.any(is_target), observation.sensor
    eye = eye_of(pose[0], pose[1], pose[2], sensor)
    return replace(
        run,
        coverage=add_view(run.coverage, eye, sensor, OPEN.view),
        target=jnp.where(is_observed, jnp.stack([x[nearest], y[nearest]]), run.target),
        has_target=run.has_target | is_observed,
    )


def _explore_sweep(run: _Run, waypoint: WaypointFn) -> _Run:
    """Advance to the next waypoint of a coverage path once the current one is reached."""
    area, range_max = run.coverage.area, run.task.sensor.range_max
    offset = waypoint(area, range_max, run.leg) - run.world.odometry[:2]
    leg = run.leg + (jnp.hypot(offset[0], offset[1]) < _ARRIVAL_RADIUS).astype(jnp.int32)
    return replace(run, waypoint=waypoint(area, range_max, leg), leg=leg)


def _explore_frontiers(run: _Run) -> _Run:
    """Keep the current frontier until it is observed; then choose the nearest one."""
    coverage, current, pose = run.coverage, run.waypoint, run.world.odometry
    x, y, is_frontier = frontiers(coverage, _NUM_BLOCKS, jnp.float32(_FRONTIER_MISS))
    squared = (x - pose[0]) ** 2 + (y - pose[1]) ** 2
    is_open = is_frontier & (squared > (0.5 * _ARRIVAL_RADIUS) ** 2)
    nearest = jnp.argmin(jnp.where(is_open, squared, jnp.inf))
    max_log_miss = jnp.max(coverage.log_miss)
    log_miss = log_miss_at(coverage, current[0], current[1])
    remaining = jnp.hypot(current[0] - pose[0], current[1] - pose[1])
    is_pending = (run.leg > 0) & (remaining > _ARRIVAL_RADIUS)
    is_pending = is_pending & (log_miss > max_log_miss + jnp.log(jnp.float32(_FRONTIER_MISS)))
    return replace(
        run,
        waypoint=jnp.where(is_pending, current, jnp.stack([x[nearest], y[nearest]])),
        leg=run.leg + (~is_pending).astype(jnp.int32),
    )


def _begin(task: Task, instructions: Instruction, *, config: NavigatorConfig) -> _Run:
    """Initialise an episode; only the type of the sentence's figure is used."""
    origin, false, zero = jnp.zeros(2), jnp.asarray(False), jnp.int32(0)
    return _Run(
        task=task,
        figure_type=jax.vmap(_figure_type)(instructions)[task.instruction_index],
        world=simulator.reset(task.scenario),
        coverage=empty_coverage(task.scenario.area, _NUM_CELLS),
        target=origin,
        has_target=false,
        waypoint=origin,
        leg=zero,
        steps=zero,
        is_stopped=false,
    )


def _advance(
    run: _Run, *, params: object, config: NavigatorConfig, explore: Callable[[_Run], _Run]
) -> tuple[_Run, None]:
    task = run.task
    # The keys of episode.advance: common random numbers for all policies.
    sense_key, _, move_key = jax.random.split(jax.random.fold_in(task.key, run.steps), 3)
    observation = sense(sense_key, run.world, task.scenario, task.sensor, task.assumed_sensor)
    run = explore(_update_target(run, observation))
    # It drives to the target if there is one, and stops where the navigator would.
    goal = jnp.where(run.has_target, run.target, run.waypoint)
    offset = goal - observation.pose[:2]
    is_near = jnp.hypot(offset[0], offset[1]) <= PlannerParams().reach
    action = move_or_stop(goal, offset, run.has_target & is_near)
    world = task.body.move(move_key, run.world, action, task.motion)
    return replace(run, world=world, steps=run.steps + 1, is_stopped=action.is_stop), None


def _advance_known(run: _Run, *, params: object, config: NavigatorConfig) -> tuple[_Run, None]:
    """Run a whole episode of the robot with a known map."""
    task = run.task
    world, is_arrived = drive_known_map(task.key, task.scenario, task.motion)
    steps = jnp.ceil(world.distance / task.motion.step_length).astype(jnp.int32)
    return replace(run, world=world, steps=steps, is_stopped=is_arrived), None


def _finish(run: _Run) -> EpisodeResult:
    """Compute an episode's result; the counters of the filter are zero."""
    world, scenario = run.world, run.task.scenario
    return EpisodeResult(
        is_success=simulator.is_success(world.position, scenario, run.is_stopped),
        is_stopped=run.is_stopped,
        ending=jnp.where(run.is_stopped, int(Status.ARRIVED), int(Status.SEARCHING)),
        distance=world.distance,
        steps=run.steps,
        final=world.position,
        goal_distance=simulator.goal_distance(world, scenario),
        **{name: jnp.int32(0) for name in COUNTS},
        mean_effective_sample_size=jnp.float32(0.0),
        is_valid=scenario.is_valid,
    )


def _program(explore: Callable[[_Run], _Run]) -> EpisodeProgram:
    return EpisodeProgram(
        begin=_begin,
        advance=functools.partial(_advance, explore=explore),
        finish=_finish,
        episode_state=lambda run: run,
        is_done=lambda run: run.is_stopped,
    )


BASELINES = {
    "frontier": _program(_explore_frontiers),
    "lawnmower": _program(functools.partial(_explore_sweep, waypoint=_lane_waypoint)),
    "arc": _program(functools.partial(_explore_sweep, waypoint=_arc_waypoint)),
    "known": _program(_explore_frontiers)._replace(
        advance=_advance_known, is_done=lambda run: jnp.ones_like(run.is_stopped)
    ),
}
"""Programs for ``run_tasks``, by name; they use neither params nor configuration."""
