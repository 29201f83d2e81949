"""The same fifty photos a third as large and a quarter of the Gaussians: minutes on a CPU."""

CONFIG: dict = {"downscale": 3.0, "max_gaussians": 9_000}
