"""A scene in blocks: what is planned once, trained once, and merged into a run like any other."""

import importlib
import shutil
from pathlib import Path

import numpy as np
import pytest
from trained_run import SETTINGS

from gsjax import config
from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.ply import read_gaussians
from gsjax.runs.result import open_result, scene_of_run
from gsjax.settings import Settings

blocks = importlib.import_module("gsjax.pipeline.blocks")
WISHES = config.parse(Settings, SETTINGS)


@pytest.fixture
def trained(monkeypatch, run):
    """Blocks whose training leaves one whole run; `broken` numbers are those that a kill stops."""
    calls, broken = [], set()

    def train(scene, out, settings, *, resume):
        calls.append((out.name, Path(settings.photos.subset).read_text().split(), resume))
        if out.name in broken:
            out.mkdir()
            raise KeyboardInterrupt
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(run, out)

    monkeypatch.setattr(blocks, "train", train)
    monkeypatch.setattr(blocks, "FEWEST", 3)
    return calls, broken


def test_blocks_of_one_run_merge_to_that_run(trained, run, scene, tmp_path):
    calls, out = trained[0], tmp_path / "blocks"
    summary = blocks.blocks(scene, out, WISHES, 2)
    assert [name for name, *_ in calls] == ["block_1", "block_2"]
    names = {record["name"] for record in json_files.read(run / "cameras.json")}
    assert set(calls[0][1]) | set(calls[1][1]) == names

    whole, merged = read_gaussians(run / "gaussians.ply"), read_gaussians(out / "run/gaussians.ply")
    rows = [np.asarray(each.means)[np.lexsort(np.asarray(each.means).T)] for each in (whole, merged)]
    np.testing.assert_array_equal(*rows)
    manifest, expected = json_files.read(out / "run/manifest.json"), json_files.read(run / "manifest.json")
    assert manifest["status"] == "done" and manifest["psnr"] == pytest.approx(expected["psnr"], abs=1e-3)
    assert summary["psnr"] == manifest["psnr"] and summary["gaussians"] == expected["gaussians"]
    assert (out / "run/cameras.json").read_bytes() == (run / "cameras.json").read_bytes()
    assert len(open_result(out / "run").cameras) == len(scene_of_run(out / "run").frames) == len(names)


def test_what_is_trained_is_not_trained_again_and_what_was_stopped_goes_on(trained, scene, tmp_path):
    (calls, broken), out = trained, tmp_path / "blocks"
    assert blocks.blocks(scene, out, WISHES, 2, only=[2])["run"] is None
    assert [name for name, *_ in calls] == ["block_2"]
    broken.add("block_1")
    with pytest.raises(KeyboardInterrupt):
        blocks.blocks(scene, out, WISHES, 2)
    broken.clear()
    assert blocks.blocks(scene, out, WISHES, 2)["trained"] == 2
    assert [(name, resume) for name, _, resume in calls[1:]] == [("block_1", False), ("block_1", True)]
    before = (out / "run/manifest.json").read_bytes()
    blocks.blocks(scene, out, WISHES, 2)
    assert len(calls) == 3 and (out / "run/manifest.json").read_bytes() == before


def test_what_cannot_be_divided_is_refused_and_leaves_nothing(trained, scene, tmp_path):
    out = tmp_path / "blocks"
    with_poses = config.parse(Settings, config.merge(SETTINGS, {"effects": {"names": "poses"}}))
    for settings, count, fault in (
        (WISHES, 8, r"blocks=8: .*would have . photos to train on; make fewer"),
        (with_poses, 2, "effects=poses: what blocks find"),
    ):
        with pytest.raises(InputError, match=fault):
            blocks.blocks(scene, out, settings, count)
        assert not out.exists()
    blocks.blocks(scene, out, WISHES, 2, only=[1])
    with pytest.raises(InputError, match="was begun with another blocks"):
        blocks.blocks(scene, out, WISHES, 3)
    with pytest.raises(InputError, match="only=3: there are blocks 1 to 2"):
        blocks.blocks(scene, out, WISHES, 2, only=[3])
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/letter.txt").write_text("kept")
    with pytest.raises(InputError, match="mine: exists and is not empty; choose another folder"):
        blocks.blocks(scene, tmp_path / "mine", WISHES, 2)
