"""The built-in scene at the demo's size (`gsjax.demo`)."""

from gsjax.demo import SETTINGS

CONFIG: dict = SETTINGS
