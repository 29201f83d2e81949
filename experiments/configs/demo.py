"""The built-in scene as `gsjax demo` trains it, whatever `base` is."""

from gsjax.config import parse, to_dict
from gsjax.settings import DEMO, NONE, PRESETS, Settings

_BASE = {**PRESETS["fast"], "effects": NONE}
CONFIG: dict = {key: value for key, value in to_dict(parse(Settings, DEMO)).items() if _BASE.get(key) != value}
