"""What a page may change of the run that it shows: its scale by a known length, and what lies outside a sphere."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.pipeline.clean import KINDS, clean, undo
from gsjax.pipeline.scale import scale_run
from gsjax.place import parse_length
from gsjax.runs.folder import is_finished
from gsjax.viewer.subject import Subject, open_subject


class Edit(NamedTuple):
    """What came of a change."""

    subject: Subject  # as the run is now
    line: str


class Editor:
    """Changes a run as `gsjax scale` and `gsjax clean` do, by two points that were clicked."""

    def __init__(self, source: str | Path, mesh: str | Path | None):
        """Of the run in a folder, shown with a mesh.

        Raises:
            InputError: It is no finished run.
        """
        self._run, self._mesh = Path(source), mesh
        if not is_finished(self._run):
            raise InputError(f"{source}: is no finished run, and --edit changes nothing else")

    def scale(self, subject: Subject, ends: np.ndarray, text: str) -> Edit:
        """Bring the run to metres.

        Args:
            subject: That is shown.
            ends: `[2, 3]` of a length, in the subject's coordinates.
            text: What that length is, as in 1.25m.

        Raises:
            InputError: That is no length, or the run cannot be written.
        """
        try:
            metres = parse_length(text)
        except ValueError as error:
            raise InputError(str(error)) from error
        distance = subject.similarity.length_to_world(np.linalg.norm(ends[1] - ends[0]))
        factor = scale_run(self._run, float(distance), metres, "two clicks")
        return Edit(self._opened(), f"{metres:g} m: all lengths are now {factor:.4g} times as long, in metres.")

    def keep_sphere(self, subject: Subject, ends: np.ndarray) -> Edit:
        """Take out what lies outside the sphere about the first point through the second, and what hovers within it.

        Args:
            subject: That is shown.
            ends: `[2, 3]` in the subject's coordinates.

        Raises:
            InputError: The run was cleaned before, nothing would be left, or it cannot be written.
        """
        middle, rim = subject.similarity.points_to_world(ends)
        told = clean(self._run, sphere=(*middle, float(np.linalg.norm(rim - middle))))
        counts = ", ".join(f"{told[kind]:,} {kind}" for kind in KINDS)
        return Edit(self._opened(), f"{told['gaussians']:,} Gaussians are left; taken out: {counts}.")

    def bring_back(self) -> Edit:
        """Bring back what was taken out.

        Raises:
            InputError: Nothing was, or the run cannot be written.
        """
        back = undo(self._run)["back"]
        return Edit(self._opened(), f"{back:,} Gaussians came back.")

    def _opened(self) -> Subject:
        return open_subject(self._run, mesh=self._mesh)
