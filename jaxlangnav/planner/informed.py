"""Our policy: search tours of least expected latency for the hypotheses (section 3.4; ours).

It accepts a goal only once all objects mentioned have been observed and no unseen rival near them
is left. Once a missing object is unlikely to exist (``termination``), it accepts the likeliest
observed object; if no observed object fits, the episode ends as not found.
"""

import dataclasses

import jax
import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner import graph, qmdp, search, tours
from jaxlangnav.planner.latency import NUM_STOPS, Tour
from jaxlangnav.planner.policy import (
    MIN_GOAL_PROB,
    Decision,
    Policy,
    PolicyDescription,
    Situation,
    Valuation,
    decide,
)
from jaxlangnav.planner.questions import decide_question
from jaxlangnav.planner.termination import MAX_UNSEEN, MAX_UNSEEN_DETOUR, Presence, presence
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapConfig

_SETTLED_VALUE = 10.0  # value of a settled goal; information values stay below 1


@dataclasses.dataclass(frozen=True)
class Informed(Policy):
    """Policy that plans search tours; its memory is the current tour."""

    portrayal = PolicyDescription(
        place="a viewpoint",
        reason="on the way {tested} of its maps are put to the test",
        reason_object="nothing is left to find out that would matter more",
    )
    takes_likeliest = True

    def check(self, sizes: MapConfig) -> None:
        """Raise a ValueError if the coverage map cannot be reduced to the search map."""
        if sizes.num_cells % search.CELLS:
            raise ValueError(
                f"num_cells is {sizes.num_cells}, but must be a multiple of {search.CELLS} "
                "for the informed policy's search map"
            )

    def init(self, belief: ParticleBelief) -> Tour:
        """Begin without a tour: all stops are at the robot's position."""
        x, y, _ = belief.last_pose
        return Tour(x=jnp.full(NUM_STOPS, x), y=jnp.full(NUM_STOPS, y))

    def step(self, key: Array, memory: Tour, situation: Situation) -> tuple[Tour, Decision]:
        """Improve the current tour, then go to its first stop or to the goal."""
        belief, params, map_params = situation.belief, situation.params, situation.map_params
        # Only the current goal and its landmarks are searched for.
        is_target = belief.particles.is_mentioned & situation.is_relevant
        targets = replace(belief, particles=replace(belief.particles, is_mentioned=is_target))
        target = search.search_map(targets, params.prior_share, params.ahead, situation.utterances)
        probs = presence(target.unseen, params.absent, map_params, target.mean_miss)
        # If an annotation is false, an observed object that does not fit may be the goal.
        has_object = jnp.any(situation.goals.is_object[:-1])
        has_no_fit = jnp.max(situation.goals.object_accepted) < MIN_GOAL_PROB
        elsewhere = jnp.where(has_object, 0.0, probs.prob_elsewhere)
        target = target.relocated(elsewhere, jnp.where(has_no_fit, probs.prob_fitting, 0.0))
        target = replace(target, prob_absent=probs.prob_absent, forbidden=situation.forbidden)
        robot, area = (situation.robot_x, situation.robot_y), belief.coverage.area
        plan = tours.plan(key, memory, target, robot, situation.sensor, area)
        decision = decide_tour(situation, plan, probs)
        index = jnp.argmax(decision.value[: plan.latency.shape[0]])  # tours come first
        return jax.tree.map(lambda leaf: leaf[index], plan.tours), decision


def decide_tour(situation: Situation, plan: tours.Plan, probs: Presence) -> Decision:
    """Decide among the first stops of tours and the common nodes, after a clarification test."""
    stop_x, stop_y = plan.tours.x[:, 0], plan.tours.y[:, 0]
    nodes = graph.prepend_nodes(stop_x, stop_y, jnp.ones(stop_x.shape, bool), situation.nodes)
    situation = replace(situation, nodes=nodes)
    params = situation.params
    question = decide_question(
        situation.goals,
        jnp.min(plan.latency) / jnp.maximum(plan.mass, 1e-6),
        params=params,
        no_search=(probs.prob_fitting < params.give_up) | situation.has_chosen,
        may_ask=situation.may_ask,
    )
    plan = replace(plan, ordered=jnp.where(question.searches_on, jnp.inf, plan.ordered))
    valuation, is_sure, is_not_found = assess(situation, plan, probs)
    decision = decide(situation, valuation, question=question)
    return replace(decision, is_stop=decision.is_stop & is_sure, is_not_found=is_not_found)


def assess(
    situation: Situation, plan: tours.Plan, probs: Presence
) -> tuple[Valuation, Array, Array]:
    """Value the first stops of tours by their information rate, until the goal is settled.

    The information value of a tour is the mass still to be found divided by the metres until it
    is found. A goal is settled once its object and all its landmarks have been observed and an
    unseen rival is improbable, near observed objects or before the one of a rank; its value is then
    higher than any information value. Unsettled goals break ties. If hardly any mass is left to be
    found and several objects may still be meant, the likeliest is accepted, unless it has an unseen
    landmark, or another may come before it: that is searched for. First stops of the plan's tours
    lead the situation's nodes.

    Returns:
        The values; bool[], no unseen rival prevents a stop; bool[], the search is exhausted without
        a goal.
    """
    params, goals, nodes = situation.params, situation.goals, situation.nodes
    robot = situation.robot_x, situation.robot_y
    is_exhausted = probs.prob_fitting < params.give_up
    has_no_fit = jnp.max(goals.object_accepted) < MIN_GOAL_PROB
    # Observed objects that do not fit now may be accepted in the end.
    has_object = jnp.any(goals.is_object[:-1])
    is_finished = jnp.where(has_object, probs.prob_fitting, probs.prob_any) < params.give_up
    # A keep-out zone hides its unseen mass in one place, so the limit is stricter.
    limit = jnp.where(jnp.any(situation.forbidden.cost > 0.0), MAX_UNSEEN_DETOUR, MAX_UNSEEN)
    is_finished = is_finished & ((probs.miss <= limit) | (params.absent <= 0.0))
    confirmed = jnp.where(is_exhausted, goals.object_accepted, goals.object_confirmed)
    goals = replace(goals, object_confirmed=confirmed)
    terrain = situation.belief.terrain
    _, reach_mass = qmdp.mass_within(*robot, goals, params.reach, terrain.view)
    _, view_mass = qmdp.mass_within(*robot, goals, situation.range_max, terrain.view)
    metres = plan.latency / jnp.maximum(plan.mass, 1e-6)
    zeros = jnp.zeros(nodes.x.shape[0] - metres.shape[0], jnp.float32)
    goal_value = qmdp.values(nodes.x, nodes.y, goals, params.discount, terrain.travel)
    confirmed = jnp.max(goals.object_confirmed)
    unseen_mass = jnp.sum(goals.hypothesis_mass)
    is_best = jnp.arange(goals.object_x.shape[0]) == jnp.argmax(goals.object_confirmed)
    is_best_goal = confirmed >= jnp.max(jnp.where(is_best, 0.0, goals.object_accepted))
    is_open = (unseen_mass <= params.rest_share * confirmed) & (confirmed < params.stop_probability)
    takes_likeliest = ((is_open & is_best_goal) | is_exhausted) & (confirmed >= MIN_GOAL_PROB)
    tolerated = params.rival_share * confirmed
    is_first = jnp.less_equal(plan.ordered, tolerated)
    is_sure = is_first & ((plan.anchored <= tolerated) | takes_likeliest)
    # While looking on, observed objects have no value, or the robot could oscillate.
    goal_value = jnp.where(is_first, 0.01 * goal_value, 0.0)
    is_settled = is_sure & ((confirmed >= params.stop_probability) | takes_likeliest)
    mass_here = jnp.where(situation.is_find > 0.5, view_mass, reach_mass)
    # The mass of a candidate may be spread over neighbours: nine tenths within reach suffice.
    is_enough = takes_likeliest & (mass_here >= 0.9 * confirmed)
    first_object = nodes.x.shape[0] - goals.object_x.shape[0]
    is_goal = jnp.concatenate([jnp.zeros(first_object, bool), is_best])
    valuation = Valuation(
        goal_value=jnp.where(is_goal & is_settled, _SETTLED_VALUE, goal_value),
        information_value=jnp.concatenate([plan.mass / (1.0 + metres), zeros]),
        stop_mass=jnp.where(is_enough, jnp.maximum(mass_here, params.stop_probability), mass_here),
    )
    return valuation, is_sure, is_finished & has_no_fit
