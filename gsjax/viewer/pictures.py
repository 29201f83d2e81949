"""What the page can show of Gaussians, as pictures."""

from functools import lru_cache

import numpy as np

from gsjax.cameras import Camera
from gsjax.colors import to_bytes
from gsjax.gaussians import Gaussians
from gsjax.report.pictures import depth_picture, normal_picture
from gsjax.viewer.drawing import Drawer
from gsjax.viewer.photo_error import error_picture, nearest_photo, photo_colors, seen_by_photo
from gsjax.viewer.subject import Subject

COLOR, DEPTH, NORMALS, ERROR = "colour", "depth", "normals", "error against the nearest photo"
KEPT_PHOTOS = 4  # in memory


class Pictures:
    """Draws one kind of picture from one camera."""

    def __init__(self, subject: Subject):
        """With the background, the depth and the photos of a subject."""
        self._background = subject.background
        self._drawer = Drawer(subject.depth_mode)
        self._photos = {name: frame for name, frame in subject.photos.items() if name in subject.cameras}
        self._cameras = [subject.cameras[name] for name in self._photos]
        # Photos do not change, and reading one takes longer than drawing.
        self._photo = lru_cache(KEPT_PHOTOS)(self._read_photo)

    @property
    def kinds(self) -> tuple[str, ...]:
        """What can be drawn: without photos, no error."""
        return (COLOR, DEPTH, NORMALS, ERROR) if self._photos else (COLOR, DEPTH, NORMALS)

    def draw(
        self, kind: str, gaussians: Gaussians, camera: Camera, background: np.ndarray | None = None
    ) -> tuple[np.ndarray, str]:
        """Draw one.

        Args:
            kind: One of `kinds`.
            gaussians: What to look at.
            camera: From where.
            background: As `gsjax.rendering.backdrop` has it; None: the subject's.

        Returns:
            `[H, W, 3]` uint8, and a line about it, or "".

        Raises:
            InputError: The view does not fit the device, or the photo cannot be read.
        """
        background = self._background if background is None else background
        drawing = self._drawer.draw(gaussians, camera, background, with_surface=kind != COLOR)
        if kind == COLOR or drawing.depth is None or drawing.normals is None:
            return to_bytes(drawing.colors), ""
        if kind == DEPTH:
            return depth_picture(drawing.depth), ""
        if kind == NORMALS:
            return normal_picture(drawing.normals), ""
        index = nearest_photo(camera, self._cameras)
        name = list(self._photos)[index]
        seen, known = seen_by_photo(drawing.depth, camera, self._photo(name), self._photo_camera(name))
        return error_picture(drawing.colors, seen, known), f"against {name}"

    def _photo_camera(self, name: str) -> Camera:
        """Of the photo as it is at hand, whatever its size in training."""
        frame = self._photos[name]
        return Camera(frame.viewmat, frame.K, frame.width, frame.height)

    def _read_photo(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        return photo_colors(self._photos[name].pixels(), self._background)
