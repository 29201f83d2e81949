"""Which effects a run simulates, and what it reports of each photo and its camera afterwards."""

import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import optax
from tqdm import tqdm

from gsjax.effects import background, blur, sky
from gsjax.effects.appearance import Appearance, Start, appearances, light_range, moves, simulations, start
from gsjax.effects.diagnosis import Diagnosis
from gsjax.effects.diagnosis import diagnose as look
from gsjax.effects.evidence import Evidence
from gsjax.effects.observations import observe
from gsjax.effects.simulation import Effects, EffectState, learning_rate
from gsjax.errors import InputError
from gsjax.planning.effect_validation import Validate
from gsjax.planning.validation import WORTH, ValidationGain
from gsjax.runs.photo_effects import PhotoEffects
from gsjax.scene import Scene
from gsjax.settings import AUTO, EFFECTS, NONE, SIMULATED, named_effects
from gsjax.training.plan import Plan

PROPOSED = tuple(name for name, kind in EFFECTS.items() if kind.is_proposed)
"""Effects that "auto" may simulate, in the order in which they are validated."""
UNVALIDATED = tuple(name for name, kind in EFFECTS.items() if kind.on_evidence)
"""Those that a run which is too short for validation simulates on evidence alone: they remove no surface."""
STRICTER = 1.5  # times the threshold, which evidence alone must exceed
_PLAIN = {"black": 0.0, "white": 1.0}  # what `Settings.background` lays under the renders


def diagnose_scene(scene: Scene) -> Diagnosis:
    """The diagnosis of a loaded data set, a bar meanwhile."""
    return look(scene, progress=lambda frames: tqdm(list(frames), desc="diagnose", unit="photo", leave=False))


class Inspection(NamedTuple):
    """A data set without the photos that are too blurred for training."""

    scene: Scene
    diagnosis: Diagnosis | None = None  # of its photos; None: none was made
    left_out: tuple[str, ...] = ()  # names


def inspect_photos(request: str, scene: Scene) -> Inspection:
    """Leave too blurred photos out of the data set and report them, and diagnose the photos, unless effects are "none".

    Raises:
        InputError: A photo or the tracks cannot be read.
    """
    if request == NONE:
        return Inspection(scene)
    findings = diagnose_scene(scene)
    is_requested = request == AUTO or "blur" in named_effects(request)
    names = blur.photos_to_leave_out(findings.observations) if is_requested else ()
    if not names:
        return Inspection(scene, findings)
    print(f"train: too blurred, left out: {', '.join(names)}", file=sys.stderr)
    sharp = replace(scene, frames=tuple(frame for frame in scene.frames if frame.name not in names))
    again = diagnose_scene(sharp)
    return Inspection(sharp, replace(again, effects=again.effects | {"blur": findings.effects["blur"]}), names)


@dataclass(frozen=True)
class ChosenEffects:
    """The effects of a run."""

    effects: Effects = field(default_factory=dict)
    initial: Start | None = None  # None: of no effects
    evidence: dict[str, Any] | None = None  # for the manifest; None: the photos were not diagnosed
    skies: sky.Masks = field(default_factory=dict)  # where photos show sky, if the run knows of one

    @property
    def names(self) -> tuple[str, ...]:
        """What the plan takes, see `gsjax.training.plan.Plan.with_effects`."""
        return (*self.effects, *(("sky",) if self.skies else ()))

    def with_own(self, effects: Effects) -> "ChosenEffects":
        """The same and a user's own effects, which are simulated without a decision.

        Raises:
            InputError: One has the name of an effect of this library.
        """
        for name in effects:
            if name in EFFECTS:
                raise InputError(f"effects: {name!r} is an effect of the library; give yours another name")
        return replace(self, effects={**self.effects, **effects})

    def photo_effects(self, state: EffectState | None) -> PhotoEffects:
        """What the state says of the photos."""
        if state is None or self.initial is None:
            return PhotoEffects()
        behind = state.numbers.get("background")
        return PhotoEffects(
            appearances(self.initial, state),
            moves(self.initial, state),
            None if behind is None else np.asarray(behind),
        )


def choose_effects(
    request: str,
    plan: Plan,
    scene: Scene,
    validate: Validate | None = None,
    inspection: Inspection | None = None,
    *,
    skies: sky.Masks | None = None,
    with_sky: bool = False,
    before: Mapping[str, Any] | None = None,
) -> ChosenEffects:
    """The effects that are named or, of "auto", that the photos show and validation confirms; one line names them.

    Args:
        request: As `Settings.effects`.
        plan: The run, without effects.
        scene: Its data set, at the size that is trained on.
        validate: Validates, of "auto", what the evidence proposes. None, or a run too short for it: exposure and poses
            alone are simulated, on strong evidence.
        inspection: Of `inspect_photos`, if it was called.
        skies: Where photos show sky, if masks of it were given; they enable a background.
        with_sky: Whether a sky must be there, whatever `request` names.
        before: The manifest's record of what was decided when this run began; nothing is validated again.

    Raises:
        InputError: A photo or the tracks cannot be read, or a background is requested behind mattes.
    """
    if request == NONE and skies is None and not with_sky:
        return ChosenEffects()
    inspection = inspection or inspect_photos(request, scene)
    scene, findings = inspection.scene, inspection.diagnosis or diagnose_scene(inspection.scene)
    if skies is not None:
        findings = _with_given(findings, skies)
    is_auto, with_sky = request == AUTO, with_sky or "sky" in named_effects(request)
    selection, validated = set(named_effects(request)) - {"sky"}, {}
    is_on = selection if not is_auto else {name for name in PROPOSED if findings.effects[name].on}
    behind = findings.effects["background"]
    if behind.on and _is_laid(findings, plan, is_on & {*SIMULATED}):
        note = f"off: the background is {plan.background}; {behind.note}"
        laid = {"background": behind._replace(on=False, note=note)}
        findings = replace(findings, effects=findings.effects | laid)
    if is_auto:
        named = {"sky"} if with_sky or skies is not None else set()
        proposed = [name for name in PROPOSED if findings.effects[name].on and name not in named]
        selection, validated = _decided(findings, proposed, validate, before)
        findings = replace(findings, effects=findings.effects | _noted(findings, proposed, selection, validated))
    skies_in_photos = findings.plain if with_sky and skies is None else findings.sky
    skies = skies_in_photos if with_sky or skies is not None or "sky" in selection else {}
    if skies and not _is_laid(findings, plan, selection - {"background", "sky"}):
        selection.add("background")
    names = [name for name in SIMULATED if name in selection]
    if skies:
        print(f"train: {sky.summary(skies, scene.frames)}", file=sys.stderr)
    elif with_sky:
        raise InputError(f"sky: the photos of {scene.root} show no sky; effects.sky takes a folder of masks")
    simulated = [*names, *(["sky"] if skies else [])]
    print(f"train: {_line(findings, simulated, validated)}", file=sys.stderr)
    evidence = {
        "simulated": simulated,
        "left_out": list(inspection.left_out),
        "evidence": findings.record()["effects"],
        "validated": {name: each._asdict() for name, each in validated.items()},
    }
    if not names:
        return ChosenEffects(skies=skies, evidence=evidence)
    if "background" in names and any(facts.has_matte for facts in findings.observations.facts):
        raise InputError(
            f"effects={request}: the photos of {scene.root} have mattes, what is behind them is not theirs;"
            " leave background out"
        )
    start_values = start(findings.observations, names, skies)
    return ChosenEffects(simulations(start_values, names, _rate(plan)), start_values, evidence, skies)


def _rate(plan: Plan) -> Callable[..., optax.Schedule]:
    """Learning rates of a run's effects, see `gsjax.effects.simulation.learning_rate`."""
    density = plan.density
    resets_stop = min(density.stop, plan.steps)
    return partial(learning_rate, plan.steps, reset_every=density.reset_every, resets_stop=resets_stop)


def _decided(
    findings: Diagnosis, proposed: Sequence[str], validate: Validate | None, before: Mapping[str, Any] | None
) -> tuple[set[str], dict[str, ValidationGain]]:
    """The proposed effects that are simulated, and the gain of each that was validated."""
    if before is not None:
        stored = before.get("validated", {})
        return {*before["simulated"]}, {name: ValidationGain(**each) for name, each in stored.items()}
    certain = {name for name in proposed if findings.effects[name].is_certain}
    if "sky" in certain:
        certain |= {"background"}  # what its term uncovers
    doubtful = [name for name in proposed if name not in certain]
    validated = validate(findings.observations, doubtful) if validate and doubtful else {}
    if not validated:
        evidence = {name: findings.effects[name] for name in doubtful if name in UNVALIDATED}
        return certain | {name for name, each in evidence.items() if (each.value or 0) > STRICTER * each.threshold}, {}
    return certain | {name for name, each in validated.items() if each.passes}, validated


def _noted(
    findings: Diagnosis, proposed: Sequence[str], selection: Collection[str], validated: Mapping[str, ValidationGain]
) -> dict[str, Evidence]:
    """The evidence of the proposed effects, with the validated gain and the decision in its note."""
    notes = {}
    for name in proposed:
        decision = "simulated" if name in selection else "not simulated"
        why = "not validated, the run is too short"
        why = f"gains {validated[name]} in a validation run (needs {WORTH:g})" if name in validated else why
        why = "certain without validation" if findings.effects[name].is_certain else why
        why = "part of the sky" if name == "background" and "sky" in selection else why
        notes[name] = findings.effects[name]._replace(note=f"{decision}: {why}; {findings.effects[name].note}")
    return notes


def _line(findings: Diagnosis, simulated: Sequence[str], validated: Mapping[str, ValidationGain]) -> str:
    """Which effects are simulated and which of the proposed ones are not, each with its validated gain."""

    def text_of(name: str) -> str:
        return f"{name} ({validated[name]})" if name in validated else name

    rejected = [
        text_of(name)
        for name in PROPOSED
        if name not in simulated and (name in validated or findings.effects[name].note.startswith("not simulated"))
    ]
    line = f"effects: {', '.join(map(text_of, simulated)) or 'none that the photos show'}"
    return f"{line}; not simulated: {', '.join(rejected)}" if rejected else line


def _with_given(findings: Diagnosis, skies: sky.Masks) -> Diagnosis:
    """The diagnosis with a sky that was given instead of what the photos show."""
    evidence = sky.judge_masks(findings.observations, skies)
    sky_evidence = evidence._replace(
        on=True, note=f"given by masks: {sky.summary(skies, findings.observations.frames)}"
    )
    return replace(findings, sky=skies, effects=findings.effects | {"sky": sky_evidence})


def _is_laid(findings: Diagnosis, plan: Plan, light: Collection[str]) -> bool:
    """Whether what looks like sky is the colour that the run lays under its renders, seen through effects on light."""
    if plan.background not in _PLAIN:
        return False
    reached = light_range(start(findings.observations, light), findings.observations.frames, light)
    return background.is_one(findings.observations, _PLAIN[plan.background], *reached)


def appearances_of_tracks(scene: Scene) -> dict[str, Appearance]:
    """Gains of all photos as their tracks imply them, no fall-off: to score a scene that took nothing in.

    Raises:
        InputError: A photo or the tracks cannot be read.
    """
    start_values = start(observe(scene), ("exposure",))
    return {
        name: Appearance(tuple(gains.tolist()), (0.0, 0.0))
        for name, gains in zip(start_values.names, start_values.log_gains, strict=True)
    }
