"""Several pictures of one view side by side, as one file."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from gsjax.io.files import atomic_path
from gsjax.report.drawing import new_figure


def draw_panels(panels: Mapping[str, np.ndarray], path: str | Path, *, columns: int = 4) -> Path:
    """Write pictures `[H, W, 3]` uint8 under their titles, in rows of `columns`.

    Raises:
        InputError: The file cannot be written.
    """
    rows = math.ceil(len(panels) / columns)
    height, width = next(iter(panels.values())).shape[:2]
    figure = new_figure(13, (13 / columns * height / width + 0.4) * rows)
    for axes, (title, image) in zip(figure.subplots(rows, columns, squeeze=False).flat, panels.items(), strict=False):
        axes.imshow(image, interpolation="nearest")
        axes.set_title(title, fontsize=11)
    for axes in figure.axes:
        axes.axis("off")
    with atomic_path(path) as temporary:
        # Of JPEG alone: normals are read by their hue, which subsampling blurs.
        figure.savefig(temporary, dpi=110, pil_kwargs={"quality": 85, "subsampling": 0})
    return Path(path)
