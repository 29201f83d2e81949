"""Knobs on a clock of the test's own: ratios within a round, the front, what is done is not done again."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gsjax.config import to_dict
from gsjax.errors import InputError
from gsjax.io.images import read_image
from gsjax.settings import Settings, total_steps


@pytest.fixture
def script(scripts):
    return scripts("accuracy_vs_time")


@pytest.fixture
def turned(script, scripts, monkeypatch):
    """A knob of three settings, of errors 0, 1 and 2 in times that halve; every second round is 3 times slower."""
    knobs, seen = scripts("knobs"), []

    def measure(place, value, index):
        seen.append((value, index))
        slow = 3.0 if index % 2 else 1.0
        return knobs.knob.Measured(slow * 8.0 / 2**value, value)

    knob = knobs.Knob({"best": 0, "half": 1, "quarter": 2}, measure, lambda own, best: {"off": float(own - best)})
    monkeypatch.setattr(knobs, "knobs_of", lambda config: {"alpha cut": knob, "a knob": knob})
    return seen


def test_every_round_turns_every_setting_once_and_the_best_twice(script, turned, tmp_path):
    done = script.run("scene", str(tmp_path), ["a knob"], 3, 1.0)["a knob"]
    assert [list(each) for each in done] == [["best", "half", "quarter", script.AGAIN]] * 3
    assert [value for value, index in turned if index == 0] == [0, 1, 2, 0]
    assert [value for value, index in turned if index == 1] == [1, 2, 0, 0]  # the order turns
    for label, ratio, off in (("best", 1, 0), ("half", 0.5, 1), ("quarter", 0.25, 2), (script.AGAIN, 1, 0)):
        np.testing.assert_allclose(script.ratios(done, label), ratio)  # however slow the round was
        np.testing.assert_allclose(script.errors(done, label, "off"), off)
    text = (tmp_path / "accuracy_vs_time.md").read_text()
    assert "| a knob | half | 0.5 [0.5 0.5] | off: 1 [1 1] | yes |" in text
    assert f"| a knob | {script.AGAIN} | 1 [1 1] | off: 0 [0 0] |  |" in text
    picture = read_image(tmp_path / "accuracy_vs_time.png")[0]
    assert min(picture.shape[:2]) > 200 and picture.std() > 5


def test_called_again_it_does_what_is_left(script, turned, tmp_path):
    script.run("scene", str(tmp_path), ["a knob"], 2, 1.0)
    before = len(turned)
    script.run("scene", str(tmp_path), ["a knob"], 2, 1.0)
    assert len(turned) == before
    script.run("scene", str(tmp_path), ["a knob"], 3, 1.0)
    assert [index for _, index in turned[before:]] == [2] * 4


def test_rounds_of_another_length_are_not_mixed_in(script, turned, tmp_path):
    script.run("scene", str(tmp_path), ["a knob"], 1, 1.0)
    before = (tmp_path / "rounds.json").read_bytes()
    with pytest.raises(InputError, match=r"asked.json: its runs are of share 1.0, not 0.5; --out takes another folder"):
        script.run("scene", str(tmp_path), ["a knob"], 2, 0.5)
    assert (tmp_path / "rounds.json").read_bytes() == before and len(turned) == 4


def test_a_mesh_without_truth_is_compared_in_the_photos(script, monkeypatch):
    from knobs import surface

    scored = []

    def evaluate(run, *, mesh):
        scored.append((run, mesh))
        return {"psnr": 30.0, "mesh_psnr": 21.5, "mesh_covers": 0.5, "covered_psnr": 29.0}

    monkeypatch.setattr(surface.pipeline, "evaluate", evaluate)
    assert surface._shown(SimpleNamespace(run="run"), Path("mesh.glb")) == {"psnr": 21.5, "covered": 0.5}
    assert scored == [("run", Path("mesh.glb"))]
    lost = surface._errors({"psnr": 20.0, "covered": 0.4}, {"psnr": 21.5, "covered": 0.5})
    assert lost == {"PSNR lost, dB": pytest.approx(1.5), "covered less, %": pytest.approx(10.0)}
    lost = surface._errors({"psnr": 20.0, "chamfer": 3.0, "fscore": 0.5}, {"psnr": 21.0, "chamfer": 2.0, "fscore": 1.0})
    assert lost == {"Chamfer, % more": pytest.approx(50.0), "F-score lost": pytest.approx(0.5)}


def test_the_front_is_what_nothing_beats(script):
    assert script.on_front([(1.0, 0.0), (0.5, 1.0), (0.6, 1.5), (0.5, 2.0), (0.25, 2.0)]) == [
        True, True, False, False, True
    ]  # fmt: skip
    assert script.on_front([(1.0, 0.0), (1.0, 0.0)]) == [True, True]


def test_an_unknown_knob_is_one_line(script, tmp_path):
    with pytest.raises(InputError, match="no knob 'alpha'; there are alpha cut, "):
        script.run("scene", str(tmp_path), ["alpha"], 1, 1.0)


@pytest.mark.parametrize("config", ["built_in", "bunny_plane", "fox"])
def test_the_settings_of_training_are_settings(script, config):
    from knobs import knob, training
    from train import load_settings

    whole = to_dict(load_settings(config))
    place = knob.Place("scene", "out", whole, 0.1)
    for each in training.knobs_of(whole).values():
        seen = [place.settings(difference, 3) for difference in each.values.values()]
        assert all(isinstance(settings, Settings) and settings.seed == 3 for settings in seen)
        assert len(set(seen)) == len(seen)
        steps = 0.1 * max(phase["steps"] for phase in whole["phases"])
        assert max(phase.steps for settings in seen for phase in settings.phases) <= 2 * steps
        assert min(abs(total_steps(settings) - 0.1 * sum(p["steps"] for p in whole["phases"])) for settings in seen) < 3


def test_r_in_fewer_steps_is_as_much_stronger_and_what_costs_no_time_stays(script):
    from knobs import training
    from train import load_settings

    knob = training.knobs_of(to_dict(load_settings("built_in")))["R"]
    surfaces = {label: difference["phases"][-1] for label, difference in knob.values.items()}
    assert [phase["surface_every"] for phase in surfaces.values()] == [1, 2, 4]
    acting = [phase["weights"]["pixel_normal"] / phase["surface_every"] for phase in surfaces.values()]
    assert acting == pytest.approx([acting[0]] * 3, rel=1e-12)
    assert {phase["weights"]["thickness"] for phase in surfaces.values()} == {0.02}
