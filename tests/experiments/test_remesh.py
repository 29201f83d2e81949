"""Other meshes of runs that are trained: what every variant is made of, and that nothing is made twice."""

from pathlib import Path
from types import SimpleNamespace

import pytest

import gsjax
import gsjax.pipeline
from gsjax import config, tables
from gsjax.binding.refining import PRESETS, Refinement
from gsjax.errors import InputError
from gsjax.io import json_files

STUDIES = ["methods", "length"]


@pytest.fixture
def remesh(scripts):
    return scripts("remesh")


@pytest.fixture
def asked(monkeypatch):
    """What the pipeline is asked for; it scores its calls by their number."""
    calls = []

    def evaluate(folder, *, mesh):
        calls.append(("evaluate", folder, mesh))
        return {"psnr": float(len(calls)), "views": 2, "floor": {"chamfer": 1e-4, "threshold": 0.03}}

    monkeypatch.setattr(
        gsjax,
        "pipeline",
        SimpleNamespace(
            mesh=lambda run, out, **options: calls.append(("mesh", run, options)),
            refine=lambda run, out, settings, *, mesh: calls.append(("refine", run, settings, mesh)),
            evaluate=evaluate,
        ),
    )
    return calls


@pytest.fixture
def trained(tmp_path):
    """Two runs, of seeds 3 and 4."""
    folders = [tmp_path / f"run_{seed}" for seed in (3, 4)]
    for folder in folders:
        json_files.write(folder / "config.json", {"seed": int(folder.name[-1])})
    return [str(folder) for folder in folders]


def test_a_refinement_has_the_runs_seed_and_meshes_are_shared(remesh, asked, trained, tmp_path):
    rows = remesh.run("length", trained, str(tmp_path / "out"))
    assert [Path(run).name for name, run, *_ in asked if name == "mesh"] == ["run_3", "run_4"]
    refinements = [call[2:] for call in asked if call[0] == "refine"]
    assert [(settings.seed, settings.steps) for settings, _ in refinements] == [
        (seed, PRESETS[name]["steps"]) for seed in (3, 4) for name in ("fast", "balanced")
    ]
    assert len({mesh for _, mesh in refinements}) == 2
    scored = [(Path(run).name, Path(mesh).parent.name) for name, run, mesh in (c for c in asked if len(c) == 3)
              if name == "evaluate"]  # fmt: skip
    assert (
        scored
        == [("run_3", "meshes")] + [("refined", "refined")] * 3 + [("run_4", "meshes")] + [("refined", "refined")] * 3
    )
    assert [row["psnr"] for row in rows["free"]] == [2.0, 10.0]
    assert rows[tables.FLOOR] == [{"chamfer": 1e-4}]


def test_called_again_it_makes_nothing_twice(remesh, asked, trained, tmp_path):
    first = remesh.run("methods", trained, str(tmp_path / "out"))
    done = len(asked)
    assert remesh.run("methods", trained, str(tmp_path / "out")) == first
    assert len(asked) == done
    (tmp_path / "out/depth_run_4/remesh.json").unlink()  # Stopped before its scores.
    remesh.run("methods", trained, str(tmp_path / "out"))
    assert [name for name, *_ in asked[done:]] == ["evaluate"], "its mesh was whole"


def test_figures_of_other_runs_are_not_taken_for_these(remesh, asked, trained, tmp_path):
    remesh.run("methods", trained[:1], str(tmp_path / "out"))
    other = tmp_path / "elsewhere/run_3"
    other.mkdir(parents=True)
    with pytest.raises(InputError, match=r"remesh\.json: is of the run .*, not of .*elsewhere/run_3; --out takes"):
        remesh.run("methods", [str(other)], str(tmp_path / "out"))
    with pytest.raises(InputError, match="two runs have one name"):
        remesh.run("methods", [trained[0], str(other)], str(tmp_path / "new"))


@pytest.mark.parametrize("study", STUDIES)
def test_every_study_parses_and_no_two_of_its_variants_are_the_same(remesh, study):
    variants = remesh.variants_of(study)
    parsed = []
    for name, asked in variants.items():
        refined = config.parse(Refinement, asked["refine"], where=name) if "refine" in asked else None
        parsed.append(str((asked.get("mesh", {}), refined and config.to_dict(refined))))
    assert len(set(parsed)) == len(parsed)
    assert set().union(*map(set, variants.values())) <= {"mesh", "refine"}


def test_presets_are_compared_as_they_are(remesh):
    variants = remesh.variants_of("length")
    assert {name: asked["refine"] for name, asked in variants.items() if asked} == {
        name: PRESETS[name] for name in ("fast", "balanced")
    }
