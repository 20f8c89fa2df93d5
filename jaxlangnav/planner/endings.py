"""When there is nothing left to look for: the end of a search that finds nothing (ours).

The belief takes it for granted that what is spoken of exists, so a robot that goes by it alone
searches for ever. Whether it exists is itself inferred. Before any look the number N of things of
a type is Poisson with mean α, the map's ``concentration``; a sentence speaks of one that is there
with probability 1 − ε, and of one that is not with probability ε, the map's ``misleading``. There
are some and all have escaped every look with probability

    Σ_{n≥1} e^{-α} (α u)ⁿ / n! = e^{-α} (e^{α u} − 1)

where u is the probability that one of them has (``search.SearchMap.unseen``). Where the rate is not
known but Gamma, with mean α and variance α κ (``semantic_map.counts``), e^{α u} is
((1 + κ) / (1 + κ (1 − u)))^{α / κ}.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.kinds import fits
from jaxlangnav.messages import Readings


def chance_left(unseen: Array, concentration: Array, misleading: Array, clumping: Array) -> Array:
    """Compute the probability that what is spoken of, and has not been seen, is there at all.

        p = (1 − ε) (e^{α u} − 1) / [(1 − ε) (e^{α u} − 1) + ε]

    Limits: u → 0 gives 0, and ε → 0 gives 1 while anything is unseen: what is said is then sure.

    Args:
        unseen: f32[], u, probability that a thing that is there would have escaped every look.
        concentration: f32[], α, expected number of things of a type in the area.
        misleading: f32[], ε, probability that what is said does not hold.
        clumping: f32[], κ of the number of things.

    Returns:
        f32[] in [0, 1].
    """
    grown = jnp.log1p(clumping * unseen / (1.0 + clumping * (1.0 - unseen)))
    share = jnp.where(clumping > 0.0, grown / jnp.maximum(clumping, 1e-9), unseen)
    there = (1.0 - misleading) * jnp.expm1(concentration * share)
    return there / jnp.maximum(there + misleading, 1e-12)


def missing_types(readings: Readings, object_type: np.ndarray) -> list[int]:
    """List what a sentence speaks of and no look has shown (host only).

    Args:
        readings: the sentence, of one robot; the likeliest reading is taken.
        object_type: i32[...], kinds of all objects observed, in any of the maps; NONE in between.

    Returns:
        Kinds, in the order of the mentions.
    """
    best = int(np.argmax(np.asarray(readings.log_probability)))
    spoken = dict.fromkeys(int(kind) for kind in np.asarray(readings.mention_type)[best])
    seen = np.unique(object_type)
    return [kind for kind in spoken if kind >= 0 and not np.any(fits(seen, kind))]
