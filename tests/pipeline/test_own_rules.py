"""A rule of densification that was registered under a name of its own trains, and goes on after a stop."""

from trained_run import SETTINGS, train_until_killed

from gsjax import config, pipeline, runs
from gsjax.settings import Settings
from gsjax.training.densification.rules import DENSIFICATION_RULES


def test_a_registered_rule_trains_and_is_resumed_to_the_same_bits(scene, tmp_path, monkeypatch):
    monkeypatch.setitem(DENSIFICATION_RULES, "mine", DENSIFICATION_RULES["error"])
    settings = config.parse(
        Settings,
        config.merge(
            SETTINGS,
            {
                "schedule": {"phases": [{"name": "coarse", "steps": 12, "image_scale": 2, "density_control": True}]},
                "density": {**SETTINGS["density"], "rule": "mine"},
            },
        ),
    )
    pipeline.train(scene, tmp_path / "whole", settings)
    train_until_killed(9, scene, tmp_path / "stopped", settings)
    assert runs.latest_checkpoint(tmp_path / "stopped")[0] == 7
    pipeline.train(scene, tmp_path / "stopped", settings, resume=True)
    whole, stopped = ((tmp_path / name / "gaussians.ply").read_bytes() for name in ("whole", "stopped"))
    assert stopped == whole
