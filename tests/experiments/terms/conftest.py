"""The terms of `experiments/terms` as a package, as a script of `experiments/` finds it."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "experiments"))
