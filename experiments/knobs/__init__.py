"""What trades accuracy for time, stage by stage."""

from collections.abc import Mapping
from typing import Any

from knobs import rendering, surface, training
from knobs.knob import Knob


def knobs_of(config: Mapping[str, Any]) -> dict[str, Knob]:
    """Every knob by its name; those of training are turned from where a whole config has them."""
    return {**rendering.KNOBS, **training.knobs_of(config), **surface.KNOBS}
