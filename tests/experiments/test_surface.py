"""The study of three ways to a mesh: its stages are measured alone, its tables tell mean and spread."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"


@pytest.fixture
def surface(monkeypatch):
    monkeypatch.syspath_prepend(str(EXPERIMENTS))
    yield importlib.import_module("surface")
    for name in ("surface", "train"):
        sys.modules.pop(name, None)


def test_a_stage_runs_in_a_process_of_its_own_and_is_measured(surface):
    # 200 MiB of ones, summed: what comes back is right, and so is the order of what it took.
    total, cost = surface._alone(np.sum, np.ones(25 * 2**20, np.int64))
    assert total == 25 * 2**20
    assert 0.2 < cost["peak_gib"] < 2
    assert 0 < cost["seconds"] < 60


def test_a_stage_that_fails_fails_the_study(surface):
    with pytest.raises(ZeroDivisionError):
        surface._alone(divmod, 1, 0)


def test_figures_are_shown_with_least_and_most(surface):
    rows = [{"fscore": 0.5, "psnr": 30.0}, {"fscore": 0.7, "psnr": 33.0}, {"fscore": 0.6, "psnr": 30.0}]
    assert surface.summary(rows) == {"fscore": "0.6 [0.5 0.7]", "psnr": "31 [30 33]"}
