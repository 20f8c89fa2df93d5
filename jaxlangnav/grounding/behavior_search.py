"""Behavior inference on the host, over the whole symbol space of a world (section 3.3).

Slow and plain: Table 1 counts its root sets, and the device kernel is tested against it.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from jaxlangnav.grounding.annotation import walk
from jaxlangnav.grounding.behavior_features import World
from jaxlangnav.grounding.features import senses_of
from jaxlangnav.grounding.graph import VERB_LABELS
from jaxlangnav.grounding.model import CorrespondenceModel
from jaxlangnav.grounding.properties import (
    KIND_OF,
    Path,
    behavior_properties,
    child_groundings,
    ranks_meant,
)
from jaxlangnav.grounding.search import BEAM_WIDTH, Hypothesis, LogOdds, search
from jaxlangnav.grounding.symbols import BehaviorSpace
from jaxlangnav.language.phrase import Phrase


def infer_behavior_sets(
    root: Phrase,
    clause: int,
    world: World,
    model: CorrespondenceModel,
    rank: Mapping[Path, int],
    type_names: tuple[str, ...],
    width: int = BEAM_WIDTH,
) -> list[Hypothesis]:
    """Infer the distribution over sets of behavior symbols at the root of a clause.

    Args:
        root: the clause.
        clause: its position in the sentence.
        world: placed objects, the robot last.
        model: behavior model.
        rank: of each phrase: 0, 1 nearest, 2 second, ... (annotation model).
        type_names: object types.
        width: beam width.

    Returns:
        Up to ``width`` hypotheses over ``BehaviorSpace(N)``, best first.
    """
    log_odds = behavior_log_odds(root, clause, world, model, rank, type_names)
    return search(root, log_odds, width=width, path=(clause,))


def behavior_log_odds(
    root: Phrase,
    clause: int,
    world: World,
    model: CorrespondenceModel,
    rank: Mapping[Path, int],
    type_names: tuple[str, ...],
) -> LogOdds:
    """Build the log-odds of the behavior symbols for ``search``; arguments as above."""
    space = BehaviorSpace(world.object_type.shape[0])
    prepared = {
        path: (
            model.coefficients(phrase),
            senses_of(phrase, type_names),
            ranks_meant(phrase, path, rank, type_names),
        )
        for phrase, path in walk(root, (clause,))
    }

    def log_odds(phrase: Phrase, path: Path, children: Sequence[Hypothesis]) -> np.ndarray:
        coefficients, senses, _ = prepared[path]
        joined = child_groundings(
            world,
            space,
            [
                (phrase.children[i], child.expressed, prepared[(*path, i)][2])
                for i, child in enumerate(children)
            ],
        )
        odds = np.full(space.size, -np.inf)
        is_verb = phrase.label in VERB_LABELS
        for kind, table in behavior_properties(world, is_verb, senses, joined).items():
            values = space.part(odds, KIND_OF[kind])
            found = (table @ coefficients[kind]).reshape(values.shape)
            if kind not in ("action", "mode"):
                found = np.where(world.is_object, found, -np.inf)
            values[...] = found
        return odds

    return log_odds
