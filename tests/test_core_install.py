"""`pip install gsjax` without extras: the core works, and what needs more ends with one line."""

import re
import subprocess
import sys
from pathlib import Path

import pytest
from small_scenes import built_in

README = Path(__file__).resolve().parents[1] / "README.md"
PROGRAM = """
import sys
from gsjax.io.packages import EXTRAS

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"No module named '{name}'")

sys.meta_path.insert(0, Blocker())
"""
FEW_STEPS = """
def range(count):
    return [16, 17, 18, 19, 20]  # The README densifies after number 19.
"""
MESH = """
from gsjax import cli
assert int(state.step) == 5 and 0 < float(metrics.loss) < 1
assert image.shape == (40, 48, 3)
gsjax.save_gaussians(state.gaussians, "garden.ply")
[getattr(gsjax, name) for name in gsjax.__all__]
sys.exit(cli.main(["mesh", "garden.ply", "--out", "mesh.ply"]))
"""
TRAIN = """
from gsjax import cli
short = ["--set", "schedule.phases=[{\\"name\\":\\"plain\\",\\"steps\\":5}]", "model.max_gaussians=900"]
sys.exit(cli.main(["train", "scenes/garden", "--out", "run", "--effects", "none", *short]))
"""


@pytest.fixture
def run_core(tmp_path):
    """Runs a program where no extra is installed, in a folder with a data set."""
    built_in(tmp_path / "scenes/garden", num_views=9, size=(48, 40))

    def run(body):
        command = [sys.executable, "-c", PROGRAM + body]
        return subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)

    return run


def test_the_loop_of_the_readme_trains_and_a_command_names_the_extra_that_it_needs(run_core):
    (block,) = re.findall(r"^```python\n(.*?)^```$", README.read_text(), re.MULTILINE | re.DOTALL)
    loop, _, _ = block.partition("mesh, report")
    ended = run_core(FEW_STEPS + loop + MESH)
    assert ended.returncode == 2, ended.stderr
    last = ended.stderr.splitlines()[-1]
    assert last == "gsjax: error: open3d is not installed; install it with: pip install 'gsjax[mesh]'"


@pytest.mark.long
def test_the_command_trains_without_stereo_and_report_and_says_so(run_core):
    ended = run_core(TRAIN)
    assert ended.returncode == 0, ended.stderr
    for what, package, extra in [("multi-view stereo", "cv2", "sfm"), ("report", "jinja2", "view")]:
        line = f"no {what}: cannot load {package} (No module named '{package}'); install it with: "
        assert f"{line}pip install 'gsjax[{extra}]'" in ended.stderr
