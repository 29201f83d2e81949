"""The study of three ways to a mesh: its stages are measured alone, its tables tell mean and spread."""

import numpy as np
import pytest


@pytest.fixture
def surface(scripts):
    return scripts("surface_stages")


def test_a_stage_runs_in_a_process_of_its_own_and_is_measured(surface):
    # 200 MiB of ones, summed: what comes back is right, and so is the order of what it took.
    total, cost = surface._alone(np.sum, np.ones(25 * 2**20, np.int64))
    assert total == 25 * 2**20
    assert 0.2 < cost["peak_gib"] < 2
    assert 0 < cost["seconds"] < 60
    assert 0 < cost["cpu_seconds"] < 60


def test_a_stage_that_fails_fails_the_study(surface):
    with pytest.raises(ZeroDivisionError):
        surface._alone(divmod, 1, 0)


def test_a_study_that_was_stopped_goes_on_after_the_stages_that_are_done(surface, tmp_path, monkeypatch):
    told = []

    def alone(stage, *arguments):
        told.append(stage.__name__)
        if len(told) == 12:
            raise KeyboardInterrupt
        scored = ({"psnr": float(len(told))}, {"chamfer": 1e-4})
        return (scored if stage.__name__ == "_score" else None), {"seconds": 1.0, "peak_gib": 0.5}

    monkeypatch.setattr(surface, "_alone", alone)
    with pytest.raises(KeyboardInterrupt):
        surface.run("demo", "scene", str(tmp_path), seeds=2)
    report = surface.run("demo", "scene", str(tmp_path), seeds=2)
    assert told[11] == told[12], "the stage that was cut is done again, and no other"
    assert len(told) == 2 * 9 + 1 + 1
    assert [row["psnr"] for row in report["figures"]["vanilla"]] == [7.0, 17.0]
    assert len(report["stages"]["refine"]) == 2
