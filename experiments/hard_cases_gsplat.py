"""How stable is float32 on hard input? Errors and non-finite results of gsplat's torch code and of ours, by family.

    python experiments/hard_cases_gsplat.py OUT.json

Renders and differentiates the cases of `tests/hard_scenes.py` in float32, and compares each side with its own float64.
Writes and draws all errors, and prints the tables. Needs gsplat 1.5.3 and torch (`pip install gsplat torch`), no GPU.
"""

import argparse
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from benchmarks.peers import pixel_pairs, sums_along_rays

from gsjax.cli import run_guarded

TILE = 16  # pixels, gsplat's default

Results = tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]
"""Image `[1, H, W, D]`, alphas `[1, H, W, 1]`, and gradients of `scenes.loss` by field."""


def gsplat_results(scene: Any, options: dict[str, Any], dtype: str) -> Results:
    """What gsplat's torch code computes, with autograd."""
    import torch
    from gsplat.cuda import _torch_impl as reference
    from scenes import FIELDS

    import rasterizer

    sys.modules["nerfacc"] = sums_along_rays(torch)  # gsplat imports it by name when it blends
    kind = getattr(torch, dtype)
    tensors = {name: torch.tensor(np.array(getattr(scene, name)), dtype=kind, requires_grad=True) for name in FIELDS}
    s, size, antialiased = SimpleNamespace(**tensors), (scene.width, scene.height), "rasterize_mode" in options
    covars, _ = reference._quat_scale_to_covar_preci(s.quats, s.scales, compute_preci=False)
    radii, means2d, depths, conics, compensations = reference._fully_fused_projection(
        s.means, covars, s.viewmats, s.Ks, *size, calc_compensations=antialiased,
        camera_model=options.get("camera_model", "pinhole"),
    )  # fmt: skip
    opacities = s.opacities[None] * compensations if antialiased else s.opacities[None]
    grid = rasterizer.TileGrid(1, *size, TILE)
    _, isect_ids, listed = reference._isect_tiles(means2d, radii, depths, TILE, grid.tiles_x, grid.tiles_y)
    offsets = reference._isect_offset_encode(isect_ids, 1, grid.tiles_x, grid.tiles_y).flatten().tolist()
    values = means2d[0].detach(), conics[0].detach(), opacities[0].detach()
    ids, pixels = map(torch.tensor, pixel_pairs(*values, grid, [*offsets, len(listed)], listed))
    blended = means2d, conics, opacities, s.colors[None], ids, pixels, torch.zeros_like(ids)
    image, alphas = reference.accumulate(*blended, *size)
    image = image + s.backgrounds[:, None, None] * (1 - alphas)
    rng = np.random.default_rng(3)  # as `scenes.loss` has it
    loss = sum((torch.tensor(rng.normal(size=each.shape), dtype=kind) * each).sum() for each in (image, alphas))
    gradients = torch.autograd.grad(loss, list(tensors.values()), allow_unused=True, materialize_grads=True)
    by_field = {name: gradient.numpy() for name, gradient in zip(FIELDS, gradients, strict=True)}
    return image.detach().numpy(), alphas.detach().numpy(), by_field


def our_results(scene: Any, options: dict[str, Any], dtype: str) -> Results:
    """What ours computes: `native` in float32, the reference in float64."""
    import jax
    from scenes import FIELDS, evaluate, in_float64

    with jax.enable_x64(dtype == "float64"):
        scene, backend = (in_float64(scene), "reference") if dtype == "float64" else (scene, "native")
        image, alphas, _, gradient = evaluate(scene, backend, capacity=4096, **options)
        return np.asarray(image), np.asarray(alphas), {name: np.asarray(getattr(gradient, name)) for name in FIELDS}


def errors(results: Any, case: Any) -> list[float | None]:
    """Errors of value and gradient in float32, each None where a number is not finite."""
    from scenes import relative_errors

    image, alphas, gradient = results(case.scene, case.options, "float32")
    true_image, true_alphas, true_gradient = results(case.expected, case.options, "float64")
    largest = max(1.0, float(np.abs(case.expected.colors).max()))
    value = max(np.abs(image - true_image).max() / largest, np.abs(alphas - true_alphas).max())
    relative = relative_errors(SimpleNamespace(**gradient), SimpleNamespace(**true_gradient))
    return [float(each) if np.isfinite(each) else None for each in (value, np.max([*relative.values()]))]


def main() -> None:
    """Measures all cases, writes and draws them, and prints the tables."""
    sys.path.append(str(Path(__file__).parents[1] / "tests"))
    from hard_cases_page import comparison, comparison_faults, draw_comparison
    from hard_scenes import images_by_family

    from gsjax.io import json_files
    from gsjax.io.machine import machine, versions

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", metavar="OUT.json")
    arguments = parser.parse_args()
    sides = {"native": our_results, "gsplat": gsplat_results}
    families = {
        family: {name: {side: errors(of, case) for side, of in sides.items()} for name, case in cases.items()}
        for family, cases in images_by_family().items()
    }
    record = machine() | versions() | {name: metadata.version(name) for name in ("gsplat", "torch")}
    json_files.write(arguments.out, {"record": record, "families": families})
    draw_comparison(families, Path(__file__).parents[1] / "docs/assets/hard_cases.png")
    print("\n".join([*comparison(families), "", *comparison_faults(families)]))


if __name__ == "__main__":
    sys.exit(run_guarded(main))
