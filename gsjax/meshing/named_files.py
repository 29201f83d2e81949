"""The files that a mesh file names, materials and pictures, and a line for each of them that gives no colours."""

from io import BytesIO
from pathlib import Path

from gsjax.io.notices import print_once
from gsjax.meshing.libraries import load_trimesh

NO_PICTURES = (".mtl", ".bin")


class NamedFiles:
    """The folder that a mesh file lies in, as trimesh asks it for files; trimesh itself passes over what fails."""

    def __init__(self, path: Path):
        """Of the mesh file at `path`."""
        self._path = path
        self._folder = load_trimesh().resolvers.FilePathResolver(str(path))

    def get(self, name: str) -> bytes:
        """What a file of the folder holds.

        Raises:
            OSError, ValueError: It is not there, or not in the folder.
        """
        try:
            content = self._folder.get(name)
        except (OSError, ValueError):
            self._tell(name, "is not in its folder")
            raise
        if not name.lower().endswith(NO_PICTURES) and not _is_picture(content):
            self._tell(name, "is no picture that can be read")
        return content

    __getitem__ = get

    def _tell(self, name: str, fault: str) -> None:
        print_once(f"{self._path}: {name}, which it names, {fault}; the colours that it would give are missing")


def _is_picture(content: bytes) -> bool:
    """Whether the header of some bytes is that of a picture."""
    from PIL import Image

    try:
        Image.open(BytesIO(content)).close()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError):
        return False
    return True
