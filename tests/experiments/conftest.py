"""The scripts of `experiments/`, which are no package, as modules."""

import importlib
import sys
from pathlib import Path

import pytest

EXPERIMENTS = Path(__file__).resolve().parents[2] / "experiments"
sys.path.insert(0, str(EXPERIMENTS))


@pytest.fixture
def scripts():
    """Imports a module of `experiments/` by its name, as a script there does; after the test all are forgotten."""
    yield importlib.import_module
    for name, module in list(sys.modules.items()):
        if EXPERIMENTS in Path(getattr(module, "__file__", None) or "/").parents:
            del sys.modules[name]
