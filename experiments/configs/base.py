"""What all experiments share: the settings that the others are differences from."""

from gsjax.settings import PRESETS

CONFIG: dict = PRESETS["fast"]
