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
