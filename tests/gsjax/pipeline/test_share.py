"""The shared page: what is inside comes back whole, and nothing that is named in it becomes a program."""

import json
import shutil
import subprocess
from base64 import b64decode
from html.parser import HTMLParser

import numpy as np
import pytest
from meshes import tetrahedron
from run_folders import write_run
from small_scenes import camera_at, cloud

from gsjax import cli, pipeline
from gsjax.io import json_files
from gsjax.io.spz import read_spz
from gsjax.meshing.export import read_mesh, write_mesh
from gsjax.pipeline.share import LIBRARIES

HOSTILE = "</script><script>alert(1)</script><!-- <b onload='x'>&\""


class Page(HTMLParser):
    """The elements of a page by their ids (else by their tags), and how many of each tag there are."""

    def __init__(self, text):
        super().__init__()
        self.texts, self.counts, self._open = {}, {}, "none"
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self._open = dict(attributes).get("id") or tag
        self.counts[tag] = self.counts.get(tag, 0) + 1

    def handle_data(self, data):
        self.texts[self._open] = self.texts.get(self._open, "") + data


@pytest.fixture
def run(tmp_path):
    """Of 30 Gaussians and 20 cameras, with a mesh, and photos that are named to do harm."""
    cameras = [camera_at((x, 0.0, 0.0), (0.0, 0.0, 4.0), size=(24, 20)) for x in np.linspace(-1, 1, 20)]
    folder = write_run(tmp_path / "run", cloud(30), cameras, prefix=HOSTILE)
    write_mesh(folder / "mesh.ply", tetrahedron())
    return folder


def test_what_is_inside_comes_back(run, tmp_path):
    figures = pipeline.share(run, tmp_path / "page.html", title=HOSTILE, sh_degree=0)
    text = (tmp_path / "page.html").read_text()
    assert figures["bytes"] == len(text.encode()) and figures["gaussians"] == 30 and figures["bookmarks"] == 12
    page = Page(text)
    (tmp_path / "inside.spz").write_bytes(b64decode(page.texts["splats"]))
    read, original = read_spz(tmp_path / "inside.spz"), cloud(30)
    assert read.sh_degree == 0 and read.pixel_filter == original.pixel_filter
    np.testing.assert_allclose(read.means, original.means, atol=1e-5)
    (tmp_path / "inside.glb").write_bytes(b64decode(page.texts["mesh"]))
    assert read_mesh(tmp_path / "inside.glb").num_faces == 4
    assert b64decode(page.texts["libraries"]) == LIBRARIES.read_bytes()
    view = json.loads(page.texts["view"])
    assert view["background"] == "#ffffff" and view["is_mip"] == (original.pixel_filter == "mip")
    first, last = view["bookmarks"][0], view["bookmarks"][-1]
    assert (first["name"], last["name"]) == (f"{HOSTILE}0.jpg", f"{HOSTILE}19.jpg")
    assert np.reshape(first["viewmat"], (4, 4)).T[:3, 3] == pytest.approx(
        camera_at((-1, 0, 0), (0, 0, 4)).viewmat[:3, 3]
    )
    assert first["slopes"] == pytest.approx([12 / 30, 10 / 33])
    np.testing.assert_allclose(view["up"], [0, -1, 0], atol=1e-6)


def test_titles_and_names_stay_text_and_a_far_run_is_shared_about_its_own_middle(run, tmp_path):
    """What saved paths and the mesh are brought by is in the page, in double precision."""
    similarity = {"scale": 0.25, "center": [5e6, -2e6, 300.0]}
    json_files.write(run / "manifest.json", {"scene": "nowhere", "similarity": similarity})
    pipeline.share(run, tmp_path / "page.html", title=HOSTILE)
    page = Page((tmp_path / "page.html").read_text())
    assert json.loads(page.texts["view"])["similarity"] == similarity
    assert page.texts["title"].strip() == page.texts["h1"].strip() == HOSTILE
    assert page.counts["script"] == 5 and "b" not in page.counts  # the view, three parts and the viewer
    assert "connect-src blob: data:" in (tmp_path / "page.html").read_text(), "no network"


def test_the_viewer_is_javascript(run, tmp_path):
    node = shutil.which("node") or pytest.skip("needs node")
    pipeline.share(run, tmp_path / "page.html")
    (tmp_path / "viewer.js").write_text(Page((tmp_path / "page.html").read_text()).texts["script"])
    subprocess.run([node, "--check", tmp_path / "viewer.js"], check=True)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--out", "page.txt"], "out=page.txt: a page ends in .html"),
        (["--out", "no/such/page.html", "--mesh", "no.ply"], "no.ply: "),
        (["--out", "page.html", "--sh-degree", "4"], "sh_degree=4 is not between 0 and 3"),
    ],
)
def test_what_cannot_be_shared_is_one_line(run, tmp_path, monkeypatch, capsys, options, message):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["share", "run", *options]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.glob("*.html"))
