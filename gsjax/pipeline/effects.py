"""Which effects a run simulates, and what it tells of each photo and its camera afterwards."""

import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np

from gsjax.effects import background, transients
from gsjax.effects.appearance import (
    Appearance,
    Start,
    appearances,
    as_near_photos,
    light_range,
    moves,
    simulations,
    start,
)
from gsjax.effects.diagnosis import Diagnosis
from gsjax.effects.evidence import Evidence
from gsjax.effects.model import Effects, EffectState, learning_rate
from gsjax.effects.observations import observe
from gsjax.effects.poses import Move
from gsjax.errors import InputError
from gsjax.io import runs
from gsjax.pipeline.diagnose import Looked, looked_at
from gsjax.pipeline.trials import WORTH, Trial, is_near, is_worthwhile
from gsjax.scene import Frame, Scene
from gsjax.settings import AUTO, NONE, SIMULATED, Settings, named_effects, total_steps

FILE, POSES, BACKGROUND = "effects.json", "poses.json", "background.json"
_PLAIN = {"black": 0.0, "white": 1.0}  # what `Settings.background` lays under the renders
T = TypeVar("T", Appearance, Move)
_SAID = "cameras.json has the cameras after these moves of those of the data set: radians, scene units, a factor"
_BEHIND = "behind all Gaussians: max(0, SH(direction of the ray in the world) + 0.5), as Gaussians' colours are"


class Photography(NamedTuple):
    """What a run found of how its photos were taken: of each by name. Empty: what it did not look for."""

    looks: Mapping[str, Appearance] = MappingProxyType({})
    moves: Mapping[str, Move] = MappingProxyType({})  # of its camera from where the data set has it
    background: np.ndarray | None = None  # [(L + 1)^2, 3] SH coefficients of what is behind all, see `gsjax.backdrop`
    near: Mapping[str, Appearance] = MappingProxyType({})  # held-out photos, exposed as those taken near them

    def with_near(self, frames: Sequence[Frame]) -> "Photography":
        """The same and, where there are looks, what the other photos tell of those held out."""
        return self._replace(near=as_near_photos(frames, self.looks)) if self.looks else self


@dataclass(frozen=True)
class Joined:
    """The effects of a run."""

    effects: Effects = field(default_factory=dict)
    begun: Start | None = None  # None: of no effects
    evidence: dict[str, Any] | None = None  # for the manifest; None: nobody looked
    tries_degrees: bool = False  # whether the run cuts its harmonics to those that photos do not miss

    def paced(self, settings: Settings) -> Settings:
        """The settings as these effects need them."""
        if "transients" not in self.effects:
            return settings
        growing = sum(phase.steps for phase in settings.phases if phase.density_control)
        return replace(settings, density=transients.patient(settings.density, growing))

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


def joined(settings: Settings, scene: Scene, trial: Trial | None = None, looked: Looked | None = None) -> Joined:
    """The effects that the settings name or, of "auto", that the photos show; one line says which.

    Args:
        settings: The run.
        scene: Its data set, at the size that is trained on.
        trial: Decides, of "auto", where evidence is near its threshold. None, or a short run: the threshold does.
        looked: What `looked_at` found, if it was asked.

    Raises:
        InputError: A photo or the tracks cannot be read, or a background is asked for behind mattes.
    """
    if settings.effects == NONE:
        return Joined()
    looked = looked or looked_at(settings, scene)
    scene, found = looked.scene, looked.found
    assert found is not None, "somebody looked"
    wanted = set(named_effects(settings.effects))
    is_auto = settings.effects == AUTO
    near = [name for name in SIMULATED if is_auto and is_near(name, found.effects[name])]
    is_on = [name for name in SIMULATED if found.effects[name].on] if is_auto else [*wanted]
    if _is_laid(found, settings, {*is_on, *near}):
        found = replace(found, effects=found.effects | {"background": _laid(found.effects["background"], settings)})
        near = [name for name in near if name != "background"]
    if is_auto:
        if trial is not None and is_worthwhile(settings):
            found = replace(found, effects=found.effects | _tried(found, near, trial))
        wanted = {name for name in SIMULATED if found.effects[name].on}
    chosen = [name for name in SIMULATED if name in wanted]
    print(f"train: effects: {', '.join(chosen) or 'none that the photos show'}", file=sys.stderr)
    evidence = {"simulated": chosen, "left_out": list(looked.left_out), "evidence": found.record()["effects"]}
    tries_degrees = "sh_degree" in wanted and settings.sh_degree > 0
    if tries_degrees and grown(settings) is None:
        raise InputError(
            f"--effects {settings.effects}: no phase comes after those of density control, to go on with fewer"
            " harmonics; leave sh_degree out"
        )
    if not chosen:
        return Joined(evidence=evidence, tries_degrees=tries_degrees)
    density = settings.density
    rate = partial(
        learning_rate,
        total_steps(settings),
        reset_every=density.reset_every,
        resets_stop=min(density.stop, total_steps(settings)),
    )
    if "background" in chosen and any(facts.has_matte for facts in found.seen.facts):
        raise InputError(
            f"--effects {settings.effects}: the photos of {scene.root} have mattes, what is behind them is not theirs;"
            " leave background out"
        )
    begun = start(found.seen, chosen)
    return Joined(simulations(begun, chosen, rate), begun, evidence, tries_degrees)


def grown(settings: Settings) -> int | None:
    """How many phases have run when no Gaussians multiply any more; None where none comes then."""
    last = max((index for index, phase in enumerate(settings.phases, 1) if phase.density_control), default=0)
    return last if last < len(settings.phases) else None


def _tried(found: Diagnosis, near: list[str], trial: Trial) -> dict[str, Evidence]:
    """The evidence of effects that are near their threshold, decided by what a trial of each brings."""
    on = [name for name in SIMULATED if found.effects[name].on and name not in near]
    gains = trial(found.seen, on, near) if near else {}
    told = {name: f"near its threshold, a trial of it brings {gain:+.2f} dB" for name, gain in gains.items()}
    return {
        name: each._replace(on=gains[name] >= WORTH, note=f"{told[name]} (needs {WORTH}); {each.note}")
        for name, each in found.effects.items()
        if name in gains
    }


def _is_laid(found: Diagnosis, settings: Settings, light: Collection[str]) -> bool:
    """Whether what looks like sky is the colour that the run lays under its renders, seen through effects on light."""
    if settings.background not in _PLAIN:
        return False
    reached = light_range(start(found.seen, light), found.seen.frames, light)
    return background.is_one(found.seen, _PLAIN[settings.background], *reached)


def _laid(evidence: Evidence, settings: Settings) -> Evidence:
    """The evidence of a sky whose one colour the run lays under its renders anyway: nothing is left to simulate."""
    note = f"off: --background {settings.background} lays that colour there; {evidence.note}"
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


def refined(frames: tuple[Frame, ...], moves: Mapping[str, Move]) -> tuple[Frame, ...]:
    """The frames with their cameras where training moved them; as they are without moves."""
    return tuple(moves[frame.name].refined(frame) if frame.name in moves else frame for frame in frames)


def write_photography(run: Path, found: Photography) -> None:
    """`effects.json`, `poses.json` and `background.json`, where there is anything to say.

    Raises:
        InputError: A file cannot be written.
    """
    if found.looks:
        runs.write_json(run / FILE, {"photos": {name: look._asdict() for name, look in found.looks.items()}})
    if found.moves:
        photos = {name: move._asdict() for name, move in found.moves.items()}
        runs.write_json(run / POSES, {"about": _SAID, "photos": photos})
    if found.background is not None:
        runs.write_json(run / BACKGROUND, {"about": _BEHIND, "sh": found.background})


def read_photography(run: Path) -> Photography:
    """What a run found; nothing where it simulated nothing.

    Raises:
        InputError: A file is damaged.
    """
    file = run / BACKGROUND
    background = np.asarray(runs.read_json(file)["sh"], np.float32) if file.exists() else None
    return Photography(_read(run / FILE, Appearance), _read(run / POSES, Move), background)


def moves_line(moves: Mapping[str, Move]) -> str:
    """How far cameras went, in words."""
    turns, shifts = (np.linalg.norm([getattr(m, name) for m in moves.values()], axis=1) for name in ("turn", "shift"))
    turns, shifts = (each[each > 0] if each.any() else each for each in (np.degrees(turns), shifts))  # not held out
    focals = [move.focal for move in moves.values()]
    return (
        f"cameras turned by {np.median(turns):.3f} degrees and shifted by {np.median(shifts):.3g} scene units"
        f" (medians), focal lengths x{min(focals):.4f} to x{max(focals):.4f}"
    )


def _read(file: Path, kind: type[T]) -> dict[str, T]:
    """Records of every photo by name; none where the file is absent."""
    if not file.exists():
        return {}
    photos = runs.read_json(file)["photos"]
    return {name: kind(*(_plain(record[field]) for field in kind._fields)) for name, record in photos.items()}  # pyright: ignore[reportAttributeAccessIssue]


def _plain(value: Any) -> Any:
    return tuple(map(float, value)) if isinstance(value, list) else float(value)
