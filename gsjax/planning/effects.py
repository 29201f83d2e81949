"""Which effects a run simulates, and what it tells of each photo and its camera afterwards."""

import sys
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from tqdm import tqdm

from gsjax.effects import background, blur, sky
from gsjax.effects.appearance import (
    Appearance,
    Start,
    appearances,
    light_range,
    moves,
    simulations,
    start,
)
from gsjax.effects.diagnosis import Diagnosis
from gsjax.effects.diagnosis import diagnose as look
from gsjax.effects.evidence import Evidence
from gsjax.effects.observations import observe
from gsjax.effects.simulation import Effects, EffectState, learning_rate
from gsjax.errors import InputError
from gsjax.planning.effect_trials import WORTH, EffectTrial, is_near, is_worthwhile
from gsjax.runs.photography import Photography
from gsjax.scene import Scene
from gsjax.settings import AUTO, NONE, SIMULATED, named_effects
from gsjax.training.plan import Plan

_PLAIN = {"black": 0.0, "white": 1.0}  # what `Settings.background` lays under the renders


def diagnose_scene(scene: Scene) -> Diagnosis:
    """The diagnosis of a loaded data set, a bar meanwhile."""
    return look(scene, progress=lambda frames: tqdm(list(frames), desc="diagnose", unit="photo", leave=False))


class Looked(NamedTuple):
    """A data set without the photos that are too blurred to be trained on."""

    scene: Scene
    found: Diagnosis | None = None  # of its photos; None: nobody looked
    left_out: tuple[str, ...] = ()  # names


def look_for_effects(asked: str, scene: Scene) -> Looked:
    """The data set as the run trains on it, and what its photos show if the run asks; one line says what was left out.

    Raises:
        InputError: A photo or the tracks cannot be read.
    """
    if asked == NONE:
        return Looked(scene)
    found = diagnose_scene(scene)
    is_asked = asked == AUTO or "blur" in named_effects(asked)
    names = blur.photos_to_leave_out(found.seen) if is_asked else ()
    if not names:
        return Looked(scene, found)
    print(f"train: too blurred, left out: {', '.join(names)}", file=sys.stderr)
    sharp = replace(scene, frames=tuple(frame for frame in scene.frames if frame.name not in names))
    again = diagnose_scene(sharp)
    return Looked(sharp, replace(again, effects=again.effects | {"blur": found.effects["blur"]}), names)


@dataclass(frozen=True)
class ChosenEffects:
    """The effects of a run."""

    effects: Effects = field(default_factory=dict)
    begun: Start | None = None  # None: of no effects
    evidence: dict[str, Any] | None = None  # for the manifest; None: nobody looked
    skies: sky.Masks = field(default_factory=dict)  # where photos show sky, if the run knows of one
    tries_degrees: bool = False  # whether the run cuts its harmonics to those that photos do not miss

    @property
    def names(self) -> tuple[str, ...]:
        """What the plan is told of, see `gsjax.training.plan.Plan.with_effects`."""
        return (*self.effects, *(("sky",) if self.skies else ()))

    def photography(self, state: EffectState | None) -> Photography:
        """What the state says of the photos."""
        if state is None or self.begun is None:
            return Photography()
        behind = state.numbers.get("background")
        return Photography(
            appearances(self.begun, state),
            moves(self.begun, state),
            None if behind is None else np.asarray(behind),
        )


def choose_effects(
    asked: str,
    plan: Plan,
    scene: Scene,
    trial: EffectTrial | None = None,
    looked: Looked | None = None,
    *,
    sh_degree: int = 3,
    skies: sky.Masks | None = None,
    with_sky: bool = False,
) -> ChosenEffects:
    """The effects that are named or, of "auto", that the photos show; one line says which.

    Args:
        asked: As `Settings.effects`.
        plan: The run, without effects.
        scene: Its data set, at the size that is trained on.
        trial: Decides, of "auto", where evidence is near its threshold. None, or a short run: the threshold does.
        looked: What `look_for_effects` found, if it was asked.
        sh_degree: Of the run's Gaussians.
        skies: Where photos show sky, if masks of it were given; with it a background is taken in.
        with_sky: Whether a sky is looked for whatever else is asked for, and must be found.

    Raises:
        InputError: A photo or the tracks cannot be read, or a background is asked for behind mattes.
    """
    if asked == NONE and skies is None and not with_sky:
        return ChosenEffects()
    looked = looked or look_for_effects(asked, scene)
    scene, found = looked.scene, looked.found or diagnose_scene(looked.scene)
    if skies is not None:
        found = _with_given(found, skies)
    wanted = set(named_effects(asked))
    is_auto = asked == AUTO
    near = [name for name in SIMULATED if is_auto and is_near(name, found.effects[name])]
    is_on = [name for name in SIMULATED if found.effects[name].on] if is_auto else [*wanted]
    if _is_laid(found, plan, {*is_on, *near}):
        found = replace(found, effects=found.effects | {"background": _laid(found.effects["background"], plan)})
        near = [name for name in near if name != "background"]
    if is_auto:
        if trial is not None and is_worthwhile(plan.steps):
            found = replace(found, effects=found.effects | _tried(found, near, trial))
        wanted = {name for name in SIMULATED if found.effects[name].on}
    with_sky = with_sky or "sky" in named_effects(asked)
    skies = found.plain if with_sky and skies is None else found.sky if is_auto or skies is not None else {}
    if skies and not _is_laid(found, plan, wanted - {"background"}):
        wanted.add("background")
    chosen = [name for name in SIMULATED if name in wanted]
    if skies:
        print(f"train: {sky.told(skies, scene.frames)}", file=sys.stderr)
    elif with_sky:
        raise InputError(f"--sky: the photos of {scene.root} show no sky; --sky DIR takes masks of it")
    print(f"train: effects: {', '.join(chosen) or 'none that the photos show'}", file=sys.stderr)
    evidence = {
        "simulated": [*chosen, *(["sky"] if skies else [])],
        "left_out": list(looked.left_out),
        "evidence": found.record()["effects"],
    }
    tries_degrees = "sh_degree" in wanted and sh_degree > 0
    if tries_degrees and plan.grown is None:
        raise InputError(
            f"--effects {asked}: no phase comes after those of density control, to go on with fewer"
            " harmonics; leave sh_degree out"
        )
    if not chosen:
        return ChosenEffects(skies=skies, evidence=evidence, tries_degrees=tries_degrees)
    density = plan.density
    rate = partial(
        learning_rate,
        plan.steps,
        reset_every=density.reset_every,
        resets_stop=min(density.stop, plan.steps),
    )
    if "background" in chosen and any(facts.has_matte for facts in found.seen.facts):
        raise InputError(
            f"--effects {asked}: the photos of {scene.root} have mattes, what is behind them is not theirs;"
            " leave background out"
        )
    begun = start(found.seen, chosen, skies)
    return ChosenEffects(simulations(begun, chosen, rate), begun, evidence, skies, tries_degrees)


def _with_given(found: Diagnosis, skies: sky.Masks) -> Diagnosis:
    """The diagnosis with a sky that was given instead of what the photos show."""
    evidence = sky.judge(found.seen, skies)
    given = evidence._replace(on=True, note=f"given by --sky: {sky.told(skies, found.seen.frames)}")
    return replace(found, sky=skies, effects=found.effects | {"sky": given})


def _tried(found: Diagnosis, near: list[str], trial: EffectTrial) -> dict[str, Evidence]:
    """The evidence of effects that are near their threshold, decided by what a trial of each brings."""
    on = [name for name in SIMULATED if found.effects[name].on and name not in near]
    gains = trial(found.seen, on, near) if near else {}
    told = {name: f"near its threshold, a trial of it brings {gain:+.2f} dB" for name, gain in gains.items()}
    return {
        name: each._replace(on=gains[name] >= WORTH, note=f"{told[name]} (needs {WORTH}); {each.note}")
        for name, each in found.effects.items()
        if name in gains
    }


def _is_laid(found: Diagnosis, plan: Plan, light: Collection[str]) -> bool:
    """Whether what looks like sky is the colour that the run lays under its renders, seen through effects on light."""
    if plan.background not in _PLAIN:
        return False
    reached = light_range(start(found.seen, light), found.seen.frames, light)
    return background.is_one(found.seen, _PLAIN[plan.background], *reached)


def _laid(evidence: Evidence, plan: Plan) -> Evidence:
    """The evidence of a sky whose one colour the run lays under its renders anyway: nothing is left to simulate."""
    note = f"off: --background {plan.background} lays that colour there; {evidence.note}"
    return evidence._replace(on=False, note=note) if evidence.on else evidence


def appearances_of_tracks(scene: Scene) -> dict[str, Appearance]:
    """Gains of all photos as their tracks tell them, no fall-off: to score a scene that took nothing in.

    Raises:
        InputError: A photo or the tracks cannot be read.
    """
    begun = start(observe(scene), ("exposure",))
    return {
        name: Appearance(tuple(gains.tolist()), (0.0, 0.0))
        for name, gains in zip(begun.names, begun.log_gains, strict=True)
    }
