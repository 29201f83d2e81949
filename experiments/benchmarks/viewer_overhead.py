"""What does a page cost the training that it shows? Runs with and without a visitor, in turn, in one process.

    python experiments/benchmarks/viewer_overhead.py SCENE --rounds 3 [--steps 1000] [--downscale 4] [--gaussians 10000]

A round is three runs of one phase without density control: nobody looks; somebody looks at splats; somebody looks at
the rasterizer's pictures and never rests. The visitor is a stand-in: pictures and splats are made and encoded, and go
nowhere. Prints seconds of the clock and of the processors for each run, and ratios to the run without. The training's
program is compiled in a run before the first round, the page's own where it first needs them.
"""

import argparse
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from gsjax import config, tables
from gsjax.cli import run_guarded
from gsjax.settings import Settings

if TYPE_CHECKING:  # It imports jax.
    from gsjax.training.loop import Progress

NOBODY, SPLATS, PICTURES = "nobody", "splats", "pictures, moving"
PAGE = 960, 640


@contextmanager
def visited(scene: str, settings: Settings, visit: str) -> Iterator[Callable[["Progress"], None]]:
    """As `gsjax.viewer.watch`, with a visitor."""
    from gsjax.io.scenes import load_scene
    from gsjax.viewer.page import SHOW, Page
    from gsjax.viewer.page_camera import page_camera
    from gsjax.viewer.pictures import COLOR
    from gsjax.viewer.snapshots import Snapshots
    from gsjax.viewer.subject import subject_of_scene
    from gsjax.viewer.watch import SHARE

    loaded = load_scene(scene, downscale=settings.downscale or 1)
    subject = subject_of_scene("scene", loaded, settings.background, settings.depth_mode)
    snapshots, done = Snapshots(settings.phases[0].steps), threading.Event()
    with Page(subject, host="127.0.0.1", port=0, news=snapshots.news, share=SHARE) as page:
        page.server.get_clients = lambda: {"me": SimpleNamespace(scene=page.server.scene)}
        if visit == PICTURES:
            page.switches[SHOW].value = COLOR

        def move() -> None:
            start = page_camera(subject.start)._replace(width=PAGE[0], height=PAGE[1])
            page.desk.moved("me", start)
            while visit == PICTURES and not done.wait(0.1):
                page.desk.moved("me", start._replace(position=start.position + 0.01 * np.sin(time.monotonic())))

        threads = [threading.Thread(target=work) for work in (page.work, move) if visit != NOBODY]
        for thread in threads:
            thread.start()
        try:
            yield snapshots.observe
        finally:
            done.set()
            page.close()
            for thread in threads:
                thread.join()


def run(scene: str, settings: Settings, visit: str) -> dict[str, float]:
    """Seconds of one training."""
    from gsjax import pipeline

    with tempfile.TemporaryDirectory() as folder, visited(scene, settings, visit) as observe:
        before = time.process_time()
        summary = pipeline.train(scene, Path(folder) / "run", settings, observe=observe)
        return {"clock": summary["train_seconds"], "processors": time.process_time() - before}


def main() -> None:
    """Reads the arguments, prints the tables."""
    # A script beside this one has the name of the package.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", metavar="SCENE", help="folder of the data set")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--downscale", type=float, default=4)
    parser.add_argument("--gaussians", type=int, default=10_000)
    given = parser.parse_args()
    phase = {"name": "vanilla", "steps": given.steps}
    logging = {"evaluate_every": 0, "checkpoint_every": 10**6}
    asked = {"downscale": given.downscale, "max_gaussians": given.gaussians, "phases": [phase], "logging": logging}
    settings = config.parse(Settings, asked)
    run(given.scene, settings, NOBODY)  # Compiles; another number of steps would be another program.
    found: dict[str, list[dict[str, float]]] = {visit: [] for visit in (NOBODY, SPLATS, PICTURES)}
    for _ in range(given.rounds):
        for visit, seconds in found.items():
            seconds.append(run(given.scene, settings, visit))
            print(visit, seconds[-1], flush=True)
    ratios = {
        visit: {name: np.array([a[name] / b[name] for a, b in zip(all, found[NOBODY], strict=True)]) for name in all[0]}
        for visit, all in found.items()
    }
    print(tables.compare({visit: tables.spread([dict(zip(r, v, strict=True)) for v in zip(*r.values(), strict=True)])
        for visit, r in ratios.items()}))  # fmt: skip


if __name__ == "__main__":
    sys.exit(run_guarded(main))
