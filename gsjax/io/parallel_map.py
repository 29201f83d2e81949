"""An ordered parallel map over photos or pairs of them, with or without a progress bar."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from tqdm import tqdm

T = TypeVar("T")
R = TypeVar("R")

MOST_THREADS = 4  # Each holds a photo and what was made of it.

Progress = Callable[..., tqdm]
"""Makes a progress bar, called with tqdm's `total`, `desc` and `unit`."""


def parallel_map(made_of: Callable[[T], R], things: Iterable[T], most_threads: int = MOST_THREADS) -> Iterator[R]:
    """`map(made_of, things)`, in as many threads as there are cores, or `most_threads`.

    Things are read one by one, few more than threads ahead of what has been taken. What `made_of` raises of a thing is
    raised when it is that thing's turn.
    """
    threads = min(os.cpu_count() or 1, most_threads)
    futures: deque = deque()
    with ThreadPoolExecutor(threads) as pool:
        for thing in things:
            futures.append(pool.submit(made_of, thing))
            if len(futures) > threads:
                yield futures.popleft().result()
        while futures:
            yield futures.popleft().result()


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
