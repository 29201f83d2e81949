"""The files that a mesh file names, materials and pictures, and a line for each that gives no colours."""

import os
import unicodedata
from pathlib import Path
from tempfile import NamedTemporaryFile
from urllib.parse import unquote

import numpy as np

from gsjax.errors import InputError
from gsjax.io.messages import print_once


class NamedFiles:
    """The folder of a mesh file; what it lists and what cannot be shown is said in one line each."""

    def __init__(self, path: Path):
        """Of the mesh file at `path`."""
        self._path = path
        self._textures: dict[str, np.ndarray | None] = {}

    def find(self, name: str) -> Path | None:
        """The file that a name means, in its folder or below; None, and a line, where there is none.

        Programs write paths of the machine that they ran on, with backslashes, in quotes, and in another case.
        """
        file = self._file(name)
        if file is None:
            self.report_missing(name, "is not in its folder")
        return file

    def has(self, name: str) -> bool:
        """Whether there is a file that a name means."""
        return self._file(name) is not None

    def texture(self, name: str) -> np.ndarray | None:
        """`[H, W, 3]` uint8 of the picture that a name means; None, and a line, where there is none."""
        if name not in self._textures:
            file = self.find(name)
            self._textures[name] = None if file is None else self._pixels(name, file)
        return self._textures[name]

    def embedded_texture(self, name: str, content: bytes) -> np.ndarray | None:
        """`[H, W, 3]` uint8 of a picture that the mesh file itself holds; None, and a line, where it is none."""
        with NamedTemporaryFile() as file:
            file.write(content)
            file.flush()
            return self._pixels(name, Path(file.name))

    def report_missing(self, name: str, fault: str) -> None:
        """Says once that what the mesh file names gives no colours."""
        print_once(f"{self._path}: {name}, which it names, {fault}; the colours that it would give are missing")

    def _file(self, name: str) -> Path | None:
        for spelling in dict.fromkeys((name, _of_windows(name))):
            plain = spelling.strip().strip("\"'").replace("\\", "/")
            steps = [step for step in plain.split("/") if step not in ("", ".", "..")]
            for first in range(len(steps)):
                if file := _below(self._path.parent, steps[first:]):
                    return file
        return None

    def _pixels(self, name: str, file: Path) -> np.ndarray | None:
        from gsjax.io.images import read_image  # It loads OpenCV.

        try:
            return read_image(file)[0]
        except InputError:
            self.report_missing(name, "is no picture that can be read")
            return None


def _of_windows(name: str) -> str:
    """A name that is no UTF-8, as Windows' Western European code page has it."""
    try:
        return os.fsencode(name).decode("utf-8")
    except UnicodeDecodeError:
        return os.fsencode(name).decode("cp1252", "replace")


def _alike(name: str) -> str:
    """Equal for names that differ by case, or by how accents are composed."""
    return unicodedata.normalize("NFC", name).lower()


def _below(folder: Path, steps: list[str]) -> Path | None:
    """The file at the end of some steps from a folder, in any case where the exact name is not there."""
    try:
        for step in steps:
            names = {entry.name: entry for entry in folder.iterdir()} if folder.is_dir() else {}
            same = [names[n] for n in (step, unquote(step)) if n in names]
            same += [entry for name, entry in sorted(names.items()) if _alike(name) == _alike(step)]
            if not same:
                return None
            folder = same[0]
        return folder if folder.is_file() else None
    except OSError:
        return None
