"""Materials of OBJ files (.mtl): one colour, or one picture and how it is placed."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gsjax.io.files import read_bytes
from gsjax.scene.colors import to_bytes

GREY = 128  # of what has no colour
MAPS = ("map_kd", "map_ka", "map_ke")  # The first that a material has is its picture.
ARGUMENTS = {"-mm": 2}  # of options; -o, -s and -t have one to three numbers, all others one word
PLACING = ("-o", "-s", "-t")


@dataclass
class Material:
    """What a surface shows."""

    color: tuple[int, ...] = (GREY, GREY, GREY)  # sRGB bytes
    picture: str | None = None  # as the file names it
    scale: tuple[float, ...] = (1.0, 1.0)  # of places in the picture, before `origin` is added
    origin: tuple[float, ...] = (0.0, 0.0)
    is_clamped: bool = False  # its border continues outside; otherwise it is repeated


def read_materials(path: Path) -> dict[str, Material]:
    """The materials of a file by their names.

    Raises:
        InputError: It cannot be read.
    """
    materials: dict[str, Material] = {}
    pictures: dict[str, int] = {}  # the rank in `MAPS` of each material's picture
    name, text = "", read_bytes(path).removeprefix(b"\xef\xbb\xbf").decode("utf-8", "surrogateescape")
    for line in text.splitlines():
        key, _, rest = line.strip().replace("\t", " ").partition(" ")
        key, rest = key.lower(), rest.strip()
        if key == "newmtl":
            name = rest
            materials[name] = Material()
        elif name in materials and key == "kd":
            materials[name].color = _color(rest.split())
        elif name in materials and key in MAPS and MAPS.index(key) < pictures.get(name, len(MAPS)):
            pictures[name] = MAPS.index(key)
            _place_picture(materials[name], rest)
    return materials


def _color(words: Sequence[str]) -> tuple[int, ...]:
    values = [_number(word) for word in words[:3]]
    values *= 3 if len(values) == 1 else 1
    if len(values) < 3 or None in values:  # A file of a spectrum, or none at all.
        return Material.color
    return tuple(to_bytes(np.array(values, np.float64)).tolist())


def _place_picture(material: Material, rest: str) -> None:
    """Reads the options before a picture's name, and the name, which may have spaces."""
    words = rest.split()
    material.scale, material.origin, material.is_clamped = Material.scale, Material.origin, Material.is_clamped
    while len(words) > 1 and words[0][:1] == "-" and words[0][1:].isalpha():
        option = words.pop(0).lower()
        if option == "-clamp":
            material.is_clamped = words[0].lower() == "on"
        if option not in PLACING:
            del words[: ARGUMENTS.get(option, 1)]
            continue
        values = []
        while len(words) > 1 and len(values) < 3 and (value := _number(words[0])) is not None:
            values.append(value)
            del words[0]
        if option == "-s":
            material.scale = (*values, 1.0, 1.0)[:2]
        elif option == "-o":
            material.origin = (*values, 0.0, 0.0)[:2]
    material.picture = " ".join(words)


def _number(word: str) -> float | None:
    try:
        return float(word)
    except ValueError:
        return None
