"""Which programs were compiled while a run went, how long that took, and room for more of them."""

import gc
from pathlib import Path
from typing import Any, Self

import jax
from jax import monitoring

MOST_MAPPINGS = 50_000
"""Linux allows a process 65,530 by default. A run's programs take some 6,000."""

_COMPILED = "/jax/core/compile/backend_compile_duration"
_SHORTEST = 0.1  # seconds


class Compilations:
    """Collects compilations of this process while its context is open."""

    def __init__(self):
        self._records: list[dict[str, Any]] = []

    def __enter__(self) -> Self:
        monitoring.register_event_duration_secs_listener(self._note)
        return self

    def __exit__(self, *error: object) -> None:
        monitoring.unregister_event_duration_listener(self._note)

    def drain(self) -> list[dict[str, Any]]:
        """`program` and `seconds` of each compilation since the last call, without those under a tenth of a second."""
        records, self._records = self._records, []
        return records

    def _note(self, event: str, seconds: float, **about: Any) -> None:
        if event == _COMPILED and seconds >= _SHORTEST:
            program = str(about.get("fun_name", "?")).removeprefix("jit(").removesuffix(")")
            self._records.append({"program": program, "seconds": round(seconds, 2)})


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
