"""What two clicks change of a run, without a browser."""

from dataclasses import replace

import numpy as np
import pytest
from small_scenes import camera_at, plane

from gsjax.errors import InputError
from gsjax.io import json_files
from gsjax.io.gaussian_files import load_gaussians
from gsjax.io.ply import write_gaussians
from gsjax.runs.result import write_views
from gsjax.scene import Pixels, frame_of
from gsjax.similarity import Similarity
from gsjax.viewer import editing
from gsjax.viewer.editing import Edit, Editor
from gsjax.viewer.page import BACK, LENGTH, SPHERE, Page
from gsjax.viewer.subject import open_subject

ENDS = np.array([[0.0, 0.0, 4.0], [1.0, 0.0, 4.0]])


@pytest.fixture
def run(tmp_path):
    """A wall of Gaussians, 4 away from its two cameras."""
    cameras = [camera_at((x, 0.0, 0.0), (x, 0.0, 4.0), size=(24, 20)) for x in (-0.2, 0.3)]
    folder, image = tmp_path / "run", np.zeros((20, 24, 3), np.uint8)
    json_files.write(folder / "config.json", {"background": "white"})
    json_files.write(folder / "manifest.json", {"scene": "gone", "status": "done"})
    json_files.write(folder / "plan.json", {"phases": [], "steps": 1, "downscale": 2.0})
    write_gaussians(folder / "gaussians.ply", plane((0.0, 0.0, -1.0)))
    frames = [
        frame_of(f"{k}.jpg", np.asarray(c.viewmat), np.asarray(c.K), Pixels(image)) for k, c in enumerate(cameras)
    ]
    write_views(folder, tuple(frames))
    return folder


def test_a_length_between_two_clicks_brings_the_run_to_metres(run):
    before = open_subject(run)
    subject, line = Editor(run, None).scale(before, ENDS, "2.5 m")
    assert line == "2.5 m: all lengths are now 2.5 times as long, in metres."
    assert subject.is_in_metres and not before.is_in_metres
    np.testing.assert_allclose(subject.gaussians.means, before.gaussians.means, atol=1e-6)  # clicks stay right
    world = subject.similarity.points_to_world(ENDS)
    np.testing.assert_allclose(np.linalg.norm(world[1] - world[0]), 2.5, rtol=1e-6)
    np.testing.assert_allclose(load_gaussians(run).means, 2.5 * np.asarray(plane((0.0, 0.0, -1.0)).means), rtol=1e-5)


def test_a_sphere_is_about_the_first_click_through_the_second_in_the_world(run, monkeypatch):
    asked, told = [], {"gaussians": 7, "giants": 0, "floaters": 1, "crumbs": 2, "cropped": 3000}
    monkeypatch.setattr(editing, "clean", lambda source, **how: asked.append((source, how)) or told)
    shown = replace(open_subject(run), similarity=Similarity(0.25, (32.0, 0.0, -64.0)))
    _, line = Editor(run, None).keep_sphere(shown, ENDS)
    [(source, how)] = asked
    assert source == run and set(how) == {"sphere"}
    np.testing.assert_allclose(how["sphere"], [32, 0, 16 - 64, 4])
    assert line == "7 Gaussians are left; taken out: 0 giants, 1 floaters, 2 crumbs, 3,000 cropped."


def test_what_is_no_length_or_no_run_or_was_not_taken_out_is_one_line(run):
    editor, before = Editor(run, None), (run / "gaussians.ply").read_bytes()
    with pytest.raises(InputError, match="^long: not a length, such as 1.25m"):
        editor.scale(open_subject(run), ENDS, "long")
    with pytest.raises(InputError, match="nothing was taken out of it"):
        editor.bring_back()
    assert (run / "gaussians.ply").read_bytes() == before
    for other in (run / "gaussians.ply", run.parent):
        with pytest.raises(InputError, match="is no finished run, and --edit changes nothing else"):
            Editor(other, None)


def test_the_page_shows_what_became_of_the_run(run):
    class Other(Editor):
        def keep_sphere(self, subject, ends):
            return Edit(replace(subject, name="other"), f"from {ends[0].tolist()}")

    with Page(open_subject(run), host="127.0.0.1", port=0, editor=(editor := Other(run, None))) as page:
        assert LENGTH in page.switches
        page._edit(editor.keep_sphere, SPHERE)
        assert page._measured.content == "Measure first: two clicks on the surface."
        page._edit(lambda *_: editor.bring_back(), BACK)
        assert "nothing was taken out of it" in page._measured.content
        page.ruler.ends = ENDS
        page._edit(editor.keep_sphere, SPHERE)
        assert page._measured.content == "from [0.0, 0.0, 4.0]" and page.subject.name == "other"
        assert page.ruler.ends is None
