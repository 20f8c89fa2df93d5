"""A film of a recording: the belief step by step, beside what the robot's cameras have seen."""

import io
from pathlib import Path

import numpy as np

from jaxlangnav.episode.recording import Recording
from jaxlangnav.inputs.whole_files import replacing
from jaxlangnav.viz import style
from jaxlangnav.viz.panels import draw_belief

FORMATS = (".gif", ".mp4")
_MILLISECONDS, _REST = 400, 5  # that a step is shown, and how many times as long the last one
_INCHES, _DPI = (4.6, 4.8), 100


def check_format(path: Path) -> None:
    """Refuse a file that would be no film with a ValueError."""
    if path.suffix not in FORMATS:
        raise ValueError(f"{path.name} is no film: its name must end in {' or '.join(FORMATS)}")


def write_film(recording: Recording, path: Path) -> Path:
    """Write a film, all or nothing: .gif by Pillow, .mp4 by OpenCV of the extra ``robot``.

    A ValueError for another ending, or where OpenCV cannot write it; ``MissingExtraError`` without
    the libraries.
    """
    check_format(path)
    style.require("matplotlib")
    from PIL import Image

    frames = [_picture(recording, step) for step in range(recording.num_steps)]
    frames += frames[-1:] * _REST
    with replacing(path) as temporary:
        if path.suffix == ".gif":
            first, *others = map(Image.fromarray, frames)
            how = {"save_all": True, "duration": _MILLISECONDS, "loop": 0}
            first.save(temporary, "GIF", append_images=others, **how)
        else:
            cv2, (height, width, _) = style.require("cv2", extra="robot"), frames[0].shape
            code, rate = cv2.VideoWriter_fourcc(*"mp4v"), 1000.0 / _MILLISECONDS
            writer = cv2.VideoWriter(str(temporary), code, rate, (width, height))
            if not writer.isOpened():
                raise ValueError(f"OpenCV cannot write {path.suffix} films here: take .gif")
            for frame in frames:
                writer.write(frame[..., ::-1])
            writer.release()
    return path


def _picture(recording: Recording, step: int) -> np.ndarray:
    """Draw one step, u8[H, W, 3] red, green, blue."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from PIL import Image

    titles = list(recording.pictures[-1]) if recording.pictures else []
    frame = recording.at(step)
    with style.house_style():
        width, height = _INCHES
        figure = Figure((width * (1 + len(titles)), height), dpi=_DPI, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        axes, *others = figure.subplots(1, 1 + len(titles), squeeze=False)[0]
        draw_belief(axes, recording, step)
        figure.suptitle(f"“{recording.scene.text}” · step {step} · {float(frame.distance):.1f} m")
        for view, title in zip(others, titles, strict=True):
            view.axis("off")
            if jpeg := recording.pictures[step].get(title):
                view.imshow(Image.open(io.BytesIO(jpeg)))
                view.set_title(title, fontsize=7)
        canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
