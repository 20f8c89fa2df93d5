"""The door for policies: what one is shown, what it answers, what holds for all (section 3.4).

    memory = policy.init(belief)
    memory, decision = policy.step(key, memory, situation)

A policy is written for ONE robot in operations that JAX can trace; the engine compiles and batches
it. It has its own memory, its own randomness and, if it likes, waypoints of its own: ``ahead`` puts
them before the places visited and the objects seen, which every policy is shown. ``decide`` makes
a decision of what the waypoints are worth, by rules that are the same for all: a way past what is
to be kept away from costs, nobody goes where he stands, a value that is no number closes its node,
and nobody stops unless something that has been seen and may be the goal is within reach.
"""

import dataclasses
from abc import abstractmethod
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.messages import SensorParams
from jaxlangnav.planner import graph
from jaxlangnav.planner.asking import Doubt, doubt_of
from jaxlangnav.planner.blocked import Way, open_nodes
from jaxlangnav.planner.constraints import constraint_cost
from jaxlangnav.planner.goals import Goals
from jaxlangnav.planner.graph import OBJECT_NODE, Nodes
from jaxlangnav.planner.params import PlannerParams
from jaxlangnav.pytree import pytree, replace, static, strong
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapConfig, MapParams
from jaxlangnav.terrain import OPEN, Eye, View

LEAST_GOAL = 0.01
"""Probability below which an object is no goal: nothing is settled and nothing stops for it."""
UNDERFOOT = 0.25
"""Metres from a place that count as standing on it; an object is reached from further off."""


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
    way: Way  # waypoints that have been given up as out of reach
    may_ask: Array  # bool[] it has not been told to choose by itself
    has_chosen: Array  # bool[] it has gone up to something for this task, or is on its way
    is_find: Array  # f32[] probability that "find" is asked for: stop once it is in view
    is_news: Array  # bool[] something new has been seen or heard in this step
    stands: Array  # bool[] it stands still whatever is decided: halted, at its end, or at a fault
    may_stop: Array  # bool[] something seen that may be the goal is within reach: a stop is heard
    params: PlannerParams
    map_params: MapParams
    num_blocks: int = static()  # blocks a side that frontiers are gathered in
    is_thorough: bool = static(default=False)  # all of the area may have to be looked at

    @property
    def range_max(self) -> Array:
        """Sensing range, f32[] metres."""
        return self.sensor.range_max

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

    waypoint_x: Array  # f32[] metres, map frame
    waypoint_y: Array  # f32[]
    kind: Array  # i32[] kind of node it goes to
    is_stop: Array  # bool[] the goal is within reach
    is_approach: Array  # bool[] the waypoint is a thing seen that may be the goal
    is_not_found: Array  # bool[] nothing is left to look for, and there is no goal
    is_kept: Array  # bool[] the former waypoint was kept
    nodes: Nodes  # leaves [A], what it chose among
    value: Array  # f32[A] value of every node; −∞ where there is none
    goal_value: Array  # f32[A] part of it from goals
    information_value: Array  # f32[A] part of it from what the way would reveal
    cost: Array  # f32[A] part of it lost to constraint regions
    stop_mass: Array  # f32[] goal probability within reach
    doubt: Doubt  # whether to ask which one is meant, or to look on before anything is accepted


@dataclasses.dataclass(frozen=True, kw_only=True)
class Portrayal:
    """How stories and pictures show a policy's choices."""

    place: str = "a place of its own choice"
    """What its own waypoints are called."""
    reason: str = "of {number} places it is worth most to its policy (value {value:.2f})"
    """Why a waypoint was taken; {tested} is the share of maps that the way puts to the test."""
    reason_object: str | None = None
    """The same where it is an object that has been seen; None: no other reason."""
    is_field: bool = False
    """Places between the nodes have values, too: those of eq. 11."""


@runtime_checkable
class Policy(Protocol):
    """How a robot decides where to go, and when it is there.

    A policy of one's own derives from this class and has ``init`` and ``step``; the rest has
    defaults. It must be hashable, as a frozen dataclass of plain numbers is: with other values it
    is another policy, and another program is compiled.
    """

    @property
    def name(self) -> str:
        """What people call it."""
        return type(self).__name__.lower()

    @property
    def portrayal(self) -> Portrayal:
        """How stories and pictures show its choices."""
        return Portrayal()

    @abstractmethod
    def init(self, belief: ParticleBelief, /) -> Any:
        """Build the memory of a robot that has not decided yet.

        Args:
            belief: before the first look: operating area, where the robot stands, sizes.

        Returns:
            Any pytree of arrays. It is kept over commands; ``Situation.is_news`` tells of them.
        """

    @abstractmethod
    def step(self, key: Array, memory: Any, situation: Situation, /) -> tuple[Any, Decision]:
        """Decide.

        Args:
            key: random key, consumed.
            memory: after the last decision.
            situation: now.

        Returns:
            The memory, of the same shapes and dtypes, and the decision.
        """
        ...

    def map_params(self, params: MapParams) -> MapParams:
        """Tell by which numbers the robot believes what it sees and hears: by those given.

        Args:
            params: the map's numbers.

        Returns:
            Those to filter with.
        """
        return params

    def check(self, sizes: MapConfig) -> None:
        """Refuse sizes of the map that the policy cannot work with: there are none.

        Args:
            sizes: of the map.

        Raises:
            ValueError: names the value, the limit and the remedy.
        """
        return


def has_goal(goals: Goals, x: Array, y: Array, radius: Array, view: View) -> Array:
    """Tell whether something seen that may be the goal is in sight of a place and near, bool[]."""
    is_near = view.sees(Eye(x, y, radius), goals.object_x, goals.object_y)
    share = jnp.where(is_near, goals.object_accepted, 0.0)
    return jnp.any(goals.is_object & jnp.isfinite(share) & (share >= LEAST_GOAL))


def may_stop(
    goals: Goals, eye: Eye, is_find: Array, *, params: PlannerParams, view: View = OPEN.view
) -> Array:
    """Tell whether there is anything to stop for: whatever a policy says, otherwise there is none.

    Args:
        goals: weighed goals.
        eye: where the robot is, and how far it sees.
        is_find: f32[], probability that "find" is asked for: to have it in view is then enough.
        params: reach.
        view: what can be seen; a thing behind a wall is not within reach.

    Returns:
        bool[], whether something that has been seen and may be the goal is within reach.
    """
    radius = jnp.where(is_find > 0.5, jnp.maximum(params.reach, eye.range_max), params.reach)
    return has_goal(goals, eye.x, eye.y, radius, view)


def ahead(situation: Situation, x: Array, y: Array, is_node: Array | None = None) -> Situation:
    """Put waypoints of a policy's own before those that every policy is shown.

    Limits: a place that is no number is no waypoint.

    Args:
        situation: as shown to the policy.
        x: f32[K], metres, map frame.
        y: f32[K], metres.
        is_node: bool[K], which of them are waypoints; all of them by default.

    Returns:
        The situation with K more nodes, which lead.
    """
    is_place = jnp.isfinite(x) & jnp.isfinite(y)
    is_node = is_place if is_node is None else is_node & is_place
    return replace(situation, nodes=graph.put_first(x, y, is_node, situation.nodes))


def _metres_left(situation: Situation) -> Array:
    """Estimate the way to what has not been seen where no tour is planned: to where it may be."""
    goals, travel = situation.goals, situation.belief.terrain.travel
    here = situation.robot_x, situation.robot_y
    away = travel.metres(*here, goals.hypothesis_x, goals.hypothesis_y)
    mass = goals.hypothesis_mass
    return jnp.sum(mass * away) / jnp.maximum(jnp.sum(mass), 1e-9)


def _require_one_a_node(situation: Situation, valuation: Valuation) -> None:
    """Refuse values that are not one for each node (when the program is traced)."""
    shape = situation.nodes.x.shape
    for name in ("goal_value", "information_value"):
        found = jnp.shape(getattr(valuation, name))
        if found != shape:
            raise ValueError(
                f"{name} has shape {found}, but must have {shape}: one value for each of "
                "situation.nodes"
            )


def _own_doubt(situation: Situation) -> Doubt:
    """Doubt as one who does not know when all has been looked at."""
    return doubt_of(
        situation.goals,
        _metres_left(situation),
        params=situation.params,
        has_looked=situation.has_chosen,
        may_ask=situation.may_ask,
    )


def _is_worth_going(situation: Situation, doubt: Doubt) -> Array:
    """Tell to which nodes the robot may go, bool[A]."""
    nodes = situation.nodes
    is_object = nodes.kind == OBJECT_NODE
    # Standing still teaches nothing: the node underfoot is a_stop's business.
    is_away = situation.distance > jnp.where(is_object, situation.params.reach, UNDERFOOT)
    # While there is more to be seen first, nothing is gone up to.
    return open_nodes(nodes, situation.way).is_node & (~doubt.looks_on | ~is_object) & is_away


def _pick(situation: Situation, value: Array, kept: Waypoint | None) -> Waypoint:
    """Go to the node that is worth most, or on as before: active is what was under way already."""
    nodes, best = situation.nodes, jnp.argmax(value)
    is_nowhere = jnp.all(value == -jnp.inf)
    x = jnp.where(is_nowhere, situation.robot_x, nodes.x[best])
    y = jnp.where(is_nowhere, situation.robot_y, nodes.y[best])
    kind, is_kept = nodes.kind[best], jnp.asarray(False)
    if kept is not None:
        is_kept = kept.is_active
        x, y = jnp.where(is_kept, kept.x, x), jnp.where(is_kept, kept.y, y)
        kind = jnp.where(is_kept, kept.kind, kind)
    return Waypoint(x=x, y=y, kind=kind, is_active=is_kept)


def decide(
    situation: Situation,
    valuation: Valuation,
    kept: Waypoint | None = None,
    doubt: Doubt | None = None,
) -> Decision:
    """Pick the waypoint of highest value, or stop (eq. 10).

    Limits: no stop without a goal that has been seen and is within reach; a value that is no
    number closes its node, and with all of them closed the waypoint is where the robot stands.

    Args:
        situation: nodes, goals, where the robot is.
        valuation: what its nodes are worth, and whether to stop.
        kept: a waypoint that is gone on to, if it is active, whatever the nodes are worth.
        doubt: whether to ask which one is meant (``asking``); by default as one who does not know
            when all has been looked at.

    Returns:
        The decision; of itself it gives up nothing as not to be found.

    Raises:
        ValueError: the values are not one for each node.
    """
    _require_one_a_node(situation, valuation)
    nodes, goals, params = situation.nodes, situation.goals, situation.params
    robot_x, robot_y = situation.robot_x, situation.robot_y
    cost = constraint_cost(
        situation.belief, situation.constraint, nodes, robot_x, robot_y, params.constraint_cost
    )
    value = valuation.goal_value + valuation.information_value - cost
    doubt = _own_doubt(situation) if doubt is None else doubt
    value = jnp.where(_is_worth_going(situation, doubt) & ~jnp.isnan(value), value, -jnp.inf)
    to = _pick(situation, value, kept)
    mass = valuation.stop_mass
    is_sure = (mass >= params.stop_probability) & jnp.isfinite(mass)
    doubt = replace(doubt, asks=doubt.asks & ~situation.stands)
    may_stop = situation.may_stop & ~doubt.looks_on & ~doubt.asks
    is_goal = has_goal(goals, to.x, to.y, params.reach, situation.belief.terrain.view)
    return Decision(
        waypoint_x=to.x,
        waypoint_y=to.y,
        kind=to.kind,
        is_stop=is_sure & may_stop,
        is_approach=(to.kind == OBJECT_NODE) & is_goal,
        is_not_found=jnp.asarray(False),
        is_kept=to.is_active,
        nodes=nodes,
        value=value,
        goal_value=valuation.goal_value,
        information_value=valuation.information_value,
        cost=cost,
        stop_mass=mass,
        doubt=doubt,
    )


def choose(policy: Policy, key: Array, memory: Any, situation: Situation) -> tuple[Any, Decision]:
    """Let a policy decide, and hold it to what holds for all.

    Args:
        policy: who decides.
        key: random key, consumed.
        memory: of the policy, after the last decision.
        situation: now.

    Returns:
        The memory and the decision: a stop only where one is heard, and nothing given up as not to
        be found on top of it.

    Raises:
        ValueError: the answer is no decision, or a memory of other shapes than the one before.
    """
    after, decision = policy.step(key, memory, situation)
    if not isinstance(decision, Decision):
        raise ValueError(
            f"policy {policy.name} decides {type(decision).__name__}: its step must return its "
            "memory and a Decision, as policy.decide makes it"
        )
    had, has = _shapes(memory), _shapes(after)
    if had != has:
        raise ValueError(
            f"policy {policy.name} is given a memory of {had} and returns one of {has}: shapes and "
            "dtypes must stay as its init makes them"
        )
    is_stop = decision.is_stop & situation.may_stop & ~decision.doubt.asks
    is_not_found = decision.is_not_found & ~is_stop & ~situation.stands & ~decision.doubt.asks
    return strong(after), replace(decision, is_stop=is_stop, is_not_found=is_not_found)


def _shapes(memory: Any) -> Any:
    """Tell the structure of a memory with the shape and dtype of every leaf."""
    return jax.tree.map(lambda leaf: f"{jnp.result_type(leaf)}{list(jnp.shape(leaf))}", memory)
