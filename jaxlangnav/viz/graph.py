"""Draw the DCG factor graph of a sentence with its probabilities, as Figure 3 (eq. 4).

Black squares are factors, white circles unknown and grey circles known random variables: the
phrase λ, the grounding γ and the correspondence φ of each symbol. Of the 494 symbols of a phrase
the likeliest are drawn; a φ is filled by the probability that the phrase expresses its symbol,
given what its child phrases express in the likeliest reading.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxlangnav.grounding.correspondence import CorrespondenceGraph, PhraseBelief
from jaxlangnav.grounding.instruction import GroundingModel
from jaxlangnav.grounding.properties import Annotations
from jaxlangnav.grounding.symbols import AnnotationSpace, AnnotationSymbol
from jaxlangnav.language.phrase import Parse
from jaxlangnav.messages import NONE, ROBOT
from jaxlangnav.relations.table import REGISTRY
from jaxlangnav.viz import style
from jaxlangnav.viz.sentences import percent

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PHRASE_WIDTH, _SYMBOL_HEIGHT = 2.0, 0.62  # inches
_NUM_SYMBOLS = 3  # the likeliest of each phrase, which are drawn


def _symbol_name(symbol: AnnotationSymbol, type_names: tuple[str, ...]) -> str:
    """Format an annotation symbol: "hydrant behind cone", "behind cone", "hydrant"."""
    names = {NONE: "", ROBOT: "robot", **dict(enumerate(type_names))}
    parts = [names[symbol.figure]]
    if symbol.relation != NONE:
        parts += [REGISTRY[symbol.relation].words, names[symbol.landmark]]
    return " ".join(parts).strip()


def graph_figure(parse: Parse, model: GroundingModel) -> "Figure":
    """Draw a sentence's factor graph, phrases in reading order; raises as ``beliefs_figure``."""
    space = AnnotationSpace(len(model.type_names))
    names = [_symbol_name(symbol, model.type_names) for symbol in space.symbols]
    graph = CorrespondenceGraph(Annotations(model.type_names), model.annotation)
    trees = (graph.score(root, None, clause) for clause, root in enumerate(parse.clauses))
    beliefs = [belief for tree in trees for belief in tree.beliefs()]
    return beliefs_figure(beliefs, names, title=parse.instruction)


def beliefs_figure(
    beliefs: Sequence[PhraseBelief], names: Sequence[str], *, title: str
) -> "Figure":
    """Draw the factor graph of a phrase tree over any S symbols (``grounding.correspondence``).

    ``beliefs``: of all phrases, parents first; ``names``: of the S symbols; ``title``: the
    sentence. ``MissingExtraError`` without matplotlib.
    """
    with style.house_style():
        from matplotlib.figure import Figure

        width = max(_PHRASE_WIDTH * len(beliefs) + 0.6, 8.9)
        height = 2.35 + _SYMBOL_HEIGHT * _NUM_SYMBOLS
        figure = Figure(figsize=(width, height))
        axes = figure.add_axes((0, 0, 1, 1 - 0.62 / height))
        axes.set(xlim=(0, width), ylim=(0, height - 0.62))
        axes.axis("off")
        left = (width - _PHRASE_WIDTH * len(beliefs)) / 2 + 0.32
        columns = {belief.path: left + _PHRASE_WIDTH * i for i, belief in enumerate(beliefs)}
        for belief in beliefs:
            _draw_phrase(axes, belief, columns, names)
        x, y = 0.25, 0.16
        axes.plot([x], [y], marker="s", markersize=7, color=style.INK)
        _draw_variable(axes, x + 1.05, y, face=style.LINE)
        _draw_variable(axes, x + 3.35, y, face=style.PAPER, fill=0.7)
        axes.plot([x + 6.12, x + 6.4], [y, y], color=style.SERIES[0], linewidth=1.2)
        for right, text in (
            (0.14, "factor Ψ"),
            (1.22, "known: phrase λ, grounding γ"),
            (3.52, "correspondence φ, filled by probability"),
            (6.48, "what a child phrase expresses"),
        ):
            axes.text(x + right, y, text, va="center", fontsize=8)
        factors = len(names) * len(beliefs)
        variables = 2 * factors + len(beliefs)
        style.title(
            figure,
            f"“{title}”",
            f"{len(beliefs)} phrases × {len(names)} symbols: {factors:,} factors, {variables:,} "
            f"random variables; of each phrase the {_NUM_SYMBOLS} likeliest are shown.",
        )
    return figure


def _factor_height(rank: int) -> float:
    """Compute the y coordinate of the factor of a rank, inches; the likeliest is lowest."""
    return 1.75 + _SYMBOL_HEIGHT * rank


def _draw_phrase(
    axes: "Axes", belief: PhraseBelief, columns: dict[tuple[int, ...], float], names: Sequence[str]
) -> None:
    """Draw a phrase, its likeliest symbols and the link to its parent's factors."""
    x = columns[belief.path]
    top_symbols = np.argsort(-belief.probability, kind="stable")[:_NUM_SYMBOLS]
    top = _factor_height(len(top_symbols) - 1)
    axes.plot([x, x], [0.95, top], color=style.MUTED, linewidth=0.9, zorder=1)
    axes.plot([x, x], [top, top + 0.42], color=style.MUTED, linewidth=0.9, linestyle=":", zorder=1)
    _draw_variable(axes, x, 0.95, face=style.LINE)
    words = " ".join(word.text for word in belief.phrase.words)
    axes.text(x, 0.74, belief.phrase.label, ha="center", va="top", fontweight="bold", fontsize=9)
    quoted = f"“{words}”" if words else "(no words)"
    superlative = {0: "", 1: " (superlative)"}.get(belief.rank, f" (number {belief.rank})")
    axes.text(x, 0.56, quoted + superlative, ha="center", va="top", fontsize=9)
    for rank, symbol in enumerate(top_symbols):
        y, prob = _factor_height(rank), float(belief.probability[symbol])
        axes.plot([x, x + 0.62], [y, y], color=style.MUTED, linewidth=0.9, zorder=1)
        axes.plot([x], [y], marker="s", markersize=7, color=style.INK, zorder=3)
        _draw_variable(axes, x + 0.31, y, face=style.LINE)
        _draw_variable(axes, x + 0.62, y, face=style.PAPER, fill=prob)
        color, weight = (style.INK, "bold") if prob >= 0.5 else (style.MUTED, "normal")
        axes.text(
            x + 0.12, y + 0.15, names[int(symbol)], fontsize=8, va="bottom", zorder=6,
            bbox={"fc": style.PAPER, "ec": "none", "pad": 0.6}, fontweight=weight, color=color,
        )  # fmt: skip
        axes.text(x + 0.78, y, percent(prob), fontsize=8, va="center", color=color)
    hidden = len(names) - len(top_symbols)
    axes.text(x + 0.08, top + 0.36, f"{hidden} more", fontsize=7.5, va="bottom", color=style.MUTED)
    ranks = [rank for rank, symbol in enumerate(top_symbols) if belief.probability[symbol] >= 0.5]
    if belief.parent is None or not ranks:
        return
    from matplotlib.patches import FancyArrowPatch

    start, end = x + 0.31, columns[belief.parent]
    # Longer links are flatter, so that they stay below the factors they pass.
    bend = -0.3 * _PHRASE_WIDTH / (start - end)
    props = {"color": style.SERIES[0], "linewidth": 1.2, "zorder": 2}
    axes.plot([start, start], [_factor_height(ranks[0]), _factor_height(ranks[-1])], **props)
    arrow = {"arrowstyle": "-|>", "mutation_scale": 8, "shrinkA": 5, "shrinkB": 0}
    curve, ends = f"arc3,rad={bend:.3f}", ((start, _factor_height(ranks[0])), (end, 1.3))
    axes.add_patch(FancyArrowPatch(*ends, connectionstyle=curve, **arrow, **props))


def _draw_variable(axes: "Axes", x: float, y: float, *, face: str, fill: float = 0.0) -> None:
    """Draw a random variable as a circle filled clockwise by a probability."""
    from matplotlib.patches import Circle, Wedge

    axes.add_patch(Circle((x, y), 0.095, facecolor=face, edgecolor=style.INK, lw=0.9, zorder=3))
    if fill > 0.0:
        start = 90 - 360 * min(fill, 1.0)
        axes.add_patch(Wedge((x, y), 0.095, start, 90, facecolor=style.GOOD, lw=0, zorder=4))
        axes.add_patch(Circle((x, y), 0.095, fill=False, edgecolor=style.INK, lw=0.9, zorder=5))
