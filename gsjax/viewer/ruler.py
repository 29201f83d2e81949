"""Two clicks, and how far apart the surface is where they hit it."""

from collections.abc import Callable, Hashable

import numpy as np
import viser

from gsjax.cameras import Camera, look_at
from gsjax.gaussians import Gaussians
from gsjax.viewer.drawing import Drawer
from gsjax.viewer.subject import Subject

SIDE, FOCAL = 16, 1000.0  # pixels: what is drawn of a click's surroundings, at about the resolution of a page
COLOR = (255, 200, 0)


class Ruler:
    """Measures between the clicks of each browser: the second of two tells a distance, the third begins anew."""

    def __init__(self, server: viser.ViserServer, subject: Subject, say: Callable[[str], None]):
        """Nothing is clicked yet; `say` is told what was measured."""
        self._scene, self._subject, self._say = server.scene, subject, say
        self._drawer = Drawer(subject.depth_mode)
        self._first: dict[Hashable, np.ndarray] = {}
        self.ends: np.ndarray | None = None  # [2, 3] of the newest length, the subject's coordinates

    def click(self, who: Hashable, gaussians: Gaussians, origin: np.ndarray, direction: np.ndarray) -> float | None:
        """A browser clicked.

        Args:
            who: Which.
            gaussians: What it sees.
            origin: `[3]` of the ray, in the subject's coordinates.
            direction: `[3]` of it.

        Returns:
            After the second click the distance in the world, else None.
        """
        hit = self._hit(gaussians, np.asarray(origin, np.float64), np.asarray(direction, np.float64))
        if hit is None:
            self._say("There is no surface.")
            return None
        first = self._first.pop(who, None)
        if first is None:
            self._first[who] = hit
            self._say("Click on the other end.")
            return None
        self.ends = np.stack([first, hit])
        self._scene.add_line_segments(
            "/ruler", self.ends[None].astype(np.float32), COLOR, thickness=3.0, thickness_units="screen"
        )
        distance = float(self._subject.similarity.length_to_world(np.linalg.norm(hit - first)))
        self._say(f"{distance:.4g} {'m' if self._subject.is_in_metres else 'scene units'}")
        return distance

    def show(self, subject: Subject) -> None:
        """What is measured from now on; the coordinates of clicks stay."""
        self._subject = subject

    def forget(self) -> None:
        """No ends of lengths, no line."""
        self._first.clear()
        self.ends = None
        self._say("")
        line = self._scene.get_handle_by_name("/ruler")
        if line is not None:
            line.remove()

    def _hit(self, gaussians: Gaussians, origin: np.ndarray, direction: np.ndarray) -> np.ndarray | None:
        """`[3]` where a ray meets the surface: what a camera along it has in its middle."""
        along = direction / np.linalg.norm(direction)
        aside = np.eye(3)[np.argmin(np.abs(along))]  # Which way is up in the picture does not matter.
        K = np.array([[FOCAL, 0, SIDE / 2 + 0.5], [0, FOCAL, SIDE / 2 + 0.5], [0, 0, 1]], np.float32)
        camera = Camera(look_at(origin, origin + along, aside), K, SIDE, SIDE)
        depth = self._drawer.draw(gaussians, camera, self._subject.background, with_surface=True).depth
        assert depth is not None, "was asked for"
        middle = float(depth[SIDE // 2, SIDE // 2])
        return origin + middle * along if middle > 0 else None
