"""The files that a mesh file names, as trimesh requests them, and a line for each that gives no colours."""

from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from gsjax.io.color_profiles import in_srgb
from gsjax.io.files import read_bytes
from gsjax.io.messages import print_once


class NamedFiles:
    """The folder of a mesh file: trimesh's resolver of names."""

    def __init__(self, path: Path):
        """Of the mesh file at `path`."""
        self._path = path

    def get(self, name: str) -> bytes | str:
        """Return the content of the file that a name means, text of materials; OSError where there is none."""
        if (file := self._file(name)) is None:
            raise FileNotFoundError(name)
        content = read_bytes(file)
        if file.suffix.lower() != ".mtl":
            return content
        return content.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "surrogateescape")

    __getitem__ = get

    def text(self, name: str) -> str:
        """Return the materials that a name means; none, and a line, where there is no such file."""
        if self._file(name) is None:
            self.report_picture(name)
            return ""
        return str(self.get(name))

    def pixels(self, picture: Any) -> np.ndarray | None:
        """`[H, W, 3]` uint8 of a picture that Pillow has opened; None where there is none, or it is damaged."""
        if getattr(picture, "format", None) is None:  # trimesh makes pictures of one colour, of no format.
            return None
        try:
            return np.array(in_srgb(self._path, picture))
        except Exception:  # Pillow's decoders raise whatever the broken bytes lead to.
            return None

    def report_picture(self, name: str) -> None:
        """Report that a file gives no colours."""
        fault = "is not in its folder" if self._file(name) is None else "is not read as a picture of its triangles"
        self.report_missing(name, "has options that are not read" if name.startswith("-") else fault)

    def report_missing(self, name: str, fault: str) -> None:
        """Report once that what the mesh file names gives no colours."""
        print_once(f"{self._path}: {name}, which it names, {fault}; the colours that it would give are missing")

    def _file(self, name: str) -> Path | None:
        """Find the file in the folder or below.

        Programs write paths of the machine that they ran on, with backslashes, in quotes, and in another case.
        """
        spelling = name.strip().strip("\"'").replace("\\", "/")
        steps = [step for step in spelling.split("/") if step not in ("", ".", "..")]
        for first in range(len(steps)):
            folder, last = self._path.parent.joinpath(*steps[first:-1]), steps[-1].lower()
            try:
                files = [file for file in folder.iterdir() if file.name.lower() in (last, unquote(last))]
            except (OSError, ValueError):  # ValueError: of a name that no disk holds.
                continue
            for file in sorted(files, key=lambda file: file.name != steps[-1]):
                if file.is_file():
                    return file
        return None
