"""Which tests a session on a GPU runs."""

import os
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent
COLLECTED = """
import os, sys, pytest

class Told:
    def pytest_collection_modifyitems(self, items):
        files = sorted({item.path.stem for item in items})
        print("platforms:", repr(os.environ["JAX_PLATFORMS"]), "files:", files)

sys.exit(pytest.main(["--collect-only", "-qq", *sys.argv[1:]], plugins=[Told()]))
"""


def test_a_session_on_a_gpu_leaves_the_platform_to_jax_and_runs_what_is_marked():
    files = [str(TESTS / "rasterizer" / f"{name}.py") for name in ("test_binning", "test_golden")]
    environment = {**os.environ, "GSJAX_TEST_GPU": "1", "JAX_PLATFORMS": ""}
    command = [sys.executable, "-c", COLLECTED, *files]
    done = subprocess.run(command, capture_output=True, text=True, cwd=TESTS.parent, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[0] == "platforms: '' files: ['test_golden']"
