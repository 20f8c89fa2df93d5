"""World templates and the published values of Table 2 (section 4.2).

A template is the number of hydrants and cones of a world: "2H1C". The paper gives no geometry;
the distances of its known-map robot (column *Known*) determine the distance of the hydrant.
"""

import dataclasses
import math
import re
from typing import NamedTuple

from jaxlangnav.inputs.sanitize import as_text, did_you_mean, shorten

RELATION_NAMES = ("null", "behind", "nearest")
"""Relations of Table 2's commands, "null": none; ``ScenarioParams.relation`` is an index."""
MAX_HYDRANTS = 4
MAX_CONES = 4
TEMPLATE_NAMES = ("1H1C", "1H2C", "2H1C", "2H2C")
"""The templates of the paper; any "<h>H<c>C" up to four of each is valid as well."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Template:
    """Number of objects of each type in a world."""

    name: str
    num_hydrants: int
    num_cones: int


class TableRow(NamedTuple):
    """One published row of Table 2; rates in percent, distances in metres, ``sd`` 1 sigma."""

    world: str
    range: float  # sensing range
    relation: str
    known_success_rate: float  # of its robot that knows the map
    success_rate: float  # of the paper's method
    known_distance_mean: float
    known_distance_sd: float
    distance_mean: float
    distance_sd: float


TABLE_2 = (
    TableRow("1H1C", 3.0, "null", 100.0, 93.9, 8.75, 1.69, 16.78, 7.90),
    TableRow("1H1C", 3.0, "behind", 100.0, 98.3, 8.75, 1.69, 13.43, 7.02),
    TableRow("1H2C", 3.0, "null", 100.0, 100.0, 11.18, 1.38, 32.54, 18.50),
    TableRow("1H2C", 3.0, "behind", 100.0, 99.5, 11.18, 1.38, 40.02, 29.66),
    TableRow("2H1C", 3.0, "null", 100.0, 54.4, 10.49, 1.81, 21.56, 10.32),
    TableRow("2H1C", 3.0, "behind", 100.0, 67.4, 10.38, 1.86, 18.72, 10.23),
    TableRow("2H1C", 5.0, "nearest", 100.0, 46.2, 9.19, 1.54, 12.05, 5.76),
)
"""Table 2 of the paper."""


def parse_template(name: str) -> Template:
    """Parse a template's name, "2H1C" or "2h, 1c": two hydrants (1 to 4) and one cone (0 to 4).

    Raises:
        ValueError: the name is not of this form, or a number is outside its limits.
    """
    compact = re.sub(r"[\s,]", "", name).upper()
    match = re.fullmatch(r"(\d{1,9})H(\d{1,9})C", compact)
    if match is None:
        # "1C2H" means 2H1C
        reordered = re.sub(r"(\d+C)(\d+H)", r"\2\1", shorten(compact))
        hint = did_you_mean(reordered, TEMPLATE_NAMES, cutoff=0.4)
        raise ValueError(
            f"unknown world template {as_text(name)}: expected <hydrants>H<cones>C, one of "
            f"{', '.join(TEMPLATE_NAMES)} or the like{hint}"
        )
    hydrants, cones = int(match[1]), int(match[2])
    for noun, count, minimum, maximum in (
        ("hydrants", hydrants, 1, MAX_HYDRANTS),
        ("cones", cones, 0, MAX_CONES),
    ):
        if not minimum <= count <= maximum:
            message = f"world template {as_text(name)} has {count} {noun}"
            raise ValueError(f"{message}: choose {minimum} to {maximum}")
    return Template(name=f"{hydrants}H{cones}C", num_hydrants=hydrants, num_cones=cones)


def check_relation(relation: str) -> int:
    """Return the index of one of ``RELATION_NAMES``, or raise a one-line ValueError."""
    if relation not in RELATION_NAMES:
        choices = f"{', '.join(RELATION_NAMES)}{did_you_mean(relation, RELATION_NAMES)}"
        raise ValueError(f"unknown relation {as_text(relation)}: choose one of {choices}")
    return RELATION_NAMES.index(relation)


def known_map_distance(template: Template, relation: str) -> tuple[float, float]:
    """Look up the distance from the start to the intended hydrant: column Known of Table 2.

    A combination that is not in the paper uses the closest row that is: the same relation or else
    null, at most two hydrants, at most two cones, and 2H1C for 2H2C. Worlds with three or four of
    a type are scaled up so that the density of objects is that of 2H1C.

    Returns:
        Mean and standard deviation, metres.
    """
    check_relation(relation)
    world = "2H1C" if template.num_hydrants > 1 else f"1H{min(max(template.num_cones, 1), 2)}C"
    rows = {row.relation: row for row in TABLE_2 if row.world == world}
    row = rows.get(relation, rows["null"])
    counts = template.num_hydrants, template.num_cones
    scale = math.sqrt(sum(counts) / 3) if max(counts) > 2 else 1.0
    return row.known_distance_mean * scale, row.known_distance_sd * scale
