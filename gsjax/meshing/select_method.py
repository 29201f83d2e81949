"""Select the mesh method whose mesh fits best to evidence that its Gaussians were not made from."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from gsjax.errors import NoSurfaceError
from gsjax.meshing.regions import Box
from gsjax.meshing.silhouettes import overlap, silhouettes_of
from gsjax.meshing.track_visibility import track_rays, track_visibility
from gsjax.scene import Scene
from gsjax.scene.meshes import Mesh

UNMET = 2 / 3  # Of the evidence that contradicts the usual mesh, the most that contradicts a clearly better one.
FEWEST_LINES = 100  # of sight, for a comparison of methods


class Witness(NamedTuple):
    """Evidence about a scene that does not come from its Gaussians."""

    says: str  # what it is, in words
    judge: Callable[[Mesh], Mapping[str, float]]  # shares of it, of which the first is what fits to a mesh
    margin: float  # of that share, by which another mesh has to exceed the usual one


def evidence_of(scene: Scene, boxes: Sequence[Box]) -> Witness | None:
    """Return the tracks, where they are enough; else the mattes, which show the whole object and nothing of a box.

    Without boxes the surface is judged everywhere.
    """
    lines = track_rays(scene)
    if boxes:
        lines = lines.within(boxes)
    if len(lines) >= FEWEST_LINES:
        says = f"{len(lines):,} lines of sight to matched points"
        return Witness(says, lambda mesh: track_visibility(mesh, lines), 0.04)
    silhouettes = () if boxes else silhouettes_of(scene)
    if not silhouettes:
        return None
    return Witness(f"its outline in {len(silhouettes)} photos", lambda mesh: overlap(mesh, silhouettes), 0.02)


def select_method(candidates: Mapping[str, Callable[[], Mesh]], witness: Witness) -> tuple[str, dict[str, dict]]:
    """Return the first method, or the best fitting one of those that fit clearly better to the witness.

    Clearly better is better by the witness' margin, or if no more than `UNMET` of the contradictions is left. A
    method that finds no surface is left out, and the first that finds one is the usual. One mesh at a time exists.

    Returns:
        Its name, and by method what the witness says of its mesh, and the `seconds` that that took.

    Raises:
        InputError: No method finds a surface; or as they do.
    """
    judgements: dict[str, dict] = {}
    best = ""
    to_beat = 0.0
    faults = []
    for name, extract in candidates.items():
        started = time.perf_counter()
        try:
            shares = dict(witness.judge(extract()))
        except NoSurfaceError as fault:
            faults.append(fault)
            continue
        agrees = next(iter(shares.values()))
        judgements[name] = shares | {"seconds": round(time.perf_counter() - started, 1)}
        if not best:
            best, to_beat = name, min(agrees + witness.margin, 1 - UNMET * (1 - agrees))
        elif agrees > to_beat:
            best, to_beat = name, agrees
    if not best:
        raise faults[0]
    return best, judgements
