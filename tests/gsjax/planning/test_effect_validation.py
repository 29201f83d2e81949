"""Validation of effects: what is held out, how variants are compared, and which effects pass."""

import numpy as np
import pytest
from photographed_wall import gains as drawn_gains
from photographed_wall import radii2, relit, turned, wall
from small_scenes import built_in

from gsjax.config import parse
from gsjax.effects.diagnosis import diagnose
from gsjax.effects.kinds import EffectKind, Evidence
from gsjax.effects.observations import observe
from gsjax.effects.simulation import Effect, light_in_photo
from gsjax.io.scenes import load_scene
from gsjax.planning.effect_runs import held_out_blocks, without_blocks
from gsjax.planning.effect_validation import EffectValidation, select, steps_of_each
from gsjax.planning.effects import choose_effects
from gsjax.planning.pace import relative_cost
from gsjax.planning.sizes import training_extent
from gsjax.planning.start import first_state
from gsjax.planning.validation import ValidationGain, compared
from gsjax.presets import PRESETS
from gsjax.scene import Pixels, frame_of
from gsjax.settings import EFFECTS, Model, Phase, Schedule, Settings
from gsjax.training.densification.rules import rule_named
from gsjax.training.plan import plan

SETTINGS = Settings(
    model=Model(background="white", max_gaussians=2000, sh_degree=1),
    schedule=Schedule(phases=(Phase("vanilla", 3000),)),
)


def photo(index=0, size=(40, 30)):
    return frame_of(f"{index:02d}", np.eye(4), np.eye(3), Pixels(np.zeros((size[1], size[0], 3), np.uint8)))


def validation(scene, settings=SETTINGS):
    return EffectValidation(
        settings,
        plan(settings),
        scene.train_frames,
        training_extent(scene),
        lambda short, optimizer, effects: first_state(
            scene, short.model, rule_named(short.density.rule), optimizer, effects
        ),
    )


@pytest.mark.long
@pytest.mark.parametrize("effect", ["exposure", "poses", None])
def test_what_photos_differ_in_passes(tmp_path, effect):
    clean = load_scene(built_in(tmp_path / "scene", num_views=24, size=(96, 96)))
    stops = drawn_gains(clean, 0.3)
    photos = {
        "exposure": lambda: relit(clean, lambda index, *_: stops[index]),
        "poses": lambda: turned(clean, 0.3 / np.sqrt(3), seed=0),
        None: lambda: clean,
    }[effect]()
    settings = SETTINGS.replace(schedule={"phases": (Phase("vanilla", 800),)})
    choice = choose_effects("auto", plan(settings), photos, validation(photos, settings))
    assert choice.names == ((effect,) if effect else ())


@pytest.mark.parametrize("name", ["quick", "fast", "balanced", "accurate"])
@pytest.mark.parametrize(("side", "count"), [(160, 1), (640, 6), (1600, 2)])
def test_validation_takes_a_twentieth_of_the_run_or_100_steps_each(name, side, count):
    """By its pixels alone, 0.65 of a step's cost: what the Gaussians take comes on top, and is accounted for."""
    planned = plan(parse(Settings, PRESETS[name]))
    frames = [photo(index, (side, side)) for index in range(30)]
    steps = steps_of_each(planned, frames, count)
    assert steps is not None and 100 <= steps <= 300
    if steps == 100:
        return
    scale = max(round(side / 96), *(phase.scale for phase in planned.phases))
    whole = sum(phase.steps * relative_cost(phase) for phase in planned.phases)
    assert (count + 1) * steps * 0.65 / scale**2 < 0.05 * whole


def test_a_run_under_600_steps_is_not_validated():
    frames = [photo(index, (1600, 1200)) for index in range(30)]
    for whole, is_validated in ((599, False), (600, True)):
        planned = plan(SETTINGS.replace(schedule={"phases": (Phase("vanilla", whole),)}))
        assert (steps_of_each(planned, frames, 1) is not None) == is_validated


def test_every_pixel_is_held_out_in_one_of_four_consecutive_photos():
    blocks = np.stack([held_out_blocks(photo(), index) for index in range(4)])
    np.testing.assert_array_equal(blocks.sum(0), 1)
    rows, columns = np.nonzero(np.diff(blocks[0].astype(int), axis=1))
    assert set((columns + 1) % 10) == {0}, "blocks are a quarter of the longer side"


def test_effects_start_from_what_is_not_held_out():
    scene = wall(6)
    observations = observe(scene)
    frames = scene.frames[:4]
    blocks = [held_out_blocks(frame, index) for index, frame in enumerate(frames)]
    left = without_blocks(observations, frames, blocks)
    assert 0 < len(left.photo) < len(observations.photo) and set(left.photo) == {0, 1, 2, 3}
    column, row = np.floor(left.pixels).astype(int).T
    assert not any(blocks[index][y, x] for index, x, y in zip(left.photo, column, row, strict=True))
    assert [frame.held_out for frame in left.frames] == [False] * 4 + [True] * 2


def test_effects_are_selected_one_after_the_other():
    worth = {"exposure": 0.3, "vignetting": -0.2, "background": 0.5, "transients": 0.05}
    requests = []

    def predict(names):
        requests.append(tuple(names))
        return [np.float64(sum(worth[name] for name in names))]

    def compare(without, with_effect):
        return ValidationGain(float(with_effect[0] - without[0]), 0.01)

    verdicts = select(tuple(worth), predict, compare)
    useful = "exposure", "background"
    assert requests == [(), ("exposure",), ("exposure", "vignetting"), useful, (*useful, "transients")]
    assert {name: each.passes for name, each in verdicts.items()} == {name: name in useful for name in worth}


def test_both_variants_are_scored_on_the_same_pixels():
    """Errors of 0.02 against 0.04 are 6.02 dB; what neither predicts counts for neither, what one lost counts."""
    rng = np.random.default_rng(0)
    photos = [rng.uniform(0.3, 0.6, (20, 20, 3)) for _ in range(4)]
    whole = [np.ones((20, 20), bool)] * 4
    blocks = [np.arange(20)[:, None].repeat(20, 1) < 5] * 4
    better, worse = (
        [p + np.where(blocks[0], size, 0)[..., None] * rng.choice([-1, 1], (20, 20, 1)) for p in photos]
        for size in (0.02, 0.04)
    )

    def gain(without, with_it, targets=photos):
        return compared(without, with_it, targets, whole, blocks).gain

    expected, corner = 20 * np.log10(2), np.pad(np.ones((2, 4)), ((0, 18), (0, 16)))[..., None]
    assert gain(worse, better) == pytest.approx(expected, abs=1e-6)
    assert gain([0.5 * p for p in worse], [1.7 * p for p in better]) == pytest.approx(expected, abs=1e-3)
    assert gain(worse, better, [np.maximum(p, corner) for p in photos]) == pytest.approx(expected, abs=0.1)
    assert gain(worse, [p + 0.4 * corner for p in better]) < -5
    assert compared(worse, better, photos, [~each for each in whole], blocks) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("darker", "gain", "simulated"), [(0.2, 0.09, False), (0.2, 0.11, True), (0.4, 0.01, True), (0.4, -0.01, False)]
)
def test_evidence_proposes_and_validation_decides(darker, gain, simulated, capsys):
    """Evidence over three times its threshold, 0.3 EV in a corner, needs any gain, less of it 0.1 dB."""
    true = drawn_gains(wall(), 0.3)
    photos = relit(wall(), lambda index, frame, x, y: true[index] - darker * radii2(frame, x, y))
    calls = []

    def validate(observations, proposed):
        calls.append(list(proposed))
        return {"exposure": ValidationGain(0.5, 0.02), "vignetting": ValidationGain(gain, 0.02)}

    choice = choose_effects("auto", plan(SETTINGS), photos, validate)
    assert calls == [["exposure", "vignetting"]]
    assert set(choice.names) == {"exposure", "vignetting"} if simulated else {"exposure"}
    light, falloff = "exposure (+0.50 +-0.02 dB)", f"vignetting ({gain:+.2f} +-0.02 dB)"
    assert f"effects: {light}{', ' if simulated else '; not simulated: '}{falloff}\n" in capsys.readouterr().err
    record = choice.evidence
    assert record["validated"]["vignetting"] == {"gain": gain, "error": 0.02}
    assert record["evidence"]["vignetting"]["on"], "the evidence stays what it is"
    # What was decided once is not validated again.
    again = choose_effects("auto", plan(SETTINGS), photos, validate, before=record)
    assert again.names == choice.names and len(calls) == 1
    assert all(again.evidence[key] == record[key] for key in ("simulated", "validated"))


EFFECT = EffectKind(
    lambda findings: Evidence(len(findings.steps) == 12, 1.0, "", 0.0, 0.5, "dusk"),
    lambda inputs, rate: Effect(np.float32(0.5), rate(), light=lambda numbers, colors, batch: numbers * colors),
)


def test_one_line_registers_an_effect_that_is_diagnosed_proposed_and_simulated(monkeypatch):
    monkeypatch.setitem(EFFECTS, "dusk", __name__)
    assert diagnose(wall()).effects["dusk"].note == "dusk"
    choice = choose_effects("auto", plan(SETTINGS), wall(), lambda *_: {"dusk": ValidationGain(0.5, 0.1)})
    assert choice.names == choose_effects("dusk", plan(SETTINGS), wall()).names == ("dusk",)
    assert light_in_photo(choice.effects, {"dusk": choice.effects["dusk"].initial}, 0.8, None) == pytest.approx(0.4)


def test_without_validation_evidence_must_be_stronger_and_corners_are_left_alone(capsys):
    gains, dark = drawn_gains(wall(), 0.3), relit(wall(), lambda index, frame, x, y: -radii2(frame, x, y))
    weak, strong = (relit(wall(), lambda index, *_, size=size: size * gains[index]) for size in (0.37, 1.0))
    for scene, names, refused in ((weak, (), "exposure"), (strong, ("exposure",), None), (dark, (), "vignetting")):
        assert choose_effects("auto", plan(SETTINGS), scene).names == names
        assert refused is None or f"not simulated: {refused}" in capsys.readouterr().err
    assert choose_effects("vignetting", plan(SETTINGS), dark, lambda *_: {}).names == ("vignetting",)
