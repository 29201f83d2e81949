# %% [markdown]
# # Photos to a mesh in ten cells
#
# The whole road at a tiny size, through the functions that the commands call. The photos are of the built-in scene,
# which is known exactly: so is the error of what comes out.

# %%
import json
from pathlib import Path

import numpy as np
from matplotlib import pyplot

from gsjax import config, pipeline
from gsjax.io import analytic_scene
from gsjax.io.scenes import load_scene
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.meshing.pictures import headlight, render_mesh
from gsjax.presets import DEMO
from gsjax.runs.result import open_result
from gsjax.settings import Settings

# %% [markdown]
# **1. Photos.** Here they are rendered; `gsjax sfm` makes such a folder of your own.

# %%
folder = analytic_scene.write("scene", num_views=16, size=(64, 64))
photos = sorted(Path(folder, "images").iterdir())

figure, panels = pyplot.subplots(1, 8, figsize=(13, 1.8))
for panel, photo in zip(panels.flat, photos, strict=False):
    panel.imshow(pyplot.imread(photo))
    panel.axis("off")
pyplot.show()

# %% [markdown]
# **2. What the library reads of it**: photos with their cameras, and a sparse cloud to start from. Every eighth photo
# is held out.

# %%
scene = load_scene(folder)
print(f"{scene.source}: {len(scene.train_frames)} photos to train on, {len(scene.held_out_frames)} held out,")
print(f"{len(scene.points):,} points")

# %% [markdown]
# **3. Settings** are data: those of the demo, with few steps and Gaussians, and one phase instead of two. Its loss has
# the photos and normal maps; here these are the true ones.

# %%
shorter = {
    "supervision": {"normals": str(folder / "normals")},
    "model": {"max_gaussians": 3000, "sh_degree": 1},
    "schedule": {
        "phases": [
            {
                "name": "surface",
                "steps": 200,
                "density_control": True,
                "weights": {"sdf_normal": 0.1, "pixel_normal": 0.4, "thickness": 0.02},
            }
        ]
    },
    "density": {**DEMO["density"], "start": 50, "stop": 150, "every": 25},
    "logging": {"evaluate_every": 0, "metrics_every": 10},
}
settings = config.parse(Settings, config.merge(DEMO, shorter))

# %% [markdown]
# **4. Train.** The run folder holds the Gaussians, the cameras, checkpoints and `report.html`.

# %%
summary = pipeline.train(folder, "run", settings)
print(f"{summary['gaussians']:,} Gaussians, held-out PSNR {summary['psnr']:.1f} dB, SSIM {summary['ssim']:.3f}")
assert summary["psnr"] > 20

# %% [markdown]
# **5. How it went**: `metrics.jsonl` has a line every so many steps.

# %%
metrics = [json.loads(line) for line in Path("run/metrics.jsonl").read_text().splitlines()]
pyplot.plot([m["step"] for m in metrics], [m["psnr"] for m in metrics])
pyplot.xlabel("step")
pyplot.ylabel("PSNR of the photo of this step, dB")
pyplot.show()

# %% [markdown]
# **6. Look at it** from where a held-out photo was taken. The run keeps such pictures for its report.

# %%
figure, panels = pyplot.subplots(1, 3, figsize=(10, 3.4))
for panel, kind in zip(panels, ("photo", "render", "normals"), strict=True):
    panel.imshow(pyplot.imread(f"run/pictures/0008_{kind}.jpg"))
    panel.set_title(kind)
    panel.axis("off")
pyplot.show()

# %% [markdown]
# **7. The mesh**: points where the density of the Gaussians crosses a level, Poisson through them, then vertices moved
# to where the photos agree.

# %%
report = pipeline.mesh("run", "run/mesh.ply", points=20_000)
print(f"{report['vertices']:,} vertices, {report['faces']:,} triangles")

# %% [markdown]
# **8. Scores.** The true surface is known: distances are in scene units, the solids are 0.85 high.

# %%
figures = pipeline.evaluate("run")
print(f"Chamfer distance {figures['chamfer']:.4f}, F-score {figures['fscore']:.2f}")
assert figures["chamfer"] < 0.05

# %% [markdown]
# **9. Pictures of the mesh** and the true surface: colours, and the shape alone under a lamp at the camera.

# %%
camera = open_result("run").cameras[8]
larger = np.diag([4, 4, 1]) @ camera.K  # of a picture of four times the size
figure, panels = pyplot.subplots(1, 4, figsize=(13, 3.4))
for pair, name, file in ((panels[:2], "mesh", "run/mesh.ply"), (panels[2:], "truth", folder / "gt_mesh.ply")):
    for panel, shading in zip(pair, ({}, {"shading": headlight}), strict=True):
        panel.imshow(render_mesh(read_mesh(file), camera.viewmat, larger, 256, 256, **shading))
        panel.set_title(name)
        panel.axis("off")
pyplot.show()

# %% [markdown]
# **10. Take it along**: as a GLB, which any 3D program opens, and the Gaussians as an SPZ for viewers in the web.

# %%
write_mesh("mesh.glb", read_mesh("run/mesh.ply"))
pipeline.convert("run", "gaussians.spz")
for file in ("mesh.glb", "gaussians.spz"):
    print(f"{file}: {Path(file).stat().st_size / 1024:.0f} KiB")
