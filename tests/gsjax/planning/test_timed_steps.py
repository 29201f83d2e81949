"""How long steps take: the first ones of every phase, on a clock of the test's own."""

from dataclasses import replace

import numpy as np
import pytest
from photographed_wall import wall

from gsjax.config import parse
from gsjax.errors import InputError
from gsjax.planning import timed_steps
from gsjax.settings import PRESETS, Density, Phase, Settings
from gsjax.training.growth.adaptive import is_alive
from gsjax.training.plan import plan

FAST = parse(Settings, PRESETS["fast"])


@pytest.fixture
def photos():
    return wall(20, num_points=40)


SETTINGS = Settings(
    phases=(
        Phase("a", 700, image_scale=2, density_control=True),
        Phase("b", 900, density_control=True),
        Phase("c", 800, density_control=True, cull_below=0.5),
        Phase("d", 30),
    ),
    max_gaussians=300,
    density=Density(rule="error", start=0, stop=0),  # as many as there will ever be from the start
)


def test_a_trial_takes_the_median_of_a_few_steps_of_every_kind_of_phase(monkeypatch, photos):
    now, seen = [100.0], []

    def follow(work, state):
        (phase,) = work.plan.phases
        rows = int(is_alive(state.gaussians).sum()), state.gaussians.num_gaussians
        seen.append(((phase.steps, len(work.frames)), rows))
        assert not any(work.plan.density.start < step < work.plan.density.stop for step in range(1, phase.steps + 1))
        assert phase.scale == 1
        pace = 1.0 if phase.rule else 2.0
        for step in range(phase.steps):
            now[0] += 20.0 if step == 0 else 7.0 if step == 5 else pace  # compiles; is held up once
            work.observe(None)

    monkeypatch.setattr(timed_steps.loop, "follow", follow)
    times = timed_steps.time_steps(photos, SETTINGS, most=1e9, clock=lambda: now[0])
    half = timed_steps.image_cost(2)  # of a step at full size: at half the size it is not tried
    assert 0.25 < half < 1 and times.seconds_per_step == (half, 1.0, 1.0, 2.0)
    # a, b and d are programs of their own, b and c one; of the first 2 steps one compiles.
    # One that multiplies once more, for a longer list of pairs.
    assert times.overhead == pytest.approx(3 * (20 - 1.0) + (20 - 2.0))
    assert (times.plain_step, times.plain_program) == (1.0, pytest.approx(20 - 1.0))
    assert seen == [((12, 8), (300, 300))] * 2
    growing = replace(SETTINGS, density=Density(rule="error", start=800, stop=1_000, full_by=1.0))
    slower = timed_steps.time_steps(photos, growing, most=1e9, clock=lambda: now[0]).seconds_per_step
    # 40 points of 300 until step 800, all from step 1,000 on.
    least = 1 - timed_steps.PER_GAUSSIAN * (1 - 40 / 300)
    assert slower[0] == pytest.approx(half * least)
    assert least < slower[1] < 1 and slower[2:] == times.seconds_per_step[2:]


def test_where_all_photos_are_small_no_larger_one_is_tried(monkeypatch, photos):
    now, scales = [0.0], []

    def follow(work, state):
        scales.append(work.plan.phases[0].scale)
        for _ in range(work.plan.phases[0].steps):
            now[0] += 3.0
            work.observe(None)

    monkeypatch.setattr(timed_steps.loop, "follow", follow)
    phases = (Phase("a", 100, image_scale=4), Phase("b", 100, image_scale=2))
    times = timed_steps.time_steps(photos, replace(SETTINGS, phases=phases), most=1e9, clock=lambda: now[0])
    quarter, half = (timed_steps.image_cost(phase.image_scale) for phase in phases)
    assert scales == [2]
    assert times.seconds_per_step == pytest.approx((3.0 * quarter / half, 3.0))
    assert times.plain_step == pytest.approx(3.0 / half)  # as it would be at full size


@pytest.mark.parametrize("points", [1_000, 9_000, 60_000, 80_000])
def test_while_gaussians_multiply_by_the_same_factor_their_mean_is_the_logarithmic_one(points):
    # `fast`: 900 steps of which growth takes 50 to 620, then 200 and 1,000.
    first = min(points / 60_000, 1.0)
    growing = (1 - first) / np.log(1 / first) if first < 1 else 1.0
    expected = (50 * first + 570 * growing + 280) / 900
    assert timed_steps.shares_alive(plan(FAST), points) == pytest.approx([expected, 1.0, 1.0], abs=1e-3)


def test_where_nobody_knows_how_many_there_will_be_half_of_them_grow():
    phases = (Phase("a", 10, density_control=True), Phase("b", 10))
    assert timed_steps.shares_alive(plan(Settings(phases=phases)), 100) == [timed_steps.HALF_GROWN, 1.0]


def test_slow_steps_are_tried_no_longer_than_asked(monkeypatch, photos):
    now, steps = [0.0], [0]

    def follow(work, state):
        for _ in range(work.plan.phases[0].steps):
            now[0] += 30.0
            steps[0] += 1
            work.observe(None)

    monkeypatch.setattr(timed_steps.loop, "follow", follow)
    times = timed_steps.time_steps(
        photos, replace(SETTINGS, phases=SETTINGS.phases[1:2]), most=5.0, clock=lambda: now[0]
    )
    assert steps == [timed_steps.WARM + 2]
    assert times.seconds_per_step == (30.0,)


def test_cameras_at_one_place_and_no_photos_are_one_line(photos):
    held_out = replace(photos, frames=tuple(replace(frame, held_out=True) for frame in photos.frames))
    with pytest.raises(InputError, match="wall: all 20 photos are held out"):
        timed_steps.time_steps(held_out, SETTINGS, most=1.0)
    with pytest.raises(InputError, match="all 1 training cameras are at one place"):
        timed_steps.time_steps(replace(photos, frames=photos.frames[:1]), SETTINGS, most=1.0)
    two = (held_out.frames[0], photos.frames[1])
    with pytest.raises(InputError, match="of its 2 photos one is left to train on.*; --hold-out none trains on all"):
        timed_steps.time_steps(replace(photos, frames=two), SETTINGS, most=1.0)


def test_what_grows_freely_is_tried_at_ten_times_the_cloud(photos):
    settings = replace(SETTINGS, density=Density(rule="adc"), max_gaussians=10_000)
    gaussians = timed_steps._grown(photos, settings)
    assert int(is_alive(gaussians).sum()) == gaussians.num_gaussians == 400
    spread = np.asarray(gaussians.means)
    assert np.isfinite(spread).all() and len(np.unique(spread, axis=0)) == 400
