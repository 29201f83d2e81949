"""What each pixel of a picture shows, from a segmentation network."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsjax.errors import InputError
from gsjax.io.images import resample
from gsjax.networks.records import BACKGROUND, MaskNetwork
from gsjax.networks.runner import Runner, output_names
from gsjax.scene import Pixels, frame_of


class Segmenter(Runner):
    """Finds the pixels that show one of some classes."""

    network: MaskNetwork

    def __init__(self, network: MaskNetwork, weights: str | Path, classes: Sequence[str]):
        """As of `Runner`; the classes are names of the record's, see `chosen_classes`."""
        super().__init__(network, weights)
        self._output, _ = output_names(self.graph, "classes", network.output)
        self._chosen = [network.classes.index(name) for name in classes]

    def __call__(self, picture: np.ndarray, name: str) -> np.ndarray:
        """`[H, W]` bool, where a picture `[H, W, 3]` uint8 shows one of the classes; `name` is for messages.

        Raises:
            InputError: The graph does not give classes for it.
        """
        pixels = Pixels(picture)
        frame = frame_of(name, np.eye(4, dtype=np.float32), np.eye(3, dtype=np.float32), pixels)
        (output,) = self.outputs(frame, pixels, [self._output])
        evidence, bound = self._evidence(output)
        evidence_map = self.finite(self.output_map(evidence, 1, frame, "a class, one value"), frame)
        return resample(evidence_map, frame.width, frame.height).reshape(picture.shape[:2]) > bound

    def _evidence(self, output: np.ndarray) -> tuple[np.ndarray, float]:
        """One number a pixel, and above what it says that the pixel shows one of the chosen classes."""
        if self.network.kind == "probability":
            return output, self.network.bound
        if self.network.kind == "labels":
            return np.isin(output, self._chosen).astype(np.float32), 0.5
        return self._lead(output), 0.0

    def _lead(self, scores: np.ndarray) -> np.ndarray:
        """`[h, w]` float32: by how much the best of the chosen classes leads before the best of the others."""
        count = len(self.network.classes)
        inner = scores[0] if scores.ndim == 4 and scores.shape[0] == 1 else scores
        axis = next((axis for axis in (0, 2) if inner.ndim == 3 and inner.shape[axis] == count), None)
        if axis is None:
            raise InputError(f"{self.graph.file}: gives {list(scores.shape)}, not a score for each of {count} classes")
        by_class = np.moveaxis(inner.astype(np.float32), axis, 0)
        is_chosen = np.isin(np.arange(count), self._chosen)
        return by_class[is_chosen].max(axis=0) - by_class[~is_chosen].max(axis=0)


def chosen_classes(network: MaskNetwork, names: Sequence[str] | None) -> tuple[str, ...]:
    """The classes of a record that are named; None: the only one besides the background.

    Raises:
        InputError: The record has no such class, has several where none is named, or none is left besides them.
    """
    things = tuple(name for name in network.classes if name != BACKGROUND)
    if names is None and len(things) != 1:
        raise InputError(f"classes: the network knows {', '.join(network.classes)}; name those to mask out")
    classes = things if names is None else tuple(names)
    for name in classes:
        if name not in network.classes:
            raise InputError(f"classes={name}: the network knows {', '.join(network.classes)}")
    if not classes or (network.kind != "probability" and set(classes) == set(network.classes)):
        raise InputError(f"classes={','.join(classes)}: must be some of {', '.join(network.classes)}, and not all")
    return classes
