"""Inputs and outputs of a policy: situation, valuation, decision (section 3.4)."""

import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.planner.blocked import ProgressMonitor
from jaxlangnav.planner.constraints import Zones, keep_out_zones
from jaxlangnav.planner.goals import Goals, has_goal
from jaxlangnav.planner.graph import Nodes
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.planner.questions import AskDecision
from jaxlangnav.pytree import pytree, static
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.proposal.relation_query import Utterances


@pytree
class Situation:
    """Input of a policy's decision; metres, map frame."""

    belief: ParticleBelief  # weighted maps with their hypotheses, and the coverage map
    nodes: Nodes  # leaves [A], waypoints to value: visited positions, observed objects, custom ones
    goals: Goals  # goal distribution
    forbidden_prob: Array  # f32[R, N + 1, P] probability that a region of a slot is forbidden
    is_relevant: Array  # bool[M, P] mentions that bear on the current goal (``relevance``)
    robot_x: Array  # f32[] believed position
    robot_y: Array  # f32[]
    sensor: SensorParams  # of the last observation; the default one at a fault
    progress: ProgressMonitor  # waypoints abandoned as unreachable
    may_ask: Array  # bool[] the user has not asked it to choose by itself
    has_chosen: Array  # bool[] it has approached an object for this task, or is approaching one
    is_find: Array  # f32[] probability of the action "find": stop once the goal is in view
    is_news: Array  # bool[] a new object or utterance in this step
    is_still: Array  # bool[] it does not move: halted, idle, finished, or at a fault
    params: PlannerParams
    map_params: MapParams
    utterances: Utterances | None = None  # None: none is relevant to the search
    num_blocks: int = static(default=1)  # blocks per side that frontiers are grouped in

    @property
    def range_max(self) -> Array:
        """Sensing range, f32[] metres."""
        return self.sensor.range_max

    @property
    def may_stop(self) -> Array:
        """Whether an observed object that may be the goal is within reach, bool[].

        Otherwise there is no stop, whatever a policy decides. For "find" it is enough to see it.
        """
        reach = self.params.reach
        radius = jnp.where(self.is_find > 0.5, jnp.maximum(reach, self.range_max), reach)
        view = self.belief.terrain.view
        return has_goal(self.goals, self.robot_x, self.robot_y, radius, view) & ~self.is_still

    @property
    def forbidden(self) -> Zones:
        """Keep-out zones of the forbidden objects."""
        robot, cost = (self.robot_x, self.robot_y), self.params.constraint_cost
        return keep_out_zones(self.belief, self.forbidden_prob, *robot, cost)

    @property
    def distance(self) -> Array:
        """Travel distance from the robot to each node, f32[A] metres."""
        metres = self.belief.terrain.travel.metres
        return metres(self.robot_x, self.robot_y, self.nodes.x, self.nodes.y)


@pytree
class Valuation:
    """A policy's values; the value of a node is the sum of its parts less its cost."""

    goal_value: Array  # f32[A] value of being near the goal
    information_value: Array  # f32[A] value of the information gained on the path
    stop_mass: Array  # f32[] probability that the goal is within reach; the robot stops from τ on


@pytree
class Waypoint:
    """The waypoint that the robot is driving to."""

    x: Array  # f32[] metres, map frame
    y: Array  # f32[]
    kind: Array  # i32[] type of node
    is_active: Array  # bool[] the robot is driving to it


@pytree
class Decision:
    """A policy's decision with its values; built by ``decide``."""

    waypoint_x: Array  # f32[] metres, map frame: waypoint
    waypoint_y: Array  # f32[]
    next_x: Array  # f32[] metres, map frame: first turning point of a detour, else the waypoint
    next_y: Array  # f32[]
    kind: Array  # i32[] node type of the waypoint
    is_stop: Array  # bool[] the goal is within reach
    is_approach: Array  # bool[] the waypoint is an observed object that may be the goal
    is_not_found: Array  # bool[] the search is exhausted, and there is no goal
    is_kept: Array  # bool[] the previous waypoint was kept
    nodes: Nodes  # leaves [A], the candidates
    value: Array  # f32[A] value of every node; −∞ where there is none
    goal_value: Array  # f32[A] part of it from goals
    information_value: Array  # f32[A] part of it from information gained on the path
    cost: Array  # f32[A] part of it lost to detours around keep-out zones
    stop_mass: Array  # f32[] goal probability within reach
    question: AskDecision  # ask which object is meant, or search on before one is accepted

    @property
    def turns(self) -> Array:
        """Whether the path has a turning point before the waypoint, bool[]."""
        return (self.next_x != self.waypoint_x) | (self.next_y != self.waypoint_y)
