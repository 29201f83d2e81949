"""A network's record and its graph, bound together: one frame in, its normals out."""

from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import resample, same_shape
from gsjax.io.normal_maps import resize_normals
from gsjax.networks.onnx import FLOATS, Graph, Port
from gsjax.networks.records import (
    CanvasFit,
    Confidence,
    Network,
    Output,
    canvas_fit,
    decode_normals,
    input_intrinsics,
    is_reliable,
    normalize_picture,
    token_count,
)
from gsjax.scene import Frame, Pixels

WHITE = 255.0  # What a photo with a matte is shown over.
COARSEST = 16  # An output may be so many times smaller than the input.


class Estimator:
    """Estimates the normals of frames.

    Attributes:
        graph: What runs.
        fixed: Height and width that the graph insists on, None where it takes any.
    """

    def __init__(self, network: Network, weights: str | Path):
        """Loads the weights and holds them against the record.

        Raises:
            InputError: They cannot be loaded, or do not fit the record.
        """
        self.network, self.graph = network, Graph(weights)
        self._picture, self.layout = _picture_input(network, self.graph)
        sides = self._picture.shape[2:] if self.layout == "NCHW" else self._picture.shape[1:3]
        self.fixed = (sides[0], sides[1])
        self._extra = _extra_inputs(network, self.graph, self._picture)
        self._normals, self._confidence = _outputs(network, self.graph)

    def __call__(self, frame: Frame) -> np.ndarray:
        """`[H, W, 3]` float32 of the frame's size: unit, in our axes, exactly zero where nothing is known.

        Nothing is known where the network's confidence, the photo's mask or its matte says so.

        Raises:
            InputError: The photo cannot be read, or the graph does not give normals for it.
        """
        pixels = frame.pixels()
        place = canvas_fit(self.network.size, frame.width, frame.height, self.fixed)
        outputs = self.graph(self._feeds(frame, pixels, place), self._names())
        raw = self._shown(outputs[0], 3, place)
        known = np.ones(raw.shape[:2], bool)
        if self._confidence is not None and self.network.confidence is not None:
            confidence = self._finite(self._shown(outputs[1], 1, place), known, frame)
            known = is_reliable(self.network.confidence, confidence[..., 0])
        unit = decode_normals(self.network, np.where(known[..., None], self._finite(raw, known, frame), 0))
        return resize_normals(unit, frame.width, frame.height) * _usable(pixels)[..., None]

    def _feeds(self, frame: Frame, pixels: Pixels, place: CanvasFit) -> dict[str, np.ndarray]:
        picture = normalize_picture(self.network, _on_canvas(_over_white(pixels), self.network, place))
        feeds = {self._picture.name: picture.transpose(2, 0, 1)[None] if self.layout == "NCHW" else picture[None]}
        for port, kind in self._extra:
            if kind == "tokens":
                value = np.array(token_count(self.network.size, place.canvas))
            else:
                value = input_intrinsics(frame.K, frame.width, frame.height, place, self.network.pixel_center)
            feeds[port.name] = value.reshape((1,) * (len(port.shape) - value.ndim) + value.shape)
        return feeds

    def _names(self) -> list[str]:
        return [self._normals] if self._confidence is None else [self._normals, self._confidence]

    def _shown(self, output: np.ndarray, channels: int, place: CanvasFit) -> np.ndarray:
        """The part of an output that shows the photo, `[h, w, channels]` float32."""
        height, width = place.canvas
        field = _field(output, channels)
        if field is None or field.shape[0] * COARSEST < height or not same_shape(field.shape[1::-1], (width, height)):
            what = "normals, three values" if channels == 3 else "confidence, one value"
            raise InputError(
                f"{self.graph.file}: gives {list(output.shape)} for a photo of {width}x{height}, not {what} a pixel"
            )
        if field.shape[:2] != place.canvas:
            field = resample(field, width, height).reshape(height, width, channels)
        return field[place.top : place.top + place.height, place.left : place.left + place.width]

    def _finite(self, values: np.ndarray, where: np.ndarray, frame: Frame) -> np.ndarray:
        broken = (~np.isfinite(values).all(axis=-1) & where).sum()
        if broken:
            raise InputError(f"{self.graph.file}: gives {broken} pixels that are not finite for {frame.name}")
        return values


def _picture_input(network: Network, graph: Graph) -> tuple[Port, str]:
    """The input for the photo and its layout: as the graph's shape tells, else as the record has it."""
    named = [port for port in graph.inputs if port.name == network.picture]
    for port in named or graph.inputs:
        if len(port.shape) != 4 or port.dtype not in FLOATS.values() or port.shape[0] not in (None, 1):
            continue
        at = {"NCHW": port.shape[1], "NHWC": port.shape[3]}
        told = [layout for layout in at if at[layout] == 3]
        if told or at[network.layout] is None:
            return port, network.layout if network.layout in told or not told else told[0]
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


def _outputs(network: Network, graph: Graph) -> tuple[str, str | None]:
    """The names of the outputs that hold the normals and the confidence; None where the graph gives none."""
    normals, confidence = network.normals, network.confidence
    wanted = (normals,) if confidence is None else (normals, confidence)
    names = [port.name for port in graph.outputs]
    foreign = not any(name in names for output in wanted for name in output.names)
    found = [_output(output, names, foreign) for output in wanted]
    if found[0] is None:
        looked_for = " or ".join(normals.names) or f"output {normals.place}"
        raise InputError(f"{graph.file}: gives no normals ({looked_for}); its outputs are {_listed(graph.outputs)}")
    return found[0], found[1] if len(found) > 1 and found[1] != found[0] else None


def _output(output: Output | Confidence, names: list[str], by_place: bool) -> str | None:
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


def _usable(pixels: Pixels) -> np.ndarray:
    """`[H, W]` float32, 1 where the photo shows something that counts."""
    usable = np.ones(pixels.image.shape[:2], bool)
    for mask in (pixels.matte, pixels.valid):
        usable &= True if mask is None else mask > 127
    return usable.astype(np.float32)


def _listed(ports) -> str:
    return ", ".join(f"{p.name} {['?' if side is None else side for side in p.shape]}".replace("'", "") for p in ports)
