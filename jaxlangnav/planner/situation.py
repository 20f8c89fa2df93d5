"""What a policy is shown, and what it answers (section 3.4)."""

from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.planner.blocked import ProgressMonitor
from jaxlangnav.planner.constraints import Forbidden, forbidden_objects
from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.graph import Nodes
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.planner.questions import AskDecision
from jaxlangnav.pytree import pytree, replace, static
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapParams
from jaxlangnav.semantic_map.proposal.relation_query import Utterances


@pytree
class Situation:
    """What a policy decides upon; metres, map frame."""

    belief: ParticleBelief  # weighted maps, what each hypothesises, what has been looked at
    nodes: Nodes  # leaves [A], waypoints to value: places visited, objects seen, and its own
    goals: Goals  # where the goal may be, with probabilities
    constraint: Array  # f32[R, N + 1, P] probability that a region of a slot is forbidden
    is_relevant: Array  # bool[M, P] mentions that bear on the present goal (``relevance``)
    robot_x: Array  # f32[] believed position
    robot_y: Array  # f32[]
    sensor: SensorParams  # how far and how wide it sees
    way: ProgressMonitor  # waypoints that have been given up as out of reach
    may_ask: Array  # bool[] it has not been told to choose by itself
    has_chosen: Array  # bool[] it has gone up to something for this task, or is on its way
    is_find: Array  # f32[] probability that "find" is asked for: stop once it is in view
    is_news: Array  # bool[] something new has been seen or heard in this step
    stands: Array  # bool[] it stands still whatever is decided: halted, at its end, or at a fault
    may_stop: Array  # bool[] something seen that may be the goal is within reach: a stop is heard
    params: PlannerParams
    map_params: MapParams
    spoken: Utterances | None = None  # None: nothing that was said bears on where to look
    num_blocks: int = static(default=1)  # blocks a side that frontiers are gathered in

    @property
    def range_max(self) -> Array:
        """Sensing range, f32[] metres."""
        return self.sensor.range_max

    @property
    def forbidden(self) -> Forbidden:
        """What is to be kept away from."""
        here, cost = (self.robot_x, self.robot_y), self.params.constraint_cost
        return forbidden_objects(self.belief, self.constraint, *here, cost)

    @property
    def wanted(self) -> ParticleBelief:
        """The belief of what is worth looking for: of the present goal, and what it hangs on."""
        particles = self.belief.particles
        spoken = particles.is_mentioned & self.is_relevant
        return replace(self.belief, particles=replace(particles, is_mentioned=spoken))

    @property
    def distance(self) -> Array:
        """Metres from the robot to each node, f32[A]."""
        metres = self.belief.terrain.travel.metres
        return metres(self.robot_x, self.robot_y, self.nodes.x, self.nodes.y)


@pytree
class Valuation:
    """What a policy makes of it; the value of a node is the sum of its parts less its cost."""

    goal_value: Array  # f32[A] what a node is worth for being near the goal
    information_value: Array  # f32[A] what it is worth for what the way would reveal
    stop_mass: Array  # f32[] probability that the goal is within reach; the robot stops from τ on


@pytree
class Waypoint:
    """The place the robot is on its way to."""

    x: Array  # f32[] metres, map frame
    y: Array  # f32[]
    kind: Array  # i32[] of node
    is_active: Array  # bool[] it is under way


@pytree
class Decision:
    """What a policy decided, and why; ``decide`` makes it."""

    waypoint_x: Array  # f32[] metres, map frame: where it goes
    waypoint_y: Array  # f32[]
    next_x: Array  # f32[] metres, map frame: where it turns first to go round what is forbidden
    next_y: Array  # f32[]
    kind: Array  # i32[] kind of node it goes to
    is_stop: Array  # bool[] the goal is within reach
    is_approach: Array  # bool[] the waypoint is a thing seen that may be the goal
    is_not_found: Array  # bool[] nothing is left to look for, and there is no goal
    is_kept: Array  # bool[] the former waypoint was kept
    nodes: Nodes  # leaves [A], what it chose among
    value: Array  # f32[A] value of every node; −∞ where there is none
    goal_value: Array  # f32[A] part of it from goals
    information_value: Array  # f32[A] part of it from what the way would reveal
    cost: Array  # f32[A] part of it lost to the way round what is forbidden
    stop_mass: Array  # f32[] goal probability within reach
    doubt: AskDecision  # ask which one is meant, or look on before anything is accepted

    @property
    def turns(self) -> Array:
        """Whether it turns before it comes to its waypoint, bool[]."""
        return (self.next_x != self.waypoint_x) | (self.next_y != self.waypoint_y)
