import json
from pathlib import Path

import numpy as np
import pytest
from small_scenes import angles, camera_at, plane
from tolerances import assert_close

from gsjax.errors import InputError
from gsjax.io import normal_folders
from gsjax.runs import normal_source
from gsjax.runs.normal_filter import filter_normals
from gsjax.runs.normal_source import NormalSource, read_map, write_map
from gsjax.scene import Pixels, frame_of

NORMAL = np.array([0.5, -0.3, -1]) / np.linalg.norm([0.5, -0.3, -1])
EYES = [(0.0, 0.0, 0.0), (0.2, 0.0, 0.1), (-0.1, 0.2, 0.0)]
CAMERAS = [camera_at(eye, np.add(eye, (0, 0, 1)), size=(40, 32)) for eye in EYES]
PHOTO = Pixels(np.zeros((32, 40, 3), np.uint8))
FRAMES = tuple(
    frame_of(name, np.asarray(c.viewmat), np.asarray(c.K), PHOTO)
    for name, c in zip(("left/a.jpg", "b.jpg", "c.jpg"), CAMERAS, strict=True)
)


@pytest.fixture(scope="module")
def tilted():
    return plane(NORMAL)


@pytest.fixture
def foreign(tmp_path):
    """Maps of a plane straight ahead or tilted, mirrored."""

    def write(normal, signs) -> str:
        for frame in FRAMES:
            file = (tmp_path / "foreign" / frame.name).with_suffix(".npy")
            file.parent.mkdir(parents=True, exist_ok=True)
            np.save(file, np.tile(np.float32(normal) * np.float32(signs), (32, 40, 1)))
        return str(tmp_path / "foreign")

    return write


def directions(rng):
    normals = rng.normal(size=(32, 40, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[:8] = 0
    normals[8, :6] = np.concatenate([np.eye(3), -np.eye(3)])
    return normals.astype(np.float32)


def test_a_map_on_disk_is_the_map_in_eight_bits_and_a_zero_stays_one(tmp_path):
    normals = directions(np.random.default_rng(0))
    write_map(tmp_path / "b.png", normals)
    stored = read_map(tmp_path / "b.png", FRAMES[1])
    assert stored.dtype == np.int8
    assert np.all(stored[:8] == 0)
    assert angles(stored[8:], normals[8:]).max() < 0.4


def test_own_normals_are_those_of_the_surface_and_a_killed_run_ends_with_the_same_bits(tilted, tmp_path, monkeypatch):
    whole = NormalSource(tmp_path / "whole", None, None, FRAMES)(tilted, FRAMES)
    for normals in whole:
        has_normal = np.any(normals, axis=-1)
        assert has_normal.mean() > 0.9
        assert angles(normals[has_normal], NORMAL).mean() < 3

    def killed(file: Path, normals):
        if file.name == "b.png":
            raise KeyboardInterrupt
        write_map(file, normals)

    with monkeypatch.context() as patched:
        patched.setattr(normal_source, "write_map", killed)
        with pytest.raises(KeyboardInterrupt):
            NormalSource(tmp_path / "run", None, None, FRAMES)(tilted, FRAMES)
    first = tmp_path / "run/normals/left/a.png"
    before = first.stat().st_mtime_ns
    np.testing.assert_array_equal(NormalSource(tmp_path / "run", None, None, FRAMES)(tilted, FRAMES), whole)
    assert first.stat().st_mtime_ns == before
    np.testing.assert_array_equal(NormalSource(tmp_path / "run", None, None, FRAMES)(None, FRAMES), whole)


def test_foreign_maps_are_turned_to_our_axes(tilted, foreign, tmp_path, capsys):
    maps = NormalSource(tmp_path / "run", foreign(NORMAL, (1, -1, -1)), None, FRAMES)(tilted, FRAMES)
    assert angles(np.stack(maps), NORMAL).max() < 0.4
    assert "axes read as " in capsys.readouterr().err


def test_where_views_cannot_tell_the_convention_stays_and_a_line_says_so(foreign, tmp_path, capsys):
    """Straight ahead all mirrorings but one look the same, and that one faces away."""
    wall = plane((0, 0, -1))
    maps = NormalSource(tmp_path / "run", foreign((0, 0, -1), (1, 1, -1)), None, FRAMES)(wall, FRAMES)
    np.testing.assert_array_equal(np.stack(maps)[..., 2], 127)
    assert "axes taken as +x+y+z: -x-y-z is doubtful" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("signs", "line"),
    [
        ((1, 1, 1), "axes confirmed as in moge2's record (mean cosine "),
        ((1, -1, -1), "axes kept as in moge2's record: +x-y-z fits better (mean cosine "),
    ],
)
def test_axes_of_a_network_stay_and_the_comparison_confirms_or_doubts_them(tilted, tmp_path, capsys, signs, line):
    folder = tmp_path / "scene/normals_moge2"
    folder.mkdir(parents=True)
    manifest = normal_folders.begin(folder, {"network": "moge2"})
    for frame in FRAMES:
        normals = np.tile(np.float32(NORMAL) * np.float32(signs), (32, 40, 1))
        normal_folders.add(folder, manifest, frame.name, Path(frame.name).with_suffix(".npz"), normals, {})
    maps = NormalSource(tmp_path / "run", str(folder), None, FRAMES)(tilted, FRAMES)
    assert angles(np.stack(maps), NORMAL * signs).max() < 0.4
    assert line in capsys.readouterr().err


def test_axes_without_maps_or_that_are_none_are_refused_before_the_run_begins(foreign, tmp_path):
    with pytest.raises(InputError, match=r"normal_axes=opengl: there are no maps .* .supervision.normals"):
        NormalSource(tmp_path / "run", None, "opengl", FRAMES)
    with pytest.raises(InputError, match=r"normal_axes=up: expected three signs"):
        NormalSource(tmp_path / "run", foreign(NORMAL, (1, 1, 1)), "up", FRAMES)
    assert not (tmp_path / "run").exists()


def test_the_filter_scales_inconsistent_normals_and_runs_once(tilted, tmp_path):
    maps = NormalSource(tmp_path, None, None, FRAMES)(tilted, FRAMES)
    wrong = [m.copy() for m in maps]
    wrong[0][8:20, 8:20] = np.int8([0, -127, 0])
    lines = []
    gated = filter_normals(tmp_path / "normals", tilted, FRAMES, wrong, "plane", notify=lines.append)
    lengths = [np.linalg.norm(m.astype(np.float32), axis=-1) / 127 for m in gated]
    assert lengths[0][9:19, 9:19].max() < 0.1 and lengths[0][22:28, 22:36].min() > 0.9
    assert all(length[np.any(m, -1)].mean() > 0.95 for length, m in zip(lengths[1:], maps[1:], strict=True))
    again = filter_normals(tmp_path / "normals", None, FRAMES, wrong, "plane", notify=lines.append)
    np.testing.assert_array_equal(again, gated)
    (line,) = lines
    assert line.endswith("cannot be judged: 0 photos show enough of others from another direction")
    verdict = json.loads((tmp_path / "normals/gate.json").read_text())
    assert verdict["kept"] and [*verdict["photos"]] == [frame.name for frame in FRAMES]


def test_stereo_normals_serve_where_no_maps_are_given_or_these_are_rejected(tilted, foreign, tmp_path, monkeypatch):
    def reject_first(folder, gaussians, frames, maps, depth_mode, *, keep, notify):
        notify("no normal has weight")
        return [np.zeros_like(maps[0]), *maps[1:]]

    monkeypatch.setattr(normal_source, "filter_normals", reject_first)
    half = np.zeros((16, 20, 3), np.int8)
    half[:, 10:] = [0, 0, -127]
    whole, lines = half.repeat(2, axis=0).repeat(2, axis=1), []
    stereo = dict.fromkeys((FRAMES[0].name, FRAMES[1].name), half)
    how = {"gated": True, "stereo": stereo, "notify": lines.append}
    source = NormalSource(tmp_path / "without", None, None, FRAMES, **how)
    np.testing.assert_array_equal(source(tilted, FRAMES), [whole, whole, 0 * whole])
    assert not lines, "stereo normals are not filtered"
    assert_close(source.shares_compared(FRAMES), np.ones(3))
    source = NormalSource(tmp_path / "run", foreign((1, 0, 0), (1, 1, 1)), "+x+y+z", FRAMES, **how)
    map_normals = np.broadcast_to(np.int8([127, 0, 0]), whole.shape)
    np.testing.assert_array_equal(source(tilted, FRAMES), [whole, map_normals, map_normals])
    assert lines == ["no normal has weight; rejected photos take stereo normals"]


def test_own_normals_are_compared_as_often_as_their_verdict_says(tilted, foreign, tmp_path, monkeypatch):
    """Runs with maps of a network use them in all steps."""

    def leave_verdict(folder, gaussians, frames, maps, depth_mode, *, keep, notify):
        photos = {frame.name: {"apart": degrees} for frame, degrees in zip(frames, (23.0, None, 40.0), strict=True)}
        (folder / "gate.json").write_text(json.dumps({"photos": photos}))
        notify("they agree")
        return maps

    monkeypatch.setattr(normal_source, "filter_normals", leave_verdict)
    lines, how = [], {"gated": True, "notify": lambda line: lines.append(line)}
    own = NormalSource(tmp_path / "own", None, None, FRAMES, **how)
    of_network = NormalSource(tmp_path / "run", foreign(NORMAL, (1, 1, 1)), "+x+y+z", FRAMES, **how)
    for source, expected in ((own, [0.2, 1.0, 0.0]), (of_network, [1.0, 1.0, 1.0])):
        source(tilted, FRAMES)
        assert_close(source.shares_compared(FRAMES), np.array(expected))
    assert lines == ["they agree; 40% of the comparisons of neighbours are made", "they agree"]
    (tmp_path / "own/normals/gate.json").write_text('{"photos": {"b.jpg": {}, "c.jpg": {}}}')
    with pytest.raises(InputError, match=r"gate\.json: .*lacks 'photos.left/a.jpg'"):
        own.shares_compared(FRAMES)
