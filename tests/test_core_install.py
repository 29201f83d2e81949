"""`pip install gsjax` without extras: the core works, and a command that needs more ends with one line."""

import subprocess
import sys

import pytest
from small_scenes import built_in

PROGRAM = """
import sys
from gsjax.io.packages import EXTRAS

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"No module named '{name}'")

sys.meta_path.insert(0, Blocked())
scene, run = sys.argv[1:]
"""
LOOP = """
import itertools
import jax, gsjax
loaded = gsjax.load_scene(scene)
views = gsjax.read_views(loaded.train_frames, normals=f"{scene}/normals")
gaussians = gsjax.from_points(loaded.points, loaded.point_colors, capacity=900)
optimizer = gsjax.adam(loaded.extent, steps=5)
step = gsjax.train_step(optimizer, {"l1": 0.8, "dssim": 0.2, "sdf_normal": 0.05}, densify="error")
state, key = gsjax.init(gaussians, optimizer), jax.random.key(0)
losses = []
for view in itertools.islice(itertools.cycle(views), 5):
    state, metrics = step(state, view, key)
    losses.append(float(metrics.loss))
state = gsjax.densify(state, key)
assert losses[-1] < losses[0], losses
assert gsjax.render(state.gaussians, views[0].camera).colors.shape == (32, 32, 3)
gsjax.save_gaussians(state.gaussians, f"{run}.ply")
[getattr(gsjax, name) for name in gsjax.__all__]
"""
MESH = """
from gsjax import cli
sys.exit(cli.main(["mesh", f"{run}.ply", "--out", f"{run}/mesh.ply"]))
"""
TRAIN = """
from gsjax import cli
short = ["--set", "schedule.phases=[{\\"name\\":\\"plain\\",\\"steps\\":5}]", "model.max_gaussians=900"]
sys.exit(cli.main(["train", scene, "--out", run, "--effects", "none", *short]))
"""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return built_in(tmp_path_factory.mktemp("data") / "scene", num_views=6, size=(32, 32))


def run_core(body, scene, out):
    command = [sys.executable, "-c", PROGRAM + body, str(scene), str(out)]
    return subprocess.run(command, capture_output=True, text=True)


def test_a_loop_trains_renders_and_saves_and_a_command_names_the_extra_that_it_needs(scene, tmp_path):
    ended = run_core(LOOP + MESH, scene, tmp_path / "run")
    assert ended.returncode == 2, ended.stderr
    last = ended.stderr.splitlines()[-1]
    assert last == "gsjax: error: open3d is not installed; install it with: pip install 'gsjax[mesh]'"


@pytest.mark.long
def test_the_command_trains_and_says_that_it_writes_no_report(scene, tmp_path):
    ended = run_core(TRAIN, scene, tmp_path / "run")
    assert ended.returncode == 0, ended.stderr
    line = "no report: cannot load jinja2 (No module named 'jinja2'); install it with: pip install 'gsjax[view]'"
    assert line in ended.stderr
