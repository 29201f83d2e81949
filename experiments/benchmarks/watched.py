"""What a page costs the training that it shows: runs with and without one, in turn.

    python experiments/benchmarks/watched.py SCENE --rounds 3 [--set KEY=VALUE ...]

Needs Chromium. A round is three runs of the same settings: without a page; with a browser on it that looks at splats;
with one that looks at the rasterizer's pictures and never rests. Prints seconds of the clock and of processors of each
run, the browser's own not among the latter, and their ratios to the run without.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from gsjax import tables

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from devtools import Tab, browser

SIZE = 960, 640
SPLATS, PICTURES = "looks at splats", "moves among pictures"
PICK = """(async () => {
  const pause = () => new Promise(done => setTimeout(done, 500));
  [...document.querySelectorAll("input")].find(each => each.value.startsWith("colour")).click();
  await pause();
  [...document.querySelectorAll("[role=option]")].find(each => each.textContent === "colour").click();
})()"""


def run(scene: str, out: Path, port: int, visit: str | None, more: list[str]) -> dict[str, float]:
    """Seconds of one training: of its steps, and of its processors."""
    command = [sys.executable, "-m", "gsjax", "train", scene, "--out", str(out), *more]
    command += ["--view", "--port", str(port)] if visit else []
    # The browser is a child of its own, and as little as possible in the way.
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    if visit:
        with browser(*SIZE, lowest_priority=True) as tab:
            look(tab, f"http://127.0.0.1:{port}", visit, process)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        sys.exit(f"{' '.join(command)} ended with {process.returncode}")
    wall = json.loads((out / "manifest.json").read_text())["train_seconds"]
    return {"wall": wall, "processor": used.ru_utime + used.ru_stime}


def look(tab: Tab, address: str, visit: str, process: subprocess.Popen) -> None:
    """Until the training is done."""
    tab.call("Page.enable")
    while is_running(process) and "errorText" in tab.call("Page.navigate", url=address):
        time.sleep(0.5)
    if visit == PICTURES and is_running(process):
        tab.wait_for("[...document.querySelectorAll('input')].some(each => each.value.startsWith('colour'))")
        tab.evaluate(PICK)
    side = 1
    while is_running(process):
        time.sleep(0.2)
        if visit == PICTURES:
            tab.press(400, 400, to=(400 + 30 * side, 400))
            side = -side


def is_running(process: subprocess.Popen) -> bool:
    """Without taking its exit status, which `wait4` is to have."""
    return os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None


def main() -> None:
    """Reads the arguments, prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--port", type=int, default=8090)
    given, more = parser.parse_known_args()
    found: dict[str, list[dict[str, float]]] = {"without a page": [], SPLATS: [], PICTURES: []}
    with tempfile.TemporaryDirectory() as folder:
        for round in range(given.rounds):
            for visit, seconds in found.items():
                out = Path(folder) / f"{round} {visit}"
                seconds.append(run(given.scene, out, given.port, visit if visit in (SPLATS, PICTURES) else None, more))
                print(f"round {round}, {visit}: {seconds[-1]}", flush=True)
    plain = found["without a page"]
    print(
        tables.compare(
            {
                visit: {
                    f"{name}, ratio": np.median([a[name] / b[name] for a, b in zip(seconds, plain, strict=True)])
                    for name in ("wall", "processor")
                }
                for visit, seconds in found.items()
            }
        )
    )


if __name__ == "__main__":
    main()
