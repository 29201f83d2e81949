"""Figures and ticks of matplotlib, which is imported here alone, by one thread at a time.

Two threads that import it at once meet its modules half loaded. There is no global state of `pyplot` either.
"""

from threading import Lock
from typing import Any

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
