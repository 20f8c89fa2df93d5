"""Slow twins of the correspondence graph in plain NumPy: everything is enumerated."""

import itertools

import numpy as np


def softplus(x):
    return np.logaddexp(0.0, x)


def all_sets(size):
    """Every set over ``size`` symbols, bool[2^size, size]."""
    return np.array(list(itertools.product((False, True), repeat=size)))


def log_probability(expressed, log_odds):
    """log p of a set of independent binary factors."""
    return float(np.where(expressed, -softplus(-log_odds), -softplus(log_odds)).sum())


def root_distribution(root, log_odds, path=()):
    """Exact distribution over root sets by enumeration of all correspondences, {bytes: p}."""
    below = [
        root_distribution(child, log_odds, (*path, i)) for i, child in enumerate(root.children)
    ]
    total = {}
    for chosen in itertools.product(*(b.items() for b in below)):
        prior = np.prod([p for _, p in chosen]) if chosen else 1.0
        children = [np.frombuffer(key, bool) for key, _ in chosen]
        odds = log_odds(root, path, children)
        for expressed in all_sets(len(odds)):
            key = expressed.tobytes()
            total[key] = total.get(key, 0.0) + prior * np.exp(log_probability(expressed, odds))
    return total
