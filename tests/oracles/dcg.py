"""Slow twins of the correspondence graph in plain NumPy: everything is enumerated."""

import itertools

import numpy as np

from jaxlangnav.grounding.behavior_properties import (
    CONSTRAINT_CONDITIONS,
    OBJECT_CONDITIONS,
    REGION_CONDITIONS,
)


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


class BehaviorOracle:
    """A behavior program in one small world, all sets of every phrase enumerated."""

    def __init__(self, program, world):
        self.p = {name: np.asarray(value, np.float64) for name, value in vars(program).items()}
        self.w = world
        self.size = len(world.object_type)
        self.num_slots = self.p["region_relation"].shape[1]
        self.groups = 2 + self.num_slots  # objects, regions by slot, constraints
        self.sets = all_sets(self.groups * self.size).reshape(-1, self.groups, self.size)

    def own(self, row):
        named = [kind for kind in self.p["own"][row] if kind != -1]
        return np.isin(self.w.object_type, named) & self.w.is_object

    def lies(self, row, expressed):
        """Objects that lie in the regions that a phrase expresses."""
        found = np.zeros(self.size, bool)
        for slot in range(self.num_slots):
            index = int(self.p["region_table"][row, slot])
            if index < 0:
                continue
            table = int(self.p["table"][index])
            for j in np.flatnonzero(expressed[1 + slot]):
                if table == 18:
                    found[j] = True
                    continue
                kind, relation = divmod(table, 6)
                extreme = self.w.is_ranked[0][relation][:, j]
                later = self.w.is_ranked[1][relation][:, j]
                rows = (self.w.is_related[relation][:, j], extreme, later)
                found |= rows[kind]
        return found & self.w.is_object

    def odds(self, row, children):
        """Log-odds [groups, N] given (child row, set) with the last child first."""
        p, n = self.p, self.size
        objects, touched = np.zeros(n, bool), np.zeros(n, bool)
        same, near = np.zeros((self.num_slots, n), bool), np.zeros(n, bool)
        kept, lies = np.zeros(n, bool), np.ones(n, bool)
        for k, (child, chosen) in enumerate(children):
            objects |= chosen[0]
            touched |= chosen[: 1 + self.num_slots].any(0)
            for slot in range(self.num_slots):
                source = int(p["region_from"][row, k, slot])
                if source >= 0:
                    same[slot] |= chosen[1 + source]
            source = int(p["constraint_region"][row, k])
            if source >= 0:
                near |= chosen[1 + source]
            if p["constraint_from"][row, k] == 0:
                kept |= chosen[-1]
            if p["is_restrictor"][row, k]:
                lies &= self.lies(child, chosen)
        own, robot = self.own(row), self.w.object_type == -2
        last = self.w.is_previous & self.w.is_object
        alike = np.isin(self.w.object_type, self.w.object_type[last]) & ~last & self.w.is_object
        odds = np.full((self.groups, n), -np.inf)
        for i in np.flatnonzero(self.w.is_object):
            w = dict(zip(OBJECT_CONDITIONS, p["objects"][row], strict=True))
            value = w["always"] + (w["own"] if own[i] else w["other"])
            value += w["own_previous"] * (own[i] and last[i])
            value += w["previous"] * last[i] + w["alike"] * alike[i]
            value += w["unlike"] * (last.any() and not last[i] and not alike[i])
            value += w["no_previous"] * (not last.any())
            if objects[i]:
                value += w["inside"] + (w["inside_lies"] if lies[i] else w["inside_elsewhere"])
            else:
                value += w["outside"]
            odds[0, i] = value + w["own_lies"] * (own[i] and lies[i])
            for s in range(self.num_slots):
                w = dict(zip(REGION_CONDITIONS, p["regions"][row, :, s], strict=True))
                value = w["base"] + w["own"] * own[i] + w["robot"] * robot[i]
                value += w["inside"] * objects[i] + w["same"] * same[s, i]
                odds[1 + s, i] = value + w["absent"] * (not objects[i] and not same[s, i])
            w = dict(zip(CONSTRAINT_CONDITIONS, p["constraints"][row], strict=True))
            value = w["base"] + w["same"] * near[i] + w["inside"] * objects[i] + w["kept"] * kept[i]
            value += w["touched"] + w["new"] * (not kept[i]) if touched[i] else w["untouched"]
            odds[-1, i] = value
        return odds

    def distribution(self, row, children):
        """Exact distribution over the sets of one phrase, given those of its children."""
        total = np.zeros(len(self.sets))
        for prior, chosen in self.combinations(children):
            odds = np.clip(self.odds(row, chosen), -1e4, 1e4)
            logs = np.where(self.sets, -softplus(-odds), -softplus(odds)).sum((1, 2))
            total += prior * np.exp(logs)
        return total

    def combinations(self, children):
        """Joint sets of the children worth looking at, with their probability."""
        kept = [(row, np.flatnonzero(p > 1e-9), p) for row, p in children]
        for index in itertools.product(*(places for _, places, _ in kept)):
            pairs = list(zip(kept, index, strict=True))
            prior = np.prod([p[i] for (_, _, p), i in pairs]) if pairs else 1.0
            if prior > 1e-9:
                yield prior, [(row, self.sets[i]) for (row, _, _), i in pairs]

    def behavior(self):
        """Goal [7, N] and constraint [7, N] at the root."""
        count = int(self.p["num_phrases"])
        stack = []

        def pop(row):
            number = int(self.p["num_children"][row])
            taken = [stack.pop() for _ in range(number)]
            return taken

        for row in range(count - 1):
            taken = pop(row)
            stack.append((row, self.distribution(row, taken)))
        goal, constraint = np.zeros((7, self.size)), np.zeros((7, self.size))
        root = len(self.p["num_children"]) - 1
        mass = 0.0
        for prior, chosen in self.combinations(pop(root)):
            chance = 1.0 / (1.0 + np.exp(-np.clip(self.odds(root, chosen), -500, 500)))
            part = chance[1 : 1 + self.num_slots]
            share = (1 - np.prod(1 - part)) / max(part.sum(), 1e-9)
            for s in range(self.num_slots):
                goal[int(self.p["region_relation"][root, s])] += prior * share * part[s]
            constraint[int(self.p["constraint_relation"][root])] += prior * chance[-1]
            mass += prior
        return goal / mass, constraint / mass
