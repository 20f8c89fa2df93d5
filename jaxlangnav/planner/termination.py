"""Termination of a search that finds nothing: P(the goal exists and is still unseen) (ours).

A priori the number N of objects of a type is Poisson with mean α, the map's ``concentration``; a
mentioned object exists with probability 1 − ε, and does not with probability ε, the map's
``misleading``. Some exist and all have been missed by every observation with probability

    Σ_{n≥1} e^{-α} (α u)ⁿ / n! = e^{-α} (e^{α u} − 1)

where u is the miss probability of one of them (``search.SearchMap.unseen``). If the rate is
unknown, Gamma with mean α and variance α κ (``semantic_map.counts``), e^{α u} is
((1 + κ) / (1 + κ (1 − u)))^{α / κ}.

A wrong location of an object that exists, and a mention of an object that does not exist, are two
errors, of probabilities ε and ν, the planner's ``absent``. If a candidate has been observed, only
ε ends the search for another. If none has, either error ends it, so it ends sooner, by
ε + (1 − ε) ν; and with the probability of the second,

    q = (1 − ε) ν / [(1 − ε) (1 − ν) (e^{α u} − 1) + ε + (1 − ε) ν]

the whole area has to be viewed in any order, so that the total distance counts (``latency``).

The description of an existing object may be false. Until one is observed it is elsewhere,
anywhere unobserved, with probability 1 − p given that it exists: p is ``prob_exists`` with the
error rate ε v, where v is the mean miss probability over the area.

A thorough search (ν > 0) continues until at most ``MAX_UNSEEN`` of the goal's possible positions
are left.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.object_types import is_anything, is_type
from jaxlangnav.messages import Readings
from jaxlangnav.semantic_map.params import MapParams

MAX_UNSEEN = 0.022
"""Maximum u at which a thorough search ends as not found."""
MAX_UNSEEN_DETOUR = 0.002
"""The same with keep-out zones: the mass that they hide lies in one place."""


def prob_exists(unseen: Array, concentration: Array, misleading: Array, clumping: Array) -> Array:
    """Compute the probability that a mentioned, unobserved object exists.

        p = (1 − ε) (e^{α u} − 1) / [(1 − ε) (e^{α u} − 1) + ε]

    Limits: u → 0 gives 0, and ε → 0 gives 1 while u > 0: annotations are then certain.

    Args:
        unseen: f32[], u, miss probability of an existing object over all observations.
        concentration: f32[], α, expected number of objects of a type in the area.
        misleading: f32[], ε, probability that an annotation is false.
        clumping: f32[], κ, overdispersion of the number of objects.
    """
    log_growth = jnp.log1p(clumping * unseen / (1.0 + clumping * (1.0 - unseen)))
    rate = jnp.where(clumping > 0.0, log_growth / jnp.maximum(clumping, 1e-9), unseen)
    exists = (1.0 - misleading) * jnp.expm1(concentration * rate)
    return exists / jnp.maximum(exists + misleading, 1e-12)


class Presence(NamedTuple):
    """Existence probabilities of an unobserved goal."""

    prob_fitting: Array  # f32[] that a fitting object exists, if an observed one does not fit
    prob_any: Array  # f32[] that one exists at all, if none has been observed
    prob_absent: Array  # f32[] q, that the mentioned object does not exist
    miss: Array | float = 0.0  # f32[] u, miss probability of the goal over all observations
    prob_elsewhere: Array | float = 0.0  # f32[] s, that it is not where described, if it exists


def presence(unseen: Array, absent: Array, maps: MapParams, miss: Array | np.float32) -> Presence:
    """Compute the probabilities that an unobserved goal exists.

    ``unseen`` is u, ``absent`` ν and ``miss`` v, f32[]. Limits: at ν = 0 both are the same, and q
    is 0.
    """
    nonexistent = (1.0 - maps.misleading) * absent
    error = maps.misleading + nonexistent
    fitting, any_exist, placed = (
        prob_exists(unseen, maps.concentration, rate, maps.clumping)
        for rate in (maps.misleading, error, maps.misleading * miss)
    )
    prob_absent = nonexistent / jnp.maximum(error, 1e-12) * (1.0 - any_exist)
    return Presence(fitting, any_exist, prob_absent, miss=unseen, prob_elsewhere=1.0 - placed)


def missing_types(readings: Readings, object_type: np.ndarray) -> list[int]:
    """List the object types that a sentence mentions and that have not been observed (host only).

    Type codes of the likeliest interpretation, in the order of the mentions; ``ANYTHING`` if all
    observed objects are named by their types. ``object_type``, i32[O, ...], has the type codes of
    all observed objects, in any of the maps; NONE in between.
    """
    likeliest = int(np.argmax(np.asarray(readings.log_probability)))
    mentioned = dict.fromkeys(int(code) for code in np.asarray(readings.mention_type)[likeliest])
    observed, codes = np.unique(object_type), [code for code in mentioned if code >= 0]
    missing = [code for code in codes if not np.any(is_type(observed, code))]
    # An object named by its type is not also "the thing".
    num_named = sum(not is_anything(code) for code in codes if code not in missing)
    num_seen = np.any(np.reshape(object_type, (len(object_type), -1)) >= 0, axis=1).sum()
    return [c for c in codes if c in missing or (is_anything(c) and num_seen <= num_named)]
