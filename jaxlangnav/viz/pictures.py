"""Everything there is to see of one episode, written into a folder."""

from pathlib import Path

from jaxlangnav.files.whole import write_text
from jaxlangnav.grounding.instruction import GroundingModel
from jaxlangnav.language.phrase import Parse
from jaxlangnav.recording import Recording
from jaxlangnav.viz import style
from jaxlangnav.viz.belief import belief_figure
from jaxlangnav.viz.graph import graph_figure
from jaxlangnav.viz.html import write_html
from jaxlangnav.viz.narrative import narrate
from jaxlangnav.viz.values import values_figure


def write_pictures(recording: Recording, folder: Path | str) -> list[Path]:
    """Write belief and value function over time, the interactive recording, and the story.

    Args:
        recording: the episode.
        folder: where to; made if it is not there.

    Returns:
        belief.png, belief.svg, values.png, values.svg, episode.html and story.txt.

    Raises:
        MissingExtraError: matplotlib is not installed; nothing has been written.
    """
    style.require("matplotlib")
    folder = Path(folder)
    paths = [
        *style.save(belief_figure(recording), folder / "belief"),
        *style.save(values_figure(recording), folder / "values"),
        write_html(recording, folder / "episode.html"),
    ]
    return [*paths, write_text("\n".join(narrate(recording)) + "\n", folder / "story.txt")]


def write_graph(
    parse: Parse, model: GroundingModel, folder: Path | str, *, name: str = "graph"
) -> list[Path]:
    """Write the factor graph of a sentence.

    Args:
        parse: the sentence, such as ``Understanding.parse``.
        model: trained models.
        folder: where to; made if it is not there.
        name: of the files, without ending.

    Returns:
        The PNG and the SVG file.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    return [*style.save(graph_figure(parse, model), Path(folder) / name)]
