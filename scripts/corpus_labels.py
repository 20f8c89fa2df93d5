"""Compositional rules for the gold labels of the corpus, phrase by phrase (sections 3.1, 3.3).

Annotation labels state what a phrase says of the unseen world, by object type; behavior labels its
meaning among the objects of a known world. Nothing may use them in place of the trained model.
"""

import functools
import itertools
from dataclasses import dataclass

import numpy as np

from jaxlangnav.grounding.worlds import Geometry
from jaxlangnav.language.corpus import ROBOT_LABEL, Labels, PlacedWorld
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import RELATIONS
from jaxlangnav.relations.strength import count_before

geometry_of = functools.lru_cache(maxsize=8)(Geometry)


def sense_of(phrase: Phrase, sense_name: str) -> str | None:
    """Find the value of a lexical sense such as ``relation`` among a phrase's own words."""
    senses = (sense.partition(":") for word in phrase.words for sense in word.senses)
    return next((value or name for name, _, value in senses if name == sense_name), None)


def rank(phrase: Phrase) -> int:
    """Return the superlative rank of a PP or ADJP: 0 none, 1 nearest or first, 2 second, ..."""
    is_ranked = sense_of(phrase, "superlative") and sense_of(phrase, "relation")
    return int(sense_of(phrase, "rank") or 1) if is_ranked else 0


@dataclass(frozen=True)
class _Annotation:
    symbols: frozenset[str]
    types: tuple[str, ...] = ()  # of the object, for use as a landmark
    regions: tuple[tuple[str, str], ...] = ()  # (relation, landmark type), without a figure yet


def annotate(root: Phrase) -> tuple[Labels, tuple[int, ...]]:
    """Label the phrases of a clause, in the order of ``walk``: annotation symbols, and ranks."""
    labels: list[frozenset[str]] = []

    def visit(phrase: Phrase) -> _Annotation:
        meaning = _annotation(phrase, [visit(child) for child in phrase.children])
        labels.append(meaning.symbols)
        return meaning

    visit(root)
    return tuple(labels), tuple(map(rank, root.walk()))


def _annotation(phrase: Phrase, children: list[_Annotation]) -> _Annotation:
    if phrase.label == "NP" and not children:
        types = tuple(filter(None, (sense_of(phrase, "type"),)))
        return _Annotation(frozenset(f"object({t})" for t in types), types)
    inherited = frozenset().union(*(child.symbols for child in children))
    relations = frozenset(symbol for symbol in inherited if symbol.startswith("relation"))
    types = tuple(t for child in children for t in child.types)
    regions = tuple(region for child in children for region in child.regions)
    relation = sense_of(phrase, "relation")
    if phrase.label in ("PP", "ADJP") and relation is not None:
        regions = tuple((relation, landmark) for landmark in types or (ROBOT_LABEL,))
        opened = frozenset(f"region({relation},{landmark})" for _, landmark in regions)
        return _Annotation(relations | opened, regions=regions)
    if phrase.label not in ("NP", "S"):
        return _Annotation(inherited, types, regions)
    # A figure is combined with its regions: relation(hydrant,behind,cone).
    figure = next((child.types for child in children if child.types), ())
    if not figure or not regions:
        return _Annotation(inherited, figure, regions)
    new = frozenset(f"relation({figure[0]},{r},{landmark})" for r, landmark in regions)
    return _Annotation(relations | new, figure[:1])


@dataclass(frozen=True)
class _Behavior:
    symbols: frozenset[str]
    objects: tuple[int, ...] | None = None
    regions: tuple[tuple[str, int, int], ...] | None = None  # relation, object, rank
    constraints: frozenset[str] = frozenset()


def behave(root: Phrase, world: PlacedWorld, *, is_among_part: bool = True) -> Labels:
    """Label the phrases of a clause in a world with behavior symbols, in the order of ``walk``.

    ``is_among_part``: "the second cone on your left" is the second of those there, not of all.
    """
    labels: list[frozenset[str]] = []

    def visit(phrase: Phrase) -> _Behavior:
        meaning = _behavior(phrase, [visit(c) for c in phrase.children], world, is_among_part)
        labels.append(meaning.symbols)
        return meaning

    visit(root)
    return tuple(labels)


def _behavior(
    phrase: Phrase, children: list[_Behavior], world: PlacedWorld, is_among_part: bool
) -> _Behavior:
    if phrase.label == "VP":
        return _verb_phrase(phrase, children)
    if phrase.label == "S":
        return _Behavior(frozenset())
    if phrase.label == "NP" and not children:
        is_place = sense_of(phrase, "place")
        return _Behavior(frozenset()) if is_place else _objects(_denotation(phrase, world))
    relation = sense_of(phrase, "relation")
    if phrase.label in ("PP", "ADJP") and relation is not None:
        landmarks = (children[0].objects or ()) if children else (len(world.objects),)
        return _regions(tuple((relation, i, rank(phrase)) for i in landmarks), world)
    if phrase.label == "NP":
        return _restrict(children, world, is_among_part)
    inner = children[0]
    if phrase.label == "PP" and inner.objects is not None:
        return _regions(tuple(("at", i, 0) for i in inner.objects), world)
    return inner


def _denotation(phrase: Phrase, world: PlacedWorld) -> tuple[int, ...]:
    """List the objects that a noun phrase without modifiers can denote."""
    type_name = sense_of(phrase, "type")
    is_other = sense_of(phrase, "other") is not None
    previous = None if world.previous is None else world.objects[world.previous][0]
    if sense_of(phrase, "same") is not None and world.previous is not None:
        return (world.previous,) if previous == type_name else ()
    if type_name is None and is_other:
        type_name = previous
    if type_name is None and sense_of(phrase, "anaphor") is None:
        return ()
    return tuple(
        index
        for index, (name, _, _) in enumerate(world.objects)
        if type_name in (None, name) and not (is_other and index == world.previous)
    )


def _objects(indices: tuple[int, ...]) -> _Behavior:
    return _Behavior(frozenset(f"object({i})" for i in indices), objects=indices)


def _regions(regions: tuple[tuple[str, int, int], ...], world: PlacedWorld) -> _Behavior:
    names = [*map(str, range(len(world.objects))), ROBOT_LABEL]
    symbols = frozenset(f"region({relation},{names[i]})" for relation, i, _ in regions)
    return _Behavior(symbols, regions=regions)


def _restrict(children: list[_Behavior], world: PlacedWorld, is_among_part: bool) -> _Behavior:
    """Intersect the objects with the regions of every modifier; without objects, the regions."""
    # A rank counts among the objects left by the other modifiers: "the second cone on your left".
    base, *modifiers = children
    regions = [modifier.regions or () for modifier in modifiers]
    if base.objects is None:
        return _regions(tuple(itertools.chain(*regions)), world)
    geometry, types = geometry_of(world), np.array([type_name for type_name, _, _ in world.objects])

    def select(objects: tuple[int, ...], *, is_ranked: bool) -> tuple[int, ...]:
        selected = [r for r in regions if any(order for _, _, order in r) == is_ranked]
        candidates = np.isin(np.arange(len(types)), objects) if is_among_part else types == types

        def fits(figure: int, region: tuple[str, int, int]) -> bool:
            relation, landmark, order = region
            index = RELATIONS.index(relation)
            if figure == landmark or not order:
                return figure != landmark and bool(geometry.holds[index, figure, landmark])
            rivals = candidates & (types == types[figure])
            rivals &= ~np.isin(np.arange(len(types)), (figure, landmark))
            num_stronger = count_before(geometry.strength[index, :, landmark], rivals)
            return bool(num_stronger[figure] == order - 1)

        return tuple(f for f in objects if all(any(fits(f, r) for r in m) for m in selected))

    return _objects(select(select(base.objects, is_ranked=False), is_ranked=True))


def _verb_phrase(phrase: Phrase, children: list[_Behavior]) -> _Behavior:
    """Compose action, mode, goal regions and constraint regions."""
    constraints = frozenset().union(*(child.constraints for child in children))
    goals = [child for child in children if child.objects is not None or child.regions is not None]
    if sense_of(phrase, "constraint"):
        avoided = frozenset(f"constraint(near,{i})" for g in goals for i in g.objects or ())
        return _Behavior(avoided | constraints, constraints=avoided | constraints)
    action, mode = sense_of(phrase, "action") or "navigate", sense_of(phrase, "mode") or "normal"
    symbols = {f"action({action})", f"mode({mode})"}
    for goal in goals:
        symbols |= {f"goal(at,{i})" for i in goal.objects or ()}
        symbols |= {s.replace("region", "goal") for s in goal.symbols if s.startswith("region")}
    return _Behavior(frozenset(symbols) | constraints)
