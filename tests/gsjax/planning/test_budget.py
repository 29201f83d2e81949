"""Budgets of time: what is read, what is scaled, what is chosen; on a clock of the test's own."""

import re

import numpy as np
import pytest
from photographed_wall import wall

from gsjax.cli import parsers
from gsjax.config import parse
from gsjax.errors import InputError
from gsjax.gaussians import is_alive
from gsjax.planning import budget
from gsjax.presets import LENGTHS, PRESETS
from gsjax.settings import Density, Model, Phase, Rates, Schedule, Settings

NAMED = {name: parse(Settings, PRESETS[name]) for name in LENGTHS}


def test_a_time_is_a_number_and_its_unit_and_anything_else_is_one_line():
    times = {"90s": 90, "10m": 600, "1.5h": 5400, ".5m": 30, " 2m ": 120}
    assert {text: parsers.seconds(text) for text in times} == times
    for text in ("10", "m", "", "-3m", "0s", "ten minutes", "10 m", "1e9h", "10d", "nan", "9" * 400 + "h"):
        with pytest.raises(InputError, match=r"^[^\n]*not a time, such as 90s, 10m or 1.5h[^\n]*$"):
            parsers.seconds(text)


def test_all_that_is_due_at_a_step_is_scaled_with_the_phases():
    settings = Settings(
        schedule=Schedule(phases=(Phase("a", 1000), Phase("b", 0), Phase("c", 501)), sh_every=700),
        rates=Rates(decay_steps=3000),
        density=Density(start=200, stop=900, every=100, reset_every=400),
    )
    half = budget.scaled(settings, 0.5)
    assert [phase.steps for phase in half.schedule.phases] == [500, 0, 250]
    assert (half.schedule.sh_every, half.rates.decay_steps) == (350, 1500)
    density = half.density
    assert (density.start, density.stop, density.every, density.reset_every) == (100, 450, 50, 200)
    assert budget.scaled(settings, 1.0) == settings
    assert budget.scaled(settings, 3.0).density.every == 100
    tiny = budget.scaled(settings, 1e-4)
    assert [phase.steps for phase in tiny.schedule.phases] == [1, 0, 1]
    assert (tiny.schedule.sh_every, tiny.density.every) == (1, 20)
    unset = budget.scaled(NAMED["fast"], 0.3)
    assert unset.density.reset_every == 0 and unset.rates.decay_steps is None


@pytest.mark.parametrize(("factor", "every"), [(3.0, 100), (1.0, 100), (0.5, 100), (0.25, 100), (0.1, 40), (0.04, 20)])
def test_gaussians_that_move_by_error_have_as_many_steps_as_before(factor, every):
    """Moved every 25 steps, Gaussians of a quarter of `balanced` ended 7 dB lower on *fox* (seed 0)."""
    settings = Settings(
        schedule=Schedule(phases=(Phase("a", 8000),)), density=Density(rule="error", start=400, stop=3600, every=100)
    )
    assert budget.scaled(settings, factor).density.every == every


class Machine:
    """A clock, a data set, and runs whose steps take what a test says; measuring one takes 4 s, compiling 6 s."""

    def __init__(self, monkeypatch, **paces):
        self.now, self.paces, self.measured = 0.0, paces, []
        monkeypatch.setattr(budget.time, "perf_counter", lambda: self.now)
        monkeypatch.setattr(budget, "at_size", lambda scene, photos, steps: (scene, 1 + bool(photos.cpu_pixels), ""))
        monkeypatch.setattr(budget, "measure", self.measure)

    def measure(self, scene, planned, model):
        name = next(name for name, each in NAMED.items() if each.schedule.steps == planned.steps)
        self.measured.append(name)
        self.now += 4.0
        return self.paces[name] * planned.steps, 6.0

    def spent(self, seconds, settings, name):
        """Seconds of the whole run, what is reserved for photos and scores included."""
        gaussians = settings.model.max_gaussians / NAMED[name].model.max_gaussians
        steps = settings.schedule.steps * self.paces[name] * (0.3 + 0.7 * gaussians)
        return 0.2 * seconds + 4.0 * len(self.measured) + 6.0 + steps


PACES = {"quick": 0.05, "fast": 0.1, "balanced": 0.3, "accurate": 0.8}


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [(60, "quick"), (90, "quick"), (100, "fast"), (485, "fast"), (510, "balanced"), (3520, "accurate")],
)
def test_the_preset_is_the_longest_of_which_two_fifths_fit_and_ends_within_the_budget(monkeypatch, seconds, expected):
    # quick takes 45 s; by relative costs fast is estimated at 239 s.
    machine = Machine(monkeypatch, **PACES)
    settings, line = budget.budgeted("scene", NAMED, seconds)
    assert machine.measured == list(dict.fromkeys(["quick", expected]))
    assert machine.spent(seconds, settings, expected) == pytest.approx(seconds, rel=0.01)
    assert line.startswith(f"{expected} in {settings.schedule.steps:,} steps")


@pytest.mark.parametrize("seconds", [60, 10_000])
def test_a_run_whose_gaussians_stay_as_many_is_scaled_in_its_steps_alone(monkeypatch, seconds):
    machine = Machine(monkeypatch, fast=0.1)
    settings, _ = budget.budgeted("scene", {"fast": NAMED["fast"]}, seconds, budget.scaled)
    assert settings.model.max_gaussians == NAMED["fast"].model.max_gaussians
    assert machine.spent(seconds, settings, "fast") == pytest.approx(seconds, rel=0.01)


def test_the_least_budget_that_a_refusal_names_is_taken(monkeypatch):
    only = {"quick": NAMED["quick"]}
    Machine(monkeypatch, quick=0.5)
    with pytest.raises(InputError, match=r"^a budget of 20 s is too short: even 50 steps take \d+ s") as caught:
        budget.budgeted("scene", only, 20)
    least = float(re.search(r"take (\d+) s", str(caught.value))[1])
    assert least == np.ceil((4.0 + 6.0 + 50 * 0.5) / 0.8)
    assert budget.budgeted("scene", only, least)[0].schedule.steps >= 50


PHASES = (
    Phase("a", 700, image_scale=2, density_control=True),
    Phase("b", 900, density_control=True, cull_below=0.5),
    Phase("c", 30),
)
SETTINGS = Settings(
    schedule=Schedule(phases=PHASES),
    model=Model(max_gaussians=300, sh_degree=0),
    density=Density(rule="error", start=0, stop=1000),
)


def test_the_first_twenty_steps_of_each_phase_are_timed_and_the_compiling_ones_left_out(monkeypatch):
    """Steps take 1, 2 and 3 s; 20 s more where a phase compiles, and 7 s more where a buffer grows."""
    now, work, states = [100.0], [], []
    monkeypatch.setattr(budget.time, "perf_counter", lambda: now[0])

    def follow(one, state):
        work.append(one)
        states.append(state)
        for number, phase in enumerate(one.plan.phases, 1):
            for step in range(phase.steps):
                now[0] += number + 20.0 * (step == 0) + 7.0 * (step == 8)
                one.observe(None)

    monkeypatch.setattr(budget.loop, "follow", follow)
    whole, compiling = budget.measure(wall(20, num_points=40), budget.plan(SETTINGS), SETTINGS.model)
    assert whole == pytest.approx(700 * 1 + 900 * 2 + 30 * 3) and compiling == pytest.approx(3 * 27)
    (fold,), (state,) = work, states
    phases = [(phase.begin, phase.end, phase.cull_below) for phase in fold.plan.phases]
    assert phases == [(0, 20, 0), (20, 40, 0), (40, 60, 0)]
    assert fold.plan.density.start > 60 and 0 < len(fold.frames) <= 8
    assert int(is_alive(state.gaussians).sum()) == state.gaussians.num_gaussians == 300
