"""Every phase for a few steps on small photos: whether it runs, not how well."""

CONFIG: dict = {
    "downscale": 2,
    "max_gaussians": 4000,
    "phases": [
        {"name": "vanilla", "steps": 40, "density_control": True},
        {"name": "entropy", "steps": 10, "weights": {"entropy": 0.1}},
        {"name": "surface", "steps": 10, "weights": {"sdf_normal": 0.2}},
    ],
    "density": {"start": 10, "stop": 30, "every": 10},
    "logging": {"metrics_every": 10, "evaluate_every": 0, "checkpoint_every": 20},
}
