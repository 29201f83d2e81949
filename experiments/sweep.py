"""How do the variants of a study compare, their runs spread over all devices?

    python experiments/sweep.py STUDY --scene PATH --out DIR [--on CONFIG] [--seeds N] [--budget TIME] [--at-once N]

Every run is a process of its own that sees one device; what it says is in DIR/VARIANT_SEED.log. Called again it does
what is left; what was stopped goes on.
"""

import argparse
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

import compare

from gsjax import tables
from gsjax.cli import run_guarded
from gsjax.errors import InputError

Start = Callable[[str, str], int]
"""(name of a run, name of a device) -> exit code."""


def sweep(names: Sequence[str], out: Path, devices: Sequence[str], start: Start) -> list[str]:
    """Do what is left of all runs, as many at a time as there are devices; a run that fails stops no other.

    Args:
        names: Of the runs.
        out: Their folder; a run whose OUT/NAME/study.json is there is done.
        devices: What a run sees one of.
        start: Does one run.

    Returns:
        The names of those that failed.
    """
    free: SimpleQueue[str] = SimpleQueue()
    for device in devices:
        free.put(device)

    def done(name: str) -> bool:
        if (out / name / "study.json").exists():
            return True
        device = free.get()
        try:
            print(f"== {name} on {device}", flush=True)
            return start(name, device) == 0
        finally:
            free.put(device)

    with ThreadPoolExecutor(len(devices)) as pool:
        finished = list(pool.map(done, names))
    return [name for name, ok in zip(names, finished, strict=True) if not ok]


def visible_devices() -> list[str]:
    """Names of the GPUs that this process may use, as CUDA_VISIBLE_DEVICES has them; "cpu" where there are none."""
    chosen = os.environ.get("CUDA_VISIBLE_DEVICES")
    if chosen is not None:
        return [name for name in chosen.split(",") if name] or ["cpu"]
    try:
        listed = subprocess.run(["nvidia-smi", "--list-gpus"], capture_output=True, text=True)
    except OSError:
        return ["cpu"]
    return [str(index) for index in range(len(listed.stdout.splitlines()))] or ["cpu"]


def _start(name: str, device: str, out: Path, arguments: Sequence[str]) -> int:
    """One run in a process that sees one device; what it says goes to OUT/NAME.log."""
    seen = {"JAX_PLATFORMS": "cpu"} if device.startswith("cpu") else {"CUDA_VISIBLE_DEVICES": device}
    command = [sys.executable, str(Path(__file__).with_name("compare.py")), *arguments, "--only", name]
    out.mkdir(parents=True, exist_ok=True)
    with open(out / f"{name}.log", "a", encoding="utf-8") as log:
        return subprocess.run(command, env={**os.environ, **seen}, stdout=log, stderr=log).returncode


def main() -> None:
    """Runs what is left and prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    compare.add_arguments(parser)
    parser.add_argument("--at-once", type=int, metavar="N", help="runs at a time where there is no GPU (default: 1)")
    arguments = parser.parse_args()
    devices, out = visible_devices(), Path(arguments.out)
    if devices == ["cpu"]:
        devices = [f"cpu {index}" for index in range(arguments.at_once or 1)]
    same = [arguments.study, "--scene", arguments.scene, "--out", arguments.out, "--seeds", str(arguments.seeds)]
    same += ["--on", arguments.on] if arguments.on else []
    same += ["--budget", arguments.budget] if arguments.budget else []
    names = compare.run_names(compare.load_study(arguments.study, arguments.on).variants, arguments.seeds)
    failed = sweep(names, out, devices, lambda name, device: _start(name, device, out, same))
    if failed:
        raise InputError(f"{len(failed)} of {len(names)} runs failed: {', '.join(failed)}; see {out}/{failed[0]}.log")
    every = compare.run(arguments.study, arguments.scene, arguments.out, arguments.seeds, on=arguments.on)
    print(tables.compare({variant: tables.spread(rows) for variant, rows in every.items()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
