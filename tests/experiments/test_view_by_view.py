"""Runs compared view by view: means that hang on one view stand beside medians that do not."""

from types import SimpleNamespace

import pytest

from gsjax.errors import InputError

VIEWS = "a.jpg", "b.jpg", "c.jpg", "d.jpg"
PSNR = {"plain": (30.0, 28.0, 32.0, 24.0), "other": (29.9, 27.8, 31.9, 28.0), "exposed": (20.0, 20.0, 20.0, 20.0)}


@pytest.fixture
def script(scripts, monkeypatch):
    """The module, with runs of the figures above; one undid exposures, in whose light it has 9 dB more."""
    frames = {run: tuple(SimpleNamespace(name=name) for name in VIEWS) for run in PSNR}
    frames |= {"fewer": frames["plain"][:2], "none": ()}
    known = {**PSNR, "fewer": PSNR["plain"][:2], "none": ()}

    def score(run, only, background, found):
        assert (background, found) == ("white", f"near of {run}")
        score = {"psnr": known[run][VIEWS.index(only[0].name)]}
        return score | ({"psnr_near_gains": score["psnr"] + 9} if run == "exposed" else {})

    def folder(run):
        photography = SimpleNamespace(with_near=lambda photos: f"near of {run}")
        return SimpleNamespace(settings={"background": "white"}, photography=photography)

    monkeypatch.setattr("gsjax.runs.result.open_result", lambda run: SimpleNamespace(gaussians=run))
    monkeypatch.setattr(
        "gsjax.runs.result.scene_of_run",
        lambda run: SimpleNamespace(frames=frames[str(run)], held_out_frames=frames[str(run)]),
    )
    monkeypatch.setattr("gsjax.runs.run.Run.open", folder)
    monkeypatch.setattr("gsjax.scoring.images.score_images", score)
    return scripts("view_by_view")


def test_a_mean_that_hangs_on_one_view_is_told_by_its_error_and_the_median(script, capsys):
    script.main("plain", ["other"])
    lines = [line.split("  ") for line in capsys.readouterr().out.splitlines()]
    table = {line[0]: [cell.strip() for cell in line[1:] if cell] for line in lines}
    assert table["d.jpg"] == ["24", "4"]
    assert table["a.jpg"] == ["30", "-0.1"]
    assert table["mean"] == ["28.5", "0.9"]
    assert table["error of the mean"] == ["-", "1.034"]  # of -0.1, -0.2, -0.1 and 4, by hand
    assert table["median"] == ["29", "-0.1"]


def test_photos_whose_exposure_was_undone_are_compared_in_the_light_of_near_ones(script):
    assert script.psnr_by_view("exposed") == dict.fromkeys(VIEWS, 29.0)


@pytest.mark.parametrize(("others", "fault"), [("fewer", "does not hold out the same photos"), ("none", "no photo")])
def test_runs_that_cannot_be_compared_are_refused(script, others, fault):
    with pytest.raises(InputError, match=f"{others}: .*{fault}"):
        script.main("plain", [others])
