"""Which effects a run simulates, and what it reports of each photo and its camera afterwards."""

import sys
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

from tqdm import tqdm

from gsjax.effects import sky
from gsjax.effects.appearance import Appearance, appearances, light_range
from gsjax.effects.diagnosis import Diagnosis, diagnose
from gsjax.effects.exposure import gains_of_tracks
from gsjax.effects.kinds import Evidence, Masks, Rate, StartInputs, effect_kinds, simulations
from gsjax.effects.observations import observe
from gsjax.effects.simulation import Effects, EffectState, learning_rate, reports
from gsjax.errors import InputError
from gsjax.planning.effect_validation import Validate
from gsjax.planning.validation import WORTH, ValidationGain
from gsjax.runs.photo_effects import PhotoEffects
from gsjax.scene import Scene
from gsjax.settings import AUTO, EFFECTS, NONE, named_effects
from gsjax.training.plan import Plan

STRICTER = 1.5  # times the threshold, which evidence alone must exceed
STRONG = 3.0  # times the threshold: evidence by which any gain is enough, as validation runs are short and small
SKY = "sky"  # the effect that the setting `effects.sky` requires or has masks of
_PLAIN = {"black": 0.0, "white": 1.0}  # what `Settings.background` lays under the renders


def diagnose_scene(scene: Scene) -> Diagnosis:
    """The diagnosis of a loaded data set, a bar meanwhile."""
    return diagnose(scene, progress=lambda frames: tqdm(list(frames), desc="diagnose", unit="photo", leave=False))


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
    diagnosis, names, evidence = diagnose_scene(scene), [], {}
    for effect, kind in effect_kinds().items():
        if kind.photos_to_leave_out and (request == AUTO or effect in named_effects(request)):
            names += kind.photos_to_leave_out(diagnosis.observations)
            evidence[effect] = diagnosis.effects[effect]
    if not names:
        return Inspection(scene, diagnosis)
    print(f"train: too blurred, left out: {', '.join(names)}", file=sys.stderr)
    sharp = replace(scene, frames=tuple(frame for frame in scene.frames if frame.name not in names))
    return Inspection(sharp, diagnose_scene(sharp).with_evidence(evidence), tuple(names))


@dataclass(frozen=True)
class ChosenEffects:
    """The effects of a run."""

    effects: Effects = field(default_factory=dict)
    evidence: dict[str, Any] | None = None  # for the manifest; None: the photos were not diagnosed
    skies: Masks = field(default_factory=dict)  # where photos show sky, if the run knows of one

    @property
    def names(self) -> tuple[str, ...]:
        """What the plan takes, see `gsjax.training.plan.Plan.with_effects`."""
        return (*self.effects, *((SKY,) if self.skies else ()))

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
        learned = {} if state is None else reports(self.effects, state.numbers)
        return PhotoEffects(appearances(learned), learned.get("moves", {}), learned.get("background"))


class EffectDecision(NamedTuple):
    """Which of the effects that "auto" proposes are simulated."""

    proposed: tuple[str, ...] = ()
    selection: frozenset[str] = frozenset()
    validated: Mapping[str, ValidationGain] = MappingProxyType({})  # the gain of each that was validated


def choose_effects(
    request: str,
    plan: Plan,
    scene: Scene,
    validate: Validate | None = None,
    inspection: Inspection | None = None,
    *,
    skies: Masks | None = None,
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
    diagnosis = _with_masks(inspection.diagnosis or diagnose_scene(inspection.scene), skies)
    required = {*named_effects(request), *((SKY,) if with_sky or skies is not None else ())}
    diagnosis = _without_needless(diagnosis, plan, _proposals(diagnosis) if request == AUTO else required)
    decision = EffectDecision()
    if request == AUTO:
        proposed = tuple(name for name in _proposals(diagnosis) if name not in required)
        decision = _decide(diagnosis, proposed, validate, before)
        diagnosis = _with_notes(diagnosis, decision)
    names, masks = _selection(diagnosis, plan, required, decision)
    if SKY in required and not masks:
        raise InputError(f"sky: the photos of {scene.root} show no sky; effects.sky takes a folder of masks")
    evidence = _report(inspection, diagnosis, decision, names, masks)
    effects = simulations(diagnosis.observations, names, _rate(plan), masks)
    behind = [name for name, effect in effects.items() if effect.behind]
    if behind and any(facts.has_matte for facts in diagnosis.observations.facts):
        raise InputError(
            f"effects={request}: the photos of {scene.root} have mattes, what is behind them is not theirs;"
            f" leave {' and '.join(behind)} out"
        )
    return ChosenEffects(effects, evidence, masks)


def _proposals(diagnosis: Diagnosis) -> tuple[str, ...]:
    """The effects that "auto" may simulate and that the photos show, in the order in which they are validated."""
    return tuple(name for name, kind in effect_kinds().items() if kind.is_proposed and diagnosis.effects[name].on)


def _with_masks(diagnosis: Diagnosis, skies: Masks | None) -> Diagnosis:
    """The diagnosis with a sky that was given, if one was, instead of what the photos show."""
    if skies is None:
        return diagnosis
    note = f"given by masks: {sky.summary(skies, diagnosis.observations.frames)}"
    evidence = sky.judge_masks(diagnosis.observations, skies)._replace(on=True, note=note)
    return replace(diagnosis.with_evidence({SKY: evidence}), sky=skies, plain=skies)


def _without_needless(diagnosis: Diagnosis, plan: Plan, names: Collection[str]) -> Diagnosis:
    """The diagnosis without the effects that the colour under the renders replaces, seen through the named effects."""
    off = {
        name: evidence._replace(on=False, note=f"off: the background is {plan.background}; {evidence.note}")
        for name, evidence in diagnosis.effects.items()
        if evidence.on and _is_needless(name, diagnosis, plan, names)
    }
    return diagnosis.with_evidence(off)


def _is_needless(name: str, diagnosis: Diagnosis, plan: Plan, names: Collection[str]) -> bool:
    """Whether the colour that the run lays under its renders is enough, seen through the named effects on light."""
    is_needless = effect_kinds()[name].is_needless
    if is_needless is None or plan.background not in _PLAIN:
        return False
    observations = diagnosis.observations
    effects = simulations(observations, names, _rate(plan))
    return is_needless(observations, _PLAIN[plan.background], *light_range(effects, observations.frames))


def _decide(
    diagnosis: Diagnosis, proposed: tuple[str, ...], validate: Validate | None, before: Mapping[str, Any] | None
) -> EffectDecision:
    """Decide by the evidence where it is certain, else by validation; `before` has the decision of a resumed run."""
    if before is not None:
        validated = {name: ValidationGain(**each) for name, each in before.get("validated", {}).items()}
        return EffectDecision(proposed, frozenset(before["simulated"]), validated)
    kinds, evidence = effect_kinds(), diagnosis.effects
    certain = {name for name in proposed if evidence[name].is_certain}
    certain |= {behind for name in certain if (behind := kinds[name].uncovers)}
    doubtful = [name for name in proposed if name not in certain]
    validated = validate(diagnosis.observations, doubtful) if validate and doubtful else {}
    passed = {name for name, gain in validated.items() if gain.passes or (gain.gain > 0 and _is_strong(evidence[name]))}
    if not validated:
        alone = [name for name in doubtful if kinds[name].on_evidence]
        passed = {name for name in alone if (evidence[name].value or 0) > STRICTER * evidence[name].threshold}
    return EffectDecision(proposed, frozenset(certain | passed), validated)


def _is_strong(evidence: Evidence) -> bool:
    return (evidence.value or 0) > STRONG * evidence.threshold


def _with_notes(diagnosis: Diagnosis, decision: EffectDecision) -> Diagnosis:
    """The diagnosis with the validated gain and the decision in the note of each proposed effect."""
    uncovered = {kind.uncovers: name for name, kind in effect_kinds().items() if name in decision.selection}
    with_notes, gains = {}, decision.validated
    for name in decision.proposed:
        evidence, verdict = diagnosis.effects[name], "simulated" if name in decision.selection else "not simulated"
        why = "not validated, the run is too short"
        needs = "any gain, on strong evidence" if _is_strong(evidence) else f"{WORTH:g}"
        why = f"gains {gains[name]} in a validation run (needs {needs})" if name in gains else why
        why = "certain without validation" if evidence.is_certain else why
        why = f"part of the {uncovered[name]}" if name in uncovered else why
        with_notes[name] = evidence._replace(note=f"{verdict}: {why}; {evidence.note}")
    return diagnosis.with_evidence(with_notes)


def _selection(
    diagnosis: Diagnosis, plan: Plan, required: Collection[str], decision: EffectDecision
) -> tuple[tuple[str, ...], Masks]:
    """The effects whose numbers training learns, and where photos show sky: a sky enables what its term uncovers."""
    selection, masks = {*required, *decision.selection}, {}
    if SKY in selection:
        masks = diagnosis.plain if SKY in required else diagnosis.sky
    behind = effect_kinds()[SKY].uncovers
    if masks and behind and not _is_needless(behind, diagnosis, plan, selection):
        selection.add(behind)
    return tuple(name for name, kind in effect_kinds().items() if kind.simulate and name in selection), masks


def _report(
    inspection: Inspection, diagnosis: Diagnosis, decision: EffectDecision, names: tuple[str, ...], masks: Masks
) -> dict[str, Any]:
    """Print which effects are simulated and which of the proposed ones are not; the record of the manifest."""
    simulated, validated = [*names, *((SKY,) if masks else ())], decision.validated

    def listed(effects: Collection[str]) -> str:
        return ", ".join(f"{name} ({validated[name]})" if name in validated else name for name in effects)

    rejected = [name for name in EFFECTS if name in {*decision.proposed, *validated} and name not in simulated]
    line = f"effects: {listed(simulated) or 'none that the photos show'}"
    if masks:
        print(f"train: {sky.summary(masks, inspection.scene.frames)}", file=sys.stderr)
    print(f"train: {line}{f'; not simulated: {listed(rejected)}' if rejected else ''}", file=sys.stderr)
    return {
        "simulated": simulated,
        "left_out": list(inspection.left_out),
        "evidence": diagnosis.record()["effects"],
        "validated": {name: gain._asdict() for name, gain in validated.items()},
    }


def _rate(plan: Plan) -> Rate:
    """Learning rates of a run's effects, see `gsjax.effects.simulation.learning_rate`."""
    density = plan.density
    resets_stop = min(density.stop, plan.steps)
    return partial(learning_rate, plan.steps, reset_every=density.reset_every, resets_stop=resets_stop)


def appearances_of_tracks(scene: Scene) -> dict[str, Appearance]:
    """Gains of all photos as their tracks imply them, no fall-off: to score a scene that took nothing in.

    Raises:
        InputError: A photo or the tracks cannot be read.
    """
    inputs = StartInputs(observe(scene))
    return appearances({"log_gains": dict(zip(inputs.names, gains_of_tracks(inputs).tolist(), strict=True))})
