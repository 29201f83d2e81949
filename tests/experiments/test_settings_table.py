"""The table of settings: every value of the training is a setting, and errors have the sign of a loss."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from gsjax.config import to_dict
from gsjax.errors import InputError
from gsjax.settings import Settings


@pytest.fixture
def table(scripts):
    return scripts("settings_table")


@pytest.fixture
def whole(scripts):
    return to_dict(scripts("train").load_settings("built_in"))


def test_every_value_of_the_training_is_another_setting(table, whole):
    place = table.Place("scene", "out", whole, 0.1)
    for name, differences in table.of_training(whole).items():
        settings = [place.settings(difference, 3) for difference in differences.values()]
        assert all(isinstance(each, Settings) and each.seed == 3 for each in settings)
        assert len(set(settings)) == len(settings), name
        steps = 0.1 * sum(phase["steps"] for phase in whole["schedule"]["phases"])
        assert min(abs(each.schedule.steps - steps) for each in settings) < 3, name


def test_r_in_fewer_steps_is_as_much_stronger_and_what_costs_no_time_stays(table, whole):
    surfaces = [difference["schedule"]["phases"][-1] for difference in table.of_training(whole)["R"].values()]
    assert [phase["surface_every"] for phase in surfaces] == [1, 2, 4]
    assert [phase["weights"]["pixel_normal"] for phase in surfaces] == pytest.approx([0.0625, 0.125, 0.25])
    assert {phase["weights"]["thickness"] for phase in surfaces} == {0.02}


def test_errors_are_what_is_lost_against_the_most_accurate_value(table):
    best, own = {"psnr": 21.5, "covered": 0.5, "chamfer": 2.0}, {"psnr": 20.0, "covered": 0.4, "chamfer": 3.0}
    lost = {"PSNR lost, dB": 1.5, "covered less, %": 10.0, "Chamfer, % more": 50.0}
    assert table.errors(own, best) == pytest.approx(lost)
    assert table.errors({"normals": 9.0}, {"normals": 7.0}) == {"normals, degrees more": 2.0}


def test_every_round_measures_every_value_once_and_the_best_twice(scripts, table, monkeypatch, tmp_path):
    script, measured = scripts("accuracy_vs_time"), []

    def measure(place, value, index):
        """Seconds that halve, errors of 0, 1 and 2 dB; every second round is three times slower."""
        measured.append((value, index))
        return (3.0 if index % 2 else 1.0) * 8.0 / 2**value, {"psnr": 30.0 - value}

    varied = table.Varied({"best": 0, "half": 1, "quarter": 2}, measure)
    monkeypatch.setattr(table, "table", lambda config: {"one": varied})
    done = script.run("scene", str(tmp_path), [], 3, 1.0)["one"]
    assert [list(each) for each in done] == [["best", "half", "quarter", script.AGAIN]] * 3
    assert [value for value, index in measured if index == 1] == [1, 2, 0, 0], "the order turns"
    for label, ratio, lost in (("best", 1, 0), ("half", 0.5, 1), ("quarter", 0.25, 2), (script.AGAIN, 1, 0)):
        assert script.ratios(done, label) == pytest.approx(ratio)
        assert script.errors(done, label, "PSNR lost, dB") == pytest.approx(lost)
    assert (
        "| one | half | 0.5 [0.5 0.5] | PSNR lost, dB: 1 [1 1] | yes |"
        in (tmp_path / "accuracy_vs_time.md").read_text()
    )
    script.run("scene", str(tmp_path), [], 3, 1.0)
    assert len(measured) == 12 and (tmp_path / "accuracy_vs_time.png").stat().st_size > 1000
    with pytest.raises(InputError, match="no setting 'alpha'; there are one"):
        script.run("scene", str(tmp_path), ["alpha"], 1, 1.0)
    with pytest.raises(InputError, match="asked.json: its runs are of share 1.0, not 0.5"):
        script.run("scene", str(tmp_path), [], 3, 0.5)


def test_a_mesh_without_truth_is_scored_in_the_photos(table, monkeypatch):
    figures = {"psnr": 30.0, "mesh_psnr": 21.5, "mesh_covers": 0.5, "covered_psnr": 29.0}
    monkeypatch.setattr(table, "pipeline", SimpleNamespace(evaluate=lambda run, mesh: figures))
    assert table.in_photos("run", Path("mesh.glb")) == {"psnr": 21.5, "covered": 0.5}
