"""Termination of a search that finds nothing: P(the goal exists and is still unseen) (ours).

Before any look the number N of things of a type is Poisson with mean α, the map's
``concentration``; a sentence speaks of one that is there with probability 1 − ε, and of one that is
not with probability ε, the map's ``misleading``. There are some and all have escaped every look
with probability

    Σ_{n≥1} e^{-α} (α u)ⁿ / n! = e^{-α} (e^{α u} − 1)

where u is the probability that one of them has (``search.SearchMap.unseen``). Where the rate is not
known but Gamma, with mean α and variance α κ (``semantic_map.counts``), e^{α u} is
((1 + κ) / (1 + κ (1 − u)))^{α / κ}.

That a sentence says where a thing is which stands elsewhere, and that it speaks of a thing which is
nowhere, are two errors, of probabilities ε and ν, the planner's ``absent``. Where something has
been seen the search for another goes on until ε says that there is none. Where nothing has either
error ends the search, so it ends sooner, by ε + (1 − ε) ν; and with the probability of the second,

    q = (1 − ε) ν / [(1 − ε) (1 − ν) (e^{α u} − 1) + ε + (1 − ε) ν]

all is to be looked at whatever the order, so that the whole way counts (``latency``).

What is said may be false of a thing that is there. Until one is seen it stands elsewhere, anywhere
not looked at, with probability 1 − p of what is there at all: p is ``chance_left`` with the doubt
ε v, where v is the probability that a thing anywhere would still be unseen.

A thorough search (ν > 0) goes on until no more than ``MOST_UNLOOKED`` of where the goal could stand
is left.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.object_types import is_anything, is_type
from jaxlangnav.messages import Readings
from jaxlangnav.semantic_map.params import MapParams

MOST_UNLOOKED = 0.02
"""u above which nothing is given up as nowhere in a thorough search."""
MOST_UNLOOKED_ROUND = 0.002
"""The same where something forbidden is gone round: what it hides lies in one place."""


def chance_left(unseen: Array, concentration: Array, misleading: Array, clumping: Array) -> Array:
    """Compute the probability that what is spoken of, and has not been seen, is there at all.

        p = (1 − ε) (e^{α u} − 1) / [(1 − ε) (e^{α u} − 1) + ε]

    Limits: u → 0 gives 0, and ε → 0 gives 1 while anything is unseen: what is said is then sure.

    Args:
        unseen: f32[], u, probability that a thing that is there would have escaped every look.
        concentration: f32[], α, expected number of things of a type in the area.
        misleading: f32[], ε, probability that what is said does not hold.
        clumping: f32[], κ of the number of things.
    """
    grown = jnp.log1p(clumping * unseen / (1.0 + clumping * (1.0 - unseen)))
    share = jnp.where(clumping > 0.0, grown / jnp.maximum(clumping, 1e-9), unseen)
    there = (1.0 - misleading) * jnp.expm1(concentration * share)
    return there / jnp.maximum(there + misleading, 1e-12)


class Chances(NamedTuple):
    """How likely it is that what has not been seen is there."""

    fitting: Array  # f32[] that there is one that fits, where something seen does not
    any: Array  # f32[] that there is one at all, where nothing spoken of has been seen
    nowhere: Array  # f32[] q, that there is none because what is spoken of is nowhere
    unlooked: Array | float = 0.0  # f32[] u, where it could stand and nobody has looked
    elsewhere: Array | float = 0.0  # f32[] s, that it is not as is said, if it is there


def chances(unseen: Array, absent: Array, maps: MapParams, missed: Array | np.float32) -> Chances:
    """Compute how likely it is that what has not been seen is there.

    ``unseen`` is u, ``absent`` ν and ``missed`` v, f32[]. Limits: at ν = 0 both are the same, and q
    is 0.
    """
    nowhere = (1.0 - maps.misleading) * absent
    wrong = maps.misleading + nowhere
    fitting, either, as_said = (
        chance_left(unseen, maps.concentration, doubt, maps.clumping)
        for doubt in (maps.misleading, wrong, maps.misleading * missed)
    )
    nowhere = nowhere / jnp.maximum(wrong, 1e-12) * (1.0 - either)
    return Chances(fitting, either, nowhere, unlooked=unseen, elsewhere=1.0 - as_said)


def missing_types(readings: Readings, object_type: np.ndarray) -> list[int]:
    """List what a sentence speaks of and no look has shown (host only).

    Kinds of the likeliest reading, in the order of the mentions; ``ANYTHING`` where no more has
    been seen than what is called by its type. ``object_type``, i32[O, ...], has the kinds of all
    objects observed, in any of the maps; NONE in between.
    """
    best = int(np.argmax(np.asarray(readings.log_probability)))
    spoken = dict.fromkeys(int(kind) for kind in np.asarray(readings.mention_type)[best])
    seen, kinds = np.unique(object_type), [kind for kind in spoken if kind >= 0]
    missing = [kind for kind in kinds if not np.any(is_type(seen, kind))]
    # What is called by its own name is not "the thing" too.
    num_named = sum(not is_anything(kind) for kind in kinds if kind not in missing)
    num_seen = np.any(np.reshape(object_type, (len(object_type), -1)) >= 0, axis=1).sum()
    return [k for k in kinds if k in missing or (is_anything(k) and num_seen <= num_named)]
