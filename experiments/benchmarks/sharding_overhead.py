"""What does sharding cost? Processor time of a view in a step of D views on D devices, beside one device, in turn.

    python experiments/benchmarks/sharding_overhead.py RUN [--devices 1 2 4] [--rounds 15]

RUN is a finished run: its Gaussians and photos are used. On a CPU the devices are simulated and share its cores: the
ratio to the program of one device is what exchanging and stacking cost, not what several devices bring. Every number of
devices has a process of its own, since simulated ones that stand idle slow the others down.
"""

import argparse
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from gsjax import tables
from gsjax.cli import run_guarded
from gsjax.io.machine import machine, versions

WARM = 3  # steps that are not timed: they compile, the second too where the first began with a state from the host


def stepper(placement: Any, state: Any, data: Any, optimizer: Any) -> Callable[[], None]:
    """Takes one step, and the next when called again."""
    import jax

    from gsjax.settings import Weights
    from gsjax.training.capacity import STILL
    from gsjax.training.growth.rules import RULES
    from gsjax.training.step import BACKGROUNDS
    from gsjax.training.terms import weigh_terms

    capacity = placement.chosen_capacity(state.gaussians, data, headroom=STILL)
    step = placement.make_step(
        optimizer,
        weigh_terms(Weights(alpha=0.0)),
        capacity=capacity,
        background=BACKGROUNDS["black"],
        sh_every=1,
        rule=RULES["error"],
        depth_mode="plane",
        effects={},
        extent=1.0,
    )
    target, key, taken = placement.feed(data, 0, 0.5), jax.random.key(0), 0

    def once() -> None:
        nonlocal state, taken
        state, metrics = step(state, target(taken), key)
        assert not bool(jax.block_until_ready(metrics).overflowed)
        taken += 1

    for _ in range(WARM):
        once()
    return once


def prepare(run: Path, count: int) -> None:
    """What a process does first: its devices, and a step on them; 0 stands for the program of one device."""
    # Where there are GPUs, the flag says nothing of them.
    simulated = f"--xla_force_host_platform_device_count={max(count, 1)}"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {simulated}"
    import jax
    import jax.numpy as jnp

    from gsjax import targets
    from gsjax.runs.result import open_result, scene_of_run
    from gsjax.settings import Rates
    from gsjax.training import buffers
    from gsjax.training.growth.rules import RULES
    from gsjax.training.loop import one_device
    from gsjax.training.optimizers import make_optimizer
    from gsjax.training.sharded import layout as sharding
    from gsjax.training.sharded import placement as several
    from gsjax.training.state import initial_state

    global once  # what this process is there for
    gaussians, data = open_result(run).gaussians, targets.read_targets(scene_of_run(run).train_frames)
    optimizer = make_optimizer(Rates(), 1.0, 1000)
    state = initial_state(jax.tree.map(jnp.asarray, gaussians), optimizer, RULES["error"])
    if not count:
        once = stepper(one_device(), state, data, optimizer)
        return
    mesh = sharding.mesh_of(jax.devices()[:count])
    whole = buffers.lengthen(state, optimizer, -(-gaussians.num_gaussians // count) * count)
    once = stepper(several.placement(mesh, count), sharding.deal_rows(whole, mesh), data, optimizer)


def timed() -> float:
    """Processor seconds of a step."""
    started = time.process_time()
    once()
    return time.process_time() - started


def measure(run: Path, counts: list[int], rounds: int) -> dict[str, dict[str, str]]:
    """By number of devices: milliseconds a view, and the ratio to the program of one device."""
    asked = [0, *counts]
    pools = {n: ProcessPoolExecutor(1, get_context("spawn"), prepare, (run, n)) for n in asked}
    for pool in pools.values():
        pool.submit(timed).result()
    times = {n: [] for n in asked}
    for _ in range(rounds):
        for n, pool in pools.items():
            times[n].append(1e3 * pool.submit(timed).result() / max(n, 1))
    table = {}
    for n, spent in times.items():
        low, middle, high = np.quantile(np.array(spent) / times[0], [0.25, 0.5, 0.75])
        name = f"{n}, shards" if n else "the program of one device"
        table[name] = {"ms a view": f"{np.median(spent):.1f}", "ratio": f"{middle:.2f} ({low:.2f}-{high:.2f})"}
    return table


def main() -> None:
    """Measure and print one table, with machine and versions."""
    # A script beside this one has the name of the package.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--devices", type=int, nargs="+", default=[1, 2, 4])
    parser.add_argument("--rounds", type=int, default=15)
    arguments = parser.parse_args()
    print(tables.compare(measure(arguments.run, arguments.devices, arguments.rounds)))
    print(tables.record({"rounds": arguments.rounds, **machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
