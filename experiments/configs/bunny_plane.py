"""Sixty rendered views of a scanned mesh on a plane; `--set normals=SCENE/normals` gives the true normals."""

CONFIG: dict = {"background": "white", "max_gaussians": 20_000, "sh_degree": 2}
