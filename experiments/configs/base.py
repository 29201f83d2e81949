"""What all experiments share: the settings that the others are differences from.

No effects: they are compared by the score of the render as it is.
"""

from gsjax.settings import NONE, PRESETS

CONFIG: dict = {**PRESETS["fast"], "effects": NONE}
