"""Which programs were compiled while a run went, how long that took, and room for more of them."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
from jax import monitoring

MOST_MAPPINGS = 50_000
"""Linux allows a process 65,530 by default. A run's programs take some 6,000."""

_COMPILED = "/jax/core/compile/backend_compile_duration"
_SHORTEST = 0.1  # seconds


@contextmanager
def record_compilations() -> Iterator[list[dict[str, Any]]]:
    """While it lasts, list `program` and `seconds` of each compilation of this process from a tenth of a second on."""
    records: list[dict[str, Any]] = []

    def note(event: str, seconds: float, **about: Any) -> None:
        if event == _COMPILED and seconds >= _SHORTEST:
            program = str(about.get("fun_name", "?")).removeprefix("jit(").removesuffix(")")
            records.append({"program": program, "seconds": round(seconds, 2)})

    monitoring.register_event_duration_secs_listener(note)
    try:
        yield records
    finally:
        monitoring.unregister_event_duration_listener(note)


def is_crowded() -> bool:
    """Whether the system will soon refuse more memory mappings. Known on Linux alone."""
    mappings = Path("/proc/self/maps")
    return mappings.exists() and len(mappings.read_bytes().splitlines()) > MOST_MAPPINGS


def make_room() -> None:
    """Forgets compiled programs before the system refuses more memory mappings, which XLA does not survive.

    Every program takes about six, and jax keeps them: some thirty runs of different settings end a process. Elsewhere
    than on Linux nothing is known and nothing forgotten.
    """
    if is_crowded():
        jax.clear_caches()
        gc.collect()
