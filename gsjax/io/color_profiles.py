"""Colours of photos in sRGB: by their ICC profile, by the code points of HEIC, AVIF and video, or by EXIF."""

import struct
from functools import cache, lru_cache
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, ImageCms

from gsjax.io.exif import is_adobe_rgb
from gsjax.io.messages import print_first

HDR = {16: "PQ", 18: "HLG"}
"""Transfer functions of high dynamic range, by their code points (ITU-T H.273)."""
_MODES = {"RGB": "RGB", "GRAY": "L", "CMYK": "CMYK"}  # Pillow's, by the colour space of a profile
_NEAR = 1  # of 255: a profile that moves no colour by more is sRGB's
_GRID = 9  # values of each channel that a profile is compared with sRGB at
_HEAD = 2**16  # bytes of a file that begin with all that describes its picture
_D65 = (0.3127, 0.3290)
_PRIMARIES = {  # x and y of red, green and blue, by code point (ITU-T H.273); the white point is D65
    9: ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046)),  # BT.2020
    12: ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060)),  # Display P3
}
_ADOBE_RGB = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06))
_ADOBE_CURVE = (0, (563 / 256,))  # Adobe RGB (1998) color image encoding, 4.3.1.2, as ICC's function type 0
_SRGB_CURVE = (3, (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045))  # IEC 61966-2-1, as ICC's function type 3
_D50 = np.array([0.9642, 1.0, 0.8249])  # white of ICC profiles
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


class CodePoints(NamedTuple):
    """How the colours of a video, or of a photo in a video's format, are coded: numbers of ITU-T H.273."""

    primaries: int
    transfer: int


def in_srgb(path: Path, picture):
    """An opened picture's colours in sRGB, as a picture of mode RGB; an alpha channel is dropped.

    Colours of a profile that is damaged, or of another kind of picture, are taken as sRGB, and a line says so.
    """
    profile = _profile_of(path, picture)
    if profile is not None:
        try:
            mode, transform = _to_srgb(profile)
            return in_mode(picture, "RGB") if transform is None else transform.apply(_for_profile(picture, mode))
        except (ImageCms.PyCMSError, OSError, ValueError) as error:
            message = f"{path}: its colour profile cannot be used ({error}); its colours are taken as sRGB"
            print_first((path.parent, profile), message)
    return in_mode(picture, "RGB")


def code_points(data: bytes) -> CodePoints | None:
    """The first colour information (`colr`) in the bytes of an MP4, MOV, HEIC or AVIF file; None where it has none."""
    for kind in (b"colrnclx", b"colrnclc"):
        at = data.find(kind) + len(kind)
        if at >= len(kind) and at + 4 <= len(data):
            return CodePoints(*struct.unpack_from(">HH", data, at))
    return None


def _profile_of(path: Path, picture) -> bytes | None:
    """The ICC profile that states what an opened picture's colours mean; None: sRGB."""
    embedded = picture.info.get("icc_profile")
    if embedded:
        return embedded
    coded = _coding_of(path, picture)
    if coded is not None and coded.transfer in HDR:
        message = f"{path}: is coded for high dynamic range ({HDR[coded.transfer]}), which is not converted"
        print_first((path.parent, coded), f"{message}; its colours are taken as sRGB")
        return None
    if coded is not None:
        return matrix_profile(_PRIMARIES[coded.primaries], _SRGB_CURVE) if coded.primaries in _PRIMARIES else None
    return matrix_profile(_ADOBE_RGB, _ADOBE_CURVE) if is_adobe_rgb(picture) else None


def _coding_of(path: Path, picture) -> CodePoints | None:
    """The code points of an opened HEIC or AVIF; None of other pictures."""
    coded = picture.info.get("nclx_profile")
    if coded:
        return CodePoints(coded["color_primaries"], coded["transfer_characteristics"])
    if picture.format != "AVIF":  # Pillow does not report its code points.
        return None
    with path.open("rb") as file:
        return code_points(file.read(_HEAD))


@lru_cache(maxsize=32)
def _to_srgb(profile: bytes) -> tuple[str, Any]:
    """The mode of Pillow that a profile is for, and the transform from it to sRGB; None where it is sRGB's."""
    source = ImageCms.ImageCmsProfile(BytesIO(profile))
    space = source.profile.xcolor_space.strip()  # pyright: ignore[reportAttributeAccessIssue]
    if space not in _MODES:
        raise ValueError(f"it is for colours of {space}")
    transform = ImageCms.buildTransform(
        source,
        ImageCms.createProfile("sRGB"),
        _MODES[space],
        "RGB",
        ImageCms.Intent.RELATIVE_COLORIMETRIC,
        ImageCms.Flags.BLACKPOINTCOMPENSATION,
    )
    return _MODES[space], None if _is_srgb(transform, _MODES[space]) else transform


def _is_srgb(transform, mode: str) -> bool:
    """Whether a transform leaves colours as they are; of CMYK none does."""
    if mode == "CMYK":
        return False
    steps = np.linspace(0, 255, 256 if mode == "L" else _GRID).round().astype(np.uint8)
    grid = steps[None] if mode == "L" else np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(1, -1, 3)
    before = Image.fromarray(grid)
    after = np.asarray(transform.apply(before), np.int16)
    return bool(np.abs(after - np.asarray(before.convert("RGB"), np.int16)).max() <= _NEAR)


def _for_profile(picture, mode: str):
    """A picture in the mode of its profile."""
    is_grey = picture.mode[0] in "1LIF" and picture.mode != "LAB"
    own = "CMYK" if picture.mode == "CMYK" else "L" if is_grey else "RGB"
    if own != mode and (own, mode) != ("L", "RGB"):
        raise ValueError(f"it is for pictures of {mode}, and this one is of {own}")
    return in_mode(picture, mode)


def in_mode(picture, mode: str):
    """The picture itself where it is of that mode: Pillow would copy it."""
    return picture if picture.mode == mode else picture.convert(mode)


@cache
def matrix_profile(primaries: tuple[tuple[float, float], ...], curve: tuple[int, tuple[float, ...]]) -> bytes:
    """An ICC profile (version 4) of x and y of red, green and blue, white D65, and a parametric curve (its type)."""
    columns = np.stack([_xyz(*each) for each in primaries], axis=-1)
    white = _xyz(*_D65)
    adapted = np.linalg.inv(_BRADFORD) @ np.diag((_BRADFORD @ _D50) / (_BRADFORD @ white)) @ _BRADFORD
    matrix = adapted @ (columns * np.linalg.solve(columns, white))
    kind, numbers = curve
    curved = struct.pack(">4s4xH2x", b"para", kind) + _fixed(numbers)
    tags = {b"wtpt": _D50, **dict(zip((b"rXYZ", b"gXYZ", b"bXYZ"), matrix.T, strict=True))}
    parts = {name: struct.pack(">4s4x", b"XYZ ") + _fixed(values) for name, values in tags.items()}
    parts |= dict.fromkeys((b"rTRC", b"gTRC", b"bTRC"), curved)
    table, data, start = struct.pack(">I", len(parts)), b"", 128 + 4 + 12 * len(parts)
    for name, part in parts.items():
        table += struct.pack(">4sII", name, start + len(data), len(part))
        data += part
    size = start + len(data)
    head = struct.pack(">I4xI4s4s4s12x4s", size, 0x04200000, b"mntr", b"RGB ", b"XYZ ", b"acsp")
    head = head.ljust(68, b"\0") + _fixed(_D50)
    return head.ljust(128, b"\0") + table + data


def _xyz(x: float, y: float) -> np.ndarray:
    """XYZ of a chromaticity at luminance 1."""
    return np.array([x / y, 1.0, (1 - x - y) / y])


def _fixed(values) -> bytes:
    """Numbers as ICC stores them: 16 bits before the point and 16 after it."""
    return np.rint(np.asarray(values) * 65536).astype(">i4").tobytes()
