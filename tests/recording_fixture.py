"""A recording made by hand: pictures are tested without running the engine."""

import jax
import numpy as np
import readings as by_hand
from placed import placed

from jaxlangnav.episode import EpisodeResult
from jaxlangnav.episode.recording import Recording, Snapshot, StaticScene, stack_frames
from jaxlangnav.messages import AT, BEHIND, NONE, Readings, Status, default_sensor
from jaxlangnav.planner.config import as_policy
from jaxlangnav.planner.graph import FRONTIER, OBJECT_NODE, VISITED
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.semantic_map.unreferenced_objects import no_bystanders
from jaxlangnav.world.state import CONE, HYDRANT

TYPES = ("hydrant", "cone", "car", "building", "tree", "bench", "barrel", "box")
TEXT = "go to the hydrant behind the cone"
AREA = (0.0, 13.0, -9.0, 9.0)
SLOTS, MENTIONS, DETECTIONS, CELLS, NODES = 4, 3, 4, 16, 12


def make_readings() -> Readings:
    """Two readings: a hydrant behind a cone (0.8), a hydrant (0.2)."""
    relations = [[(0, BEHIND, 1, False)], [(0, NONE, NONE, False)]]
    told = by_hand.readings([[HYDRANT, CONE], [HYDRANT]], relations, [0.8, 0.2])
    return jax.tree.map(np.asarray, told)


def make_scene(*, policy: str = "faithful", text: str = TEXT) -> StaticScene:
    """A hydrant at (9, 1) behind a cone at (6, 1)."""
    scenario = placed([(HYDRANT, 9.0, 1.0), (CONE, 6.0, 1.0)], slots=3, area=AREA, goal=0)
    return StaticScene(
        text=text,
        type_names=TYPES,
        policy=policy,
        portrayal=as_policy(policy).portrayal,
        scenario=scenario,
        sensor=default_sensor(3.0),
        readings=make_readings(),
        planner=PlannerParams(),
        known_distance=9.06,
    )


def make_frame(step: int, num_steps: int, num_particles: int, rng: np.random.Generator) -> Snapshot:
    """Drive from (0, 0) to (8.5, 1): the cone is seen at half time, the hydrant at the end."""
    share = step / max(1, num_steps - 1)
    position = np.array([8.5 * share, share], np.float32)
    sees_cone, sees_hydrant, is_last = share >= 0.5, share >= 0.75, step == num_steps - 1
    shape = (MENTIONS, num_particles)
    weight = rng.uniform(0.5, 1.5, num_particles)
    weight = (weight / weight.sum()).astype(np.float32)
    reading = (np.arange(num_particles) % 5 == 0).astype(np.int32)
    mention_type = make_readings().mention_type[reading].T.copy()
    slots = np.full((SLOTS, num_particles), NONE, np.int32)
    slots[0] = CONE if sees_cone else NONE
    slots[1] = HYDRANT if sees_hydrant else NONE
    is_open = mention_type >= 0
    is_open[0] &= not sees_hydrant
    is_open[1] &= not sees_cone
    goal_mass = np.array([0, 0.9 if sees_hydrant else 0, 0, 0, 0], np.float32)
    unseen = np.zeros(num_particles) if sees_hydrant else 0.9 * weight
    node_x = np.linspace(1, 12, NODES).astype(np.float32)
    value = np.linspace(0.1, 0.5, NODES).astype(np.float32)
    value[1] = -np.inf
    value[NODES - SLOTS + 1] = 0.9 if sees_hydrant else -np.inf
    best = int(np.argmax(value))
    kind = np.array([FRONTIER] * 5 + [VISITED] * 3 + [OBJECT_NODE] * 4, np.int32)
    node_y = np.where(np.arange(NODES) == NODES - SLOTS + 1, 1.0, -2.0).astype(np.float32)
    node_x[NODES - SLOTS + 1] = 9.0
    looked = np.hypot(
        (np.arange(CELLS)[None, :] + 0.5) * 13 / CELLS - position[0],
        (np.arange(CELLS)[:, None] + 0.5) * 18 / CELLS - 9 - position[1],
    )
    no = np.zeros(SLOTS + 1, np.float32)
    return Snapshot(
        position=position,
        heading=np.float32(0.1),
        odometry=position + np.float32(0.05),
        robot=position + np.float32(0.02),
        distance=np.float32(np.hypot(*position)),
        clause=np.int32(0),
        detection_type=np.array([CONE, NONE, NONE, NONE], np.int32),
        detection_range=np.array([2.0, 0, 0, 0], np.float32),
        detection_bearing=np.zeros(DETECTIONS, np.float32),
        is_detection=np.array([sees_cone, False, False, False]),
        weight=weight,
        reading=reading,
        object_type=slots,
        object_x=np.tile(np.array([6, 9, 0, 0], np.float32)[:, None], num_particles),
        object_y=np.tile(np.array([1, 1, 0, 0], np.float32)[:, None], num_particles),
        object_sd=np.full((SLOTS, num_particles), 0.1, np.float32),
        bystanders=jax.device_get(no_bystanders(2)),
        mention_type=mention_type,
        referent=np.full(shape, NONE, np.int32),
        is_hypothesised=is_open,
        hypothesis_x=rng.uniform(0, 13, shape).astype(np.float32),
        hypothesis_y=rng.uniform(-9, 9, shape).astype(np.float32),
        miss=np.where(looked < 3, 0.05, 1.0).astype(np.float32),
        effective_sample_size=np.float32(0.9 * num_particles),
        num_regrounded=np.int32(num_particles // 4 if step else num_particles),
        is_news=np.array(step == 0 or is_new(step, num_steps)),
        fault=np.int32(0),
        overflow=np.int32(0),
        goal_x=no + np.array([6, 9, 0, 0, 0], np.float32),
        goal_y=no + 1,
        goal_mass=goal_mass,
        goal_confirmed=goal_mass,
        is_goal=np.array([sees_cone, sees_hydrant, False, False, False]),
        goal_region=np.full(SLOTS + 1, AT, np.int32),
        hypothesis_goal_x=rng.uniform(8, 9, num_particles).astype(np.float32),
        hypothesis_goal_y=rng.uniform(0.5, 1.5, num_particles).astype(np.float32),
        hypothesis_goal_mass=unseen.astype(np.float32),
        action=np.array([0.9, 0.1], np.float32),
        mode=np.array([1, 0, 0], np.float32),
        node_x=node_x,
        node_y=node_y,
        is_node=np.isfinite(value),
        node_kind=kind,
        value=value,
        goal_value=np.where(np.isfinite(value), value, 0).astype(np.float32),
        information_value=np.zeros(NODES, np.float32),
        cost=np.zeros(NODES, np.float32),
        waypoint=np.array([node_x[best], node_y[best]], np.float32),
        waypoint_kind=kind[best],
        is_kept=np.array(step % 3 == 1),
        is_stop=np.array(is_last),
        status=np.int32(Status.ARRIVED if is_last else Status.SEARCHING),
        is_done=np.array(is_last),
        stop_mass=np.float32(0.9 if is_last else 0.0),
    )


def is_new(step: int, num_steps: int) -> bool:
    """Whether something is seen at this step for the first time."""
    last = max(1, num_steps - 1)
    return any(step / last >= at > (step - 1) / last for at in (0.5, 0.75))


def make_recording(
    num_steps: int = 9, num_particles: int = 20, *, policy: str = "faithful", text: str = TEXT
) -> Recording:
    """A success in ``num_steps`` steps."""
    rng = np.random.default_rng(num_steps)
    frames = [make_frame(step, num_steps, num_particles, rng) for step in range(num_steps)]
    result = EpisodeResult(
        is_success=np.array(True),
        is_stopped=np.array(True),
        ending=np.int32(Status.ARRIVED),
        distance=np.float32(8.56),
        steps=np.int32(num_steps),
        final=frames[-1].position,
        goal_distance=np.float32(0.5),
        **dict.fromkeys(("overflow", "degenerate", "contradictions", "faults"), np.int32(0)),
        mean_effective_sample_size=np.float32(18.0),
        is_valid=np.array(True),
    )
    return stack_frames(make_scene(policy=policy, text=text), [(it, result) for it in frames])
