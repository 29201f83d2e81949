"""A parallel map over photos or pairs with a progress bar."""

import os
from collections.abc import Callable, Sequence
from typing import TypeVar

from tqdm import tqdm

from gsjax.io.parallel_map import parallel_map

T = TypeVar("T")
R = TypeVar("R")

Progress = Callable[..., tqdm]
"""Makes a progress bar, called with tqdm's `total`, `desc` and `unit`."""


def thread_count() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


def map_with_bar(
    function: Callable[[T], R], items: Sequence[T], progress: Progress, desc: str, unit: str, most: int | None = None
) -> list[R]:
    """Results in the order of the items, by `most` threads or as many as there are cores."""
    results = []
    with progress(total=len(items), desc=desc, unit=unit) as bar:
        for result in parallel_map(function, items, min(most or thread_count(), thread_count())):
            results.append(result)
            bar.update(1)
    return results
