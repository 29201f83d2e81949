"""Figures, panels and ticks of matplotlib, which is imported here alone, by one thread at a time.

Two threads that import it at once meet its modules half loaded. There is no global state of `pyplot` either.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from gsjax.io.files import atomic_path
from gsjax.io.packages import require

_IMPORT = Lock()


def new_figure(width: float, height: float) -> Any:
    """A `matplotlib.figure.Figure` of so many inches, whose axes keep clear of each other, to be saved to a file."""
    with _IMPORT:
        require("matplotlib")
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def round_ticks(low: float, high: float, most: int) -> list[float]:
    """At most so many intervals between round numbers, from below `low` to above `high`."""
    with _IMPORT:
        require("matplotlib")
        from matplotlib.ticker import MaxNLocator
    return [float(tick) for tick in MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)]


def draw_panels(panels: Mapping[str, np.ndarray], path: str | Path, *, columns: int = 4) -> Path:
    """Write pictures `[H, W, 3]` uint8 under their titles, in rows of `columns`."""
    rows = math.ceil(len(panels) / columns)
    height, width = next(iter(panels.values())).shape[:2]
    figure = new_figure(13, (13 / columns * height / width + 0.4) * rows)
    for axes, (title, image) in zip(figure.subplots(rows, columns, squeeze=False).flat, panels.items(), strict=False):
        axes.imshow(image, interpolation="nearest")
        axes.set_title(title, fontsize=13)  # legible at half of the width
    for axes in figure.axes:
        axes.axis("off")
    with atomic_path(path) as temporary:
        # Of JPEG alone: normals are read by their hue, which subsampling blurs.
        jpeg = {"quality": 85, "subsampling": 0}
        figure.savefig(temporary, dpi=110, bbox_inches="tight", pad_inches=0.05, pil_kwargs=jpeg)
    return Path(path)
