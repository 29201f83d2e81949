"""Does training stay finite? Every preset, shortened, on scenes that say little or nothing."""

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from breaking.commands import Rows

TITLE = "Training soak"
COLUMNS = "Scene, preset", "Steps", "Loss or gradient not finite", "Parameters not finite", "Refused"
VIEWS, SIDE, SHARE = 10, 64, 0.1  # photos, their pixels, and how much of a preset's steps is taken
SETTINGS = {
    "model": {"max_gaussians": 2_000, "far_points": 100},
    "effects": {"names": "exposure,vignetting,poses,background"},
}
SCENES: dict[str, dict[str, Any]] = {
    "as it is": {},
    "black photos": {"light": (0, 1)},
    "white photos": {"light": (255, 256)},
    "photos of noise": {"light": (0, 256)},
    "one photo": {"photos": 1},
    "points at one place": {"spread": 1e-7},
    "points a million units away": {"spread": 1e6},
}


def rows(folder: Path) -> Rows:
    """A row a scene and preset."""
    from gsjax.presets import PRESETS

    return {f"{scene}, {name}": [partial(_soak, folder / "soak", scene, name)] for scene in SCENES for name in PRESETS}


def _soak(folder: Path, name: str, preset: str) -> list[str]:
    """Steps, how many had a loss, a gradient or a parameter that is not finite, and why there were none."""
    import jax
    import numpy as np

    from gsjax import config, pipeline, presets
    from gsjax.errors import InputError
    from gsjax.io import analytic_scene

    if not (folder / "scene").exists():
        analytic_scene.write_built_in_scene(folder / "scene", num_views=VIEWS, size=(SIDE, SIDE))
    shutil.rmtree(changed := folder / "changed", ignore_errors=True)
    shutil.copytree(folder / "scene", changed)
    full = presets.preset(preset, config.merge(SETTINGS, _change(changed, **SCENES[name])))
    phases = tuple(replace(phase, steps=round(SHARE * phase.steps)) for phase in full.schedule.phases)
    density = {"start": 10, "every": 10, "stop": round(SHARE * full.density.stop)}
    losses, parameters, refusal = [], [], ""

    def observe(progress: Any) -> None:
        losses.append(bool(progress.metrics.finite) and bool(np.isfinite(progress.metrics.loss)))
        parameters.append(all(bool(np.isfinite(each).all()) for each in jax.tree.leaves(progress.state.gaussians)))

    try:
        settings = full.replace(schedule={"phases": phases}, density=density)
        pipeline.train(changed, changed / "run", settings, observe=observe)
    except InputError as error:
        refusal = str(error).rpartition("/")[2]
    return [str(len(losses)), str(losses.count(False)), str(parameters.count(False)), refusal]


def _change(
    scene: Path, light: tuple[int, int] | None = None, photos: int | None = None, spread: float | None = None
) -> dict[str, Any]:
    """Change photos, their number, or the points that training starts from; return the settings that read these."""
    import numpy as np

    from gsjax.io.images import write_image

    rng = np.random.default_rng(0)
    for photo in sorted((scene / "images").iterdir()) if light else ():
        write_image(photo, rng.integers(*light, (SIDE, SIDE, 3)).astype(np.uint8))
    if photos is not None:
        (scene / "few.txt").write_text("".join(f"{1 + index:03d}.png\n" for index in range(photos)))
        return {"photos": {"subset": str(scene / "few.txt"), "hold_out": "none"}}
    if spread is not None:
        properties = "".join(f"property float {axis}\n" for axis in "xyz")
        header = f"ply\nformat ascii 1.0\nelement vertex 500\n{properties}end_header"
        np.savetxt(scene / "start.ply", rng.normal(scale=spread, size=(500, 3)), header=header, comments="")
        return {"model": {"points": str(scene / "start.ply")}}
    return {}
