"""Sixty rendered views of a scanned mesh on a plane; `--set normals=SCENE/normals` gives the true normals."""

CONFIG: dict = {
    "background": "white",
    "pixel_filter": "mip",
    "max_gaussians": 20_000,
    "sh_degree": 2,
    "phases": [
        {"name": "coarse", "steps": 400, "image_scale": 2, "density_control": True},
        {"name": "vanilla", "steps": 1000, "density_control": True},
        {"name": "surface", "steps": 800, "weights": {"sdf_normal": 0.1, "pixel_normal": 0.4, "thickness": 0.02}},
    ],
    "density": {"stop": 1200, "replace": 0.05},
}
