"""The kinds of picture that the page can show of Gaussians."""

import numpy as np

from gsjax.gaussians import Gaussians
from gsjax.report.pictures import depth_picture, normal_picture
from gsjax.scene.cameras import Camera
from gsjax.scene.colors import to_bytes
from gsjax.viewer.drawing import Drawer
from gsjax.viewer.subject import Subject

KINDS = COLOR, DEPTH, NORMALS = "colour", "depth", "normals"


class Pictures:
    """Draws pictures of one kind from one camera."""

    def __init__(self, subject: Subject):
        """Draw with the background and the depth reading of a subject."""
        self._background = subject.background
        self._drawer = Drawer(subject.depth_mode)

    def draw(self, kind: str, gaussians: Gaussians, camera: Camera, background: np.ndarray | None = None) -> np.ndarray:
        """Draw one picture.

        Args:
            kind: One of `KINDS`.
            gaussians: What to show.
            camera: The view.
            background: As `gsjax.rendering.backdrop` has it; None: the subject's.

        Returns:
            `[H, W, 3]` uint8.

        Raises:
            InputError: The view does not fit the device.
        """
        background = self._background if background is None else background
        drawing = self._drawer.draw(gaussians, camera, background, with_surface=kind != COLOR)
        if drawing.depth is None or drawing.normals is None:
            return to_bytes(drawing.colors)
        return depth_picture(drawing.depth) if kind == DEPTH else normal_picture(drawing.normals)
