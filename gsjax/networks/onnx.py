"""ONNX graphs, run by onnxruntime: every way in which a file or a run can fail is one line."""

import hashlib
import re
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gsjax.errors import InputError
from gsjax.io.packages import require

GPU, CPU = "CUDAExecutionProvider", "CPUExecutionProvider"
FLOATS = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(double)": np.float64}
_TYPES = {**FLOATS, "tensor(int64)": np.int64, "tensor(int32)": np.int32}
_PREFIX = re.compile(r"^\[ONNXRuntimeError\] : \d+ : \w+ : ")
_FATAL = 4  # Of onnxruntime's log: what goes wrong comes up as an exception, and is one line.


class Port(NamedTuple):
    """An input or output of a graph."""

    name: str
    dtype: type | None  # numpy's; None: a type that is not fed here
    shape: tuple[int | None, ...]  # None: any length


class Graph:
    """A graph that is loaded and ready: on a GPU where onnxruntime has it, else on the CPU."""

    def __init__(self, file: str | Path):
        """Loads it.

        Raises:
            InputError: There is no such file, it is no ONNX graph, or onnxruntime is not installed.
        """
        self.file = Path(file)
        if not self.file.is_file():
            raise InputError(f"{file}: no such file of weights")
        self._session = _session(self.file)
        self.inputs = tuple(map(_port, self._session.get_inputs()))
        self.outputs = tuple(map(_port, self._session.get_outputs()))
        self.provider: str = self._session.get_providers()[0]  # what it really runs on, as onnxruntime calls it
        self.device = self.provider.removesuffix("ExecutionProvider")
        with self.file.open("rb") as handle:
            self.sha256 = hashlib.file_digest(handle, "sha256").hexdigest()

    def __call__(self, feeds: dict[str, np.ndarray], names: list[str] | None = None) -> list[np.ndarray]:
        """Runs it once on arrays by input, cast here to its types, for the named outputs; None: all.

        Raises:
            InputError: The graph takes no such arrays, or fails.
        """
        types = {port.name: port.dtype for port in self.inputs}
        feeds = {name: np.asarray(array, types.get(name), order="C") for name, array in feeds.items()}
        try:
            return self._session.run(names, feeds)
        except Exception as error:  # onnxruntime's own have no base class of theirs.
            shapes = ", ".join(f"{name} {list(array.shape)}" for name, array in feeds.items())
            raise InputError(f"{self.file}: does not run on {shapes} ({_reason(error)})") from error


def _session(file: Path) -> Any:
    runtime = require("onnxruntime")
    options = runtime.SessionOptions()
    options.log_severity_level = _FATAL
    providers = [provider for provider in (GPU, CPU) if provider in runtime.get_available_providers()]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # What it falls back to is told by `Graph.provider`.
            return runtime.InferenceSession(str(file), options, providers=providers)
    except Exception as error:
        message = f"{file}: no ONNX graph that onnxruntime {runtime.__version__} loads ({_reason(error)})"
        raise InputError(message) from error


def _port(description: Any) -> Port:
    shape = tuple(side if isinstance(side, int) else None for side in description.shape)
    return Port(description.name, _TYPES.get(description.type), shape)


def _reason(error: Exception) -> str:
    lines = " ".join(line.strip() for line in str(error).splitlines() if line.strip())
    return _PREFIX.sub("", lines) or type(error).__name__
