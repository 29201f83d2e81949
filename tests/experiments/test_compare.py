"""The rows of a study: every variant's, a row a seed, and below them what the true mesh itself scores."""

import json
from pathlib import Path

import pytest

from gsjax import config, pipeline, runs
from gsjax.report import tables
from gsjax.settings import Settings

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
STUDIES = sorted(path.stem for path in (EXPERIMENTS / "studies").glob("*.py"))


@pytest.fixture
def compare(scripts):
    return scripts("compare")


@pytest.fixture
def settings_by_run(monkeypatch):
    """What a study trains, of which nothing is run."""
    settings_by_run = {}
    monkeypatch.setattr(
        pipeline, "train", lambda _, folder, settings, **__: settings_by_run.setdefault(folder.name, settings)
    )
    monkeypatch.setattr(pipeline, "mesh", lambda *_, **__: None)
    monkeypatch.setattr(pipeline, "evaluate", lambda _: {"psnr": 30.0})
    monkeypatch.setattr(runs, "read_metrics", lambda _: [])
    return settings_by_run


@pytest.mark.parametrize("with_mesh", [True, False])
def test_the_true_mesh_has_a_row_where_there_is_one(compare, settings_by_run, monkeypatch, tmp_path, with_mesh):
    chamfers = iter([0.004, 0.006, 0.002] * 2)
    floor = {"floor": {"chamfer": 1e-4, "threshold": 0.03}} if with_mesh else {}
    two = {"base": {}, "more": {"model": {"sh_degree": 3}}}
    monkeypatch.setattr(compare, "load_study", lambda *_: compare.Study("base", compare.load_config("base"), two, None))
    figures = {"psnr": 30.0, "views": 2, **floor}
    monkeypatch.setattr(pipeline, "evaluate", lambda _: figures | {"chamfer": next(chamfers)})
    for _ in range(2):  # The second time from what the first has left.
        rows = compare.run("two", "scene", str(tmp_path), seeds=3)
        scores = [[row["chamfer"] for row in each] for each in rows.values()]
        assert scores == [[0.004, 0.002, 0.006], [0.006, 0.004, 0.002]] + [[1e-4]] * with_mesh
        assert (tables.FLOOR in rows) == with_mesh
        assert json.loads((tmp_path / "study.json").read_text()) == rows


@pytest.mark.parametrize(("study", "on"), [(study, None) for study in STUDIES] + [("baselines", "bunny_plane")])
def test_every_study_parses_and_no_two_of_its_variants_are_the_same(compare, settings_by_run, tmp_path, study, on):
    compare.run(study, "scene", str(tmp_path), on=on)
    variants = compare.load_study(study, on).variants
    assert set(settings_by_run) == {f"{variant}_0" for variant in variants}
    assert all(isinstance(settings, Settings) for settings in settings_by_run.values())
    assert len({str(config.to_dict(settings)) for settings in settings_by_run.values()}) == len(variants)
