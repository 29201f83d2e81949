"""Budgets of time: what is read, what is scaled, what is chosen; on a clock of the test's own."""

import re
from argparse import ArgumentTypeError
from dataclasses import replace
from types import SimpleNamespace

import pytest

from gsjax.cli import parsers
from gsjax.config import parse
from gsjax.effects.evidence import Evidence
from gsjax.errors import InputError
from gsjax.planning import budget, pace, timed_steps
from gsjax.planning.effects import PROPOSED
from gsjax.planning.timed_steps import StepTimes
from gsjax.settings import LENGTHS, PRESETS, Density, Phase, Rates, Settings, total_steps

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
        density=Density(start=200, stop=900, every=100, reset_every=400),
    )
    half = budget.scaled(settings, 0.5)
    assert [phase.steps for phase in half.phases] == [500, 0, 250]
    assert (half.sh_every, half.rates.decay_steps) == (350, 1500)
    density = half.density
    assert (density.start, density.stop, density.every) == (100, 450, 50)
    assert density.reset_every == 200
    assert budget.scaled(settings, 1.0) == settings
    assert budget.scaled(settings, 3.0).density.every == 100
    tiny = budget.scaled(settings, 1e-4)
    assert [phase.steps for phase in tiny.phases] == [1, 0, 1] and tiny.sh_every == 1 and tiny.density.every == 20
    unset = budget.scaled(NAMED["fast"], 0.3)
    assert unset.density.reset_every == 0
    assert unset.rates.decay_steps is None


@pytest.mark.parametrize(("factor", "every"), [(3.0, 100), (1.0, 100), (0.5, 100), (0.25, 100), (0.1, 40), (0.04, 20)])
def test_gaussians_that_move_by_error_have_as_long_to_settle_as_before(factor, every):
    """Moved every 25 steps, those of a quarter of `balanced` end 7 dB lower (experiments/results/presets.md)."""
    settings = Settings(phases=(Phase("a", 8000),), density=Density(rule="error", start=400, stop=3600, every=100))
    assert budget.scaled(settings, factor).density.every == every


def test_another_length_shares_its_time_between_gaussians_and_steps():
    quarter, four = (budget.resized(NAMED["fast"], factor) for factor in (0.25, 4.0))
    assert (quarter.max_gaussians, four.max_gaussians) == (30_000, 120_000)
    steps = total_steps(NAMED["fast"])
    assert total_steps(quarter) == pytest.approx(0.25 * steps / 0.65, abs=2)  # a step with half of them costs 0.65
    assert total_steps(four) == pytest.approx(4 * steps / 1.7, abs=2)
    assert budget.resized(NAMED["fast"], 1.0) == NAMED["fast"]


class Machine:
    """A clock, a data set of 20 photos of 1000x1000, and phases that take what a test says."""

    def __init__(self, monkeypatch, *, evidence=0.0, photos=20, **paces):
        self.now, self.paces, self.tried, self.evidence, self.photos = 0.0, paces, [], evidence, photos
        monkeypatch.setattr(budget, "at_size", self.at_size)
        monkeypatch.setattr(budget, "time_steps", self.try_out)
        monkeypatch.setattr(budget, "diagnose_scene", self.diagnosed)

    def at_size(self, scene, settings, steps):
        frames = (SimpleNamespace(name="photo", width=1000, height=1000),) * self.photos
        photos = SimpleNamespace(train_frames=frames, tracks=None)
        return photos, 2.0 if settings.cpu_pixels else 1.0, ""

    def diagnosed(self, scene):
        self.now += 3.0
        clear = {name: Evidence(False, 0.0, "", 0.0, 1.0, "") for name in PROPOSED}
        return SimpleNamespace(
            effects=clear | {"exposure": Evidence(self.evidence > 1, self.evidence, "", 0.0, 1.0, "")}
        )

    def try_out(self, scene, settings, *, most, clock):
        name = next(name for name, each in NAMED.items() if each.phases == settings.phases)
        self.tried.append((name, most))
        self.now += 4.0
        return StepTimes((self.paces[name],) * len(settings.phases), 6.0, self.paces[name], 2.0)

    def beside_steps(self, name):
        """Seconds for one that was tried: 3 of looking, twice; for a surface two programs and 20 maps of 1.4 steps."""
        maps = 0.0 if name == "quick" else 2 * 2.0 + 20 * 1.4 * self.paces[name]
        return 4.0 * len(self.tried) + 6.0 + 2 * 3.0 + maps

    def budgeted(self, seconds, candidates=NAMED, **how):
        return budget.budgeted("scene", candidates, seconds, clock=lambda: self.now, **how)


def kept_and_cost(settings, whole):
    """Of the Gaussians of the whole run, the share that one has; what a step with so many costs, of one with all."""
    kept = settings.max_gaussians / whole.max_gaussians
    return kept, 1 - timed_steps.PER_GAUSSIAN * (1 - kept)


def test_few_photos_leave_time_for_trials_of_holding_back(monkeypatch):
    paces = {"quick": 0.05, "fast": 0.1, "balanced": 0.3, "accurate": 0.8}
    few, many, vanilla = (
        Machine(monkeypatch, photos=photos, **paces).budgeted(500, {"quick": settings}).settings
        for photos, settings in (
            (15, NAMED["quick"]),
            (16, NAMED["quick"]),
            (15, replace(NAMED["quick"], vanilla=True)),
        )
    )
    trials = 2 * 2.0 + 2 * 4 * 200 * 0.05 * pace.image_cost(6)  # two programs; steps on photos of 1000 / 6 pixels
    spent = [budget._length(StepTimes((0.05,), 6.0, 0.05, 2.0), each) for each in (few, many)]
    costs = [kept_and_cost(each, NAMED["quick"])[1] for each in (few, many)]
    assert costs[1] * spent[1] - costs[0] * spent[0] == pytest.approx(trials, abs=0.5)
    assert total_steps(vanilla) == total_steps(many)


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [
        (75, "quick"),
        (85, "quick"),
        (95, "fast"),
        (1830, "fast"),
        (1850, "balanced"),
        (5040, "balanced"),
        (5060, "accurate"),
        (1e7, "accurate"),
    ],
)
def test_the_preset_is_the_longest_of_which_two_fifths_fit(monkeypatch, seconds, expected):
    # quick takes 45 s; by relative costs fast is guessed at 181, balanced at 4,598 and accurate at 12,620 s.
    machine = Machine(monkeypatch, quick=0.05, fast=0.1, balanced=0.3, accurate=0.8)
    choice = machine.budgeted(seconds)
    assert [name for name, _ in machine.tried] == list(dict.fromkeys(["quick", expected]))
    assert all(most == 0.1 * seconds for _, most in machine.tried)
    whole = NAMED[expected]
    kept, cost = kept_and_cost(choice.settings, whole)
    steps = cost * total_steps(choice.settings)
    first = budget.image_cost(2) if expected == "quick" else 1.0
    took = machine.paces[expected] * (steps + first * min(150, steps / 2))  # Gaussians are wide at first
    left = 0.9 * seconds - budget.SCORING - machine.beside_steps(expected)
    if seconds == 1e7:
        assert choice.settings == replace(whole, downscale=1.0)  # never longer than it is
    else:
        assert took == pytest.approx(left, rel=0.01)
    assert kept == pytest.approx((steps / total_steps(whole)) ** 0.5, rel=0.01)
    assert choice.line.startswith(f"{expected}, ") and "\n" not in choice.line
    assert f"{choice.settings.max_gaussians:,} Gaussians" in choice.line
    assert f"{1e3 * cost * machine.paces[expected]:.0f} ms" in choice.line


def test_a_preset_that_is_named_is_only_resized(monkeypatch):
    machine = Machine(monkeypatch, fast=0.1)
    settings = machine.budgeted(10_000, {"fast": NAMED["fast"]}).settings
    left = 9000 - budget.SCORING - machine.beside_steps("fast")
    kept, cost = kept_and_cost(settings, NAMED["fast"])
    assert cost * total_steps(settings) == pytest.approx(left / 0.1 - 150, rel=0.01)
    assert kept == pytest.approx(((left / 0.1 - 150) / total_steps(NAMED["fast"])) ** 0.5, rel=0.01)


def test_a_run_whose_gaussians_stay_as_many_is_scaled_in_its_steps_alone(monkeypatch):
    machine = Machine(monkeypatch, fast=0.1)
    settings = machine.budgeted(10_000, {"fast": NAMED["fast"]}, lasting=budget.scaled).settings
    left = 9000 - budget.SCORING - machine.beside_steps("fast")
    factor = (left / 0.1 - 150) / total_steps(NAMED["fast"])
    assert settings == budget.scaled(replace(NAMED["fast"], downscale=2.0), factor)


@pytest.mark.parametrize(("seconds", "evidence", "tries"), [(1000, 1.2, True), (1000, 0.8, False), (65, 1.2, False)])
def test_time_for_the_validation_of_an_effect_is_kept_where_there_will_be_one(monkeypatch, seconds, evidence, tries):
    """Evidence above its threshold needs one, but in a run under 600 steps."""
    machine = Machine(monkeypatch, evidence=evidence, fast=0.1)
    settings = machine.budgeted(seconds, {"fast": NAMED["fast"]}).settings
    steps = kept_and_cost(settings, NAMED["fast"])[1] * total_steps(settings)
    left = 0.9 * seconds - budget.SCORING - machine.beside_steps("fast")
    if tries:  # Two programs, and a twentieth of the run's time.
        left = (left - 2 * 2.0) / 1.05
    assert steps == pytest.approx(max(left / 0.1 - 150, left / 0.15), abs=2)


def test_maps_of_own_depth_take_time_where_a_phase_asks_for_them_and_none_are_given(monkeypatch):
    machine, fast = Machine(monkeypatch, fast=0.1), replace(NAMED["fast"], effects="none")
    own, given, plain = (
        total_steps(machine.budgeted(500, {"fast": replace(fast, **change)}, lasting=budget.scaled).settings)
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
    least = 30 if vanilla else 37  # maps of the run's own depth take the rest
    with pytest.raises(InputError, match=f"data set here, where even 50 steps take {least} s") as caught:
        machine.budgeted(seconds, {"fast": replace(NAMED["fast"], vanilla=vanilla)})
    assert "\n" not in str(caught.value)
    assert ("--vanilla" in str(caught.value)) == (not vanilla)


def test_the_least_budget_that_a_refusal_names_is_taken(monkeypatch):
    machine = Machine(monkeypatch, quick=0.5)
    only = {"quick": replace(NAMED["quick"], effects="none")}
    with pytest.raises(InputError) as caught:
        machine.budgeted(20, only)
    least = float(re.search(r"take (\d+) s", str(caught.value))[1])
    with pytest.raises(InputError):
        machine.budgeted(least - 1.5, only)
    assert total_steps(machine.budgeted(least + 1.5, only).settings) == pytest.approx(50, abs=5)


def test_what_multiplies_freely_keeps_its_limit(monkeypatch):
    machine = Machine(monkeypatch, fast=0.1)
    free = replace(NAMED["fast"], density=replace(NAMED["fast"].density, rule="adc"))
    settings = machine.budgeted(100, {"fast": free}).settings
    left = 90 - budget.SCORING - machine.beside_steps("fast")
    assert settings.max_gaussians == free.max_gaussians
    assert 0.1 * (total_steps(settings) + 150) == pytest.approx(left, rel=0.01)


def test_phases_without_steps_cannot_be_scaled(monkeypatch):
    with pytest.raises(InputError, match="the phases of fast have no steps to scale"):
        Machine(monkeypatch).budgeted(100, {"fast": replace(NAMED["fast"], phases=(Phase("a", 0),))})
