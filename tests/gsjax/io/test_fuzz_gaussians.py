"""Damaged files of Gaussians and points: read, or refused in one line."""

import gzip
import json
import zipfile

import numpy as np
import pytest
from fuzzing import damaged, damaged_json, fuzz, fuzz_files
from small_scenes import cloud

from gsjax.gaussians import Gaussians
from gsjax.io.compressed_ply import read_compressed_ply, write_compressed_ply
from gsjax.io.ply import read_gaussians, read_points, write_gaussians
from gsjax.io.sog import read_sog, write_sog
from gsjax.io.spz import read_spz, write_spz


def write_sample(write, path):
    gaussians = cloud(20)
    write(path, Gaussians(**{**gaussians.__dict__, "sh_rest": np.zeros((20, 3, 3), np.float32)}))
    return path.read_bytes()


def check_finite(content):
    if isinstance(content, Gaussians):
        assert all(np.isfinite(values).all() for values in vars(content).values() if not isinstance(values, str))


@pytest.mark.parametrize(
    ("name", "write", "read"),
    [
        ("g.ply", write_gaussians, read_gaussians),
        ("p.ply", write_gaussians, read_points),
        ("g.compressed.ply", write_compressed_ply, read_compressed_ply),
        ("g.spz", write_spz, read_spz),
        ("g.sog", write_sog, read_sog),
    ],
)
def test_fuzz_files_of_gaussians(tmp_path, name, write, read):
    path = tmp_path / name
    write_sample(write, path)
    used, refused = fuzz_files(lambda: check_finite(read(path)), path, usual=80)
    assert refused
    assert used or name.endswith((".spz", ".sog")), "a checksum tells every damage of a packed file"


def test_fuzz_the_inside_of_spz(tmp_path):
    """What a checksum would else refuse before anybody looks."""
    path = tmp_path / "g.spz"
    whole = gzip.decompress(write_sample(write_spz, path))

    def attempt(random):
        path.write_bytes(gzip.compress(damaged(whole, random)))
        read_spz(path)

    assert all(fuzz(attempt, usual=80))


def test_fuzz_the_inside_of_sog(tmp_path):
    """Its images and its meta.json, in an archive whose checksums fit."""
    path = tmp_path / "g.sog"
    write_sample(write_sog, path)
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}

    def attempt(random):
        changed, name = dict(parts), random.choice(sorted(parts))
        is_meta = name == "meta.json"
        changed[name] = damaged_json(json.loads(parts[name]), random) if is_meta else damaged(parts[name], random)
        with zipfile.ZipFile(path, "w") as archive:
            for member, content in changed.items():
                archive.writestr(member, content)
        check_finite(read_sog(path))

    assert all(fuzz(attempt, usual=80))
