"""What trades accuracy for time, stage by stage."""

from knobs import rendering, surface, training
from knobs.knob import Knob

KNOBS: dict[str, Knob] = {**rendering.KNOBS, **training.KNOBS, **surface.KNOBS}
