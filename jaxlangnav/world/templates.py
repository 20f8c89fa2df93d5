"""World templates and the printed figures of Table 2 (section 4.2).

A template says how many hydrants and cones a world has: "2H1C". The paper gives no geometry;
the distances of its known-map robot (column *Known*) fix how far the intended hydrant stands.
"""

import dataclasses
import difflib
import math
import re
from typing import NamedTuple

from jaxlangnav.inputs.sanitize import as_text, shorten
from jaxlangnav.inputs.schema import closest_choice

RELATION_NAMES = ("null", "behind", "nearest")
"""Relations of the commands of Table 2; an index into this tuple is ``ScenarioLaw.relation``."""
MAX_HYDRANTS = 4
MAX_CONES = 4
TEMPLATE_NAMES = ("1H1C", "1H2C", "2H1C", "2H2C")
"""The templates of the paper; any "<h>H<c>C" up to four of each is understood as well."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Template:
    """How many objects a world has."""

    name: str
    num_hydrants: int
    num_cones: int


class TableRow(NamedTuple):
    """One printed row of Table 2; rates in percent, distances in metres, ``sd`` 1 sigma."""

    world: str
    range: float
    relation: str
    success_known: float
    success_ours: float
    distance_known: float
    distance_known_sd: float
    distance_ours: float
    distance_ours_sd: float


TABLE_2 = (
    TableRow("1H1C", 3.0, "null", 100.0, 93.9, 8.75, 1.69, 16.78, 7.90),
    TableRow("1H1C", 3.0, "behind", 100.0, 98.3, 8.75, 1.69, 13.43, 7.02),
    TableRow("1H2C", 3.0, "null", 100.0, 100.0, 11.18, 1.38, 32.54, 18.50),
    TableRow("1H2C", 3.0, "behind", 100.0, 99.5, 11.18, 1.38, 40.02, 29.66),
    TableRow("2H1C", 3.0, "null", 100.0, 54.4, 10.49, 1.81, 21.56, 10.32),
    TableRow("2H1C", 3.0, "behind", 100.0, 67.4, 10.38, 1.86, 18.72, 10.23),
    TableRow("2H1C", 5.0, "nearest", 100.0, 46.2, 9.19, 1.54, 12.05, 5.76),
)
"""Table 2 as printed."""


def parse_template(name: str) -> Template:
    """Read a template's name, "2H1C" or "2h, 1c": two hydrants (1 to 4) and one cone (0 to 4).

    Raises:
        ValueError: the name is not of this form, or a number is outside its limits.
    """
    compact = re.sub(r"[\s,]", "", name).upper()
    match = re.fullmatch(r"(\d{1,9})H(\d{1,9})C", compact)
    if match is None:
        # "1C2H" means 2H1C
        turned = re.sub(r"(\d+C)(\d+H)", r"\2\1", shorten(compact))
        close = difflib.get_close_matches(turned, TEMPLATE_NAMES, n=1, cutoff=0.4)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise ValueError(
            f"unknown world template {as_text(name)}: expected <hydrants>H<cones>C, one of "
            f"{', '.join(TEMPLATE_NAMES)} or the like.{hint}"
        )
    hydrants, cones = int(match[1]), int(match[2])
    for what, number, least, most in (
        ("hydrants", hydrants, 1, MAX_HYDRANTS),
        ("cones", cones, 0, MAX_CONES),
    ):
        if not least <= number <= most:
            where = f"world template {as_text(name)} has {number} {what}"
            raise ValueError(f"{where}: choose {least} to {most}")
    return Template(name=f"{hydrants}H{cones}C", num_hydrants=hydrants, num_cones=cones)


def check_relation(relation: str) -> int:
    """Look up the index of one of ``RELATION_NAMES``, or raise a ValueError of one line."""
    if relation not in RELATION_NAMES:
        known = f"{', '.join(RELATION_NAMES)}{closest_choice(relation, RELATION_NAMES)}"
        raise ValueError(f"unknown relation {as_text(relation)}: choose one of {known}")
    return RELATION_NAMES.index(relation)


def known_range(template: Template, relation: str) -> tuple[float, float]:
    """Look up how far the intended hydrant stands from the start: column Known of Table 2.

    A combination that the paper does not print takes the nearest row that it prints: the same
    relation or else null, at most two hydrants, at most two cones, and 2H1C for 2H2C. Worlds
    with three or four of a kind are scaled up so that each object keeps the room of 2H1C.

    Returns:
        Mean and standard deviation, metres.
    """
    check_relation(relation)
    world = "2H1C" if template.num_hydrants > 1 else f"1H{min(max(template.num_cones, 1), 2)}C"
    rows = {row.relation: row for row in TABLE_2 if row.world == world}
    row = rows.get(relation, rows["null"])
    numbers = template.num_hydrants, template.num_cones
    scale = math.sqrt(sum(numbers) / 3) if max(numbers) > 2 else 1.0
    return row.distance_known * scale, row.distance_known_sd * scale
