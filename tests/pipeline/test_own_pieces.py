"""A rule of densification and an effect that a run is handed: trained with, recorded, and needed again to resume."""

import jax.numpy as jnp
import numpy as np
import optax
import pytest
from trained_run import SETTINGS, train_until_killed

import gsjax
from gsjax import config, pipeline, runs
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.runs.checkpoints import load_arrays
from gsjax.settings import Settings

PHASE = {"name": "coarse", "steps": 12, "image_scale": 2, "density_control": True}
ENDED = config.parse(Settings, config.merge(SETTINGS, {"schedule": {"phases": [PHASE]}}))


def fixed_number(gaussians, statistics, density, *, step, budget):
    return jnp.int32(850)


def dimmed(number, colors, photo):
    return colors * jnp.exp(-number)


PIECES = {
    "densification": gsjax.DENSIFICATION_RULES["error"]._replace(wanted_count=fixed_number),
    "effects": {"dimmer": gsjax.Effect(np.float32(0), optax.constant_schedule(1e-2), light=dimmed)},
}


def test_pieces_that_are_handed_in_train_and_are_needed_again_to_resume_to_the_same_bits(scene, tmp_path):
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    assert pipeline.train(scene, whole, ENDED, **PIECES)["gaussians"] == 850
    manifest = json_files.read(whole / "manifest.json")
    assert manifest["handed_in"] == {"terms": [], "effects": ["dimmer"], "densification": True}
    assert json_files.read(whole / "plan.json")["effects"] == ["dimmer"]
    stored = load_arrays(runs.latest_checkpoint(whole)[1])
    (learned,) = (value for name, value in stored.items() if name.endswith(".numbers['dimmer']"))
    assert abs(learned) > 0.01

    train_until_killed(9, scene, stopped, ENDED, **PIECES)
    with pytest.raises(InputError, match=r"was started with effects=\{dimmer\}, densification=, not with no terms="):
        pipeline.train(scene, stopped, ENDED, resume=True)
    pipeline.train(scene, stopped, ENDED, resume=True, **PIECES)
    assert (stopped / "gaussians.ply").read_bytes() == (whole / "gaussians.ply").read_bytes()
    with pytest.raises(InputError, match="'poses' is an effect of the library; give yours another name"):
        pipeline.train(scene, tmp_path / "other", ENDED, effects={"poses": PIECES["effects"]["dimmer"]})
