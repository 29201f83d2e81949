"""SOG, PlayCanvas's Gaussians in images: version 2 in one archive, the axes of a PLY.

The document is https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog. A ZIP holds meta.json and
lossless WebP images; pixel i of each, row by row, belongs to Gaussian i. Positions have 16 bits, of sign(x) ln(1+|x|)
between the least and the largest of an axis, in two images; scales and colours are labels of a codebook; harmonics are
labels of a palette, whose numbers are labels of a codebook.
"""

import json
import math
import zipfile
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
    ends, fixed = _fixed_positions(means[order])
    largest, three = packing.smallest_three(packing.unit_quats(np.asarray(gaussians.quats)[order]))
    rotations = np.rint((three * math.sqrt(0.5) + 0.5) * 255)
    scales, of_scales = _labelled(np.asarray(gaussians.log_scales)[order])
    colors, of_colors = _labelled(np.asarray(gaussians.sh_dc)[order, 0])
    pixels = {
        "means_l.webp": fixed & 255,
        "means_u.webp": fixed >> 8,
        "scales.webp": scales,
        "quats.webp": np.column_stack([rotations, _FIRST_TAG + largest]),
        "sh0.webp": np.column_stack([colors, packing.opacity_bytes(np.asarray(gaussians.logit_opacities)[order])]),
    }
    images = {name: _laid_out(values, width, height) for name, values in pixels.items()}
    meta = {
        "version": 2,
        "asset": {"generator": "gsjax"},
        "count": count,
        **({"model": "antialiased", "antialias": True} if gaussians.pixel_filter == "mip" else {}),
        "means": {**ends, "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": of_scales, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": of_colors, "files": ["sh0.webp"]},
    }
    if degree:
        meta["shN"], images["shN_centroids.webp"], labels = _packed_harmonics(np.asarray(gaussians.sh_rest)[order])
        images["shN_labels.webp"] = _laid_out(labels, width, height)
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, image in images.items():
            archive.writestr(zipfile.ZipInfo(name), lossless_webp(image))
        archive.writestr(zipfile.ZipInfo("meta.json"), json.dumps(meta, allow_nan=False))
    return int(far.sum())


def _laid_out(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """An image of one pixel a Gaussian, row by row."""
    image = np.zeros((height * width, values.shape[1]), np.uint8)
    image[: len(values)] = values
    return image.reshape(height, width, -1)


def _fixed_positions(means: np.ndarray) -> tuple[dict[str, list[float]], np.ndarray]:
    """The ends of the range of logs along the axes, and `[N, 3]` uint16 between them."""
    logs = np.sign(means) * np.log1p(np.abs(means))
    low, high = (logs.min(axis=0), logs.max(axis=0)) if len(means) else (np.zeros(3), np.zeros(3))
    fixed = np.rint((logs - low) / np.where(high > low, high - low, 1) * _MOST_POSITION).astype(np.uint16)
    return {"mins": low.tolist(), "maxs": high.tolist()}, fixed


def _labelled(values: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """The labels of values in their own codebook, and the codebook."""
    entries = codebook(values)
    return nearest_labels(values, entries), entries.tolist()


def _packed_harmonics(sh_rest: np.ndarray) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """The entry of meta.json for harmonics, the image of their palette, and the pixels of their labels."""
    count, bands, _ = sh_rest.shape
    rest = sh_rest.astype(np.float32).reshape(count, 3 * bands)
    rows, labels = palette(rest, min(_LARGEST_PALETTE, max(_LEAST_PALETTE, count // _A_ROW)))
    numbers, of_rest = _labelled(rows)
    # 64 rows of the palette a line, a pixel for red, green and blue of every coefficient.
    lines = np.zeros((_PER_LINE * max(1, -(-len(rows) // _PER_LINE)), bands, 3), np.uint8)
    lines[: len(rows)] = numbers.reshape(-1, bands, 3)
    degree, files = math.isqrt(bands + 1) - 1, ["shN_centroids.webp", "shN_labels.webp"]
    entry = {"count": len(rows), "bands": degree, "codebook": of_rest, "files": files}
    low_high = np.column_stack([labels & 255, labels >> 8, np.zeros_like(labels)])
    return entry, lines.reshape(-1, _PER_LINE * bands, 3), low_high


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
    except InputError:
        raise
    except Exception as error:  # Of archives and their decoders: whatever the broken bytes lead to.
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
    lower, upper = (_pixels(path, archive, name, count)[:, :3].astype(np.float64) for name in meta["means"]["files"])
    quats, scales, colors = (
        _pixels(path, archive, meta[part]["files"][0], count) for part in ("quats", "scales", "sh0")
    )
    if (quats[:, 3] < _FIRST_TAG).any():
        raise InputError(f"{path}: quaternions whose largest component is none of four")
    low, high = (np.asarray(meta["means"][end], np.float64) for end in ("mins", "maxs"))
    logs = low + (high - low) * ((lower + 256 * upper) / _MOST_POSITION)
    with np.errstate(over="ignore"):
        means = np.sign(logs) * np.expm1(np.abs(logs))
    return packing.packed_gaussians(
        path,
        means=means,
        quats=packing.of_smallest_three(
            quats[:, 3].astype(int) - _FIRST_TAG, (quats[:, :3] / 255 - 0.5) / math.sqrt(0.5)
        ),
        log_scales=_of_codebook(meta["scales"], scales[:, :3]),
        logit_opacities=packing.logits_of_bytes(colors[:, 3]),
        sh_dc=_of_codebook(meta["sh0"], colors[:, None, :3]),
        sh_rest=_harmonics(path, archive, rest, count, bands) if rest else np.zeros((count, 0, 3)),
        pixel_filter="mip" if meta.get("model") == "antialiased" or meta.get("antialias") else "classic",
    )


def _harmonics(path: Path, archive: zipfile.ZipFile, rest: dict[str, Any], count: int, bands: int) -> np.ndarray:
    """`[N, K, 3]` coefficients: rows of the palette."""
    lines = _pixels(path, archive, rest["files"][0], _PER_LINE * bands * -(-rest["count"] // _PER_LINE))
    rows = _of_codebook(rest, lines[:, :3])[: rest["count"] * bands].reshape(-1, bands, 3)
    labels = _pixels(path, archive, rest["files"][1], count)[:, :2].astype(np.int64) @ [1, 256]
    if (labels >= len(rows)).any():
        raise InputError(f"{path}: labels of harmonics beyond the {len(rows)} that there are")
    return rows[labels]


def _of_codebook(part: dict[str, Any], labels: np.ndarray) -> np.ndarray:
    return np.asarray(part["codebook"], np.float64)[labels]


def _pixels(path: Path, archive: zipfile.ZipFile, name: str, count: int) -> np.ndarray:
    """The first so many pixels `[count, 4]` uint8 of an image in the archive."""
    most = 4 * count + 2**16  # A WebP without loss is no larger than its pixels by more than a little.
    image = decode_rgba(f"{path}: {name}", _member(path, archive, name, 2 * most), most=most)
    if image.shape[0] * image.shape[1] < count:
        raise InputError(f"{path}: {name}: {image.shape[1]}x{image.shape[0]} pixels for {count}")
    return image.reshape(-1, 4)[:count]


def _member(path: Path, archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """The bytes of one file of the archive; no more than there may be, whatever the archive promises."""
    if name not in archive.NameToInfo:
        raise InputError(f"{path}: not a SOG file, it holds no {name[:100]!a}")
    with archive.open(name) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise InputError(f"{path}: {name[:100]!a} is of more than {most} bytes")
    return content
