"""What does a step on several devices exchange and hold? Counted in the compiled program, beside what the model says.

    python experiments/benchmarks/sharding_traffic.py

Nothing is run: a program for so many simulated devices is compiled, and its collectives and buffers are read.
"""

import argparse
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

from gsjax import tables
from gsjax.cli import run_guarded
from gsjax.io.machine import machine, versions

COUNTS = (1, 2, 4, 8)
COLUMNS = 9 + 3  # what travels of a splat: `rasterizer.pack`, and its colour
GAUSSIAN = 4 * 59  # bytes of its parameters at degree 3
HBM, LINKS = 3.35e12, {"NVLink": 450e9, "network": 50e9}  # bytes a second of an H100 SXM; 400 Gbit/s a device
BYTES = {"f32": 4, "s32": 4, "u32": 4, "u8": 1, "pred": 1}
COLLECTIVES = ("all-to-all", "all-gather", "all-reduce", "collective-permute")


class Load(NamedTuple):
    """A step: Gaussians of degree 3, each view as large, the same share of them visible in each."""

    rows: int
    share: float
    width: int
    height: int
    pairs: int

    def splat_capacity(self, devices: int) -> int:
        """Splats that a device sends to a view, where they are spread evenly."""
        return -(-int(self.share * self.rows) // devices)


def exchanged(load: Load, devices: int) -> int:
    """Bytes that a device sends in a step, by the model: its splats of the others' views, there and back."""
    return 2 * 4 * COLUMNS * load.splat_capacity(devices) * (devices - 1)


def estimate(load: Load, devices: int, link: float) -> dict[str, float]:
    """Milliseconds of a step on H100s by the model; not measured. Binning and blending of the own view come on top.

    A device projects N / D Gaussians into D views and reads each with its harmonics there, reads it again and adds to
    its gradient on the way back; then Adam reads four arrays of its rows and writes three.

    Args:
        load: The step.
        devices: D.
        link: Bytes a second that a device sends, to all others together.
    """
    projection = 4 * GAUSSIAN * load.rows / HBM
    adam = 7 * GAUSSIAN * load.rows / devices / HBM
    exchange = exchanged(load, devices) / link
    return {"projection_ms": 1e3 * projection, "adam_ms": 1e3 * adam, "exchange_ms": 1e3 * exchange,
            "all_ms": 1e3 * (projection + adam + exchange)}  # fmt: skip


def compiled(load: Load, devices: int) -> dict[str, Any]:
    """Counted bytes a device of the step and of a densification; in a process that has so many devices."""
    import jax
    import jax.numpy as jnp

    from gsjax.gaussians import Gaussians
    from gsjax.settings import Density, Rates, Weights
    from gsjax.targets import Target
    from gsjax.training.growth.rules import RULES
    from gsjax.training.optimizers import make_optimizer
    from gsjax.training.sharded import layout as sharding
    from gsjax.training.sharded.growth import densify
    from gsjax.training.sharded.step import make_sharded_step
    from gsjax.training.state import initial_state
    from gsjax.training.step import BACKGROUNDS
    from gsjax.training.terms import weigh_terms

    mesh = sharding.mesh_of(jax.devices()[:devices])
    optimizer = make_optimizer(Rates(), 1.0, 1000)

    def state():
        n = load.rows
        shapes = (n, 3), (n, 4), (n, 3), (n,), (n, 1, 3), (n, 15, 3)
        return initial_state(Gaussians(*(jnp.zeros(shape, jnp.float32) for shape in shapes)), optimizer)

    def placed(tree: Any) -> Any:
        def one(leaf):
            spec = sharding.BY_ROWS if leaf.ndim else sharding.EVERYWHERE
            return jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=jax.NamedSharding(mesh, spec))

        return jax.tree.map(one, tree)

    def of_views(shape: tuple[int, ...], dtype: Any) -> Any:
        return jax.ShapeDtypeStruct((devices, *shape), dtype)

    size = load.height, load.width
    target = Target(
        of_views((4, 4), jnp.float32),
        of_views((3, 3), jnp.float32),
        of_views((2,), jnp.int32),
        of_views((*size, 3), jnp.uint8),
        None,
        None,
    )
    step = make_sharded_step(
        optimizer,
        weigh_terms(Weights(alpha=0.0)),
        mesh=mesh,
        splat_capacity=load.splat_capacity(devices),
        capacity=load.pairs,
        background=BACKGROUNDS["black"],
        sh_every=1000,
        rule=RULES["adc"],
    )
    by_rows, key = placed(jax.eval_shape(state)), jax.eval_shape(lambda: jax.random.key(0))
    program = step.lower(by_rows, placed(target), key).compile()  # pyright: ignore[reportFunctionMemberAccess]
    scalar = jax.ShapeDtypeStruct((), jnp.float32), jax.ShapeDtypeStruct((), jnp.bool_)
    how = {"mesh": mesh, "optimizer": optimizer, "density": Density(), "budget": load.rows}
    growth = densify.lower(by_rows, key, *scalar, **how).compile()
    memory, of_growth = program.memory_analysis(), growth.memory_analysis()
    found = collectives(program.as_text())
    return {
        "exchanged_mb": 1e-6 * found["all-to-all"] * (devices - 1) / devices,
        "other_collectives_mb": 1e-6 * sum(found[name] for name in COLLECTIVES[1:]),
        "state_mb": 1e-6 * memory.argument_size_in_bytes,
        "workspace_mb": 1e-6 * memory.temp_size_in_bytes,
        "densify_gathered_mb": 1e-6 * collectives(growth.as_text())["all-gather"],
        "densify_workspace_mb": 1e-6 * of_growth.temp_size_in_bytes,
    }


def collectives(program: str) -> dict[str, int]:
    """Bytes of the results of every kind of collective in an optimised HLO text, each counted once."""
    found = dict.fromkeys(COLLECTIVES, 0)
    for result, name in re.findall(r"= (.+?) ([a-z-]+?)(?:-start)?\(", program):
        if name in found:
            for dtype, shape in re.findall(r"(\w+)\[([\d,]*)\]", result):
                count = 1
                for side in filter(None, shape.split(",")):
                    count *= int(side)
                found[name] += BYTES[dtype] * count
    return found


def main() -> None:
    """Compile for every number of devices and print one table, with machine and versions."""
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devices", type=int, nargs="+", default=COUNTS, help="simulated devices (default: 1 2 4 8)")
    parser.add_argument("--rows", type=int, default=1_000_000, help="Gaussians (default: 1,000,000)")
    parser.add_argument("--share", type=float, default=0.3, help="visible in a view (default: 0.3)")
    parser.add_argument("--size", type=int, nargs=2, default=(640, 480), metavar=("W", "H"), help="of a view, pixels")
    parser.add_argument("--pairs", type=int, default=1 << 20, help="(tile, splat) pairs of a view (default: 2^20)")
    parser.add_argument("--estimate-rows", type=int, default=10_000_000, help="Gaussians of the estimate")
    parser.add_argument("--inside", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    load = Load(arguments.rows, arguments.share, *arguments.size, arguments.pairs)
    if arguments.inside:
        print(json.dumps(compiled(load, arguments.inside)))
        return
    rows = {}
    for count in arguments.devices:
        flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={count}"
        environment = {**os.environ, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"}
        command = [sys.executable, *sys.argv, "--inside", str(count)]
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
        counted = json.loads(done.stdout.splitlines()[-1])
        rows[f"{count} devices"] = {"model_mb": 1e-6 * exchanged(load, count), **counted}
    print(tables.compare(rows))
    for link, speed in LINKS.items():
        print(f"computed, H100 over {link}, {arguments.estimate_rows:,} Gaussians, without binning and blending:")
        large = load._replace(rows=arguments.estimate_rows)
        print(tables.compare({f"{count} devices": estimate(large, count, speed) for count in (1, 2, 4, 8, 16, 32, 64)}))
    print(tables.record({**load._asdict(), **machine(), **versions()}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
