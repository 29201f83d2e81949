"""Budgets of time: what is read, what is scaled, what is chosen; on a clock of the test's own."""

from argparse import ArgumentTypeError
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from photographed_wall import wall

from gsjax.cli import parsers
from gsjax.config import parse
from gsjax.effects.evidence import Cost, Evidence
from gsjax.errors import InputError
from gsjax.pipeline import budget
from gsjax.pipeline.budget import Trial
from gsjax.settings import LENGTHS, PRESETS, SIMULATED, Density, Phase, Rates, Settings, total_steps
from gsjax.training.density_control import is_alive

NAMED = {name: parse(Settings, PRESETS[name]) for name in LENGTHS}


@pytest.mark.parametrize(
    ("text", "seconds"), [("90s", 90), ("10m", 600), ("1h", 3600), ("1.5h", 5400), (".5m", 30), (" 2m ", 120)]
)
def test_a_time_is_a_number_and_its_unit(text, seconds):
    assert parsers.seconds(text) == seconds


@pytest.mark.parametrize(
    "text", ["10", "m", "", "-3m", "0s", "ten minutes", "10 m", "1e9h", "10d", "nan", "9" * 400 + "h"]
)
def test_anything_else_is_one_line(text):
    with pytest.raises(InputError, match="not a time, such as 90s, 10m or 1.5h") as caught:
        parsers.seconds(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["0", "-1", "1.5", "", "two"])
def test_a_count_is_one_at_least(text):
    assert parsers.count("12") == 12
    with pytest.raises(ArgumentTypeError, match=f"^{text}: not a whole number of at least 1$"):
        parsers.count(text)


def test_all_that_is_due_at_a_step_is_scaled_with_the_phases():
    settings = Settings(
        phases=(Phase("a", 1000), Phase("b", 0), Phase("c", 501)),
        sh_every=700,
        rates=Rates(decay_steps=3000),
        density=Density(start=200, stop=900, every=100, prune_large_after=300, reset_every=400),
    )
    half = budget.scaled(settings, 0.5)
    assert [phase.steps for phase in half.phases] == [500, 0, 250]
    assert (half.sh_every, half.rates.decay_steps) == (350, 1500)
    density = half.density
    assert (density.start, density.stop, density.every) == (100, 450, 50)
    assert (density.prune_large_after, density.reset_every) == (150, 200)
    assert budget.scaled(settings, 1.0) == settings
    assert budget.scaled(settings, 3.0).density.every == 100
    tiny = budget.scaled(settings, 1e-4)
    assert [phase.steps for phase in tiny.phases] == [1, 0, 1] and tiny.sh_every == 1 and tiny.density.every == 20
    unset = budget.scaled(NAMED["fast"], 0.3)
    assert unset.density.reset_every == 0 and unset.density.prune_large_after is None
    assert unset.rates.decay_steps is None


class Machine:
    """A clock, a data set of 20 photos of 1000x1000, and phases that take what a test says."""

    def __init__(self, monkeypatch, *, evidence=0.0, **paces):
        self.now, self.paces, self.tried, self.evidence = 0.0, paces, [], evidence
        monkeypatch.setattr(budget, "at_size", self.at_size)
        monkeypatch.setattr(budget, "tried", self.try_out)
        monkeypatch.setattr(budget, "diagnosed", self.diagnosed)

    def at_size(self, scene, settings):
        photos = SimpleNamespace(train_frames=(None,) * 20)
        return photos, replace(settings, downscale=2.0 if settings.cpu_pixels else 1.0), ""

    def diagnosed(self, scene):
        self.now += 3.0
        clear = {name: Evidence(False, 0.0, "", 0.0, 1.0, Cost(), "") for name in SIMULATED}
        return SimpleNamespace(effects=clear | {"exposure": Evidence(True, self.evidence, "", 0.0, 1.0, Cost(), "")})

    def try_out(self, scene, settings, *, most, clock):
        name = next(name for name, each in NAMED.items() if each.phases == settings.phases)
        self.tried.append((name, most))
        self.now += 4.0
        return Trial((self.paces[name],) * len(settings.phases), 6.0, self.paces[name], 2.0)

    def beside_steps(self, name):
        """Seconds for one that was tried: 3 of looking, twice; for a surface two programs and 20 maps of 1.4 steps."""
        maps = 0.0 if name == "quick" else 2 * 2.0 + 20 * 1.4 * self.paces[name]
        return 4.0 * len(self.tried) + 6.0 + 2 * 3.0 + maps

    def budgeted(self, seconds, candidates=NAMED):
        return budget.budgeted("scene", candidates, seconds, clock=lambda: self.now)


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        (90, "quick"),
        (195, "quick"),
        (205, "fast"),
        (2400, "fast"),
        (2420, "balanced"),
        (7700, "balanced"),
        (7750, "accurate"),
        (1e7, "accurate"),
    ],
)
def test_the_preset_is_the_longest_of_which_two_fifths_fit(monkeypatch, seconds, expected):
    # quick takes 30 s; by relative costs fast is guessed at 501, balanced at 6,030 and accurate at 19,300 s.
    machine = Machine(monkeypatch, quick=0.05, fast=0.1, balanced=0.3, accurate=0.8)
    choice = machine.budgeted(seconds)
    assert [name for name, _ in machine.tried] == list(dict.fromkeys(["quick", expected]))
    assert all(most == 0.1 * seconds for _, most in machine.tried)
    steps = total_steps(choice.settings)
    first = budget.relative_cost(Phase("", 1, image_scale=2)) if expected == "quick" else 1.0
    took = machine.paces[expected] * (steps + first * min(150, steps / 2))  # Gaussians are wide at first
    left = 0.9 * seconds - budget.SCORING - machine.beside_steps(expected)
    if seconds == 1e7:
        assert choice.settings == replace(NAMED["accurate"], downscale=1.0)  # never longer than it is
    else:
        assert took == pytest.approx(left, rel=0.01)
    assert choice.line.startswith(f"{expected}, ")
    assert f"{1e3 * machine.paces[expected]:.0f} ms" in choice.line and "\n" not in choice.line


def test_a_preset_that_is_named_is_only_scaled(monkeypatch):
    machine = Machine(monkeypatch, fast=0.1)
    choice = machine.budgeted(10_000, {"fast": NAMED["fast"]})
    left = 9000 - budget.SCORING - machine.beside_steps("fast")
    assert total_steps(choice.settings) == pytest.approx(left / 0.1 - 150, rel=0.01)
    assert choice.settings.max_gaussians == NAMED["fast"].max_gaussians


@pytest.mark.parametrize(("seconds", "evidence", "tries"), [(1000, 1.2, True), (1000, 1.6, False), (100, 1.2, False)])
def test_time_for_the_trial_of_an_effect_is_kept_where_there_will_be_one(monkeypatch, seconds, evidence, tries):
    """Evidence near its threshold asks for one, but in a run too short for trials."""
    machine = Machine(monkeypatch, evidence=evidence, fast=0.1)
    steps = total_steps(machine.budgeted(seconds, {"fast": NAMED["fast"]}).settings)
    left = 0.9 * seconds - budget.SCORING - machine.beside_steps("fast")
    # Two programs, and three times 60 steps and 16 scores at half the size.
    trial = 2 * 2.0 + 3 * (60 + 16) * 0.1 * (budget.FIXED_COST + (1 - budget.FIXED_COST) / 4)
    assert steps == pytest.approx((left - tries * trial) / 0.1 - 150, abs=2)


def test_maps_of_own_depth_take_time_where_a_phase_asks_for_them_and_none_are_given(monkeypatch):
    machine = Machine(monkeypatch, fast=0.1)
    own, given, plain = (
        total_steps(machine.budgeted(500, {"fast": replace(NAMED["fast"], effects="none", **change)}).settings)
        for change in ({}, {"normals": "maps"}, {"vanilla": True})
    )
    # The machine's clock has gone on by a trial of 4 s each time, which each budget counts for itself.
    assert given == plain == pytest.approx(own + (2 * 2.0 + 20 * 1.4 * 0.1) / 0.1, abs=3)


def test_what_has_no_surface_phase_is_not_told_to_leave_it_out(monkeypatch):
    with pytest.raises(InputError, match=r"where even 50 steps take \d+ s with all that goes before$"):
        Machine(monkeypatch, quick=0.05).budgeted(10, {"quick": NAMED["quick"]})


@pytest.mark.parametrize("vanilla", [False, True])
@pytest.mark.parametrize("seconds", [3, 10, 14])
def test_too_short_a_budget_is_one_line_that_names_the_least_and_what_needs_less(monkeypatch, seconds, vanilla):
    machine = Machine(monkeypatch, fast=0.1)
    least = 35 if vanilla else 43  # maps of the run's own depth take the rest
    with pytest.raises(InputError, match=f"data set here, where even 50 steps take {least} s") as caught:
        machine.budgeted(seconds, {"fast": replace(NAMED["fast"], vanilla=vanilla)})
    assert "\n" not in str(caught.value)
    assert ("--vanilla" in str(caught.value)) == (not vanilla)


def test_phases_without_steps_cannot_be_scaled(monkeypatch):
    with pytest.raises(InputError, match="the phases of fast have no steps to scale"):
        Machine(monkeypatch).budgeted(100, {"fast": replace(NAMED["fast"], phases=(Phase("a", 0),))})


# --- the trial


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

    def fit(settings, frames, size, state, optimizer, *, prior, observe):
        (phase,) = settings.phases
        rows = int(is_alive(state.gaussians).sum()), state.gaussians.num_gaussians
        seen.append(((phase.steps, len(frames)), rows))
        assert not any(settings.density.start < step < settings.density.stop for step in range(1, phase.steps + 1))
        assert phase.image_scale == 1
        pace = 1.0 if phase.density_control else 2.0
        for step in range(phase.steps):
            now[0] += 20.0 if step == 0 else 7.0 if step == 5 else pace  # compiles; is held up once
            observe(None)

    monkeypatch.setattr(budget.loop, "fit", fit)
    trial = budget.tried(photos, SETTINGS, most=1e9, clock=lambda: now[0])
    half = budget.relative_cost(SETTINGS.phases[0])  # of a step at full size: at half the size it is not tried
    assert 0.25 < half < 1 and trial.seconds_per_step == (half, 1.0, 1.0, 2.0)
    # a, b and d are programs of their own, b and c one; of the first 2 steps one compiles.
    # One that multiplies once more, for a longer list of pairs.
    assert trial.overhead == pytest.approx(3 * (20 - 1.0) + (20 - 2.0))
    assert (trial.plain_step, trial.plain_program) == (1.0, pytest.approx(20 - 1.0))
    assert seen == [((10, 8), (300, 300))] * 2
    growing = replace(SETTINGS, density=Density(rule="error", start=800, stop=1_000, full_by=1.0))
    slower = budget.tried(photos, growing, most=1e9, clock=lambda: now[0]).seconds_per_step
    # 40 points of 300 until step 800, all from step 1,000 on.
    least = 1 - budget.PER_GAUSSIAN * (1 - 40 / 300)
    assert slower[0] == pytest.approx(half * least)
    assert least < slower[1] < 1 and slower[2:] == trial.seconds_per_step[2:]


def test_where_all_photos_are_small_no_larger_one_is_tried(monkeypatch, photos):
    now, scales = [0.0], []

    def fit(settings, frames, size, state, optimizer, *, prior, observe):
        scales.append(settings.phases[0].image_scale)
        for _ in range(settings.phases[0].steps):
            now[0] += 3.0
            observe(None)

    monkeypatch.setattr(budget.loop, "fit", fit)
    phases = (Phase("a", 100, image_scale=4), Phase("b", 100, image_scale=2))
    trial = budget.tried(photos, replace(SETTINGS, phases=phases), most=1e9, clock=lambda: now[0])
    quarter, half = (budget.relative_cost(phase) for phase in phases)
    assert scales == [2]
    assert trial.seconds_per_step == pytest.approx((3.0 * quarter / half, 3.0))
    assert trial.plain_step == pytest.approx(3.0 / half)  # as it would be at full size


@pytest.mark.parametrize("points", [1_000, 9_000, 36_000, 50_000])
def test_while_gaussians_multiply_by_the_same_factor_their_mean_is_the_logarithmic_one(points):
    # `fast`: 600 steps of which growth takes 50 to 560, then 1,400 and 600.
    first = min(points / 36_000, 1.0)
    growing = (1 - first) / np.log(1 / first) if first < 1 else 1.0
    expected = (50 * first + 510 * growing + 40) / 600
    assert budget.shares_alive(NAMED["fast"], points) == pytest.approx([expected, 1.0, 1.0], abs=1e-3)


def test_where_nobody_knows_how_many_there_will_be_half_of_them_grow():
    phases = (Phase("a", 10, density_control=True), Phase("b", 10))
    assert budget.shares_alive(Settings(phases=phases), 100) == [budget.HALF_GROWN, 1.0]


def test_slow_steps_are_tried_no_longer_than_asked(monkeypatch, photos):
    now, steps = [0.0], [0]

    def fit(settings, frames, size, state, optimizer, *, prior, observe):
        for _ in range(settings.phases[0].steps):
            now[0] += 30.0
            steps[0] += 1
            observe(None)

    monkeypatch.setattr(budget.loop, "fit", fit)
    trial = budget.tried(photos, replace(SETTINGS, phases=SETTINGS.phases[1:2]), most=5.0, clock=lambda: now[0])
    assert steps == [4]  # two that may compile, two that are timed
    assert trial.seconds_per_step == (30.0,)


def test_cameras_at_one_place_and_no_photos_are_one_line(photos):
    held_out = replace(photos, frames=tuple(replace(frame, held_out=True) for frame in photos.frames))
    with pytest.raises(InputError, match="wall: all 20 photos are held out"):
        budget.tried(held_out, SETTINGS, most=1.0)
    with pytest.raises(InputError, match="all 1 training cameras are at one place"):
        budget.tried(replace(photos, frames=photos.frames[:1]), SETTINGS, most=1.0)


def test_what_grows_freely_is_tried_at_ten_times_the_cloud(photos):
    settings = replace(SETTINGS, density=Density(rule="adc"), max_gaussians=10_000)
    gaussians = budget._grown(photos, settings)
    assert int(is_alive(gaussians).sum()) == gaussians.num_gaussians == 400
    spread = np.asarray(gaussians.means)
    assert np.isfinite(spread).all() and len(np.unique(spread, axis=0)) == 400
