"""How a phrase tree is labelled: the rules by which gold labels of the corpus are composed.

Annotation labels (section 3.1) say what a phrase tells of the unseen world, by object type;
behavior labels (section 3.3) what it means among the placed objects of one world. They are for
the corpus alone: nothing at run time may use these rules in place of the trained model.

Annotation: ``object(cone)``, ``region(behind,cone)``, ``relation(hydrant,behind,cone)``; the
landmark is ``robot`` where the phrase names none ("on your left"). Behavior: ``object(3)``,
``region(behind,3)``, ``region(at,3)``, ``action(navigate)``, ``mode(normal)``, ``goal(at,3)``,
``constraint(near,2)``.

Objects of such a world have known places: which relations hold there is geometry
(``relations.holds``), and which object is the nearest, the second or the leftmost is a comparison
among the objects of one type.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxlangnav.inputs.program_cache import cached_jit
from jaxlangnav.language.phrase import Phrase
from jaxlangnav.messages import RELATIONS
from jaxlangnav.relations import holds
from jaxlangnav.relations.strength import degree_of, num_before
from jaxlangnav.relations.table import SIDES

SIDE_RANGE = 5.0
"""Metres: the corpus calls nothing "on your left" that is farther off."""


@dataclass(frozen=True, kw_only=True)
class PlacedWorld:
    """Objects whose places are known, and the robot among them."""

    objects: tuple[tuple[str, float, float], ...]  # type, x, y; map frame, metres
    robot: tuple[float, float, float]  # x, y, heading; metres, radians
    previous: int | None = None  # the goal of the command before this one
    attributes: tuple[int, ...] = ()  # of each object, codes of ``attributes``; or of none


@cached_jit()
def _all_relations(places: Array, viewer: Array, heading: Array) -> Array:
    """Evaluate all relations: bool[6, N, N + 1], landmark N is the robot."""
    own_heading: Any = heading

    def one(relation: int) -> Array:
        pairs = holds(relation, places[:, None], places[None, :], viewer)
        own = holds(relation, places, viewer, viewer, own_heading)
        return jnp.concatenate([pairs, own[:, None]], axis=1)

    return jnp.stack([one(relation) for relation in range(len(RELATIONS))])


class Geometry:
    """Which relations hold between the objects of a world, and how strongly."""

    def __init__(
        self, world: PlacedWorld, *, ranks_among_part: bool = True, side_range: float = SIDE_RANGE
    ) -> None:
        """Evaluate all six relations over all pairs; index ``len(objects)`` stands for the robot.

        Up to ``side_range`` metres something is on a side of the robot. ``ranks_among_part``: "the
        second cone on your left" is the second of those there; otherwise of all, if it is there.
        """
        self.world = world
        self.ranks_among_part = ranks_among_part
        self.num_objects = len(world.objects)
        self.everything = tuple(range(self.num_objects))
        places = np.array([[x, y] for _, x, y in world.objects], np.float32).reshape(-1, 2)
        viewer = np.array(world.robot[:2], np.float32)
        heading = world.robot[2]
        where = jax.device_put((places, viewer, np.float32(heading)))
        self.holds = np.array(_all_relations(*where))
        points = np.concatenate([places, viewer[None]], 0)
        self.offset = places[:, None] - points[None]
        self.distance = np.linalg.norm(self.offset, axis=-1)
        sides = np.ix_(SIDES, range(self.num_objects), [self.num_objects])
        self.holds[sides] &= self.distance[:, -1:] <= side_range
        sideways = self.offset @ np.array([-np.sin(heading), np.cos(heading)])
        # How much each relation holds, f64[6, N, N + 1], larger is more so.
        self.strength = np.stack(
            [degree_of(one, self.distance, sideways) for one in range(len(RELATIONS))]
        )

    def is_extreme(
        self, relation: int, figure: int, landmark: int, place: int, among: tuple[int, ...]
    ) -> bool:
        """Tell whether a figure is the ``place``-th extreme of its type among some objects."""
        kinds = [kind for kind, _, _ in self.world.objects]
        rivals = {i for i in among if kinds[i] == kinds[figure]} - {figure, landmark}
        is_rival = np.isin(self.everything, list(rivals))
        before = num_before(self.strength[relation, :, landmark], is_rival)
        return bool(before[figure] == place - 1)


# ---------------------------------------------------------------- labels of phrases


ROBOT_LABEL = "robot"
Labels = tuple[frozenset[str], ...]


def sense_of(phrase: Phrase, kind: str) -> str | None:
    """Find the value of a sense such as ``relation`` among a phrase's own words."""
    senses = (sense.partition(":") for word in phrase.words for sense in word.senses)
    return next((value or name for name, _, value in senses if name == kind), None)


def rank(phrase: Phrase) -> int:
    """Read whether a PP or ADJP is superlative: 0 no, 1 nearest or first, 2 second, ..."""
    if sense_of(phrase, "superlative") is None or sense_of(phrase, "relation") is None:
        return 0
    return int(sense_of(phrase, "rank") or 1)


# ---------------------------------------------------------------- annotation


@dataclass(frozen=True)
class _Meaning:
    """What a phrase hands up: the type it is about, regions it opens, relations it states."""

    symbols: frozenset[str]
    types: tuple[str, ...] = ()  # the thing itself, for a landmark above
    regions: tuple[tuple[str, str], ...] = ()  # (relation, landmark type), not yet anyone's


def annotate(root: Phrase) -> tuple[Labels, tuple[int, ...]]:
    """Label every phrase of a clause with annotation symbols.

    Returns:
        Symbols and superlative rank of each phrase, in the order of ``root.walk()``.
    """
    return _composed(root, _annotate), tuple(rank(phrase) for phrase in root.walk())


def _composed(root: Phrase, compose: Callable[[Phrase, list[Any]], Any]) -> Labels:
    """Compose what each phrase means from its children's meanings, and collect the symbols."""
    labels: list[frozenset[str]] = []

    def visit(phrase: Phrase) -> Any:
        meaning = compose(phrase, [visit(child) for child in phrase.children])
        labels.append(meaning.symbols)
        return meaning

    visit(root)
    return tuple(labels)


def _annotate(phrase: Phrase, children: list[_Meaning]) -> _Meaning:
    if phrase.label == "NP" and not children:
        type_name = sense_of(phrase, "type")
        types = () if type_name is None else (type_name,)
        return _Meaning(frozenset(f"object({t})" for t in types), types)
    passed = frozenset().union(*(child.symbols for child in children))
    stated = frozenset(symbol for symbol in passed if symbol.startswith("relation"))
    types = tuple(t for child in children for t in child.types)
    regions = tuple(region for child in children for region in child.regions)
    relation = sense_of(phrase, "relation")
    if phrase.label in ("PP", "ADJP") and relation is not None:
        regions = tuple((relation, landmark) for landmark in types or (ROBOT_LABEL,))
        opened = frozenset(f"region({relation},{landmark})" for _, landmark in regions)
        return _Meaning(stated | opened, regions=regions)
    if phrase.label not in ("NP", "S"):
        return _Meaning(passed, types, regions)
    # A figure is joined with the regions said of it: relation(hydrant,behind,cone).
    figure = next((child.types for child in children if child.types), ())
    if not figure or not regions:
        return _Meaning(passed, figure, regions)
    made = frozenset(f"relation({figure[0]},{r},{landmark})" for r, landmark in regions)
    return _Meaning(stated | made, figure[:1])


# ---------------------------------------------------------------- behavior


@dataclass(frozen=True)
class _Sense:
    """What a phrase means in a world: objects, regions (relation, object, rank) or a behavior."""

    symbols: frozenset[str]
    objects: tuple[int, ...] | None = None
    regions: tuple[tuple[str, int, int], ...] | None = None
    constraints: frozenset[str] = frozenset()


def behave(root: Phrase, geometry: Geometry) -> Labels:
    """Label every phrase of a clause with behavior symbols in one world.

    Returns:
        Symbols of each phrase, in the order of ``root.walk()``.
    """
    return _composed(root, lambda phrase, children: _behave(phrase, children, geometry))


def _behave(phrase: Phrase, children: list[_Sense], geometry: Geometry) -> _Sense:
    if phrase.label == "VP":
        return _verb(phrase, children)
    if phrase.label == "S":
        return _Sense(frozenset())
    if phrase.label == "NP" and not children:
        is_place = sense_of(phrase, "place")
        return _Sense(frozenset()) if is_place else _objects(_named(phrase, geometry.world))
    relation = sense_of(phrase, "relation")
    if phrase.label in ("PP", "ADJP") and relation is not None:
        robot = (geometry.num_objects,)
        landmarks = (children[0].objects or ()) if children else robot
        return _regions(tuple((relation, i, rank(phrase)) for i in landmarks), geometry)
    if phrase.label == "NP":
        return _restrict(children, geometry)
    inner = children[0]
    if phrase.label == "PP" and inner.objects is not None:
        return _regions(tuple(("at", i, 0) for i in inner.objects), geometry)
    return inner


def _named(phrase: Phrase, world: PlacedWorld) -> tuple[int, ...]:
    """List the objects a noun phrase can name by itself."""
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
        for index, (kind, _, _) in enumerate(world.objects)
        if type_name in (None, kind) and not (is_other and index == world.previous)
    )


def _objects(indices: tuple[int, ...]) -> _Sense:
    return _Sense(frozenset(f"object({i})" for i in indices), objects=indices)


def _regions(regions: tuple[tuple[str, int, int], ...], geometry: Geometry) -> _Sense:
    names = [*map(str, geometry.everything), ROBOT_LABEL]
    symbols = frozenset(f"region({relation},{names[i]})" for relation, i, _ in regions)
    return _Sense(symbols, regions=regions)


def _restrict(children: list[_Sense], geometry: Geometry) -> _Sense:
    """Keep the objects that lie in one region of every modifier; without objects, the regions."""
    # A rank counts among those that the other modifiers leave: "the second cone on your left".
    base, *modifiers = children
    regions = [modifier.regions or () for modifier in modifiers]
    if base.objects is None:
        return _regions(tuple(itertools.chain(*regions)), geometry)

    def keep(objects: tuple[int, ...], *, is_ranked: bool) -> tuple[int, ...]:
        wanted = [r for r in regions if any(place for _, _, place in r) == is_ranked]
        among = objects if geometry.ranks_among_part else geometry.everything

        def fits(figure: int, region: tuple[str, int, int]) -> bool:
            relation, landmark, place = region
            index = RELATIONS.index(relation)
            if place and figure != landmark:
                return geometry.is_extreme(index, figure, landmark, place, among)
            return figure != landmark and bool(geometry.holds[index, figure, landmark])

        return tuple(f for f in objects if all(any(fits(f, r) for r in m) for m in wanted))

    return _objects(keep(keep(base.objects, is_ranked=False), is_ranked=True))


def _verb(phrase: Phrase, children: list[_Sense]) -> _Sense:
    """Compose action, mode, goal regions and constraint regions."""
    constraints = frozenset().union(*(child.constraints for child in children))
    goals = [child for child in children if child.objects is not None or child.regions is not None]
    if sense_of(phrase, "constraint"):
        own = frozenset(f"constraint(near,{i})" for g in goals for i in g.objects or ())
        return _Sense(own | constraints, constraints=own | constraints)
    symbols = {f"action({sense_of(phrase, 'action') or 'navigate'})"}
    symbols.add(f"mode({sense_of(phrase, 'mode') or 'normal'})")
    for goal in goals:
        symbols |= {f"goal(at,{i})" for i in goal.objects or ()}
        symbols |= {s.replace("region", "goal") for s in goal.symbols if s.startswith("region")}
    return _Sense(frozenset(symbols) | constraints)
