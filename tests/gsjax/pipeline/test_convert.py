"""Files of Gaussians to others: what is kept, the same picture from the same camera, and faults in one line."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import expit

from gsjax import cli, rendering
from gsjax.gaussians import Gaussians, take
from gsjax.io.gaussian_files import FORMATS, format_of
from gsjax.io.ply import read_gaussians, write_gaussians
from gsjax.io.spz import half_turned
from gsjax.pipeline import convert
from gsjax.scene.cameras import Camera


@pytest.fixture
def cloud(tmp_path):
    """60 large splats of degree 3 in front of the camera of `picture`, in in.ply."""
    rng = np.random.default_rng(3)
    values = (
        rng.uniform([-1, -1, 2], [1, 1, 4], (60, 3)),
        rng.normal(size=(60, 4)),
        rng.uniform(-3, -1, (60, 3)),
        rng.normal(size=60),
        rng.normal(size=(60, 1, 3)),
        rng.uniform(-0.3, 0.3, (60, 15, 3)),
    )
    gaussians = Gaussians(*(value.astype(np.float32) for value in values), pixel_filter="mip")
    write_gaussians(tmp_path / "in.ply", gaussians)
    return gaussians


@jax.jit
def picture(gaussians, viewmat):
    """`[32, 32, 3]` from a camera 32 pixels wide."""
    K = jnp.array([[30.0, 0, 16], [0, 30, 16], [0, 0, 1]], jnp.float32)
    return rendering.render(gaussians, Camera(viewmat, K, 32, 32), capacity=4096, background=jnp.zeros(3)).colors


def test_files_show_the_same_from_the_same_camera(cloud, tmp_path):
    ahead = np.eye(4, dtype=np.float32)
    half_turn = ahead * np.float32([1, -1, -1, 1])  # of the world, as SPZ has it
    straight = picture(cloud, ahead)
    assert np.abs(picture(half_turned(cloud), half_turn) - straight).max() < 2e-5
    # What is left out or mirrored shows: the same without harmonics, or with y and z as they are.
    assert np.abs(picture(replace(half_turned(cloud), sh_rest=cloud.sh_rest), half_turn) - straight).max() > 0.05
    assert np.abs(picture(replace(half_turned(cloud), quats=cloud.quats), half_turn) - straight).max() > 0.05
    for name, least in (("a.ply", 200), ("a.spz", 35), ("a.compressed.ply", 40)):
        report = convert(tmp_path / "in.ply", tmp_path / name, sh_degree=4)
        assert report["sh_degree"] == 3, "as high as it is"
        error = np.mean((picture(format_of(tmp_path / name).read(tmp_path / name), ahead) - straight) ** 2)
        assert -10 * np.log10(error + 1e-20) >= least, name


def test_what_is_not_wanted_is_left_out(cloud, tmp_path, capsys):
    crop = ["--crop", "-0.5", "-2", "2", "0.5", "2", "3.5"]
    arguments = ["convert", str(tmp_path), str(tmp_path / "out.ply"), *crop, "--min-opacity", "0.4", "--sh-degree", "1"]
    (tmp_path / "in.ply").rename(tmp_path / "gaussians.ply")  # a run folder
    assert cli.main(arguments) == 0
    inside = (np.abs(cloud.means[:, 0]) <= 0.5) & (cloud.means[:, 2] <= 3.5) & (expit(cloud.logit_opacities) >= 0.4)
    assert 0 < inside.sum() < 60
    read = read_gaussians(tmp_path / "out.ply")
    assert read.pixel_filter == "mip"
    np.testing.assert_array_equal(read.means, cloud.means[inside])
    np.testing.assert_array_equal(read.sh_rest, cloud.sh_rest[inside, :3])
    report = dict(line.split(None, 1) for line in capsys.readouterr().out.splitlines())
    assert report["gaussians"].strip() == str(inside.sum())
    assert report["left_out"].strip() == str(60 - inside.sum())


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_file_without_gaussians_is_one_of_each_format(tmp_path, cloud, suffix):
    write_gaussians(tmp_path / "none.ply", take(cloud, slice(0)))
    assert convert(tmp_path / "none.ply", tmp_path / f"out{suffix}")["gaussians"] == 0
    assert convert(tmp_path / f"out{suffix}", tmp_path / "again.ply", min_opacity=0.5)["sh_degree"] == 3


@pytest.mark.parametrize(
    ("source", "out", "options", "message"),
    [
        ("in.ply", "out.splat", [], "out.splat: files of Gaussians end in .compressed.ply, .ply, .sog, .spz"),
        ("short.spz", "out.ply", [], "short.spz: truncated or damaged"),
        ("in.ply", "in.ply/out.spz", [], "cannot write"),
        ("in.ply", "out.spz", ["--min-opacity", "nan"], "min_opacity=nan is not between 0 and 1"),
        ("in.ply", "out.spz", ["--crop", *"345912"], "crop 3 4 5 9 1 2: a lower side is above its upper one"),
        ("in.ply", "out.spz", ["--crop", *"777888"], "in.ply: none of its 60 Gaussians is left by"),
    ],
)
def test_faults_are_one_line_and_leave_nothing(cloud, tmp_path, capsys, source, out, options, message):
    convert(tmp_path / "in.ply", tmp_path / "short.spz")
    (tmp_path / "short.spz").write_bytes((tmp_path / "short.spz").read_bytes()[:-300])
    before = sorted(tmp_path.iterdir())
    code = cli.main(["convert", str(tmp_path / source), str(tmp_path / out), *options])
    error = capsys.readouterr().err
    assert code == 2 and message in error
    assert error.count("\n") == 1
    assert sorted(tmp_path.iterdir()) == before
