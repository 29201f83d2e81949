"""Step time against the Gaussians that are alive: buffers that grow with them beside buffers of the whole budget.

Both are timed in turn, round by round, in one process; the ratio is what the table is for.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from gsjax import tables
from gsjax.cli import guarded
from gsjax.io.machine import machine, versions

ALIVE = (10_000, 30_000, 100_000, 300_000)
SIZE = (640, 480)
ROUNDS = 7


def measure(alive: int, budget: int) -> dict[str, Any]:
    """Milliseconds of a vanilla step in both buffers (medians), their ratio, and the bytes of both states."""
    import jax
    import numpy as np

    from gsjax.training.rows import bucket

    rows = bucket(alive, budget)
    runs = {rows: _stepper(alive, rows), budget: _stepper(alive, budget)}
    times: dict[int, list[float]] = {count: [] for count in runs}
    for _ in range(ROUNDS):
        for count, (step, state, target, key) in runs.items():
            started = time.perf_counter()
            state, metrics = step(state, target, key)
            jax.block_until_ready(state)
            times[count].append(1e3 * (time.perf_counter() - started))
            assert not bool(metrics.overflowed)
            runs[count] = (step, state, target, key)
    ratios = np.array(times[budget]) / np.array(times[rows])
    size = {count: sum(leaf.nbytes for leaf in jax.tree.leaves(run[1])) for count, run in runs.items()}
    return {
        "rows": rows,
        "ms": float(np.median(times[rows])),
        "ms_of_budget": float(np.median(times[budget])),
        "ratio": float(np.median(ratios)),
        "least": float(ratios.min()),
        "most": float(ratios.max()),
        "mib": size[rows] / 2**20,
        "mib_of_budget": size[budget] / 2**20,
    }


def _stepper(alive: int, rows: int):
    """A compiled vanilla step that has run once, its state, a target and a key."""
    import jax
    import numpy as np

    from gsjax import targets
    from gsjax.cameras import look_at
    from gsjax.scene import Pixels, frame_of
    from gsjax.settings import Rates, Weights
    from gsjax.training.capacity import chosen_capacity
    from gsjax.training.growth.rules import RULES
    from gsjax.training.initialize import from_points
    from gsjax.training.optimizers import make_optimizer
    from gsjax.training.state import initial_state
    from gsjax.training.step import BACKGROUNDS, make_train_step

    rng, (width, height) = np.random.default_rng(0), SIZE
    points, colors = rng.uniform(-1, 1, (alive, 3)), rng.integers(0, 256, (alive, 3), dtype=np.uint8)
    viewmat = look_at(np.array([0.0, -4.0, 0.5]), np.zeros(3), np.array([0.0, 0.0, 1.0]))
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1]], np.float32)
    photo = Pixels(rng.integers(0, 256, (height, width, 3), dtype=np.uint8))
    data = targets.views_of([frame_of("0", viewmat, K, photo)])
    gaussians = from_points(points, colors, capacity=rows, sh_degree=3)
    optimizer = make_optimizer(Rates(), 1.0, 1000)
    step = make_train_step(
        optimizer,
        Weights(alpha=0.0),
        capacity=chosen_capacity(gaussians, data),
        background=BACKGROUNDS["black"],
        sh_every=1,
        rule=RULES["adc"],
    )
    key, target = jax.random.key(0), jax.device_put(data.targets[0])
    state, _ = step(initial_state(gaussians, optimizer), target, key)
    return step, jax.block_until_ready(state), target, key


def main() -> None:
    """Measure and print one table, with machine and versions."""
    # A script beside this one has the name of the package.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--budget", type=int, default=1_000_000, help="rows of the other buffer (default: 1,000,000)")
    parser.add_argument("--alive", type=int, nargs="+", default=ALIVE, help="Gaussians alive")
    arguments = parser.parse_args()
    print(tables.compare({f"{alive:,} alive": measure(alive, arguments.budget) for alive in arguments.alive}))
    print(tables.record({"rounds": ROUNDS, "size": "x".join(map(str, SIZE)), **machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(guarded(main))
