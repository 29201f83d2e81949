"""The settings of one short run that many tests look at, and how a run is killed."""

import numpy as np
import pytest

from gsjax import pipeline

SETTINGS = {
    "model": {"background": "white", "max_gaussians": 900, "sh_degree": 1},
    "schedule": {
        "sh_every": 10,
        "phases": [
            {"name": "coarse", "steps": 12, "image_scale": 2, "density_control": True},
            {"name": "entropy", "steps": 8, "weights": {"entropy": 0.1}, "cull_below": 0.05},
            {"name": "surface", "steps": 10, "weights": {"sdf_normal": 0.2}},
        ],
    },
    "density": {"start": 2, "stop": 12, "every": 4, "reset_every": 0},
    "logging": {"metrics_every": 5, "evaluate_every": 15, "checkpoint_every": 7},
}


FEW_POINTS = {"level": 0.1, "points": 5000}
"""Options of a mesh of that run."""

MASK = np.where(np.arange(48) < 44, np.uint8(255), np.uint8(0))[None] * np.ones((40, 1), np.uint8)


def train_until_killed(step, scene, folder, settings, **more):
    journals = pipeline.train.__globals__["TrainingJournal"]
    note = journals.note

    def killed(journal, progress):
        note(journal, progress)
        if progress.step == step:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patched, pytest.raises(KeyboardInterrupt):
        patched.setattr(journals, "note", killed)
        pipeline.train(scene, folder, settings, resume=folder.exists(), **more)
