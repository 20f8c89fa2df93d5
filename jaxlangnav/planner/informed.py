"""Our policy: the tour that puts the hypotheses to the test soonest (section 3.4; ours).

It accepts a goal only once everything the sentence mentions has been observed and no rival is left
near what has been. Once what is missing is hardly there at all (``termination``), it takes the
likeliest thing that it has seen; where nothing seen will do, the goal is not to be found.
"""

import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
from jax import Array

from jaxlangnav.planner import graph, qmdp, search, tours
from jaxlangnav.planner.latency import Tour
from jaxlangnav.planner.policy import (
    LEAST_GOAL,
    Decision,
    Policy,
    Portrayal,
    Situation,
    Valuation,
    decide,
)
from jaxlangnav.planner.questions import value_of_asking
from jaxlangnav.planner.termination import MOST_UNLOOKED, MOST_UNLOOKED_ROUND, Chances, chances
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map.belief import ParticleBelief
from jaxlangnav.semantic_map.params import MapConfig

_SETTLED = 10.0  # value of a goal that is settled; information values stay below 1


@dataclasses.dataclass(frozen=True)
class Informed(Policy):
    """Plans tours; its memory is the tour under way."""

    @property
    def portrayal(self) -> Portrayal:
        """Its own waypoints are the first stops of tours."""
        return Portrayal(
            place="a viewpoint",
            reason="no tour that starts elsewhere finds the goal sooner; on the way {tested} of "
            "its maps are put to the test",
            reason_object="nothing is left to find out that would matter more",
        )

    @property
    def takes_likeliest(self) -> bool:
        """It does, however many there may be."""
        return True

    def check(self, sizes: MapConfig) -> None:
        """Refuse a map that cannot be folded into the search map."""
        if sizes.num_cells % search.CELLS:
            raise ValueError(
                f"num_cells is {sizes.num_cells}, but must be a multiple of {search.CELLS} "
                "for the informed policy's search map"
            )

    def init(self, belief: ParticleBelief) -> Tour:
        """Begin with no tour."""
        return tours.no_tour(belief.last_pose[0], belief.last_pose[1])

    def step(self, key: Array, memory: Tour, situation: Situation) -> tuple[Tour, Decision]:
        """Improve the tour under way, go to its first stop or to the goal."""
        belief, params, maps = situation.belief, situation.params, situation.map_params
        unseen = search.search_map(
            situation.wanted, params.prior_share, params.ahead, situation.spoken
        )
        chance = chances(unseen.unseen, params.absent, maps, unseen.missed)
        # If what is said is false, something seen that does not fit may be what is meant.
        has_seen = jnp.any(situation.goals.is_object[:-1])
        fits_nothing = jnp.max(situation.goals.object_accepted) < LEAST_GOAL
        elsewhere = jnp.where(has_seen, 0.0, chance.elsewhere)
        unseen = unseen.doubted(elsewhere, jnp.where(fits_nothing, chance.fitting, 0.0))
        unseen = replace(unseen, nowhere=chance.nowhere, forbidden=situation.forbidden)
        here, area = (situation.robot_x, situation.robot_y), belief.coverage.area
        plan = tours.plan(key, memory, unseen, *here, situation.sensor, area)
        decision = decide_on(situation, plan, chance)
        return tours.best_tour(plan, decision.value), decision


def decide_on(situation: Situation, plan: tours.Plan, chance: Chances) -> Decision:
    """Decide among the first stops of tours and what every policy is shown."""
    stop_x, stop_y = plan.tours.x[:, 0], plan.tours.y[:, 0]
    nodes = graph.put_first(stop_x, stop_y, jnp.ones(stop_x.shape, bool), situation.nodes)
    situation = replace(situation, nodes=nodes)
    params = situation.params
    doubt = value_of_asking(
        situation.goals,
        jnp.min(plan.latency) / jnp.maximum(plan.mass, 1e-6),
        params=params,
        has_looked=(chance.fitting < params.give_up) | situation.has_chosen,
        may_ask=situation.may_ask,
    )
    plan = replace(plan, anchored=jnp.where(doubt.looks_on, jnp.inf, plan.anchored))
    valuation, is_sure, is_not_found = judge(situation, plan, chance)
    # What has been seen draws nobody back who looks on: else he goes to and fro.
    drawn = jnp.where(doubt.looks_on, 0.0, valuation.goal_value)
    valuation = replace(valuation, goal_value=drawn)
    decision = decide(situation, valuation, doubt=doubt)
    return replace(decision, is_stop=decision.is_stop & is_sure, is_not_found=is_not_found)


class Judgement(NamedTuple):
    """What the policy makes of a situation."""

    valuation: Valuation
    is_sure: Array  # bool[] it may stop for all it knows
    is_not_found: Array  # bool[] nothing is left to look for, and there is no goal


def judge(situation: Situation, plan: tours.Plan, chance: Chances) -> Judgement:
    """Value first stops of tours by how soon they find things, until the goal is settled.

    The information value of a tour is what is still to be found divided by the metres until it
    is. A goal is settled once its object and all that the sentence places it against have been
    seen and next to nothing speaks for an unseen rival beside things seen; the object is then
    worth more than anything there is to learn. Unsettled goals break ties. Where next to nothing
    is left to be found and several things may still be meant, the likeliest has to do, unless it is
    meant in relation to something not seen: that is looked for. First stops of the plan's tours
    lead the situation's nodes.
    """
    params, goals, nodes = situation.params, situation.goals, situation.nodes
    here = situation.robot_x, situation.robot_y
    has_looked = chance.fitting < params.give_up
    fits_nothing = jnp.max(goals.object_accepted) < LEAST_GOAL
    # Things seen that do not fit now may have to do in the end.
    has_seen = jnp.any(goals.is_object[:-1])
    is_over = jnp.where(has_seen, chance.fitting, chance.any) < params.give_up
    # What is gone round hides more in one place than what is left over here and there.
    is_round = jnp.any(situation.forbidden.price > 0.0)
    most = jnp.where(is_round, MOST_UNLOOKED_ROUND, MOST_UNLOOKED)
    is_over = is_over & ((chance.unlooked <= most) | (params.absent <= 0.0))
    confirmed = jnp.where(has_looked, goals.object_accepted, goals.object_confirmed)
    goals = replace(goals, object_confirmed=confirmed)
    terrain = situation.belief.terrain
    _, within_reach = qmdp.mass_within(*here, goals, params.reach, terrain.view)
    _, in_view = qmdp.mass_within(*here, goals, situation.range_max, terrain.view)
    metres = plan.latency / jnp.maximum(plan.mass, 1e-6)
    no_tours = jnp.zeros(nodes.x.shape[0] - metres.shape[0], jnp.float32)
    goal_value = 0.01 * qmdp.values(nodes.x, nodes.y, goals, params.discount, terrain.travel)
    confirmed = jnp.max(goals.object_confirmed)
    rest = jnp.sum(goals.hypothesis_mass)
    is_best = jnp.arange(goals.object_x.shape[0]) == jnp.argmax(goals.object_confirmed)
    is_likeliest = confirmed >= jnp.max(jnp.where(is_best, 0.0, goals.object_accepted))
    is_doubtful = (rest <= params.rest_share * confirmed) & (confirmed < params.stop_probability)
    is_exhausted = ((is_doubtful & is_likeliest) | has_looked) & (confirmed >= LEAST_GOAL)
    is_sure = (plan.anchored <= params.rival_share * confirmed) | is_exhausted
    is_settled = is_sure & ((confirmed >= params.stop_probability) | is_exhausted)
    arrived = jnp.where(situation.is_find > 0.5, in_view, within_reach)
    # The mass within reach of a candidate may be spread over neighbours: nine tenths of it count.
    will_do = is_exhausted & (arrived >= 0.9 * confirmed)
    first_object = nodes.x.shape[0] - goals.object_x.shape[0]
    is_goal = jnp.concatenate([jnp.zeros(first_object, bool), is_best])
    valuation = Valuation(
        goal_value=jnp.where(is_goal & is_settled, _SETTLED, goal_value),
        information_value=jnp.concatenate([plan.mass / (1.0 + metres), no_tours]),
        stop_mass=jnp.where(will_do, jnp.maximum(arrived, params.stop_probability), arrived),
    )
    return Judgement(valuation, is_sure, is_over & fits_nothing)
