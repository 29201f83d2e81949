"""How much of their weights the terms of the surface keep: which terms, and from when on."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from small_scenes import camera_at, cloud, photographed

from gsjax.settings import Phase, Rates, Settings, Weights
from gsjax.training import loop
from gsjax.training.loop import Work, follow
from gsjax.training.optimizers import make_optimizer
from gsjax.training.plan import plan
from gsjax.training.state import initial_state

WEIGHTS = Weights(dssim=0.0, alpha=0.0, entropy=0.1, pixel_normal=0.4, multi_view=0.2, photometric=0.6, distortion=0.3)
PHASES = Phase("plain", 1, Weights(dssim=0.0, alpha=0.0, distortion=0.3)), Phase("surface", 1, WEIGHTS)
OPTIMIZER = make_optimizer(Rates(), 1.0, 2)


def weights_of(terms):
    return {each.name: round(each.weight, 6) for each in terms}


def test_terms_of_normals_and_of_neighbouring_photos_are_scaled_and_no_others():
    surface = plan(Settings(phases=PHASES)).phases[1]
    whole = weights_of(surface.terms)
    assert whole == {
        "l1": 0.8, "entropy": 0.1, "pixel_normal": 0.4, "multi_view": 0.2, "photometric": 0.6, "distortion": 0.3
    }  # fmt: skip
    quarter = surface.with_surface_share(0.25)
    assert weights_of(quarter.terms) == whole | {"pixel_normal": 0.1, "multi_view": 0.05, "photometric": 0.15}
    assert replace(quarter, terms=surface.terms) == surface
    assert surface.with_surface_share(1.0) == surface


@pytest.mark.parametrize("begun", [0, 1])
def test_a_phase_with_normals_asks_once_they_are_there_and_a_resumed_one_again(monkeypatch, begun):
    told = []

    def make_train_step(optimizer, terms, **_):
        told.append(weights_of(terms))
        return lambda state, target, key: (
            replace(state, step=state.step + 1),
            SimpleNamespace(overflowed=False, needed=1),
        )

    def prior(state):
        told.append("normals")
        return [np.tile(np.int8([0, 0, -127]), (24, 32, 1))] * 2

    def share():
        told.append("share")
        return 0.5

    monkeypatch.setattr(loop, "kept_step", make_train_step)
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0)) for x in (-1.0, 1.0)]
    work = Work(
        plan(Settings(phases=PHASES)),
        photographed(cloud(20, seed=5), cameras),
        1.0,
        OPTIMIZER,
        prior,
        observe=lambda progress: None,
        surface_share=share,
    )
    state = replace(initial_state(cloud(10, seed=1), OPTIMIZER), step=np.int32(begun))
    follow(work, state, capacity=64)
    halved = {
        "l1": 0.8, "entropy": 0.1, "pixel_normal": 0.2, "multi_view": 0.1, "photometric": 0.3, "distortion": 0.3
    }  # fmt: skip
    assert told == [{"l1": 0.8, "distortion": 0.3}, "normals", "share", halved][begun:]
