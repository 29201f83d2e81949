"""The tables of the paper's protocol report values, spreads, absent scenes and doubtful figures."""

import re

import pytest

METHOD = "gsjax paper_6k_15k, refined"


@pytest.fixture
def tables(scripts):
    """Tables of hand-made scores: two seeds of truck and train, one run of kitchen, nothing of Deep Blending."""
    RunScore, report = scripts("paper.measured").RunScore, scripts("paper.report")
    scores = {("truck", 0): (24.0, 0.86), ("truck", 1): (25.0, 0.88), ("train", 0): (20.0, 0.74),
              ("train", 1): (22.0, 0.76), ("kitchen", 0): (30.125, 0.9)}  # fmt: skip
    measured = [RunScore(scene, METHOD, seed, *pair, None, 9) for (scene, seed), pair in scores.items()]
    return report.tables(measured, [METHOD], {"truck": "truck: limited to 5% & 3_000 Gaussians."})


def rows_of(tables):
    blocks = [block for table in tables for block in (*table.averages, *table.scenes)]
    return {(block.title, row.method): row for block in blocks for row in block.rows}


def test_averages_are_over_seeds_then_scenes_and_the_spread_over_seeds(tables):
    row = rows_of(tables)["Tanks & Temples", METHOD]
    assert row.values["psnr"].mean == pytest.approx((24.5 + 21) / 2)
    assert row.values["psnr"].spread == pytest.approx(1.5 / 2**0.5)  # seeds: 22.0 and 23.5
    assert (row.values["lpips"], row.scenes, row.seeds) == (None, "2", "2")


def test_fewer_scenes_than_published_are_named_and_absent_ones_are_dashes(scripts, tables):
    rows = rows_of(tables)
    indoor, outdoor = rows["Mip-NeRF 360, indoor", METHOD], rows["Mip-NeRF 360, outdoor", METHOD]
    assert (indoor.scenes, indoor.values["psnr"].spread, indoor.seeds) == ("1 of 4 (kitchen)", None, "1")
    assert (outdoor.scenes, outdoor.values["psnr"], outdoor.source) == ("0 of 3", None, "-")
    assert rows["playroom", METHOD].values["ssim"] is None
    assert "0.000" not in scripts("paper.report").markdown(tables), "never a zero where there is nothing"


def test_published_rows_carry_source_and_doubts(scripts, tables):
    rows = rows_of(tables)
    row = rows["Mip-NeRF 360, indoor", "The paper"]
    assert row.values["lpips"].mean == 0.117 and "0.117 is doubtful" in " ".join(row.notes)
    assert rows["Deep Blending", "SuGaR"].source == "tab:deepblend of the paper, which quotes SuGaR's"
    assert rows["Tanks & Temples", "SuGaR"].notes == ()
    text = scripts("paper.report").markdown(tables)
    assert "| The paper [1,2]" not in text, "notes are numbered in the order of the table"
    mark = re.search(r"\| The paper \[(\d+),(\d+)\] \| 29.87 \| 0.921 \| 0.117 \| - \| 4 \|", text)
    assert mark and f"[{mark[1]}] The LPIPS of 0.117 is doubtful" in text
