from dataclasses import replace

import numpy as np
import pytest

from gsjax.planning import pace
from gsjax.planning.pace import Pace, seconds_left
from gsjax.planning.sizes import chosen_downscale
from gsjax.scene import Frame
from gsjax.settings import Phase, Photos, Schedule, Settings, Weights
from gsjax.training.plan import plan
from gsjax.training.terms import weigh_terms

EYE = np.eye(4, dtype=np.float32)


def photo(width, height):
    return Frame("a.jpg", EYE, EYE[:3, :3], width, height, pixels=lambda: pytest.fail("sizes need no pixels"))


@pytest.mark.parametrize(
    ("sizes", "settings", "on_cpu", "expected"),
    [
        ([(1600, 1200), (900, 1600)], {}, True, 1.0),
        ([(800, 600), (3000, 4000)], {}, True, 2.5),  # the largest decides
        ([(4000, 3000)], {"downscale": 4.5}, False, 4.5),
        ([(4000, 3000)], {"longest_side": 1000}, False, 4.0),
        ([(2000, 1000)], {"cpu_pixels": 125_000}, True, 4.0),
        ([(2000, 1000)], {"cpu_pixels": 125_000}, False, 1.25),
        ([(300, 200)], {"cpu_pixels": 125_000}, True, 1.0),  # never larger than they are
    ],
)
def test_the_size_is_the_users_or_what_the_largest_photo_and_the_machine_bear(sizes, settings, on_cpu, expected):
    frames = [photo(*size) for size in sizes]
    assert chosen_downscale(Photos(**settings), frames, on_cpu=on_cpu) == expected


PHASES = (Phase("coarse", 100, image_scale=2), Phase("vanilla", 200), Phase("surface", 50, Weights(sdf_normal=0.1)))


def test_what_is_left_scales_with_the_pixels_and_the_terms_of_each_phase():
    planned = plan(Settings(schedule=Schedule(phases=PHASES)))
    coarse, vanilla, surface = planned.phases
    assert seconds_left(planned, 100, vanilla, 0.5) == pytest.approx(0.5 * (200 + 2 * 50))
    assert seconds_left(planned, 250, vanilla, 0.5) == pytest.approx(0.5 * (50 + 2 * 50))
    assert seconds_left(planned, 300, surface, 1.0) == pytest.approx(50)
    rarely = replace(planned, phases=(coarse, vanilla, replace(surface, surface_every=4)))
    assert seconds_left(rarely, 250, vanilla, 0.5) == pytest.approx(0.5 * (50 + 1.25 * 50))
    smaller = replace(planned, phases=(coarse, vanilla, replace(surface, surface_every=4, surface_scale=2)))
    of_dear = 2 * (pace.FIXED_COST + (1 - pace.FIXED_COST) / 4)
    assert seconds_left(smaller, 250, vanilla, 0.5) == pytest.approx(0.5 * (50 + (0.75 + 0.25 * of_dear) * 50))
    lying = replace(planned, phases=(coarse, vanilla, replace(surface, terms=weigh_terms({"depth_normal": 0.1}))))
    assert seconds_left(lying, 250, vanilla, 0.5) == pytest.approx(0.5 * (50 + 1.6 * 50))
    quarter = pace.FIXED_COST + (1 - pace.FIXED_COST) / 4
    assert seconds_left(planned, 20, coarse, quarter) == pytest.approx(80 * quarter + 200 + 2 * 50)


def test_a_phase_is_timed_once_after_its_first_steps(monkeypatch):
    clock = iter(np.arange(0, 1000, 0.25))
    monkeypatch.setattr(pace.time, "perf_counter", lambda: float(next(clock)))
    timer = Pace()
    phases = plan(Settings(schedule=Schedule(phases=PHASES))).phases
    times = [timer.seconds_per_step(phase) for phase in phases for _ in range(30)]
    steps = [i for i, seconds in enumerate(times) if seconds is not None]
    assert steps == [pace.UNTIMED + pace.TIMED - 1 + 30 * phase for phase in range(3)]
    assert {times[i] for i in steps} == {0.25 / pace.TIMED}
