"""The log of a training or a refinement: a bar with an ETA, metrics, checkpoints; and the state that a run resumes."""

import shutil
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple, Self

import jax
import jax.numpy as jnp
import numpy as np
from tqdm import tqdm

from gsjax import runs
from gsjax.errors import InputError
from gsjax.rendering.engine import computes_on_cpu
from gsjax.runs import checkpoints
from gsjax.runs.compilations import record_compilations
from gsjax.training.step import Metrics


class Journal:
    """A progress bar and a clock over the steps of one run folder. A context: the bar and writes end with it."""

    def __init__(self, run: Path, label: str, steps: int, step: int, seconds: float):
        """Begin at `step` of `steps`, after `seconds` spent in earlier sessions of the same run."""
        self.run, self.steps = run, steps
        self._seconds_before, self._started = seconds, time.perf_counter()
        self.bar = tqdm(total=steps, initial=step, desc=label, unit="step", smoothing=0.05)
        self._recorder = record_compilations()
        self._writer = ThreadPoolExecutor(1)
        self._write: Future[Path] | None = None  # of the last checkpoint

    def __enter__(self) -> Self:
        """The journal itself."""
        self._compilations = self._recorder.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        """Close the bar when the last checkpoint is written."""
        self._recorder.__exit__(*error)
        self._writer.shutdown()
        self.bar.close()
        if error[0] is None:
            self._finish_write()

    @property
    def seconds(self) -> float:
        """Time so far, scoring and earlier sessions of this run included."""
        return self._seconds_before + time.perf_counter() - self._started

    def log(self, step: int, metrics: Metrics, suffix: str = "", **more: Any) -> None:
        """One line of metrics.jsonl, compilations since the last included; loss, PSNR and `suffix` after the bar."""
        record = {
            "step": step,
            "loss": float(metrics.loss),
            "psnr": float(metrics.psnr),
            "pairs": int(metrics.needed),
            "seconds": round(self.seconds, 2),
            "terms": {name: float(value) for name, value in metrics.terms.items()},
        } | more
        if self._compilations:
            record["compiled"] = [*self._compilations]
            self._compilations.clear()
        runs.append_metrics(self.run, record)
        self.bar.set_postfix_str(f"loss {record['loss']:.4f}, PSNR {record['psnr']:.1f} dB{suffix}", refresh=False)

    def save(self, step: int, state: Any, capacity: int) -> None:
        """A checkpoint; with capacity 0 a resumed run counts the pair buffer anew.

        A GPU takes further steps while a thread writes. Then the next checkpoint, or the end, raises what failed.
        """
        self._finish_write()
        on_host = jax.device_get(_checkpoint(state, capacity, self.seconds))
        write = partial(runs.save_checkpoint, self.run, step, on_host)
        if computes_on_cpu():
            write()  # The arrays are the state's own, which the next step overwrites.
        else:
            self._write = self._writer.submit(write)

    def _finish_write(self) -> None:
        if self._write is not None:
            self._write.result()
            self._write = None


class StartingPoint(NamedTuple):
    """The state that a run starts or resumes with."""

    state: Any  # a pytree with a field `step`
    capacity: int | None  # of the pair buffer; None: to be counted
    seconds: float  # spent so far


def starting_point(
    run: Path, initial: Callable[[int | None], Any], warm_start: Path | None = None, in_common: int | None = None
) -> StartingPoint:
    """The newest checkpoint of a run folder, or the initial state; metrics of later steps are taken back.

    Args:
        run: The folder.
        initial: The state at step 0, in buffers of so many rows (None: as many as it takes).
        warm_start: A run folder with a checkpoint, where a run that has none of its own begins.
        in_common: After so many steps the two part, so no later checkpoint will do.
    """
    newest = runs.latest_checkpoint(run)
    if newest is None and warm_start is not None:
        newest = runs.latest_checkpoint(warm_start, in_common)
        shutil.copyfile(warm_start / "metrics.jsonl", run / "metrics.jsonl")
    if newest is None:
        start = StartingPoint(initial(None), None, 0.0)
    else:
        stored = checkpoints.load(newest[1], lambda arrays: _checkpoint(initial(_rows(newest[1], arrays)), 0, 0.0))
        state, capacity, seconds = jax.tree.map(jnp.asarray, stored["state"]), stored["capacity"], stored["seconds"]
        if not (0 <= capacity < 2**31 and 0 <= seconds < np.inf and state.step >= 0):
            raise InputError(f"{newest[1]}: damaged checkpoint, its step, capacity or seconds are none")
        start = StartingPoint(state, int(capacity) or None, float(seconds))
    runs.truncate_metrics(run, int(start.state.step))
    return start


def _rows(path: Path, arrays: dict[str, np.ndarray]) -> int:
    """How many rows a checkpoint says it has: no more than its arrays have (bound and free Gaussians are in two)."""
    rows = arrays.get("['rows']", np.zeros(1))
    stored = sum(len(array) for array in arrays.values() if array.shape)
    if rows.shape or rows.dtype.kind not in "iu" or not 0 <= rows <= stored:
        raise InputError(f"{path}: damaged checkpoint, its number of rows is missing")
    return int(rows)


def _checkpoint(state: Any, capacity: int, seconds: float) -> dict[str, Any]:
    rows = state.gaussians.num_gaussians
    return {"state": state, "rows": np.int64(rows), "capacity": np.int64(capacity), "seconds": np.float64(seconds)}
