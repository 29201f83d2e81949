"""The tables of the paper's protocol report values, spreads, absent scenes and doubtful figures."""

import re

import pytest

METHOD = "gsjax paper_6k_15k, refined"


@pytest.fixture
def text(scripts):
    """Tables of hand-made scores: two seeds of truck and train, one run of kitchen, nothing of Deep Blending."""
    tables = scripts("paper.tables")
    scores = [("truck", 0, 24.0, 0.86), ("truck", 1, 25.0, 0.88), ("train", 0, 20.0, 0.74), ("train", 1, 22.0, 0.76),
              ("kitchen", 0, 30.125, 0.9)]  # fmt: skip
    measured = [tables.RunScore(scene, METHOD, seed, {"psnr": p, "ssim": s}) for scene, seed, p, s in scores]
    return tables.markdown(measured, [METHOD], {"truck": "truck: limited to 5% & 3_000 Gaussians."})


def row(text, block, method):
    """The cells of a method's row after its name, and the numbers of its notes."""
    lines = text[text.index(f"### {block}\n") :].splitlines()
    cells = next(line for line in lines if line.startswith(f"| {method}")).strip("| ").split(" | ")
    return cells[1:], re.findall(r"\d+", cells[0].removeprefix(method))


def test_averages_are_over_seeds_then_scenes_and_the_spread_over_seeds(text):
    (psnr, _, lpips, _, scenes, seeds, source), _ = row(text, "Tanks & Temples", METHOD)
    assert psnr == "22.75 ± 1.06", "seeds: 22.0 and 23.5"
    assert (lpips, scenes, seeds, source) == ("-", "2", "2", "measured")


def test_fewer_scenes_than_published_are_named_and_absent_ones_are_dashes(text):
    indoor, outdoor = (row(text, f"Mip-NeRF 360, {part}", METHOD)[0] for part in ("indoor", "outdoor"))
    assert (indoor[0], indoor[4:6]) == ("30.12", ["1 of 4 (kitchen)", "1"])
    assert outdoor == ["-", "-", "-", "-", "0 of 3", "-", "-"]
    assert row(text, "playroom", METHOD)[0][1] == "-"
    assert "0.000" not in text, "never a zero where there is nothing"


def test_published_rows_carry_source_and_doubts(text):
    cells, notes = row(text, "Mip-NeRF 360, indoor", "The paper")
    assert cells[:5] == ["29.87", "0.921", "0.117", "-", "4"]
    assert f"[{notes[0]}] The LPIPS of 0.117 is doubtful" in text
    assert row(text, "Deep Blending", "SuGaR")[0][-1] == "tab:deepblend of the paper, which quotes SuGaR's"
    assert row(text, "Tanks & Temples", "SuGaR")[1] == []
    assert "| The paper [1,2]" not in text, "notes are numbered in the order of the table"
