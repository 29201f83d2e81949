"""An ordered parallel map over photos."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

MOST_THREADS = 4  # Each holds a photo and what was made of it.


def parallel_map(made_of: Callable[[T], R], things: Iterable[T], most_threads: int = MOST_THREADS) -> Iterator[R]:
    """`map(made_of, things)`, some of them at once: for numpy's work, during which Python lets other threads run.

    Args:
        made_of: Called in several threads.
        things: Read one by one, few more than threads ahead of what has been taken.
        most_threads: At most so many threads, and no more than cores.

    Raises:
        Exception: What `made_of` raises of a thing, when it is that thing's turn.
    """
    threads = min(os.cpu_count() or 1, most_threads)
    begun: deque = deque()
    with ThreadPoolExecutor(threads) as pool:
        for thing in things:
            begun.append(pool.submit(made_of, thing))
            if len(begun) > threads:
                yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
