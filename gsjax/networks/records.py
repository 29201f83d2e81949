"""Networks that see normals, depth or things in a single photo: what each is fed and what it gives back, as data."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from gsjax import config
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.normals.axes import apply_axes, axis_signs

FILE = Path(__file__).with_name("records.json")
BACKGROUND = "background"  # a class


@dataclass(frozen=True)
class Size:
    """The input that a photo is resized to. Sides that a graph has fixed come before any rule."""

    rule: Literal["fixed", "multiple", "tokens"]
    fit: Literal["pad", "stretch"] = "pad"  # keep the photo's shape, centred, and fill the rest; or fill all with it
    # What fills the rest: the photo mirrored, or RGB 0..255.
    border: Literal["reflect"] | tuple[int, int, int] = (0, 0, 0)
    sides: tuple[int, int] | None = None  # fixed: height and width, pixels
    multiple: int = 1  # multiple, tokens: each side is a multiple of it, pixels
    longest: int | None = None  # multiple: the photo's longer side becomes that, pixels; None: it stays as it is
    tokens: int | None = None  # tokens: about so many squares of side `multiple` in all

    def __post_init__(self):
        """Check that the rule has what it needs."""
        needed = {"fixed": "sides", "tokens": "tokens"}.get(self.rule)
        if needed and getattr(self, needed) is None:
            raise ValueError(f"the rule {self.rule} needs {needed}")
        numbers = {"multiple": self.multiple, "longest": self.longest, "tokens": self.tokens}
        numbers |= {"sides": min(self.sides or (1,))}
        for name, number in numbers.items():
            if number is not None and number < 1:
                raise ValueError(f"{name}={number} is below 1")


@dataclass(frozen=True)
class Output:
    """Where a graph's output is found: by name, and by place where all names of the graph are foreign to the record."""

    names: tuple[str, ...] = ()
    place: int | None = None  # counted from 0, or from -1 backwards; None: by name only


@dataclass(frozen=True)
class Confidence:
    """An output that marks where the normals hold; pixels that it rejects are left empty."""

    names: tuple[str, ...]
    kind: Literal["probability", "kappa"]  # of a pixel being valid; or a concentration, see `expected_error_degrees`
    bound: float  # probability: it must be above; kappa: the expected error must be below, degrees
    place: int | None = None  # as in `Output`


@dataclass(frozen=True, kw_only=True)
class Network:
    """What a network is fed; where a record is silent, the defaults hold. The kinds of networks add what they give."""

    licence: str  # one line, shown at every run
    size: Size
    white: float = 1.0  # what a white pixel is before `mean` and `std`: 1 or 255
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)  # RGB, subtracted
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)  # RGB, divided by
    layout: Literal["NCHW", "NHWC"] = "NCHW"  # of the photo, where the graph's own shape does not tell
    picture: str | None = None  # the input for the photo; None, or none of that name: the first of a picture's shape
    extra: Mapping[str, Literal["tokens", "intrinsics"]] = field(default_factory=dict)  # further inputs, if it has them
    pixel_center: float = 0.5  # intrinsics: where the first pixel's centre is in the K that it wants, 0.5 or 0

    def __post_init__(self):
        """Check values that types cannot."""
        if min(self.std) <= 0 or self.white <= 0:
            raise ValueError(f"white={self.white} and std={self.std} must be positive")


@dataclass(frozen=True, kw_only=True)
class NormalNetwork(Network):
    """A network that gives normals."""

    normals: Output
    axes: str  # of its normals: three signs such as +x-y-z, or a name of `gsjax.normals.axes.NAMED_AXES`
    range: Literal["signed", "unit"]  # components in -1..1; or in 0..1 and decoded as 2v - 1
    confidence: Confidence | None = None

    def __post_init__(self):
        """Check the axes besides."""
        super().__post_init__()
        axis_signs(self.axes)


@dataclass(frozen=True, kw_only=True)
class DepthNetwork(Network):
    """A network that gives depth up to a scale and a shift, which the tracks of structure from motion determine."""

    kind: Literal["disparity", "depth"]  # one over the camera z, or the camera z
    depth: Output


@dataclass(frozen=True, kw_only=True)
class MaskNetwork(Network):
    """A network that gives each pixel a class."""

    kind: Literal["scores", "labels", "probability"]  # of every class; the class's place in `classes`; of the only one
    output: Output
    classes: tuple[str, ...]  # in the order of the scores or labels
    bound: float = 0.5  # probability: above it, the pixel shows the class

    def __post_init__(self):
        """Check the classes besides."""
        super().__post_init__()
        if self.kind == "probability" and len(self.classes) != 1:
            raise ValueError(f"a probability is of one class, not of {len(self.classes)}: {', '.join(self.classes)}")
        if not self.classes or len(set(self.classes)) < len(self.classes):
            raise ValueError(f"classes={', '.join(self.classes)} are none, or one of them is named twice")
        if "intrinsics" in self.extra.values():
            raise ValueError("a network for masks is fed photos without known intrinsics")


N = TypeVar("N", bound=Network)


def read_record(
    network: str | Path, records: Mapping[str, N], kind_of: Callable[[Mapping[str, Any]], type[N]]
) -> tuple[str, N]:
    """The name and record of a network: a name of `records`, or a JSON file, whose `kind_of` its content says.

    Raises:
        InputError: It is neither a known name nor a file, or the file is no such record; names the key.
    """
    if str(network) in records:
        return str(network), records[str(network)]
    file = Path(network)
    if not file.is_file():
        names = ", ".join(records)
        raise InputError(f"network={network}: neither a known network ({names}) nor a file that describes one")
    data = json_files.read(file)
    if not isinstance(data, Mapping):
        raise InputError(f"{file}: holds no table of keys that describes a network")
    return file.stem, config.parse(kind_of(data), data, where=str(file))


def _named_records(kind: str, record: type[N]) -> dict[str, N]:
    return {name: config.parse(record, data, where=name) for name, data in json_files.read(FILE)[kind].items()}


# The networks that are known by name, each as a JSON file of a user would describe it.
NETWORKS = _named_records("normals", NormalNetwork)
DEPTH_NETWORKS = _named_records("depth", DepthNetwork)
MASK_NETWORKS = _named_records("masks", MaskNetwork)


class CanvasFit(NamedTuple):
    """Where a photo is in a network's input, pixels."""

    canvas: tuple[int, int]  # height and width of the input
    top: int
    left: int
    height: int  # of the photo there
    width: int


def canvas_fit(size: Size, width: int, height: int, fixed: tuple[int | None, int | None] = (None, None)) -> CanvasFit:
    """Where a photo of `width` x `height` pixels goes; `fixed` are the height and width that a graph insists on."""
    scale = 1.0 if size.longest is None else size.longest / max(width, height)
    ideal = _canvas(size, width, height, scale)
    canvas = (fixed[0] or ideal[0], fixed[1] or ideal[1])
    if size.fit == "stretch":
        return CanvasFit(canvas, 0, 0, *canvas)
    if size.rule != "multiple" or canvas != ideal:
        scale = min(canvas[0] / height, canvas[1] / width)
    inner = [min(max(1, round(scale * side)), most) for side, most in zip((height, width), canvas, strict=True)]
    return CanvasFit(canvas, (canvas[0] - inner[0]) // 2, (canvas[1] - inner[1]) // 2, *inner)


def _canvas(size: Size, width: int, height: int, scale: float) -> tuple[int, int]:
    if size.rule == "fixed":
        assert size.sides is not None
        return size.sides
    if size.rule == "tokens":
        assert size.tokens is not None
        counts = [math.sqrt(size.tokens * share) for share in (height / width, width / height)]
    else:
        counts = [max(1, round(scale * side)) / size.multiple for side in (height, width)]
    # Padding needs room for the whole photo; a stretched one takes the nearest size.
    whole = math.ceil if size.rule == "multiple" and size.fit == "pad" else round
    rows, columns = (size.multiple * max(1, whole(count)) for count in counts)
    return rows, columns


def token_count(size: Size, canvas: tuple[int, int]) -> int:
    """Tokens of an input: its squares, so that the network's own grid is the one it was resized for."""
    return max(1, round(canvas[0] * canvas[1] / size.multiple**2))


def input_intrinsics(K: np.ndarray, width: int, height: int, place: CanvasFit, pixel_center: float) -> np.ndarray:
    """`[3, 3]` float32 K of the input, from the photo's `[3, 3]` K in pixels with centres at +0.5."""
    scale = np.array([place.width / width, place.height / height, 1.0])
    moved = K.astype(np.float64) * scale[:, None]
    moved[:2, 2] += np.array([place.left, place.top]) + (pixel_center - 0.5)
    return moved.astype(np.float32)


def normalize_picture(network: Network, picture: np.ndarray) -> np.ndarray:
    """`[H, W, 3]` uint8 as the `[H, W, 3]` float32 that the network wants."""
    mean, std = np.float32(network.mean), np.float32(network.std)
    return (picture.astype(np.float32) * np.float32(network.white / 255) - mean) / std


def decode_normals(network: NormalNetwork, raw: np.ndarray) -> np.ndarray:
    """The network's `[H, W, 3]` float32 as unit normals in our axes (x right, y down, z forward); a zero stays one."""
    directions = 2 * np.clip(raw, 0, 1) - 1 if network.range == "unit" else raw
    length = np.linalg.norm(directions, axis=-1, keepdims=True)
    unit = np.where(length > 1e-6, directions / np.where(length > 1e-6, length, 1), 0)
    return apply_axes(unit.astype(np.float32), axis_signs(network.axes))


def is_reliable(confidence: Confidence, values: np.ndarray) -> np.ndarray:
    """Bool of the values' shape: where the network is confident of its normals."""
    if confidence.kind == "probability":
        return values > confidence.bound
    return expected_error_degrees(values) < confidence.bound


def expected_error_degrees(kappa: np.ndarray) -> np.ndarray:
    """Mean angle between true and estimated normal at a concentration `kappa` >= 0: 90 degrees at 0.

    That of the angular von Mises-Fisher distribution (Bae, Budvytis and Cipolla 2021):
    `2 k / (k^2 + 1) + pi e^(-k pi) / (1 + e^(-k pi))`.
    """
    kappa = np.maximum(kappa.astype(np.float64), 0)
    rest = np.exp(-np.pi * kappa)
    return np.degrees(2 * kappa / (kappa**2 + 1) + np.pi * rest / (1 + rest))
