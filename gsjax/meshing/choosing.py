"""Which of several ways to a mesh suits a scene: the one that agrees most with what structure from motion saw."""

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

from gsjax.errors import NoSurfaceError
from gsjax.mesh import Mesh
from gsjax.meshing.sightlines import Sightlines, agreement

MARGIN = 0.05
"""Of the sightlines, by how many more another mesh than the usual one is met; smaller differences say little."""

Extract = Callable[[], tuple[Mesh, dict]]
"""Makes a mesh, and plain numbers about it."""


class Choice(NamedTuple):
    """The way that was chosen, and how it compares."""

    method: str
    mesh: Mesh
    report: dict  # of its extraction
    tried: dict[str, dict]  # method's name -> the shares of its `Agreement`, and the `seconds` that its mesh took


def most_agreeing(methods: Mapping[str, Extract], lines: Sightlines) -> Choice:
    """The first method's mesh, or of those that clearly more sightlines meet at their point the one that most do.

    Clearly more is `MARGIN` of all lines. A method that finds no surface is passed by.

    Args:
        methods: By name; the first that finds a surface is the usual one.
        lines: At least one.

    Raises:
        InputError: No method finds a surface; or as they do.
    """
    tried: dict[str, dict] = {}
    best: tuple[str, Mesh, dict] | None = None  # One mesh at a time is kept.
    to_beat = 0.0
    faults = []
    for name, extract in methods.items():
        started = time.perf_counter()
        try:
            mesh, report = extract()
        except NoSurfaceError as fault:
            faults.append(fault)
            continue
        found = agreement(mesh, lines)
        tried[name] = found._asdict() | {"seconds": round(time.perf_counter() - started, 1)}
        if best is None:
            best, to_beat = (name, mesh, report), found.met + MARGIN
        elif found.met > to_beat:
            best, to_beat = (name, mesh, report), found.met
    if best is None:
        raise faults[0]
    return Choice(*best, tried)
