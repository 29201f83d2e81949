"""The built-in scene at the demo's size (`gsjax.demo`)."""

from gsjax.settings import DEMO

CONFIG: dict = DEMO
