"""SOG, PlayCanvas's Gaussians in images: version 2 in one archive, the axes of a PLY.

The document is https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog. A ZIP holds meta.json and
lossless WebP images; pixel i of each, row by row, belongs to Gaussian i. Positions have 16 bits, of sign(x) ln(1+|x|)
between the least and the largest of an axis, in two images; scales and colours are labels of a codebook; harmonics are
labels of a palette, whose numbers are labels of a codebook.
"""

import json
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.errors import InputError
from gsjax.gaussians import Gaussians
from gsjax.io import json_files, packing
from gsjax.io.files import atomic_path
from gsjax.io.images import decode_rgba, lossless_webp
from gsjax.io.json_shapes import check
from gsjax.io.machine import require_memory
from gsjax.io.quantization import SIZE, codebook, nearest_labels, palette

_REACH = 256.0  # Of positions, see `pull_in_outliers`.
_MOST_POSITION = 2**16 - 1
_FIRST_TAG = 252  # Alpha of a quaternion whose first component, w, is the largest.
_LARGEST_PALETTE, _LEAST_PALETTE, _A_ROW = 2**16, 2**10, 4  # Rows; one for so many Gaussians, between the two.
_PER_LINE = 64  # Rows of the palette in a line of its image.
_LONGEST_SIDE = 16383  # of a WebP
_MOST_META = 2**20  # bytes of meta.json
_BYTES_PER_NUMBER = 20  # of memory: it is a byte of an image, a float64 and a float32
_DAMAGES = (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, OSError, ValueError, zlib.error)
_FILES = {"files": [str, 1]}
_SHAPE = {
    "version": int,
    "count": int,
    "model?": str,
    "antialias?": bool,
    "means": {"mins": [float, 3], "maxs": [float, 3], "files": [str, 2]},
    "scales": {"codebook": [float, SIZE], **_FILES},
    "quats": _FILES,
    "sh0": {"codebook": [float, SIZE], **_FILES},
    "shN?": {"count": int, "bands": int, "codebook": [float, SIZE], "files": [str, 2]},
}


def write_sog(path: str | Path, gaussians: Gaussians) -> int:
    """Writes Gaussians in the order of a space-filling curve.

    The steps: positions 1/65535 of the range that ln(1+|x|) has along an axis; rotations 0.0055 a component; opacities
    1/255; scales and colours as 256 values allow. Up to 1,024 Gaussians keep their own harmonics, in 256 values; of
    more, one row of harmonics represents four Gaussians or more.

    Returns:
        How many Gaussians had to come in, because no other had the precision of its position.

    Raises:
        InputError: Values are not finite, harmonics are of degree 4, there are too many, or the target cannot be
            written.
    """
    packing.check_packable(path, gaussians)
    count, degree = gaussians.num_gaussians, gaussians.sh_degree
    width = max(4, 4 * math.ceil(math.sqrt(count) / 4))
    height = max(4, 4 * math.ceil(count / width / 4))
    if max(width, height) > _LONGEST_SIDE:
        raise InputError(f"cannot write {path}: {count} Gaussians, SOG holds {_LONGEST_SIDE**2}")
    means, far = packing.pull_in_outliers(np.asarray(gaussians.means, np.float64), _REACH)
    order = packing.morton_order(means)
    images: dict[str, np.ndarray] = {}

    def place(name: str, pixels: np.ndarray) -> list[str]:
        image = np.zeros((height * width, pixels.shape[1]), np.uint8)
        image[:count] = pixels
        images[name] = image.reshape(height, width, -1)
        return [name]

    logs = np.sign(means[order]) * np.log1p(np.abs(means[order]))
    low, high = logs.min(axis=0, initial=np.inf), logs.max(axis=0, initial=-np.inf)
    low, high = (low, high) if count else (np.zeros(3), np.zeros(3))
    fixed = np.rint((logs - low) / np.where(high > low, high - low, 1) * _MOST_POSITION).astype(np.uint16)
    largest, three = packing.smallest_three(packing.unit_quats(np.asarray(gaussians.quats)[order]))
    rotations = np.rint((three * math.sqrt(0.5) + 0.5) * 255)
    scales, colors = np.asarray(gaussians.log_scales)[order], np.asarray(gaussians.sh_dc)[order, 0]
    of_scales, of_colors = codebook(scales), codebook(colors)
    opacity = packing.opacity_bytes(np.asarray(gaussians.logit_opacities)[order])
    meta = {
        "version": 2,
        "asset": {"generator": "gsjax"},
        "count": count,
        **({"model": "antialiased", "antialias": True} if gaussians.pixel_filter == "mip" else {}),
        "means": {
            "mins": low.tolist(),
            "maxs": high.tolist(),
            "files": place("means_l.webp", fixed & 255) + place("means_u.webp", fixed >> 8),
        },
        "scales": {
            "codebook": of_scales.tolist(),
            "files": place("scales.webp", nearest_labels(scales, of_scales)),
        },
        "quats": {"files": place("quats.webp", np.column_stack([rotations, _FIRST_TAG + largest]))},
        "sh0": {
            "codebook": of_colors.tolist(),
            "files": place("sh0.webp", np.column_stack([nearest_labels(colors, of_colors), opacity])),
        },
    }
    if degree:
        rest = np.asarray(gaussians.sh_rest, np.float32)[order].reshape(count, 3 * ((degree + 1) ** 2 - 1))
        rows, labels = palette(rest, min(_LARGEST_PALETTE, max(_LEAST_PALETTE, count // _A_ROW)))
        of_rest = codebook(rows)
        images["shN_centroids.webp"] = _lines_of(nearest_labels(rows, of_rest), degree)
        low_high = np.column_stack([labels & 255, labels >> 8, np.zeros_like(labels)])
        meta["shN"] = {
            "count": len(rows),
            "bands": degree,
            "codebook": of_rest.tolist(),
            "files": ["shN_centroids.webp", *place("shN_labels.webp", low_high)],
        }
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, image in images.items():
            archive.writestr(zipfile.ZipInfo(name), lossless_webp(image))
        archive.writestr(zipfile.ZipInfo("meta.json"), json.dumps(meta, allow_nan=False))
    return int(far.sum())


def read_sog(path: str | Path) -> Gaussians:
    """Reads SOG of version 2 from its archive, any degree 0-3, as numpy float32 arrays.

    Opacities of 0 and 255 get finite logits, a quarter of a step within 0 and 1.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            text = _member(path, archive, "meta.json", _MOST_META).decode()
            meta = json_files.parse(f"{path}: meta.json", text, {"version?": int})
            if meta.get("version") != 2:
                raise InputError(f"{path}: SOG of version {meta.get('version', 1)}, not 2")
            check(f"{path}: meta.json", meta, _SHAPE)
            return _read(path, archive, meta)
    except _DAMAGES as error:
        if isinstance(error, InputError):
            raise
        if isinstance(error, OSError) and error.strerror:
            raise InputError(f"{path}: cannot be read ({error.strerror})") from error
        reason = str(error).splitlines()[0] if str(error) else "it ends too soon"
        raise InputError(f"{path}: truncated or damaged, or not a SOG file ({reason[:200]!a})") from error


def _read(path: Path, archive: zipfile.ZipFile, meta: dict[str, Any]) -> Gaussians:
    count, rest = meta["count"], meta.get("shN")
    if not 0 <= count <= _LONGEST_SIDE**2:
        raise InputError(f"{path}: meta.json: a count of {count}")
    degree = rest["bands"] if rest else 0
    if rest and not (1 <= degree <= 3 and 0 <= rest["count"] <= _LARGEST_PALETTE):
        raise InputError(f"{path}: meta.json: a palette of {rest['count']} harmonics of degree {degree}")
    bands = (degree + 1) ** 2 - 1
    require_memory(f"{path}: {count} Gaussians", _BYTES_PER_NUMBER * count * (14 + 3 * bands))

    def pixels(name: str, least: int = count) -> np.ndarray:
        """`[P, 4]` uint8 pixels of an image in the archive, of which so many are needed."""
        most = 4 * least + 2**16  # A WebP without loss is no larger than its pixels by more than a little.
        image = decode_rgba(f"{path}: {name}", _member(path, archive, name, 2 * most), most=most)
        if image.shape[0] * image.shape[1] < least:
            raise InputError(f"{path}: {name}: {image.shape[1]}x{image.shape[0]} pixels for {least}")
        return image.reshape(-1, 4)

    def of_codebook(part: dict[str, Any], labels: np.ndarray) -> np.ndarray:
        return np.asarray(part["codebook"], np.float64)[labels]

    lower, upper = (pixels(name)[:count, :3].astype(np.float64) for name in meta["means"]["files"])
    low, high = (np.asarray(meta["means"][end], np.float64) for end in ("mins", "maxs"))
    quats, scales, colors = (pixels(meta[part]["files"][0])[:count] for part in ("quats", "scales", "sh0"))
    if (quats[:, 3] < _FIRST_TAG).any():
        raise InputError(f"{path}: quaternions whose largest component is none of four")
    sh_rest = np.zeros((count, 0, 3))
    if rest:
        lines = pixels(rest["files"][0], _PER_LINE * bands * -(-rest["count"] // _PER_LINE))
        rows = of_codebook(rest, lines[:, :3])[: rest["count"] * bands].reshape(-1, bands, 3)
        labels = pixels(rest["files"][1])[:count, :2].astype(np.int64) @ [1, 256]
        if (labels >= len(rows)).any():
            raise InputError(f"{path}: labels of harmonics beyond the {len(rows)} that there are")
        sh_rest = rows[labels]
    logs = low + (high - low) * ((lower + 256 * upper) / _MOST_POSITION)
    with np.errstate(over="ignore"):
        means = np.sign(logs) * np.expm1(np.abs(logs))
    return packing.packed_gaussians(
        path,
        means=means,
        quats=packing.of_smallest_three(
            quats[:, 3].astype(int) - _FIRST_TAG, (quats[:, :3] / 255 - 0.5) / math.sqrt(0.5)
        ),
        log_scales=of_codebook(meta["scales"], scales[:, :3]),
        logit_opacities=packing.logits_of_bytes(colors[:, 3]),
        sh_dc=of_codebook(meta["sh0"], colors[:, None, :3]),
        sh_rest=sh_rest,
        pixel_filter="mip" if meta.get("model") == "antialiased" or meta.get("antialias") else "classic",
    )


def _member(path: Path, archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """The bytes of one file of the archive; no more than there may be, whatever the archive promises."""
    if name not in archive.NameToInfo:
        raise InputError(f"{path}: not a SOG file, it holds no {name[:100]!a}")
    with archive.open(name) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise InputError(f"{path}: {name[:100]!a} is of more than {most} bytes")
    return content


def _lines_of(labels: np.ndarray, degree: int) -> np.ndarray:
    """The image of a palette: 64 rows of it a line, a pixel for red, green and blue of every coefficient."""
    bands = (degree + 1) ** 2 - 1
    image = np.zeros((_PER_LINE * max(1, -(-len(labels) // _PER_LINE)), bands, 3), np.uint8)
    image[: len(labels)] = labels.reshape(-1, bands, 3)
    return image.reshape(-1, _PER_LINE * bands, 3)
