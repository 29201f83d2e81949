"""Effects of photography: their evidence in a scene, and their simulation in training. One module is one effect."""

import importlib
from types import ModuleType


def effect_module(name: str) -> ModuleType:
    """The module of an effect that `gsjax.settings.EFFECTS` names.

    It has `judge(findings)`, which returns `Evidence`, and `simulate(begun, rate)`, which returns an `Effect`.
    """
    return importlib.import_module(f"gsjax.effects.{name}")
