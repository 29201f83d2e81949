# %% [markdown]
# # Photos to a mesh
#
# This notebook runs the pipeline at a tiny size, with the functions that the commands call. The photos are of the
# built-in scene. Its surface is known exactly, so the error of the mesh can be measured.

# %%
import json
from pathlib import Path

import jax.numpy as jnp
from matplotlib import pyplot

import gsjax
from gsjax import pipeline

# %% [markdown]
# **1. Photos.** These are rendered. For your own photos `gsjax sfm` makes such a folder.

# %%
folder = gsjax.write_built_in_scene("scene", num_views=16, size=(64, 64))
figure, panels = pyplot.subplots(1, 8, figsize=(13, 1.8))
for panel, photo in zip(panels.flat, sorted(Path(folder, "images").iterdir()), strict=False):
    panel.imshow(pyplot.imread(photo))
    panel.axis("off")
pyplot.show()

# %% [markdown]
# **2. Load them**: photos with cameras, and points of their structure from motion. Every eighth photo is held out.

# %%
scene = gsjax.load_scene(folder)
print(
    f"{len(scene.train_frames)} photos to train on, {len(scene.held_out_frames)} held out, {len(scene.points)} points"
)

# %% [markdown]
# **3. Settings.** A preset and what differs from it: fewer steps and Gaussians, and one phase. Its loss has the photos
# and normal maps; these maps are the true ones.

# %%
settings = gsjax.preset(
    "quick",
    {
        "supervision": {"normals": str(folder / "normals"), "normal_gate": False},
        "model": {"background": "white", "max_gaussians": 3000, "sh_degree": 1, "far_points": 0},
        "effects": {"names": "none"},
        "schedule": {
            "sparse_views": False,
            "phases": [
                {
                    "name": "surface",
                    "steps": 200,
                    "density_control": True,
                    "weights": {"sdf_normal": 0.1, "pixel_normal": 0.4, "thickness": 0.02},
                }
            ],
        },
        "density": {"start": 50, "stop": 150, "every": 25},
        "logging": {"metrics_every": 10},
    },
)

# %% [markdown]
# **4. Train.** The run folder holds the Gaussians, the cameras, checkpoints and `report.html`.

# %%
summary = gsjax.train(folder, "run", settings)
print(f"{summary['gaussians']:,} Gaussians, held-out PSNR {summary['psnr']:.1f} dB, SSIM {summary['ssim']:.3f}")
assert summary["psnr"] > 20

# %% [markdown]
# **5. The curve.** `metrics.jsonl` has one line for every ten steps.

# %%
metrics = [json.loads(line) for line in Path("run/metrics.jsonl").read_text().splitlines()]
pyplot.plot([m["step"] for m in metrics], [m["psnr"] for m in metrics])
pyplot.xlabel("step")
pyplot.ylabel("PSNR of the photo of this step, dB")
pyplot.show()

# %% [markdown]
# **6. Render** a held-out view: the photo, the colours, and the gradient of the signed distance as a normal map.

# %%
gaussians = gsjax.load_gaussians("run")
held_out = gsjax.read_views(scene.held_out_frames)[1]
view = gsjax.render(gaussians, held_out.camera, background=jnp.ones(3))
field = gsjax.sdf_gradient(gaussians, held_out.camera, depth_mode="front")
normals = field / jnp.maximum(jnp.linalg.norm(field, axis=-1, keepdims=True), 1e-6)

images = {"photo": held_out.image, "render": jnp.clip(view.colors, 0, 1), "normals": 0.5 - 0.5 * normals}
figure, panels = pyplot.subplots(1, 3, figsize=(10, 3.4))
for panel, (name, image) in zip(panels, images.items(), strict=True):
    panel.imshow(image)
    panel.set_title(name)
    panel.axis("off")
pyplot.show()

# %% [markdown]
# **7. Mesh.** Points where the density of the Gaussians crosses a level, Poisson reconstruction of these points, and
# vertices refined on the photos.

# %%
report = gsjax.mesh("run", "run/mesh.ply", points=20_000)
print(f"{report['vertices']:,} vertices, {report['faces']:,} triangles")

# %% [markdown]
# **8. Scores.** Distances to the true surface are in scene units. The solids are 0.85 high.

# %%
figures = pipeline.evaluate("run")
print(f"Chamfer distance {figures['chamfer']:.4f}, F-score {figures['fscore']:.2f}")
assert figures["chamfer"] < 0.05

# %% [markdown]
# **9. Show** the vertices of the mesh and those of the true surface, in their colours.

# %%
figure, panels = pyplot.subplots(1, 2, figsize=(11, 5), subplot_kw={"projection": "3d"})
for panel, name, file in zip(panels, ("mesh", "truth"), ("run/mesh.ply", folder / "gt_mesh.ply"), strict=True):
    mesh = gsjax.read_mesh(file)
    panel.scatter(*mesh.vertices.T, c=mesh.colors / 255, s=2)
    panel.set_title(name)
    panel.set_aspect("equal")
pyplot.show()

# %% [markdown]
# **10. Export** the mesh as GLB for 3D programs, and the Gaussians as SPZ for viewers in the web.

# %%
gsjax.write_mesh("mesh.glb", gsjax.read_mesh("run/mesh.ply"))
gsjax.save_gaussians(gaussians, "gaussians.spz")
for file in ("mesh.glb", "gaussians.spz"):
    print(f"{file}: {Path(file).stat().st_size / 1024:.0f} KiB")
