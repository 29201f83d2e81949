"""Which of several ways to a mesh suits a scene: the one that agrees most with what is known without its Gaussians."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from gsjax.errors import NoSurfaceError
from gsjax.meshes import Mesh
from gsjax.meshing.outlines import Outline, overlap
from gsjax.meshing.sightlines import Sightlines, agreement

UNMET = 2 / 3  # Of what does not agree with the usual mesh, that another leaves at the most to be clearly better.

Extract = Callable[[], tuple[Mesh, dict]]
"""Makes a mesh, and plain numbers about it."""


class Witness(NamedTuple):
    """What is known of a scene without its Gaussians."""

    says: str  # what it is, in words
    judge: Callable[[Mesh], Mapping[str, float]]  # shares of it, of which the first is what agrees with a mesh
    margin: float  # of all, by which another mesh than the usual one has to agree more; less than that says little


def by_sightlines(lines: Sightlines) -> Witness:
    """The tracks of structure from motion, of one line at least."""
    return Witness(
        f"{len(lines):,} lines of sight to matched points", lambda mesh: agreement(mesh, lines)._asdict(), 0.04
    )


def by_mattes(outlines: Sequence[Outline]) -> Witness:
    """The mattes of photos, of one at least."""
    return Witness(f"its outline in {len(outlines)} photos", lambda mesh: overlap(mesh, outlines)._asdict(), 0.02)


class Choice(NamedTuple):
    """The way that was chosen, and how it compares."""

    method: str
    mesh: Mesh
    report: dict  # of its extraction
    tried: dict[str, dict]  # method's name -> what the witness says of its mesh, and the `seconds` that that took


def most_agreeing(methods: Mapping[str, Extract], witness: Witness) -> Choice:
    """The first method's mesh, or of those that agree clearly more with the witness the one that agrees most.

    Clearly more is more by the witness' margin, or so much that no more than `UNMET` of what did not agree is left. A
    method that finds no surface is passed by.

    Args:
        methods: By name; the first that finds a surface is the usual one.
        witness: Who judges them.

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
        shares = dict(witness.judge(mesh))
        agrees = next(iter(shares.values()))
        tried[name] = shares | {"seconds": round(time.perf_counter() - started, 1)}
        if best is None:
            best, to_beat = (name, mesh, report), min(agrees + witness.margin, 1 - UNMET * (1 - agrees))
        elif agrees > to_beat:
            best, to_beat = (name, mesh, report), agrees
    if best is None:
        raise faults[0]
    return Choice(*best, tried)
