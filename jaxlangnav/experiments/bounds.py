"""Limits no robot can beat in these worlds, by computation (section 4.2).

- The known map: the straight way to the goal.
- Search without a hint. After L metres a robot that sees R metres all round has seen at most
  πR² + 2RL square metres, so it has found the goal with at most the probability of the likeliest
  region of that size. For a goal anywhere in the area A alike that gives

      E[L] ≥ (A − πR²)² / (4RA);

  for goals drawn by the worlds' law (range N(mean, sd), bearing ±45°) the likeliest region is
  known too, and the integral of 1 − F over L is done on a grid. It is never less than the way to
  where the goal comes into view, r − R. Having found the goal at min(r, R) metres the robot still
  has to go to within 1.5 m of it; that way is added.

Detection is taken as certain in both, which only lowers them. They hold where the sentence gives
no relation: a relation makes the landmark a hint.
"""

import math

import numpy as np

from jaxlangnav.world.simulator import SUCCESS_RADIUS
from jaxlangnav.world.templates import known_range, parse_template

_SECTOR = math.pi / 2.0
"""Radians: hydrants stand within ±45° of the start's heading."""


def operating_area(template: str, relation: str) -> float:
    """Compute the size of the operating area of a template's worlds.

    Args:
        template: such as "2H1C".
        relation: "null", "behind" or "nearest".

    Returns:
        Square metres: D · √2 D, with D the known mean + 2.5 sigma.
    """
    mean, sd = known_range(parse_template(template), relation)
    depth = mean + 2.5 * sd
    return math.sqrt(2.0) * depth * depth


def uniform_search_bound(area: float, sensing_range: float) -> float:
    """Bound the mean way until a goal that may be anywhere alike comes into view.

        E[L] ≥ (A − πR²)² / (4RA)

    Limits: 0 once the first look covers the area; proportional to A / 4R for a small R.

    Args:
        area: A, square metres.
        sensing_range: R, metres.

    Returns:
        Metres.
    """
    unseen = max(0.0, area - math.pi * sensing_range**2)
    return unseen * unseen / (4.0 * sensing_range * area)


def law_search_bound(mean: float, sd: float, sensing_range: float) -> float:
    """Bound the mean way until a goal drawn by the worlds' law comes into view.

        E[L] ≥ max(∫ 1 − F(πR² + 2RL) dL, E[max(0, r − R)])

    with F(a) the probability of the likeliest region of area a. Limit: 0 for a large R.

    Args:
        mean: of the goal's range from the start, metres.
        sd: of the same, metres.
        sensing_range: R, metres.

    Returns:
        Metres.
    """
    edges = np.linspace(0.0, mean + 6.0 * sd, 4001)
    middle = 0.5 * (edges[1:] + edges[:-1])
    mass = np.exp(-0.5 * ((middle - mean) / sd) ** 2)
    mass /= mass.sum()
    # Thin arcs of the sector, likeliest per square metre first.
    area = 0.5 * _SECTOR * (edges[1:] ** 2 - edges[:-1] ** 2)
    order = np.argsort(-mass / area)
    covered = np.concatenate([[0.0], np.cumsum(area[order])])
    found = np.concatenate([[0.0], np.cumsum(mass[order])])
    way = np.maximum(0.0, (covered - math.pi * sensing_range**2) / (2.0 * sensing_range))
    search = np.sum((1.0 - 0.5 * (found[1:] + found[:-1])) * np.diff(way))
    return float(max(search, np.sum(mass * np.maximum(0.0, middle - sensing_range))))


def approach(mean: float, sd: float, sensing_range: float) -> float:
    """Compute the mean way from where the goal comes into view to 1.5 m from it.

    Args:
        mean: of the goal's range from the start, metres.
        sd: of the same, metres.
        sensing_range: R, metres.

    Returns:
        Metres: E[max(0, min(r, R) − 1.5)].
    """
    steps = np.linspace(max(0.0, mean - 6.0 * sd), mean + 6.0 * sd, 2001)
    mass = np.exp(-0.5 * ((steps - mean) / sd) ** 2)
    way = np.maximum(0.0, np.minimum(steps, sensing_range) - SUCCESS_RADIUS)
    return float(np.sum(mass * way) / np.sum(mass))


def limits(template: str, relation: str, sensing_range: float) -> dict[str, float | None]:
    """Gather the limits of one row of a table.

    Args:
        template: such as "2H1C".
        relation: "null", "behind" or "nearest".
        sensing_range: R, metres.

    Returns:
        ``known``: mean straight way, metres; ``search_uniform``, ``search_law``: least mean
        distance of a search without a hint, None where the sentence gives one; ``success``: the
        highest success rate in percent, below 100 where the sentence fits several objects.
    """
    record = parse_template(template)
    mean, sd = known_range(record, relation)
    found: dict[str, float | None] = {
        "known": mean,
        "search_uniform": None,
        "search_law": None,
        "success": 100.0,
    }
    if relation == "null":
        rest = approach(mean, sd, sensing_range)
        area = operating_area(template, relation)
        found["search_uniform"] = rest + uniform_search_bound(area, sensing_range)
        found["search_law"] = rest + law_search_bound(mean, sd, sensing_range)
        found["success"] = 100.0 / record.num_hydrants
    return found
