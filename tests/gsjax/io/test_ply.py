"""PLY files of Gaussians and points, with columns of other programs too, and the normals that ours have."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import expit
from small_scenes import cloud

from gsjax.errors import InputError
from gsjax.gaussians import SH_C0, Gaussians, covariances, take
from gsjax.io.ply import read_gaussians, read_points, write_gaussians
from gsjax.io.ply_elements import fuse_filter

PLY_TYPES = {"uchar": "u1", "ushort": "<u2", "float": "<f4"}
FIELDS = ("means", "quats", "log_scales", "logit_opacities", "sh_dc", "sh_rest")


def some_gaussians(count=7, degree=3):
    rng, rest = np.random.default_rng(0), (degree + 1) ** 2 - 1
    shapes = (count, 3), (count, 4), (count, 3), (count,), (count, 1, 3), (count, rest, 3)
    return Gaussians(*(rng.normal(size=shape).astype(np.float32) for shape in shapes))


def assert_same(a, b):
    for field in FIELDS:
        x, y = getattr(a, field), getattr(b, field)
        assert x.dtype == np.float32 and x.shape == y.shape, field
        np.testing.assert_array_equal(x, y, err_msg=field)


def table_of(path):
    """Header's names and the rows as float32: a reader of its own, for binary files of floats only."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    names = [line.split()[2].decode() for line in head.splitlines() if line.startswith(b"property float")]
    return names, np.frombuffer(body, "<f4").reshape(-1, len(names))


def write_table(path, names, rows, form="binary_little_endian"):
    header = f"ply\nformat {form} 1.0\ncomment made by hand\nelement vertex {len(rows)}\n"
    header += "".join(f"property float {name}\n" for name in names) + "end_header\n"
    if form == "ascii":
        body = "\n".join(" ".join(repr(float(v)) for v in row) for row in rows).encode() + b"\n"
    else:
        body = np.asarray(rows, "<f4" if "little" in form else ">f4").tobytes()
    path.write_bytes(header.encode() + body)


@pytest.mark.parametrize(("count", "degree", "pixel_filter"), [(0, 3, "classic"), (1, 0, "mip"), (7, 4, "mip")])
def test_what_is_written_is_read(tmp_path, count, degree, pixel_filter):
    gaussians = replace(some_gaussians(count, degree), pixel_filter=pixel_filter)
    write_gaussians(tmp_path / "g.ply", gaussians)
    read = read_gaussians(tmp_path / "g.ply")
    assert_same(read, gaussians)
    assert read.pixel_filter == pixel_filter
    assert (b"\ncomment SplatRenderMode: mip\n" in (tmp_path / "g.ply").read_bytes()) == (pixel_filter == "mip")
    assert [p.name for p in tmp_path.iterdir()] == ["g.ply"]


def test_the_layout_is_the_one_of_the_original_code(tmp_path):
    gaussians = some_gaussians(7, 2)
    write_gaussians(tmp_path / "g.ply", gaussians)
    names, rows = table_of(tmp_path / "g.ply")
    expected = ["x", "y", "z", "nx", "ny", "nz", *[f"f_dc_{i}" for i in range(3)], *[f"f_rest_{i}" for i in range(24)]]
    expected += ["opacity", *[f"scale_{i}" for i in range(3)], *[f"rot_{i}" for i in range(4)]]
    assert names == expected
    column = {name: rows[:, i] for i, name in enumerate(names)}
    for channel in range(3):
        np.testing.assert_array_equal(column[f"f_dc_{channel}"], gaussians.sh_dc[:, 0, channel])
        for k in range(8):
            np.testing.assert_array_equal(column[f"f_rest_{8 * channel + k}"], gaussians.sh_rest[:, k, channel])
    np.testing.assert_array_equal(column["opacity"], gaussians.logit_opacities)
    np.testing.assert_array_equal(column["rot_0"], gaussians.quats[:, 0])
    np.testing.assert_array_equal(column["scale_2"], gaussians.log_scales[:, 2])
    np.testing.assert_allclose(np.linalg.norm(rows[:, 3:6], axis=1), 1, rtol=1e-6)
    points, colors = read_points(tmp_path / "g.ply")
    np.testing.assert_array_equal(points, gaussians.means)
    expected_colors = np.clip(gaussians.sh_dc[:, 0] * SH_C0 + 0.5, 0, 1)
    np.testing.assert_allclose(colors / 255, expected_colors, atol=0.5001 / 255)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_columns_in_any_order_with_foreign_ones_and_in_every_form(tmp_path, form):
    gaussians = some_gaussians(7, 1)
    write_gaussians(tmp_path / "g.ply", gaussians)
    names, rows = table_of(tmp_path / "g.ply")
    order = np.random.default_rng(1).permutation(len(names))
    shuffled = [*[names[i] for i in order], "quality"]
    write_table(tmp_path / "h.ply", shuffled, np.column_stack([rows[:, order], rows[:, 0]]), form)
    assert_same(read_gaussians(tmp_path / "h.ply"), gaussians)


@pytest.mark.parametrize(
    ("comments", "expected"),
    [
        ([], "classic"),
        (["Exported from Brush", "SH degree: 0", "SplatRenderMode: mip"], "mip"),
        (["antialiased 1"], "mip"),
        (["SplatRenderMode: mip", "antialiased 0"], "classic"),  # the last of them
    ],
)
def test_the_pixel_filter_is_told_by_the_comments_of_other_programs(tmp_path, comments, expected):
    write_gaussians(tmp_path / "g.ply", some_gaussians())
    names, rows = table_of(tmp_path / "g.ply")
    write_table(tmp_path / "h.ply", names, rows)
    data = (tmp_path / "h.ply").read_bytes()
    comment_lines = "".join(f"comment {text}\n" for text in comments).encode()
    (tmp_path / "h.ply").write_bytes(data.replace(b"element", comment_lines + b"element", 1))
    assert read_gaussians(tmp_path / "h.ply").pixel_filter == expected


@pytest.mark.parametrize(
    ("old", "new"),
    [(b"ply\n", b"\xef\xbb\xbfply\n"), (b"element", b"comment end_header comes below\nelement"), (b"ply", b"ply\r")],
)
def test_byte_order_marks_comments_and_line_ends_change_nothing(tmp_path, old, new):
    write_gaussians(tmp_path / "g.ply", some_gaussians())
    whole = (tmp_path / "g.ply").read_bytes()
    (tmp_path / "g.ply").write_bytes(whole.replace(old, new, 1))
    np.testing.assert_array_equal(read_gaussians(tmp_path / "g.ply").means, some_gaussians().means)


SIGNALLING = np.array([0x7FA00000], np.uint32).view(np.float32)[0]  # A NaN that numpy warns of where it is cast.


def test_rows_that_are_not_finite_are_left_out_and_counted(tmp_path, capsys):
    gaussians = some_gaussians()
    gaussians.means[2, 1] = SIGNALLING
    gaussians.sh_rest[2, 1, 0] = np.inf
    gaussians.logit_opacities[5] = np.nan
    gaussians.log_scales[6] = np.inf
    write_gaussians(tmp_path / "g.ply", gaussians)
    assert_same(read_gaussians(tmp_path / "g.ply"), take(gaussians, np.array([0, 1, 3, 4])))
    message = f"{tmp_path / 'g.ply'}: 3 of 7 Gaussians hold values that are not finite; they are left out\n"
    assert capsys.readouterr().err == message
    gaussians.quats[:] = np.nan
    write_gaussians(tmp_path / "h.ply", gaussians)
    with pytest.raises(InputError, match=r"h.ply: 7 of 7 Gaussians hold values that are not finite$"):
        read_gaussians(tmp_path / "h.ply")


@pytest.mark.parametrize("third", ["absent", "minus infinity"])
def test_discs_of_2dgs_are_discs(tmp_path, capsys, third):
    gaussians = some_gaussians()
    gaussians.log_scales[:, 2] = -np.inf
    gaussians.log_scales[4] = -np.inf  # nothing at all
    write_gaussians(tmp_path / "g.ply", gaussians)
    names, rows = table_of(tmp_path / "g.ply")
    columns = [name for name in names if third != "absent" or name != "scale_2"]
    write_table(tmp_path / "d.ply", columns, rows[:, [names.index(name) for name in columns]])
    read = read_gaussians(tmp_path / "d.ply")
    assert "d.ply: 7 of 7 are discs, 0.0001 of their radius thick\n" in capsys.readouterr().err
    others = take(gaussians, np.arange(7) != 4)
    for field in ("means", "quats", "logit_opacities", "sh_dc", "sh_rest"):
        np.testing.assert_array_equal(getattr(read, field), getattr(others, field))
    np.testing.assert_array_equal(read.log_scales[:, :2], others.log_scales[:, :2])
    thin = np.exp(read.log_scales[:, 2] - others.log_scales[:, :2].min(axis=1))
    np.testing.assert_allclose(thin, 1e-4, rtol=1e-4)


@pytest.mark.parametrize(("kind", "most"), [("uchar", 255), ("ushort", 65535), ("float", 1)])
def test_colours_instead_of_harmonics(tmp_path, kind, most):
    """As nerfstudio's `--ply-color-mode rgb` writes them; programs write them as numbers of many types and ranges."""
    names = ["x", "y", "z", "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
    table = np.zeros(3, [(name, "<f4") for name in names] + [(c, PLY_TYPES[kind]) for c in ("red", "green", "blue")])
    table["rot_0"], table["x"] = 1, [1, 2, 3]
    table["red"], table["green"], table["blue"] = [0, most, 0], [most, 0, 0], [0, 0, most]
    lines = [f"property {'float' if name in names else kind} {name}" for name in table.dtype.names]
    head = ["ply", "format binary_little_endian 1.0", "element vertex 3", *lines, "end_header", ""]
    (tmp_path / "g.ply").write_bytes("\n".join(head).encode() + table.tobytes())
    colors = read_gaussians(tmp_path / "g.ply").sh_dc[:, 0] * SH_C0 + 0.5
    expected = [[0, 1, 0], [1, 0, 0], [0, 0, 1]]
    np.testing.assert_allclose(colors, expected, atol=1e-6)
    np.testing.assert_array_equal(read_points(tmp_path / "g.ply")[1], 255 * np.array(expected))


def test_what_is_no_ply_of_gaussians_is_named(tmp_path):
    write_gaussians(tmp_path / "g.ply", some_gaussians())
    whole = (tmp_path / "g.ply").read_bytes()
    for old, new, message in (
        (whole[-5:], b"", "truncated"),
        (b"float opacity", b"float more", "not a PLY of Gaussians, it lacks opacity$"),
        (b"f_rest_44", b"more", r"44 columns f_rest_\*"),
        (b"vertex 7", b"vertex 999999999999999999", "truncated, 999999999999999999 rows of 'vertex' need"),
        (b"property float y\n", b"property list uchar int y\n", r"not understood \(its vertices have lists"),
        (b"property float y\n", b"property int y\n", None),
    ):
        assert old in whole
        (tmp_path / "h.ply").write_bytes(whole.replace(old, new))
        if message is None:
            assert read_gaussians(tmp_path / "h.ply").num_gaussians == 7
            continue
        with pytest.raises(InputError, match=f"h.ply: .*{message}"):
            read_gaussians(tmp_path / "h.ply")
    with pytest.raises(InputError, match=r"none.ply: cannot be read"):
        read_gaussians(tmp_path / "none.ply")
    with pytest.raises(InputError, match="cannot write"):
        write_gaussians(tmp_path / "g.ply/h.ply", some_gaussians())


def test_opacities_of_0_and_1_get_logits_that_are_numbers(tmp_path):
    gaussians = some_gaussians()
    gaussians.logit_opacities[:3] = np.inf, -np.inf, 300
    write_gaussians(tmp_path / "g.ply", gaussians)
    logits = read_gaussians(tmp_path / "g.ply").logit_opacities
    np.testing.assert_array_equal(logits[2:], gaussians.logit_opacities[2:])
    assert np.isfinite(logits).all()
    np.testing.assert_array_equal(1 / (1 + np.exp(-logits[:2])), np.float32([1, np.exp(np.float32(-88))]))


@pytest.mark.parametrize("names", ["", "R G B", "scalar_Red scalar_Green scalar_Blue"])
def test_points_have_the_colours_of_other_names_or_are_grey_and_broken_ones_are_left_out(tmp_path, capsys, names):
    colors = [[0, 51, 255], [7, 7, 7], [255, 0, 102]] if names else [[], [], []]
    rows = np.c_[[[1, 2, 3], [np.nan, 0, 0], [4, 5, 6]], colors]
    write_table(tmp_path / "p.ply", ["x", "y", "z", *names.split()], rows)
    points, read = read_points(tmp_path / "p.ply")
    np.testing.assert_array_equal(points, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(read, colors[::2] if names else np.full((2, 3), 128))
    assert "p.ply: holds values that are not finite; 1 of 3 points is left out\n" in capsys.readouterr().err


def with_columns(path, **columns):
    """Adds columns of floats to a file of floats."""
    names, rows = table_of(path)
    write_table(path, [*names, *columns], np.column_stack([rows, *columns.values()]))


def normals(path):
    names, rows = table_of(path)
    return rows[:, [names.index(name) for name in ("nx", "ny", "nz")]].astype(np.float64)


@pytest.mark.parametrize("name", ["filter_3D", "filter3D"])
def test_a_3d_filter_is_fused(tmp_path, capsys, name):
    """Deviations s become sqrt(s^2 + f^2), opacities o become o * sqrt(det / det')."""
    gaussians = cloud(7)
    write_gaussians(tmp_path / "g.ply", gaussians)
    filters = np.random.default_rng(0).uniform(0, 0.3, 7)
    filters[0] = 0
    with_columns(tmp_path / "g.ply", **{name: filters})
    read = read_gaussians(tmp_path / "g.ply")
    scales = np.exp(np.asarray(gaussians.log_scales, np.float64))
    fused = np.sqrt(scales**2 + filters[:, None] ** 2)
    np.testing.assert_allclose(np.exp(read.log_scales), fused, rtol=2e-6)
    expected = expit(gaussians.logit_opacities) * np.sqrt((scales**2).prod(1) / (fused**2).prod(1))
    np.testing.assert_allclose(expit(read.logit_opacities), expected, rtol=2e-5)
    np.testing.assert_allclose(read.logit_opacities[0], gaussians.logit_opacities[0], rtol=1e-6)
    assert capsys.readouterr().err == f"{tmp_path / 'g.ply'}: {name} is fused into scales and opacities\n"


@pytest.mark.parametrize(("logit", "width"), [(88.0, 0.0), (88.0, 1e-20), (-88.0, 1e6)])
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
        (["f_offset_0", "f_anchor_feat_0"], "anchors of a network"),
    ],
)
def test_columns_that_change_the_meaning_are_refused_by_name(tmp_path, names, fault):
    write_gaussians(tmp_path / "g.ply", cloud(7))
    with_columns(tmp_path / "g.ply", **{name: np.zeros(7) for name in names})
    with pytest.raises(InputError, match=rf"g\.ply: holds .*{fault}"):
        read_gaussians(tmp_path / "g.ply")


def test_other_columns_are_named_once(tmp_path, capsys):
    gaussians = cloud(7)
    write_gaussians(tmp_path / "g.ply", gaussians)
    with_columns(tmp_path / "g.ply", roughness=np.ones(7), **{f"label_{i}": np.ones(7) for i in range(40)})
    for _ in range(2):
        np.testing.assert_array_equal(read_gaussians(tmp_path / "g.ply").log_scales, gaussians.log_scales)
    assert capsys.readouterr().err == f"{tmp_path / 'g.ply'}: columns that are not read: roughness, label_*\n"


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


@pytest.mark.parametrize(("kind", "far", "is_told"), [("f4", 4.5e6, True), ("f8", 4.5e6, False), ("f4", 0.0, False)])
def test_a_cloud_that_single_precision_has_put_on_a_grid_is_told(tmp_path, capsys, kind, far, is_told):
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3)) + [0, far, 0]
    lines = [f"property {'float' if kind == 'f4' else 'double'} {axis}" for axis in "xyz"]
    head = ["ply", "format binary_little_endian 1.0", "element vertex 50", *lines, "end_header", ""]
    file = tmp_path / f"{kind}.ply"
    file.write_bytes("\n".join(head).encode() + points.astype(f"<{kind}").tobytes())
    read_points(file)
    assert ("which there is a grid of 0.5; save them as doubles" in capsys.readouterr().err) == is_told
