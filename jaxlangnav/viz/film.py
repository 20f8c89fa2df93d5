"""Export a recording as a GIF or MP4 video: the belief at each step beside the camera images."""

import io
from pathlib import Path

import numpy as np

from jaxlangnav.episode.recording import Recording
from jaxlangnav.inputs.atomic_files import replacing
from jaxlangnav.viz import style
from jaxlangnav.viz.panels import draw_belief

FORMATS = (".gif", ".mp4")
_MILLISECONDS, _LAST_REPEATS = 400, 5  # duration of a step; extra repeats of the last frame
_INCHES, _DPI = (4.6, 4.8), 100


def check_format(path: Path) -> None:
    """Raise ValueError if the file extension is not a supported video format."""
    if path.suffix not in FORMATS:
        raise ValueError(f"{path.name} is no film: its name must end in {' or '.join(FORMATS)}")


def write_film(recording: Recording, path: Path) -> Path:
    """Write a video atomically: .gif by Pillow, .mp4 by OpenCV of the extra ``robot``.

    ValueError for another extension or where OpenCV cannot write it; ``MissingExtraError`` without
    the libraries.
    """
    check_format(path)
    style.require("matplotlib")
    from PIL import Image

    frames = [_render_step(recording, step) for step in range(recording.num_steps)]
    frames += frames[-1:] * _LAST_REPEATS
    with replacing(path) as temporary:
        if path.suffix == ".gif":
            first, *others = map(Image.fromarray, frames)
            options = {"save_all": True, "duration": _MILLISECONDS, "loop": 0}
            first.save(temporary, "GIF", append_images=others, **options)
        else:
            cv2, (height, width, _) = style.require("cv2", extra="robot"), frames[0].shape
            fourcc, fps = cv2.VideoWriter_fourcc(*"mp4v"), 1000.0 / _MILLISECONDS
            writer = cv2.VideoWriter(str(temporary), fourcc, fps, (width, height))
            if not writer.isOpened():
                raise ValueError(f"OpenCV cannot write {path.suffix} films here: take .gif")
            for frame in frames:
                writer.write(frame[..., ::-1])
            writer.release()
    return path


def _render_step(recording: Recording, step: int) -> np.ndarray:
    """Render one step as an RGB image, u8[H, W, 3]."""
    from matplotlib.figure import Figure
    from PIL import Image

    camera_names = list(recording.pictures[-1]) if recording.pictures else []
    frame = recording.at(step)
    with style.house_style():
        width, height = _INCHES
        figure = Figure((width * (1 + len(camera_names)), height), dpi=_DPI, layout="constrained")
        axes, *camera_axes = figure.subplots(1, 1 + len(camera_names), squeeze=False)[0]
        draw_belief(axes, recording, step)
        axes.set(xlabel="x (m)", ylabel="y (m)")
        figure.suptitle(f"“{recording.scene.text}” · step {step} · {float(frame.distance):.1f} m")
        for axis, name in zip(camera_axes, camera_names, strict=True):
            axis.axis("off")
            if jpeg := recording.pictures[step].get(name):
                axis.imshow(Image.open(io.BytesIO(jpeg)))
                axis.set_title(name, fontsize=7)
        return style.rgb_image(figure)
