"""QMDP values by the double sum over particles and behaviors (eq. 11-12). NumPy, float64."""

import math

import numpy as np

FRONT, BEHIND, LEFT, RIGHT, NEAR, FAR, AT = range(7)


def goal_place(
    region: int, place: np.ndarray, viewer: np.ndarray, distance: np.ndarray, is_robot: bool
) -> np.ndarray:
    """Place a goal region: the typical distance from its object, as the viewer sees it."""
    if region == AT:
        return place
    if is_robot:
        sight, turn = viewer[2], {FRONT: 0, LEFT: 1, BEHIND: 2, RIGHT: 3, NEAR: 0, FAR: 0}[region]
    else:
        sight = math.atan2(place[1] - viewer[1], place[0] - viewer[0])
        turn = {BEHIND: 0, LEFT: 1, FRONT: 2, RIGHT: 3, NEAR: 2, FAR: 2}[region]
    angle = sight + turn * math.pi / 2
    return place + distance[region] * np.array([math.cos(angle), math.sin(angle)])


def reassign_mass(mass: np.ndarray, is_referent: np.ndarray, num_objects: int) -> np.ndarray:
    """Let observed bystanders yield to the likeliest goal among the referents, f64[P, N + 1].

    Of goal probabilities of slots, the observed ones first; which slots the words refer to.
    """
    result = mass.copy()
    for particle, referents in enumerate(is_referent):
        candidates = [slot for slot, is_it in enumerate(referents) if is_it]
        if not candidates:
            continue
        chosen = max(candidates, key=lambda slot: mass[particle, slot])
        for slot in range(num_objects):
            if not referents[slot]:
                moved = min(mass[particle, slot], mass[particle, chosen])
                result[particle, slot] -= moved
                result[particle, chosen] += moved
    return result


def values(
    nodes: np.ndarray,
    places: np.ndarray,
    weight: np.ndarray,
    goal: np.ndarray,
    viewer: np.ndarray,
    distance: np.ndarray,
    discount: float,
) -> np.ndarray:
    """Sum γ^d p(β | S) p(S) over all particles, slots and regions, f64[A].

    Of nodes [A, 2], places of slots [P, N + 1, 2], the robot last, weights [P], goals
    [P, 7, N + 1], and the typical distance of each relation [6].
    """
    result = np.zeros(len(nodes))
    for particle in range(len(weight)):
        for region in range(7):
            for slot in range(places.shape[1]):
                probability = goal[particle, region, slot] * weight[particle]
                if probability > 0.0:
                    is_robot = slot == places.shape[1] - 1
                    place = goal_place(region, places[particle, slot], viewer, distance, is_robot)
                    way = np.hypot(*(nodes - place).T)
                    result += probability * discount**way
    return result
