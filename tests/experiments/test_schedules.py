"""The paper's two budgets in small: what each stage is asked for, and that what is done is not done again."""

import pytest

import gsjax.pipeline
from gsjax.io import json_files
from gsjax.settings import total_steps


@pytest.fixture
def script(scripts):
    return scripts("schedules")


@pytest.fixture
def asked(script, monkeypatch):
    """What the pipeline is asked for; it scores its calls by their number."""
    calls = []

    def note(name):
        def stage(*arguments, **_):
            calls.append((name, arguments))
            return dict.fromkeys(script.FIGURES, float(len(calls)))

        return stage

    for name in ("train", "mesh", "refine", "evaluate"):
        monkeypatch.setattr(gsjax.pipeline, name, note(name))
    return calls


def test_both_budgets_have_their_share_of_every_stage(script, asked, tmp_path):
    (tmp_path / "scene/normals").mkdir(parents=True)
    rows = script.run(str(tmp_path / "scene"), str(tmp_path / "out"), share=0.1, seeds=2)
    trainings = [arguments[2] for name, arguments in asked if name == "train"]
    assert [[phase.steps for phase in settings.phases] for settings in trainings] == [
        [700, 200, 600], [700, 200, 1300]
    ] * 2  # fmt: skip
    assert [settings.seed for settings in trainings] == [0, 0, 1, 1]
    assert {settings.normals for settings in trainings} == {str(tmp_path / "scene/normals")}
    refinements = [arguments[2] for name, arguments in asked if name == "refine"]
    assert [(each.steps, each.keep_free) for each in refinements] == [(1500, False), (700, False)] * 2
    assert [total_steps(s) + r.steps for s, r in zip(trainings, refinements, strict=True)] == [3000, 2900] * 2
    assert [row["psnr"] for row in rows["paper_13k_7k, refined"]] == [10.0, 20.0]


def test_called_again_it_does_what_is_left(script, asked, tmp_path):
    folder = tmp_path / "paper_13k_7k_0"
    (folder / "run").mkdir(parents=True)  # Stopped in its training.
    json_files.write(tmp_path / "paper_6k_15k_0/schedule.json", {"trained": {"psnr": 30.0}})
    rows = script.run("scene", str(tmp_path), share=0.1)
    assert [name for name, _ in asked] == ["train", "mesh", "refine", "evaluate", "evaluate"]
    assert not (folder / "run").exists(), "the beginning of a run that was stopped is gone"
    assert list(rows) == ["paper_6k_15k, trained", "paper_13k_7k, trained", "paper_13k_7k, refined"]
