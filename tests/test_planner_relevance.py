"""What of all that is spoken of bears on the present goal: its group of relations, and no more."""

import jax
import jax.numpy as jnp
import numpy as np
import readings as by_hand

from jaxlangnav.messages import BEHIND, LEFT, NEAR, NONE, ROBOT, Behavior, Readings
from jaxlangnav.planner.relevance import bears_on_goal, believed_groups, groups, has_open_partner
from jaxlangnav.pytree import replace
from jaxlangnav.semantic_map import particle

HYDRANT, CONE, CAR, BENCH, TREE = range(5)


def reading_of(types: list[int], relations: list[tuple[int, int, int]]) -> Readings:
    """One reading: types of its mentions; figure, relation and landmark of its relations."""
    edges = [(*one, False) for one in relations]
    return by_hand.readings([types], [edges], sizes=(1, 6, 4))


def sets(readings: Readings) -> list[set[int]]:
    found = np.asarray(groups(readings))[:, 0]
    return [{m for m in range(len(found)) if bits >> m & 1} for bits in found]


def test_relations_tie_directly_and_through_others() -> None:
    told = reading_of([HYDRANT, CONE, CAR, BENCH], [(0, BEHIND, 1), (1, NEAR, 2), (3, NONE, NONE)])
    assert sets(told)[:4] == [{0, 1, 2}, {0, 1, 2}, {0, 1, 2}, {3}]


def test_long_chains_are_followed_to_their_ends() -> None:
    told = reading_of([HYDRANT] * 6, [(0, NEAR, 1), (2, NEAR, 1), (2, NEAR, 3), (4, NEAR, 3)])
    assert sets(told)[0] == {0, 1, 2, 3, 4}
    assert sets(told)[5] == {5}


def test_the_robot_ties_nothing() -> None:
    told = reading_of([ROBOT, CONE, CAR], [(1, LEFT, 0), (2, LEFT, 0)])
    assert sets(told)[1:3] == [{1}, {2}]


def map_with(seen: dict[int, int]) -> particle.SemanticMap:
    """One particle, trailing axis P = 1: four mentions, those in ``seen`` in observed slots."""
    one = particle.empty(3, 6, jnp.float32(0), jnp.float32(0))
    referent = np.full(6, NONE, np.int32)
    for mention, slot in seen.items():
        referent[mention] = slot
    one = replace(one, referent=jnp.asarray(referent), is_mentioned=jnp.asarray(np.arange(6) < 4))
    return jax.tree.map(lambda leaf: leaf[..., None], one)


def goal_at(slot: int) -> Behavior:
    goal = np.zeros((7, 10, 1), np.float32)
    goal[6, slot] = 1.0
    nothing = jnp.zeros((2, 1))
    return Behavior(
        action=nothing, mode=nothing, goal=jnp.asarray(goal), constraint=jnp.zeros((7, 10, 1))
    )


TOLD = reading_of([HYDRANT, CONE, CAR, BENCH], [(0, BEHIND, 1), (2, NONE, NONE), (3, NONE, NONE)])


def test_what_was_said_of_other_things_keeps_no_goal_from_being_confirmed() -> None:
    """The hydrant and its cone are seen; the car to avoid and the next command's bench are not."""
    belief = map_with({0: 0, 1: 1})
    group = believed_groups(TOLD, belief)
    assert np.asarray(has_open_partner(group, belief))[:4, 0].tolist() == [False, False, True, True]
    half = map_with({0: 0})
    group = believed_groups(TOLD, half)
    assert np.asarray(has_open_partner(group, half))[:2, 0].tolist() == [True, True]


def test_only_what_the_goal_is_placed_against_is_looked_for() -> None:
    belief = map_with({0: 0})
    group = believed_groups(TOLD, belief)
    seen = np.asarray(bears_on_goal(group, belief, goal_at(0)))[:4, 0]
    assert seen.tolist() == [True, True, False, False]
    hypothesised = np.asarray(bears_on_goal(group, belief, goal_at(3 + 3)))[:4, 0]
    assert hypothesised.tolist() == [False, False, False, True]


def test_where_no_mention_is_the_goal_all_of_them_count() -> None:
    """ "The other cone" is none that has been named."""
    belief = map_with({0: 0})
    group = believed_groups(TOLD, belief)
    assert np.asarray(bears_on_goal(group, belief, goal_at(2)))[:4, 0].all()
