"""What do the GPU kernels need of an H100: registers, spills, instructions per pixel pair? Compiled without one.

    python experiments/benchmarks/kernel_report.py

Needs `pip install "jax[cuda13]>=0.11.2" nvidia-cuda-nvcc nvidia-cuda-nvdisasm` on any x86 machine; the GPU is described
by numbers.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

from gsjax import tables
from gsjax.cli import run_guarded
from gsjax.errors import InputError

# What XLA wants to know of an H100 SXM; public figures of the device.
H100 = """
gpu_device_info {
  threads_per_block_limit: 1024 threads_per_warp: 32 threads_per_core_limit: 2048
  shared_memory_per_block: 49152 shared_memory_per_core: 233472 shared_memory_per_block_optin: 232448
  core_count: 132 fpus_per_core: 128 clock_rate_ghz: 1.98 cuda_compute_capability { major: 9 }
  block_dim_limit_x: 2147483647 block_dim_limit_y: 65535 block_dim_limit_z: 65535
  registers_per_core_limit: 65536 registers_per_block_limit: 65536
  memory_bandwidth: 3352320000000 l2_cache_size: 52428800 device_memory_size: 84929347584
}
platform_name: "CUDA"
device_description_str: "NVIDIA H100 80GB HBM3"
dnn_version_info { major: 9 minor: 7 }
runtime_version { major: 13 }
"""
CHANNELS = 3


class Variant(NamedTuple):
    """One kernel at one tile size and program width."""

    kernel: str  # forward or backward
    tile_size: int  # pixels
    warps: int

    @property
    def title(self) -> str:
        """Its row in the table."""
        return f"{self.kernel}, {self.tile_size}x{self.tile_size}, {self.warps} warp{'s' * (self.warps > 1)}"

    @property
    def pixels_per_thread(self) -> float:
        """Pixels that one thread holds in registers."""
        return self.tile_size**2 / (32 * self.warps)


VARIANTS = [Variant(k, t, w) for k in ("forward", "backward") for t in (16, 8) for w in (1, 2, 4)]


def compile_to_ptx(variant: Variant, mesh, dump: Path) -> str:
    """The PTX of a kernel as XLA makes it for an H100."""
    import jax
    import jax.numpy as jnp

    from rasterizer import GSPLAT, TileGrid, _pallas
    from rasterizer.compositing import Static

    grid = TileGrid(1, 1920, 1080, variant.tile_size)
    static = Static(grid, GSPLAT, _pallas.engine(interpret=False))
    tiles, pixels, rows, capacity = grid.num_tiles, variant.tile_size**2, 100_000, 1 << 20
    replicated = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec())

    def array(*shape, dtype=jnp.float32):
        return jax.ShapeDtypeStruct(shape, dtype, sharding=replicated)

    lists = array(rows, 6 + CHANNELS), array(capacity, dtype=jnp.int32), array(tiles + 1, dtype=jnp.int32)
    images = (array(tiles, pixels), array(tiles, pixels, dtype=jnp.int32), array(tiles, CHANNELS, pixels))
    _pallas.FORWARD_WARPS = _pallas.BACKWARD_WARPS = variant.warps
    arguments = lists
    if variant.kernel == "backward":
        kept = jax.eval_shape(partial(static.engine.forward, static), *lists).kept
        arguments = *lists, *images, array(tiles, pixels), *(array(*each.shape, dtype=each.dtype) for each in kept)
    name = "_".join(map(str, variant))

    def named(*arguments):
        return getattr(static.engine, variant.kernel)(static, *arguments)

    named.__name__ = name
    with jax.sharding.use_abstract_mesh(mesh.abstract_mesh):
        jax.jit(named).lower(*arguments).compile()
    texts = [path.read_text() for path in dump.glob(f"*{name}*.ptx")]
    return next(text for text in texts if f"_{variant.kernel}_kernel" in text)


def assemble(ptx: str, folder: Path) -> tuple[str, str]:
    """(what ptxas says, disassembly)."""
    tools = next(Path(sys.prefix).glob("lib/python*/site-packages/nvidia/*/bin"))
    source, binary = folder / "kernel.ptx", folder / "kernel.cubin"
    source.write_text(ptx)
    command = [tools / "ptxas", "-arch=sm_90a", "-v", "-o", binary, source]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    return said, subprocess.run([tools / "nvdisasm", "-c", binary], capture_output=True, text=True, check=True).stdout


def inner_loop(disassembly: str) -> list[str]:
    """Instructions of the innermost loop: the shortest backward jump over an exponential."""
    labels, instructions, best = {}, [], None
    for line in disassembly.splitlines():
        if label := re.match(r"\s*(\.L_x_\d+):", line):
            labels[label.group(1)] = len(instructions)
        elif instruction := re.match(r"\s+/\*[0-9a-f]{4,}\*/\s+(.*?);", line):
            instructions.append(instruction.group(1))
    for end, instruction in enumerate(instructions):
        jump = re.search(r"BRA.*`\((\.L_x_\d+)\)", instruction)
        start = labels.get(jump.group(1), end + 1) if jump else end + 1
        body = instructions[start : end + 1]
        if any("MUFU.EX2" in i for i in body) and (best is None or len(body) < len(best)):
            best = body
    return best or []


def report(variant: Variant, mesh, dump: Path) -> dict[str, float]:
    """Static figures of one variant."""
    said, disassembly = assemble(compile_to_ptx(variant, mesh, dump), dump)
    body = inner_loop(disassembly)
    kinds = Counter(re.sub(r"^@!?U?P\w+ ", "", i).split()[0].split(".")[0] for i in body)
    registers, spilled = re.findall(r"Used (\d+) registers", said), re.findall(r"(\d+) bytes spill", said)
    return {
        "registers": max(map(int, registers)),
        "spill_bytes": sum(map(int, spilled)),
        "loop_instructions": len(body),
        "per_pixel_pair": len(body) / variant.pixels_per_thread,
        "loads": kinds["LDG"],
        "shuffles": kinds["SHFL"],
        "barriers": kinds["BAR"],
    }


def main(chosen: Sequence[str] | None = None) -> None:
    """Compile and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args(chosen)
    # A script beside this one has the name of the package.
    sys.path.sort(key=lambda folder: Path(folder).resolve() == Path(__file__).resolve().parent)
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XLA_FLAGS"] = f"--xla_dump_to={folder} --xla_dump_emitter_re=.* --xla_gpu_dump_llvmir"
        os.environ |= {"JAX_SKIP_CUDA_CONSTRAINTS_CHECK": "1", "JAX_PLATFORMS": "cpu"}
        import jax
        from jax.experimental import topologies

        try:
            topology = topologies.get_topology_desc(platform="cuda", target_config=H100, topology="1x1x1")
        except Exception as error:  # Whatever XLA raises where there is no CUDA plugin.
            raise InputError(f'no CUDA compiler in jax {jax.__version__}: pip install "jax[cuda13]>=0.11.2"') from error
        mesh = topologies.make_mesh(topology, (1,), ("x",))
        rows = {
            f"{v.kernel}, {v.tile_size}x{v.tile_size}, {v.warps} warps": report(v, mesh, Path(folder)) for v in VARIANTS
        }
        print(tables.compare(rows))
        print(tables.record({"target": "sm_90a", "channels": CHANNELS, "jax": jax.__version__}))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
