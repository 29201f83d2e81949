"""What does each effect cost a step? Processor milliseconds with it beside those without, in turn, and its bytes.

    python experiments/benchmarks/effect_cost.py RUN [--rounds 15]

RUN is a finished run on a data set with tracks: its Gaussians and first photo are used. `counted` is what
`gsjax diagnose` says.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

from gsjax import tables
from gsjax.cli import run_guarded
from gsjax.io.machine import machine, versions


def measure(run: Path, rounds: int) -> dict[str, dict[str, Any]]:
    """By effect: medians over the rounds of the step without, and of the difference; the counted cost; bytes."""
    import jax
    import numpy as np
    import optax

    from gsjax import targets
    from gsjax.effects.appearance import simulations, start
    from gsjax.effects.diagnosis import diagnose
    from gsjax.runs.result import open_result, scene_of_run
    from gsjax.settings import SIMULATED, Rates, Weights
    from gsjax.training.capacity import chosen_capacity
    from gsjax.training.growth.rules import RULES
    from gsjax.training.optimizers import make_optimizer
    from gsjax.training.state import initial_state
    from gsjax.training.step import BACKGROUNDS, make_train_step
    from gsjax.training.terms import weigh_terms

    gaussians, scene = open_result(run).gaussians, scene_of_run(run)
    found = diagnose(scene)
    counted, data = found.record()["effects"], targets.with_photo_numbers(targets.read_targets(scene.train_frames))
    optimizer, rule, key = make_optimizer(Rates(), 1.0, 1000), RULES["error"], jax.random.key(0)
    options = {"capacity": chosen_capacity(gaussians, data), "background": BACKGROUNDS["black"], "sh_every": 1}
    steppers, target = {}, jax.device_put(data.targets[0])
    for names in ((), *((name,) for name in SIMULATED)):
        effects = simulations(start(found.seen, names), names, lambda **_: optax.constant_schedule(0.0))
        step = make_train_step(optimizer, weigh_terms(Weights(alpha=0.0)), rule=rule, effects=effects, **options)
        state = initial_state(jax.tree.map(jax.numpy.asarray, gaussians), optimizer, rule, effects)
        steppers["".join(names)] = step, step(state, target, key)[0]
    times: dict[str, list[float]] = {name: [] for name in steppers}
    for _ in range(rounds):
        for name, (step, state) in steppers.items():
            started = time.process_time()
            state, _ = jax.block_until_ready(step(state, target, key))
            times[name].append(1e3 * (time.process_time() - started))
            steppers[name] = step, state
    plain = np.array(times[""])
    return {
        name: {
            "ms without": float(np.median(plain)),
            "ms more": float(np.median(np.array(times[name]) - plain)),
            "counted": counted[name]["cost"]["ms"],
            "bytes": sum(leaf.nbytes for leaf in jax.tree.leaves(steppers[name][1].effects)),
        }
        for name in SIMULATED
    }


def main() -> None:
    """Measure and print one table, with machine and versions."""
    # A script beside this one has the name of the package.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, metavar="RUN", help="a finished run")
    parser.add_argument("--rounds", type=int, default=15)
    arguments = parser.parse_args()
    print(tables.compare(measure(arguments.run, arguments.rounds)))
    print(tables.record({"rounds": arguments.rounds, **machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
