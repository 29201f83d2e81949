"""The rows of a study: every variant's, a row a seed, and below them what the true mesh itself scores."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from gsjax import config, pipeline, runs, tables
from gsjax.errors import InputError
from gsjax.settings import Phase, Rates, Settings, Weights
from gsjax.training.plan import plan

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
SDF, SUGAR, FIXED = Weights(sdf_normal=0.2), Weights(sugar_density=0.2), Rates(decay_steps=60)
STUDIES = sorted(path.stem for path in (EXPERIMENTS / "studies").glob("*.py"))


@pytest.fixture
def compare(scripts):
    return scripts("compare")


@pytest.fixture
def beginning(scripts):
    return scripts("common_phases").beginning


@pytest.mark.parametrize("with_mesh", [True, False])
def test_the_true_mesh_has_a_row_where_there_is_one(compare, monkeypatch, tmp_path, with_mesh):
    chamfers = iter([0.004, 0.006, 0.002] * 2)
    floor = {"floor": {"chamfer": 1e-4, "threshold": 0.03}} if with_mesh else {}
    monkeypatch.setattr(pipeline, "train", lambda *_, **__: None)
    monkeypatch.setattr(compare, "_common", lambda *_: None)
    figures = {"psnr": 30.0, "views": 2, **floor}
    monkeypatch.setattr(pipeline, "evaluate", lambda _, **__: figures | {"chamfer": next(chamfers)})
    monkeypatch.setattr(runs, "read_metrics", lambda _: [])
    for _ in range(2):  # The second time from what the first has left.
        rows = compare.run("growth", "scene", str(tmp_path), seeds=3)
        found = [[row["chamfer"] for row in each] for each in rows.values()]
        assert found == [[0.004, 0.002, 0.006], [0.006, 0.004, 0.002]] + [[1e-4]] * with_mesh
        assert (tables.FLOOR in rows) == with_mesh
        assert json.loads((tmp_path / "study.json").read_text()) == rows


@pytest.mark.parametrize(
    ("study", "on"),
    [(study, None) for study in STUDIES]
    + [("baselines", "bunny_plane"), ("wrong_normals", "bunny_plane"), ("growth", "photos_short"),
       ("supervision", "photos_short"), ("price_of_r", "bunny_plane")],
)  # fmt: skip
def test_every_study_parses_and_no_two_of_its_variants_are_the_same(compare, monkeypatch, tmp_path, study, on):
    seen = {}
    monkeypatch.setattr(pipeline, "train", lambda _, folder, settings, **__: seen.setdefault(folder.name, settings))
    monkeypatch.setattr(compare, "_common", lambda *_: None)
    monkeypatch.setattr(pipeline, "evaluate", lambda _, **__: {"psnr": 30.0})
    monkeypatch.setattr(runs, "read_metrics", lambda _: [])
    compare.run(study, "scene", str(tmp_path), on=on)
    variants = compare.load_study(study, on).variants
    assert set(seen) == {f"{variant}_0" for variant in variants}
    assert all(isinstance(settings, Settings) for settings in seen.values())
    assert len({str(config.to_dict(settings)) for settings in seen.values()}) == len(variants)


def test_whenever_r_acts_the_phase_takes_the_time_of_plain_training(compare):
    variants = compare.load_study("when_r").variants
    cost = 1.48  # of a step with R, in plain ones
    for name, change in variants.items():
        _, *phases = change["phases"]
        times = [p["steps"] * (1 + (cost - 1) / p["surface_every"] if p["weights"] else 1) for p in phases]
        assert sum(times) == pytest.approx(2.40 * 850, abs=2), name
    halves = [phase["steps"] for phase in variants["0.2, every 4th, last half"]["phases"]]
    assert halves == [1000, 1020, round(1020 / (1 + (cost - 1) / 4))]


@pytest.mark.parametrize(
    ("on", "mix", "time"), [("built_in", 2.40, 850), ("bunny_plane", 2.55, 800), ("fox", 2.40, 1000)]
)
def test_every_baseline_takes_the_time_of_the_mix(compare, on, mix, time):
    """By the costs that are measured on a config, or else on the built-in scene."""
    sugar = {"built_in": 4.47, "bunny_plane": 5.09}.get(on, 4.47)
    variants = compare.load_study("baselines", on).variants
    surface = {name: change["phases"][-1] for name, change in variants.items()}
    assert surface["ours, mix"]["steps"] == time
    assert surface["vanilla"]["steps"] == round(mix * time)
    assert surface["SuGaR, sdf"]["steps"] == round(mix * time / sugar)
    assert {change["depth_mode"] for change in variants.values()} == {"front"}


def test_the_price_of_r_is_told_at_equal_time(compare):
    """In plain steps: a step with the terms costs 1.30 at half size, `depth_normal` 0.15 in one of the coarse phase."""
    studied = compare.load_study("price_on_photos")
    costs = {"plain": 1.0, "and R at the means": 2.03, "full size": 3.07}
    for name, change in studied.variants.items():
        assert change["normals"] is None, "the run's own"
        (coarse, vanilla, surface), cost = change["phases"], costs.get(name, 1.30)
        lying = 0.15 * 900 * (coarse["weights"]["depth_normal"] > 0)
        time = lying + vanilla["steps"] + surface["steps"] * (1 + (cost - 1) / surface["surface_every"])
        assert (coarse["name"], time) == ("coarse", pytest.approx(200 + 1000 * (1 + 0.3 / 4), abs=1)), name
        assert change.get("vanilla", False) == (name == "plain")


@pytest.mark.parametrize("study", ["price_on_photos", "price_of_r", "baselines", "when_r"])
def test_where_time_is_equal_rates_fall_over_each_variants_own_steps(compare, study):
    """Who shared another's decay would take its last steps at the lowest rates."""
    from terms import TERMS

    studied = compare.load_study(study)
    for name, change in studied.variants.items():
        settings = config.parse(Settings, config.merge(studied.config, change))
        planned = plan(settings, TERMS)
        assert planned.rates.decay_steps == planned.steps, name


def test_the_price_of_r_with_true_normals_is_told_in_the_time_of_plain_training(compare):
    _, *phases = compare.load_study("price_of_r").variants["0.25, early, the time of plain"]["phases"]
    assert 500 + sum(phase["steps"] * (1 + 0.61 / 4) for phase in phases) == pytest.approx(1850, abs=2)


def test_a_folder_of_another_study_or_config_is_not_mixed_in(compare, monkeypatch, tmp_path):
    monkeypatch.setattr(pipeline, "train", lambda *_, **__: None)
    monkeypatch.setattr(compare, "_common", lambda *_: None)
    monkeypatch.setattr(pipeline, "evaluate", lambda _, **__: {"psnr": 30.0})
    monkeypatch.setattr(runs, "read_metrics", lambda _: [])
    compare.run("growth", "scene", str(tmp_path))
    with pytest.raises(InputError, match=r"asked.json: its runs are of on bunny_plane, not photos_short; --out takes"):
        compare.run("growth", "scene", str(tmp_path), on="photos_short")


def test_unknown_names_are_answered_with_the_nearest(compare):
    with pytest.raises(InputError, match="no study 'baseline'; the nearest is 'baselines'"):
        compare.load_study("baseline")
    with pytest.raises(InputError, match="no config 'bunny'; the nearest is 'bunny_plane'"):
        compare.load_study("baselines", "bunny")


@pytest.mark.parametrize("name", ["nonsense_0", "0.2_1"])
def test_a_run_that_the_study_does_not_have_is_one_line(compare, tmp_path, name):
    with pytest.raises(InputError, match=rf"^--only {name}: no run of lambda_r, whose runs are none_0, .*0\.2_0, .*"):
        compare.run("lambda_r", "scene", str(tmp_path / "out"), only=name)
    assert not (tmp_path / "out").exists()


def tables_of(settings):
    from terms import TERMS

    return {table for phase in plan(settings, TERMS).phases for table in phase.tables}


def phases(*named):
    described = {"coarse": Phase("coarse", 10), "more": Phase("more", 20), "sdf": Phase("sdf", 30, SDF)}
    return tuple(described[name] for name in named)


COARSE = Settings(phases=phases("coarse", "more", "sdf"), normals="omnidata")
SHORT = replace(COARSE, phases=phases("coarse", "sdf"))
SUGARED, OTHERWISE = (
    replace(COARSE, phases=(*phases("coarse", "more"), Phase("sugar", 30, weights)))
    for weights in (SUGAR, Weights(sugar_sdf=0.2))
)


@pytest.mark.parametrize(
    ("settings", "others", "shared"),
    [
        (COARSE, [SHORT], None),  # Another length: rates fall otherwise.
        (COARSE, [replace(COARSE, normals=None)], ("coarse", "more")),
        (COARSE, [replace(COARSE, phases=phases("more", "coarse", "sdf"))], None),
        (COARSE, [replace(COARSE, seed=1)], None),
        (COARSE, [replace(COARSE, vanilla=True)], ("coarse", "more")),
        (replace(COARSE, vanilla=True), [COARSE], ("coarse", "more")),
        (replace(COARSE, rates=FIXED), [replace(SHORT, rates=FIXED)], ("coarse",)),
        (COARSE, [SUGARED], None),
        (SUGARED, [OTHERWISE], ("coarse", "more", "nothing")),  # with the table that both read
        (COARSE, [], None),
    ],
)
def test_what_runs_begin_with_is_shared_as_far_as_they_are_the_same(beginning, settings, others, shared):
    begun = beginning(settings, others)
    assert (None if begun is None else tuple(phase.name for phase in begun.phases)) == shared
    if begun is not None:
        assert (begun.normals, begun.vanilla, begun.rates.decay_steps) == (None, False, 60)
        # What decides whether a state holds the table of neighbours: both must, or the run could not begin there.
        assert tables_of(begun) == tables_of(settings)
