"""Tests on four host devices: `tests/test_several_devices.py` runs them in a process that has so many."""

import jax

collect_ignore_glob = ["test_*.py"] if jax.device_count() < 4 else []
