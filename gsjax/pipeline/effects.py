"""Which effects a run simulates, and what it tells of each photo afterwards."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from gsjax.effects.appearance import Appearance, Start, appearances, simulations, start
from gsjax.effects.model import Effects, EffectState, learning_rate
from gsjax.effects.observations import observe
from gsjax.io import runs
from gsjax.pipeline.diagnose import diagnosed
from gsjax.scene import Scene
from gsjax.settings import AUTO, NONE, SIMULATED, Settings, named_effects, total_steps

FILE = "effects.json"


@dataclass(frozen=True)
class Joined:
    """The effects of a run."""

    effects: Effects = field(default_factory=dict)
    begun: Start | None = None  # None: of no effects
    evidence: dict[str, Any] | None = None  # for the manifest; None: nobody looked

    def appearances(self, state: EffectState | None) -> dict[str, Appearance]:
        """What every photo made of the light, by name; empty without effects."""
        return {} if state is None or self.begun is None else appearances(self.begun, state)


def joined(settings: Settings, scene: Scene) -> Joined:
    """The effects that the settings name or, of "auto", that the photos show; one line says which.

    Args:
        settings: The run.
        scene: Its data set, at the size that is trained on.

    Raises:
        InputError: A photo or the tracks cannot be read.
    """
    if settings.effects == NONE:
        return Joined()
    found = diagnosed(scene)
    named = named_effects(settings.effects)
    chosen = [name for name in SIMULATED if name in named or (settings.effects == AUTO and found.effects[name].on)]
    print(f"train: effects: {', '.join(chosen) or 'none that the photos show'}", file=sys.stderr)
    evidence = {"simulated": chosen, "evidence": found.record()["effects"]}
    if not chosen:
        return Joined(evidence=evidence)
    density = settings.density
    rate = learning_rate(
        total_steps(settings), reset_every=density.reset_every, resets_stop=min(density.stop, total_steps(settings))
    )
    begun = start(found.seen, chosen)
    return Joined(simulations(begun, chosen, rate), begun, evidence)


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


def write_appearances(run: Path, looks: dict[str, Appearance]) -> None:
    """`effects.json`, where there are any.

    Raises:
        InputError: It cannot be written.
    """
    if looks:
        runs.write_json(run / FILE, {"photos": {name: look._asdict() for name, look in looks.items()}})


def read_appearances(run: Path) -> dict[str, Appearance]:
    """What the photos of a run made of the light, by name; empty where it simulated nothing.

    Raises:
        InputError: The file is damaged.
    """
    if not (run / FILE).exists():
        return {}
    photos = runs.read_json(run / FILE)["photos"]
    return {
        name: Appearance(*(tuple(np.asarray(look[field], float).tolist()) for field in Appearance._fields))
        for name, look in photos.items()
    }
