"""A network's graph held against its record: one frame in, fields of numbers over the frame out."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import resample, same_shape
from gsjax.networks.onnx import FLOATS, Graph, Port
from gsjax.networks.records import (
    CanvasFit,
    Confidence,
    Network,
    Output,
    canvas_fit,
    input_intrinsics,
    normalize_picture,
    token_count,
)
from gsjax.scene import Frame, Pixels

WHITE = 255.0  # What a photo with a matte is shown over.
COARSEST = 16  # An output may be so many times smaller than the input.


class Runner:
    """Shows frames to a network."""

    def __init__(self, network: Network, weights: str | Path):
        """Loads the weights, an ONNX file, and holds their inputs against the record.

        Raises:
            InputError: They cannot be loaded, or do not fit the record.
        """
        self.network, self.graph = network, Graph(weights)
        self._picture, self.layout = _picture_input(network, self.graph)
        sides = self._picture.shape[2:] if self.layout == "NCHW" else self._picture.shape[1:3]
        self.fixed = (sides[0], sides[1])  # height and width that the graph insists on; None where it takes any
        self._extra = _extra_inputs(network, self.graph, self._picture)

    def place(self, frame: Frame) -> CanvasFit:
        """Where the frame is in the network's input."""
        return canvas_fit(self.network.size, frame.width, frame.height, self.fixed)

    def outputs(self, frame: Frame, pixels: Pixels, names: Sequence[str]) -> list[np.ndarray]:
        """The outputs of these names for a frame that shows `pixels`, as the graph gives them.

        Raises:
            InputError: The graph does not run on it.
        """
        network, place = self.network, self.place(frame)
        picture = normalize_picture(network, _on_canvas(_over_white(pixels), network, place))
        feeds = {self._picture.name: picture.transpose(2, 0, 1)[None] if self.layout == "NCHW" else picture[None]}
        for port, kind in self._extra:
            if kind == "tokens":
                value = np.array(token_count(network.size, place.canvas))
            else:
                value = input_intrinsics(frame.K, frame.width, frame.height, place, network.pixel_center)
            feeds[port.name] = value.reshape((1,) * (len(port.shape) - value.ndim) + value.shape)
        return self.graph(feeds, list(names))

    def output_map(self, output: np.ndarray, channels: int, frame: Frame, what: str) -> np.ndarray:
        """The part of an output that shows the photo, `[h, w, channels]` float32; `what` it must be, in words."""
        place = self.place(frame)
        height, width = place.canvas
        field = _field(output, channels)
        if field is None or field.shape[0] * COARSEST < height or not same_shape(field.shape[1::-1], (width, height)):
            raise InputError(
                f"{self.graph.file}: gives {list(output.shape)} for a photo of {width}x{height}, not {what} a pixel"
            )
        if field.shape[:2] != place.canvas:
            field = resample(field, width, height).reshape(height, width, channels)
        return field[place.top : place.top + place.height, place.left : place.left + place.width]

    def finite(self, values: np.ndarray, frame: Frame, where: np.ndarray | bool = True) -> np.ndarray:
        """The `[h, w, C]` values, which are all finite `where` `[h, w]` they count, or InputError."""
        broken = (~np.isfinite(values).all(axis=-1) & where).sum()
        if broken:
            raise InputError(f"{self.graph.file}: gives {broken} pixels that are not finite for {frame.name}")
        return values


def _picture_input(network: Network, graph: Graph) -> tuple[Port, str]:
    """The input for the photo and its layout: as the graph's shape has it, else as the record has it."""
    named = [port for port in graph.inputs if port.name == network.picture]
    for port in named or graph.inputs:
        if len(port.shape) != 4 or port.dtype not in FLOATS.values() or port.shape[0] not in (None, 1):
            continue
        at = {"NCHW": port.shape[1], "NHWC": port.shape[3]}
        layouts = [layout for layout in at if at[layout] == 3]
        if layouts or at[network.layout] is None:
            return port, network.layout if network.layout in layouts or not layouts else layouts[0]
    raise InputError(f"{graph.file}: takes no picture of three channels; its inputs are {_listed(graph.inputs)}")


def _extra_inputs(network: Network, graph: Graph, picture: Port) -> list[tuple[Port, str]]:
    """The other inputs of the graph, with what each is fed: by name, or the only one by the record's only one."""
    ports = [port for port in graph.inputs if port is not picture]
    kinds = dict(network.extra)
    if len(ports) == len(kinds) == 1:
        kinds = {ports[0].name: next(iter(kinds.values()))}
    foreign = [port for port in ports if port.name not in kinds]
    if foreign:
        raise InputError(f"{graph.file}: also takes {_listed(foreign)}, which the network's record does not know")
    return [(port, kinds[port.name]) for port in ports]


def output_names(graph: Graph, what: str, output: Output, *others: Output | Confidence) -> tuple[str, list[str | None]]:
    """The graph's name of an output that must be there, `what` in words, and those of others; None: not there.

    They are found by name, or by place where all names are foreign.
    """
    names = [port.name for port in graph.outputs]
    foreign = not any(name in names for each in (output, *others) for name in each.names)
    first, *more = (_output_name(each, names, foreign) for each in (output, *others))
    if first is None:
        looked_for = " or ".join(output.names) or f"output {output.place}"
        raise InputError(f"{graph.file}: gives no {what} ({looked_for}); its outputs are {_listed(graph.outputs)}")
    return first, more


def _output_name(output: Output | Confidence, names: list[str], by_place: bool) -> str | None:
    named = next((name for name in output.names if name in names), None)
    if named is not None or not by_place or output.place is None:
        return named
    return names[output.place] if -len(names) <= output.place < len(names) else None


def _field(array: np.ndarray, channels: int) -> np.ndarray | None:
    """An output as `[H, W, channels]` float32, whatever its layout; None where it is no such field."""
    inner = array[0] if array.ndim > 2 and array.shape[0] == 1 else array
    if channels == 1 and inner.ndim == 2:
        inner = inner[None]
    if inner.ndim != 3 or channels not in (inner.shape[0], inner.shape[2]):
        return None
    last = inner.shape[2] == channels and (inner.shape[0] != channels or channels == 1 and inner.shape[0] > 1)
    return (inner if last else inner.transpose(1, 2, 0)).astype(np.float32)


def _over_white(pixels: Pixels) -> np.ndarray:
    if pixels.matte is None:
        return pixels.image
    coverage = pixels.matte[..., None].astype(np.float32) / 255
    return np.rint(pixels.image * coverage + WHITE * (1 - coverage)).astype(np.uint8)


def _on_canvas(image: np.ndarray, network: Network, place: CanvasFit) -> np.ndarray:
    """The photo at its size on the network's input, with what surrounds it."""
    inner = resample(image, place.width, place.height)
    before, (height, width) = (place.top, place.left), place.canvas
    after = height - place.top - place.height, width - place.left - place.width
    if network.size.border == "reflect":
        return np.pad(inner, [(before[0], after[0]), (before[1], after[1]), (0, 0)], mode="reflect")
    canvas = np.empty((height, width, 3), np.uint8)
    canvas[:] = network.size.border
    canvas[place.top : place.top + place.height, place.left : place.left + place.width] = inner
    return canvas


def usable(pixels: Pixels) -> np.ndarray:
    """`[H, W]` float32, 1 where a photo shows something that counts: inside its mask and matte."""
    counts = np.ones(pixels.image.shape[:2], bool)
    for mask in (pixels.matte, pixels.valid):
        counts &= True if mask is None else mask > 127
    return counts.astype(np.float32)


def _listed(ports) -> str:
    return ", ".join(f"{p.name} {['?' if side is None else side for side in p.shape]}".replace("'", "") for p in ports)
