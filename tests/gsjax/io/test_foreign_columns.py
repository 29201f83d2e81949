"""PLY files of Gaussians with columns of other programs, and the normals that ours have."""

import numpy as np
import pytest
from small_scenes import cloud

from gsjax.errors import InputError
from gsjax.gaussians import covariances
from gsjax.io.foreign_columns import fuse_filter
from gsjax.io.ply import read_gaussians, write_gaussians


def with_columns(path, **columns):
    """Adds columns of floats to a file of floats."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    width = head.count(b"property float")
    rows = np.column_stack([np.frombuffer(body, "<f4").reshape(-1, width), *columns.values()]).astype("<f4")
    head += b"".join(f"property float {name}\n".encode() for name in columns)
    path.write_bytes(head + b"end_header\n" + rows.tobytes())


def opacities(logits):
    return 1 / (1 + np.exp(-np.asarray(logits, np.float64)))


@pytest.mark.parametrize("name", ["filter_3D", "filter3D"])
def test_a_3d_filter_is_fused(tmp_path, capsys, name):
    """Deviations s become sqrt(s^2 + f^2), opacities o become o * sqrt(det / det')."""
    gaussians = cloud(50)
    write_gaussians(tmp_path / "g.ply", gaussians)
    filters = np.random.default_rng(0).uniform(0, 0.3, 50)
    filters[0] = 0
    with_columns(tmp_path / "g.ply", **{name: filters})
    read = read_gaussians(tmp_path / "g.ply")
    scales = np.exp(np.asarray(gaussians.log_scales, np.float64))
    fused = np.sqrt(scales**2 + filters[:, None] ** 2)
    np.testing.assert_allclose(np.exp(read.log_scales), fused, rtol=2e-6)
    expected = opacities(gaussians.logit_opacities) * np.sqrt((scales**2).prod(1) / (fused**2).prod(1))
    np.testing.assert_allclose(opacities(read.logit_opacities), expected, rtol=2e-5)
    np.testing.assert_allclose(read.logit_opacities[0], gaussians.logit_opacities[0], rtol=1e-6)
    assert capsys.readouterr().err == f"{tmp_path / 'g.ply'}: {name} is fused into scales and opacities\n"


@pytest.mark.parametrize(("logit", "width"), [(88.0, 0.0), (-88.0, 0.0), (88.0, 1e-20), (40.0, 1e-3), (-88.0, 1e6)])
def test_extremes_stay_numbers(logit, width):
    log_scales, logits = fuse_filter(np.full((1, 3), -3.0), np.array([[logit]]), np.array([[width]]))
    assert np.isfinite(log_scales).all() and np.isfinite(logits).all()
    if width < 1e-10:
        np.testing.assert_allclose(logits, logit, rtol=1e-6)


@pytest.mark.parametrize(
    ("names", "fault"),
    [
        (["t", "scale_t", "rot_r_0", "rot_r_1"], r"move or fade over time \(t, scale_t, rot_r_\*\)"),
        (["beta"], r"kernels other than Gaussians \(beta\)"),
        (["sg_axis_0", "sg_axis_1", "sg_sharpness_0"], r"spherical harmonics \(sg_axis_\*, sg_sharpness_0\)"),
        (["sb_params_0"], "other than spherical harmonics"),
        (["f_offset_0", "f_anchor_feat_0"], "anchors of a network"),
    ],
)
def test_columns_that_change_the_meaning_are_refused_by_name(tmp_path, names, fault):
    write_gaussians(tmp_path / "g.ply", cloud(5))
    with_columns(tmp_path / "g.ply", **{name: np.zeros(5) for name in names})
    with pytest.raises(InputError, match=rf"g\.ply: holds .*{fault}"):
        read_gaussians(tmp_path / "g.ply")


def test_other_columns_are_named_once(tmp_path, capsys):
    gaussians = cloud(5)
    write_gaussians(tmp_path / "g.ply", gaussians)
    with_columns(tmp_path / "g.ply", roughness=np.ones(5), **{f"label_{i}": np.ones(5) for i in range(40)})
    for _ in range(2):
        np.testing.assert_array_equal(read_gaussians(tmp_path / "g.ply").log_scales, gaussians.log_scales)
    assert capsys.readouterr().err == f"{tmp_path / 'g.ply'}: columns that are not read: roughness, label_*\n"


def normals(path):
    head, body = path.read_bytes().split(b"end_header\n", 1)
    names = [line.split()[2] for line in head.splitlines() if line.startswith(b"property float")]
    rows = np.frombuffer(body, "<f4").reshape(-1, len(names))
    return rows[:, [names.index(name) for name in (b"nx", b"ny", b"nz")]].astype(np.float64)


def test_normals_are_the_smallest_axes_and_face_the_nearest_camera_or_away_from_the_middle(tmp_path):
    """The eigenvectors of the least eigenvalue, of which only the sign is free."""
    gaussians = cloud(50)
    means = np.asarray(gaussians.means, np.float64)
    write_gaussians(tmp_path / "g.ply", gaussians)
    least = np.linalg.eigh(np.asarray(covariances(gaussians), np.float64))[1][..., 0]
    directions = normals(tmp_path / "g.ply")
    np.testing.assert_allclose(np.abs(np.sum(directions * least, axis=1)), 1, atol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, rtol=1e-6)
    assert (np.sum(directions * (means - np.median(means, axis=0)), axis=1) >= 0).all()
    cameras = np.array([[0.0, 0, 9], [0, 0, -9], [7, 0, 0]])
    write_gaussians(tmp_path / "g.ply", gaussians, cameras=cameras)
    nearest = cameras[np.argmin(np.linalg.norm(means[:, None] - cameras, axis=-1), axis=1)]
    assert (np.sum(normals(tmp_path / "g.ply") * (nearest - means), axis=1) >= 0).all()
